"""docs/reference/ros.md against the nodes: topics with their types and QoS, services, diagnostics."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from bike_sim.ros import node_tools

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reference" / "ros.md").read_text()
NODES = ("sim_node", "drive", "record")
EVERY_NODE_HAS = ("/rosout", "/parameter_events")
ONLY_WITH = {"/tf", "/bike/telemetry", "/bike/disturbances"}
"""Published where tf2_msgs is installed, which the wheels do not bring, with a superbike, and in a disturbed ride."""


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


@pytest.mark.ros
def test_topics_services_and_diagnostics_are_those_of_the_nodes(ros, policy: str, tmp_path: Path) -> None:
    ros.simulator()
    ros.start("bike_sim.ros.record", path=str(tmp_path / "ride.mcap"))
    ros.start("bike_policy.drive", policy=policy)
    probe = ros.probe()
    probe.until(lambda: {name for name, _ in probe.get_node_names_and_namespaces()} >= set(NODES))
    check_topics(probe)
    check_services(probe)
    check_diagnostics(probe)


INTERFACES = sorted(path for folder in ("msg", "srv") for path in (ROOT / "ros_ws/src/bike_msgs" / folder).iterdir())


@pytest.mark.parametrize("path", INTERFACES, ids=lambda path: path.stem)
def test_every_field_of_a_message_is_explained(path: Path) -> None:
    fields = re.findall(r"^[\w/]+(?:\[\])? +\w+(?: +[-\d.]+)? *(#.*)?$", path.read_text(), re.MULTILINE)
    assert fields
    assert all(comment.strip("# ") for comment in fields), path.read_text()
