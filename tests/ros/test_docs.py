"""docs/ros.md against the nodes: parameters, topics with their types and QoS, services, figures of the diagnostics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from bike_policy import drive
from bike_sim import node_settings, node_tools, record
from bike_sim.node_tools import ParameterSpec

PAGE = (Path(__file__).parents[2] / "docs" / "ros.md").read_text()
NODES = ("sim_node", "drive", "record")
EVERY_NODE_HAS = ("/rosout", "/parameter_events")
ONLY_WITH = {"/tf", "/bike/telemetry"}
"""Published where tf2_msgs is installed, which the wheels do not bring, and with a superbike."""


def table(heading: str) -> list[list[str]]:
    """Cells of the first table below a heading, without its head."""
    _, found, rest = PAGE.partition(f"\n{heading}\n")
    assert found, f"docs/ros.md has no heading {heading!r}"
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


def parameter_row(spec: ParameterSpec) -> list[str]:
    """The row that belongs to a parameter: name, default, when it may be set, meaning with unit."""
    default = "none" if spec.default in ("", ()) else str(spec.default)
    default = default.lower() if isinstance(spec.default, bool) else default
    meaning = spec.text + (f" One of {', '.join(spec.choices)}." if spec.choices else "")
    return [f"`{spec.name}`", default, "start" if spec.fixed else "any time", meaning]


@pytest.mark.parametrize(
    ("node", "specs"), [("sim_node", node_settings.SPECS), ("drive", drive.SPECS), ("record", record.SPECS)]
)
def test_parameters_are_those_of_the_node(node: str, specs: tuple[ParameterSpec, ...]) -> None:
    wanted = [parameter_row(spec) for spec in specs]
    found = table(f"### Parameters of {node}")
    text = "\n".join(f"| {' | '.join(row)} |" for row in wanted)
    assert found == wanted, f"the table of {node} in docs/ros.md must be\n{text}"


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


def check_topics(ears: Any) -> None:
    published: dict[str, tuple[str, set[str]]] = {}
    heard: set[str] = set()
    for node in NODES:
        for topic, kinds in ears.get_publisher_names_and_types_by_node(node, "/bike"):
            if topic not in EVERY_NODE_HAS:
                published.setdefault(topic, (kinds[0].replace("/msg/", "/"), set()))[1].add(node)
        if node != "record":  # which hears everything
            heard |= {topic for topic, _ in ears.get_subscriber_names_and_types_by_node(node, "/bike")}
    documented = {row[0].strip("`"): row for row in table("## Topics")}
    assert set(documented) - ONLY_WITH == set(published) - ONLY_WITH
    assert heard - set(EVERY_NODE_HAS) <= set(documented)
    for topic, (kind, nodes) in published.items():
        _, documented_kind, qos, documented_nodes, _ = documented[topic]
        assert (topic, documented_kind) == (topic, kind)
        assert set(documented_nodes.split(", ")) == nodes, topic
        for end in ears.get_publishers_info_by_topic(topic):
            assert end.node_name not in NODES or same_qos(PROFILES[qos.strip("`")], end.qos_profile), topic


def check_services(ears: Any) -> None:
    found = set()
    for node in NODES:
        for service, kinds in ears.get_service_names_and_types_by_node(node, "/bike"):
            if not kinds[0].startswith(("rcl_interfaces/", "type_description_interfaces/")):
                found.add((f"`{service}`", kinds[0].replace("/srv/", "/"), node))
    assert found == {tuple(row[:3]) for row in table("## Services")}


def check_diagnostics(ears: Any) -> None:
    reports = ears.listen(DiagnosticArray, "/diagnostics")

    def figures() -> dict[str, set[str]]:
        return {r.status[0].name.removeprefix("bike/"): {v.key for v in r.status[0].values} for r in reports}

    ears.until(lambda: set(figures()) == set(NODES) and "latency_median_ms" in figures()["drive"])
    explained = {row[0]: set(row[1].replace("`", "").split(", ")) for row in table("## Diagnostics")}
    assert explained == figures()


@pytest.mark.ros
def test_topics_services_and_diagnostics_are_those_of_the_nodes(stage, policy: str, tmp_path: Path) -> None:
    stage.simulator()
    stage.start("bike_sim.record", path=str(tmp_path / "ride.mcap"))
    stage.start("bike_policy.drive", policy=policy)
    ears = stage.ears()
    ears.until(lambda: {name for name, _ in ears.get_node_names_and_namespaces()} >= set(NODES))
    ears.until(lambda: ears.states[-1].step > 0)
    check_topics(ears)
    check_services(ears)
    check_diagnostics(ears)
