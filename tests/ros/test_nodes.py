"""The three nodes of a ride: what docs/reference/ros.md says of them, their sockets, and their end."""

from __future__ import annotations

import os
import re
import resource
import signal
import socket
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from bike_sim.ros import node_tools
from tests.ros.conftest import Program, RosFixture, StateProbe

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reference" / "ros.md").read_text()
NODES = ("sim_node", "drive", "record")
EVERY_NODE_HAS = ("/rosout", "/parameter_events")
ONLY_WITH = {"/tf", "/bike/telemetry", "/bike/grip", "/bike/disturbances", "/bike/opponents", "/bike/estimated_state"}
"""Published where tf2_msgs is installed, which the wheels do not bring, with a superbike (two), in a disturbed
ride, in a race, and beside an estimator."""


def table(heading: str) -> list[list[str]]:
    """Cells of the first table below a heading, without its head."""
    _, found, rest = PAGE.partition(f"\n{heading}\n")
    assert found, f"docs/reference/ros.md has no heading {heading!r}"
    lines = iter(rest.splitlines())
    for line in lines:
        assert not line.startswith("#"), f"no table below {heading!r}"
        if line.startswith("|---"):
            break
    rows = []
    for line in lines:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


PROFILES = {name: profile for name, profile in vars(node_tools).items() if isinstance(profile, QoSProfile)}


def profile_row(name: str, profile: QoSProfile) -> list[str]:
    """The row that belongs to a QoS profile."""
    reliability = "reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best effort"
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return [f"`{name}`", reliability, "transient local" if latched else "volatile", f"keep last {profile.depth}"]


def test_profiles_are_those_of_the_code() -> None:
    rows = [row[:4] for row in table("### QoS")]
    assert sorted(rows) == sorted(profile_row(name, profile) for name, profile in PROFILES.items())


def same_qos(profile: QoSProfile, offered: QoSProfile) -> bool:
    """Whether two profiles agree in what discovery carries."""
    return (profile.reliability, profile.durability) == (offered.reliability, offered.durability)


def publishers(probe: Any) -> dict[str, tuple[str, set[str]]]:
    """Type of each topic, and which of the nodes publish it."""
    found: dict[str, tuple[str, set[str]]] = {}
    for node in NODES:
        for topic, kinds in probe.get_publisher_names_and_types_by_node(node, "/bike"):
            if topic not in EVERY_NODE_HAS:
                found.setdefault(topic, (kinds[0].replace("/msg/", "/"), set()))[1].add(node)
    return found


def check_topics(probe: Any) -> None:
    rows = {row[0].strip("`"): row for row in table("## Topics")}
    documented = {topic: (row[1], set(row[3].split(", "))) for topic, row in rows.items()}
    perhaps = {topic: documented[topic] for topic in ONLY_WITH}
    probe.until_equal(lambda: perhaps | publishers(probe), documented)
    for topic in publishers(probe):
        for end in probe.get_publishers_info_by_topic(topic):
            profile = PROFILES[rows[topic][2].strip("`")]
            assert end.node_name not in NODES or same_qos(profile, end.qos_profile), topic

    def heard() -> set[str]:
        nodes = (node for node in NODES if node != "record")  # which hears everything
        return {topic for node in nodes for topic, _ in probe.get_subscriber_names_and_types_by_node(node, "/bike")}

    probe.until(lambda: {"/bike/state", "/bike/command", "/bike/course"} <= heard())
    assert heard() - set(EVERY_NODE_HAS) <= set(documented)


def check_services(probe: Any) -> None:
    def found() -> set[tuple[str, str, str]]:
        return {
            (f"`{service}`", kinds[0].replace("/srv/", "/"), node)
            for node in NODES
            for service, kinds in probe.get_service_names_and_types_by_node(node, "/bike")
            if not kinds[0].startswith(("rcl_interfaces/", "type_description_interfaces/"))
        }

    probe.until_equal(found, {tuple(row[:3]) for row in table("## Services")})


def check_diagnostics(probe: Any) -> None:
    part = PAGE.partition("\n## Diagnostics\n")[2].partition("\n## ")[0]
    explained = {
        node: set(re.findall(r"`(\w+)`", names)) for node, names in re.findall(r"^- (\w+):((?:.|\n  )+)", part, re.M)
    }
    probe.until_equal(
        lambda: {node: {entry.key for entry in sent[-1].values} for node, sent in probe.statuses.items()}, explained
    )


