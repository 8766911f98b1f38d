"""Who sees whom: domains of one's own, and sockets of this machine only."""

from __future__ import annotations

import multiprocessing
import os
import re
import socket
import subprocess
import sys
import uuid
from pathlib import Path
from typing import Any

import pytest

from bike_sim.ros import isolation
from bike_sim.ros.topics import TOPICS

PATIENCE = 90.0
"""Longest wait for anything, s."""
DOMAIN_COUNT = isolation.LAST_DOMAIN - isolation.FIRST_DOMAIN + 1


@pytest.fixture
def family() -> str:
    """Leases of the test's own, which take nobody's domains."""
    return f"test_{uuid.uuid4().hex}"


# ------------------------------------------------------------------------------------------------------------- domains


def _lease(family: str, ready: multiprocessing.Queue, end: multiprocessing.Event) -> None:
    with isolation.DomainLease(family) as lease:
        ready.put(lease.domain_id)
        end.wait(PATIENCE)


def test_processes_get_domains_of_their_own_and_give_them_back(family: str) -> None:
    context = multiprocessing.get_context("fork")
    ready, end = context.Queue(), context.Event()
    workers = [context.Process(target=_lease, args=(family, ready, end)) for _ in range(4)]
    for worker in workers:
        worker.start()
    domains = {ready.get(timeout=PATIENCE) for _ in workers}
    with isolation.DomainLease(family) as lease:
        domains.add(lease.domain_id)
        assert len(domains) == 5
        assert all(isolation.FIRST_DOMAIN <= d <= isolation.LAST_DOMAIN for d in domains)
    end.set()
    for worker in workers:
        worker.join(PATIENCE)
    leases = [isolation.DomainLease(family) for _ in range(DOMAIN_COUNT)]
    with pytest.raises(OSError, match="all ROS domains"):
        isolation.DomainLease(family)
    for taken in leases:
        taken.close()


NOBODY = 65534
"""A user and a group without rights."""


def _lease_twice_as_nobody(family: str, drawn: multiprocessing.Queue) -> None:
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)
    leases = []
    for _ in range(2):
        try:
            leases.append(isolation.DomainLease(family))
            drawn.put(leases[-1].domain_id)
        except OSError as error:
            drawn.put(str(error))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_two_users_never_draw_the_same_domain(family: str) -> None:
    """Another user's lease counts as well as one's own."""
    leases = [isolation.DomainLease(family) for _ in range(DOMAIN_COUNT)]
    leases[17].close()
    context = multiprocessing.get_context("fork")
    drawn = context.Queue()
    other = context.Process(target=_lease_twice_as_nobody, args=(family, drawn))
    other.start()
    first, second = drawn.get(timeout=PATIENCE), drawn.get(timeout=PATIENCE)
    other.join(PATIENCE)
    assert first == leases[17].domain_id
    assert "all ROS domains from 1 to 101 are taken" in second
    for lease in leases:
        lease.close()


def test_a_domain_with_nodes_that_nobody_leased_is_avoided(family: str) -> None:
    """As nodes that were started by hand."""
    with isolation.DomainLease(family) as lease:
        drawn = lease.domain_id
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as node:
        node.bind(("127.0.0.1", isolation.FIRST_PORT + isolation.PORTS_PER_DOMAIN * drawn + 10))
        with isolation.DomainLease(family) as lease:
            assert lease.domain_id != drawn
        leases = [isolation.DomainLease(family) for _ in range(DOMAIN_COUNT)]  # rather that one than none
        for taken in leases:
            taken.close()


# ----------------------------------------------------------------------------------------------------------- discovery


def prepared(**environment: str) -> dict[str, str]:
    isolation.prepare_discovery(environment)
    return environment


def test_discovery_is_local_and_fast_unless_the_user_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    discovery, profiles = isolation.DISCOVERY_VARIABLE, isolation.PROFILES_VARIABLE
    closed = {discovery: "SYSTEM_DEFAULT", profiles: str(isolation.THIS_MACHINE)}
    opened = {discovery: "SUBNET", profiles: str(isolation.NETWORK)}
    assert prepared() == closed
    assert prepared(**{discovery: "LOCALHOST"}) == closed
    assert prepared(**{discovery: "SUBNET"}) == opened
    # Inherited from a program of this project, with and without a change by the user.
    assert prepared(**closed) == closed
    assert prepared(**closed | {discovery: "SUBNET"}) == opened
    assert prepared(**{discovery: "SUBNET", profiles: "own.xml"}) == {discovery: "SUBNET", profiles: "own.xml"}
    assert prepared(**{profiles: "own.xml"}) == {discovery: "LOCALHOST", profiles: "own.xml"}
    for middleware in ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp"):
        assert prepared(RMW_IMPLEMENTATION=middleware) == closed | {"RMW_IMPLEMENTATION": middleware}
    # Others do not read the settings, and would take SYSTEM_DEFAULT for the whole network.
    other = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    assert prepared(**other) == other | {discovery: "LOCALHOST"}
    (tmp_path / isolation.LOCAL_PROFILES).touch()
    assert prepared() == {discovery: "LOCALHOST"}
    assert isolation.THIS_MACHINE.is_file()
    assert isolation.NETWORK.is_file()


FINDS = """
import sys, time, rclpy
rclpy.init()
node = rclpy.create_node("finder")
end = time.monotonic() + float(sys.argv[1])
wanted = {"/bike/state", "/bike/course", "/bike/events", "/clock"}
while time.monotonic() < end and not wanted <= dict(node.get_topic_names_and_types()).keys():
    time.sleep(0.02)
print(" ".join(sorted(wanted & dict(node.get_topic_names_and_types()).keys())))
"""

SHELL_SPIN_TIME = 10.0
"""What docs/reference/ros.md says to give `ros2` with --spin-time, s, and twice as much again for a busy machine."""


@pytest.mark.ros
def test_a_shell_with_the_documented_variables_finds_the_topics(ros: Any) -> None:
    sender, wanted = ros.sender(), ("/bike/course", "/bike/events", "/bike/state", "/clock")
    for topic in wanted:
        sender.create_publisher(TOPICS[topic.removeprefix("/bike/")].kind, topic, 1)
    clean = {name: value for name, value in os.environ.items() if not re.match(r"ROS_|FASTRTPS|FASTDDS|RMW_", name)}
    exports = subprocess.run(
        [sys.executable, "-m", "bike_sim.ros.isolation"], env=clean, capture_output=True, text=True, check=True
    ).stdout
    assert exports.count("export ") == 2
    shell = f'{exports}\nexport ROS_DOMAIN_ID={ros.domain}\nexec "$PYTHON" -c "$FINDS" {SHELL_SPIN_TIME}'
    environment = clean | {"PYTHON": sys.executable, "FINDS": FINDS}
    found = subprocess.run(["sh", "-c", shell], env=environment, capture_output=True, text=True, check=True).stdout
    assert found.split() == [*wanted]


@pytest.mark.parametrize("name", ["this_machine.xml", "network.xml"])
def test_settings_of_both_generations_of_fast_dds_are_the_same(name: str) -> None:
    folder = isolation.NETWORK.parents[0 if isolation.NETWORK.parent.name == "middleware" else 1]
    second, third = ((path / name).read_text(encoding="utf-8") for path in (folder, folder / "fastdds3"))
    assert third == second.replace("heartbeatPeriod", "heartbeat_period")