class Nodes(NamedTuple):
    programs: list[Program]
    probe: StateProbe
    recording: Path


@pytest.fixture(scope="module")
def nodes(shared_ros: RosFixture, policy: str, tmp_path_factory: pytest.TempPathFactory) -> Nodes:
    """A ride that goes on: simulator, recorder and policy."""
    recording = tmp_path_factory.mktemp("nodes") / "ride.mcap"
    programs = [
        shared_ros.simulator(course="circle"),
        shared_ros.start("bike_sim.ros.record", path=str(recording), notes=["policy=linear"]),
        shared_ros.start("bike_policy.drive", policy=policy),
    ]
    probe = shared_ros.probe()
    probe.until(lambda: probe.records("state", "command", "course", "course_points"))
    return Nodes(programs, probe, recording)


@pytest.mark.ros
def test_topics_services_and_diagnostics_are_those_of_the_nodes(nodes: Nodes) -> None:
    probe = nodes.probe
    probe.until(lambda: {name for name, _ in probe.get_node_names_and_namespaces()} >= set(NODES))
    check_topics(probe)
    check_services(probe)
    check_diagnostics(probe)


def udp_addresses(process: int) -> set[str]:
    """Return the addresses at which a process has UDP sockets."""
    folder = Path("/proc") / str(process)
    links = [os.readlink(link) for link in (folder / "fd").iterdir() if link.is_symlink()]
    inodes = {found[1] for link in links if (found := re.fullmatch(r"socket:\[(\d+)\]", link))}
    addresses = set()
    for name in ("udp", "udp6"):
        table = folder / "net" / name
        for line in table.read_text().splitlines()[1:] if table.exists() else ():
            fields = line.split()
            if fields[9] in inodes:
                number = bytes.fromhex(fields[1].partition(":")[0])
                addresses.add(socket.inet_ntoa(number[::-1]) if len(number) == 4 else number.hex())
    return addresses


@pytest.mark.ros
def test_nodes_use_sockets_of_this_machine_only(nodes: Nodes) -> None:
    for program in nodes.programs:
        assert udp_addresses(program.process.pid) == {"127.0.0.1"}
        assert not re.findall(r"/dev/shm/\S*fast\S*", Path(f"/proc/{program.process.pid}/maps").read_text())
    assert udp_addresses(os.getpid()) <= {"127.0.0.1"}


def processor_time(pid: int) -> float:
    """Return the processor time that a process has taken so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.ros
def test_all_programs_end_within_two_seconds_and_close_their_files(nodes: Nodes) -> None:
    """Seconds of the processor, since other work may share the machine."""
    programs, probe, recording = nodes
    step = probe.states[-1].step
    probe.until(lambda: probe.states[-1].step > step + 40)
    ended_before = resource.getrusage(resource.RUSAGE_CHILDREN)
    taken = sum(processor_time(program.process.pid) for program in programs)
    for program in programs:
        program.process.send_signal(signal.SIGINT)
    assert [program.wait() for program in programs] == [0, 0, 0]
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert ended.ru_utime - ended_before.ru_utime + ended.ru_stime - ended_before.ru_stime - taken < 2.0
    # They said goodbye: who does not is missed after 20 s, the lease that Fast DDS grants.
    probe.until(lambda: not probe.count_publishers("state"), patience=15.0)
    with recording.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        counts = {c.topic: summary.statistics.channel_message_counts.get(c.id, 0) for c in summary.channels.values()}
        assert counts["/bike/state"] > 10
        assert counts["/bike/course"] == 1
        assert {"/bike/command", "/bike/course_points", "/bike/events", "/clock", "/diagnostics"} <= set(counts)
        times = [message.log_time for _, channel, message in reader.iter_messages(topics=["/bike/state", "/bike/odom"])]
        assert min(times) >= 1_000_000_000
        assert max(times) < 3600 * 1_000_000_000  # simulated, not wall-clock time
    assert " 0 dropped" in programs[1].words


INTERFACES = sorted(path for folder in ("msg", "srv") for path in (ROOT / "ros_ws/src/bike_msgs" / folder).iterdir())


@pytest.mark.parametrize("path", INTERFACES, ids=lambda path: path.stem)
def test_every_field_of_a_message_is_explained(path: Path) -> None:
    fields = re.findall(r"^[\w/]+(?:\[\])? +\w+(?: +[-\d.]+)? *(#.*)?$", path.read_text(), re.MULTILINE)
    assert fields
    assert all(comment.strip("# ") for comment in fields), path.read_text()
