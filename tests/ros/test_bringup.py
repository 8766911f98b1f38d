"""Files of bike_bringup against what they refer to: programs, parameters, and fields of messages."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from bike_sim.ros import record, standard_messages
from bike_sim.ros.node_tools import ParameterSpec
from bike_sim.ros.sim_node import SPECS, NodeSettings
from bike_sim.ros.topics import TOPICS, type_name
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.race import entries_of
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import load_vehicle, shipped_superbikes

ROOT = Path(__file__).parents[2]
BRINGUP = ROOT / "ros_ws" / "src" / "bike_bringup"
MESSAGES = ROOT / "ros_ws" / "src" / "bike_msgs" / "msg"
TOPIC_TYPES = {"/bike/state": "BikeState", "/bike/command": "BikeCommand", "/bike/telemetry": "Telemetry"}
LAYOUT = json.loads((BRINGUP / "foxglove" / "ride.json").read_text())


def strings(value: Any, key: str = "") -> list[tuple[str, str]]:
    """All strings in a JSON value, each with the key that it stands under."""
    if isinstance(value, dict):
        return [found for name, part in value.items() for found in strings(part, name)]
    if isinstance(value, list):
        return [found for part in value for found in strings(part, key)]
    return [(key, value)] if isinstance(value, str) else []


def fields(message: str) -> set[str]:
    """Names of the fields of one of our messages."""
    return set(re.findall(r"^[\w/]+(?:\[\])? (\w+)", (MESSAGES / f"{message}.msg").read_text(), re.MULTILINE))


def paths(layout: Any) -> list[str]:
    """Topics with their fields that a layout plots."""
    return [text for key, text in strings(layout) if key in ("value", "path") and text.startswith("/")]


SUPERBIKE = json.loads((BRINGUP / "foxglove" / "superbike.json").read_text())
RACE = json.loads((BRINGUP / "foxglove" / "race.json").read_text())
PATHS = paths(LAYOUT)
OF_A_MACHINE = [path.replace("/bike_1/", "/bike/") for path in paths(RACE) if path.startswith("/bike_1/")]


@pytest.mark.parametrize("path", [*PATHS, *paths(SUPERBIKE), *OF_A_MACHINE])
def test_foxglove_shows_fields_that_exist(path: str) -> None:
    topic, field = path.split(".")
    assert field in fields(TOPIC_TYPES[topic])


@pytest.mark.parametrize("name", ["ride", "superbike"])
def test_the_line_of_the_page_makes_a_layout_of_another_namespace(name: str, tmp_path: Path) -> None:
    page = (ROOT / "docs/how-to/watch-and-steer.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^sed .*?> second.json$", page, re.MULTILINE | re.DOTALL)
    subprocess.run(line.replace("ride.json", f"{name}.json"), shell=True, cwd=_clone(tmp_path), check=True)
    texts = [text for _, text in strings(json.loads((tmp_path / "second.json").read_text()))]
    assert not any("/bike/" in text or text == "base_footprint" for text in texts)
    assert sum(text.startswith("/second/") for text in texts) >= 8


def _clone(folder: Path) -> Path:
    (folder / "ros_ws").symlink_to(ROOT / "ros_ws")
    return folder


def test_foxglove_shows_the_same_of_all_machines_of_a_race() -> None:
    """Of those that a race has without names, and what the race says."""
    names = [entry.name for entry in entries_of(["r1"] * 4)]
    texts = [text for _, text in strings(RACE["configById"])] + list(RACE["configById"]["3D!race"]["topics"])
    for name in names[1:]:
        of_first = {text.replace(names[0], name) for text in texts if text.startswith(f"/{names[0]}/")}
        missing = of_first - {text for text in texts if text.startswith(f"/{name}/")}
        assert missing == {f"/{name}/course_marker"}
    shown = {panel["topicPath"] for panel in RACE["configById"].values() if "topicPath" in panel}
    assert shown == {"/race/events", "/race/standings"}
    assert RACE["configById"]["3D!race"]["followTf"] == f"{names[0]}/base_footprint"


@pytest.mark.parametrize("layout", [LAYOUT, SUPERBIKE, RACE])
def test_foxglove_places_every_panel_that_it_configures_and_no_other(layout: Any) -> None:
    placed = [text for key, text in strings(layout["layout"]) if key in ("first", "second")]
    assert len(paths(layout)) >= 7
    assert sorted(placed) == sorted(layout["configById"])


def test_the_gauge_of_a_superbike_reaches_its_speeds() -> None:
    fastest = max(vehicle.top_gear_speed for vehicle in map(load_vehicle, shipped_superbikes()))
    assert SUPERBIKE["configById"]["Gauge!speed"]["maxValue"] > 0.85 * fastest


def test_rviz_shows_topics_of_the_namespace_in_the_world_frame() -> None:
    config = yaml.safe_load((BRINGUP / "rviz" / "ride.rviz").read_text())["Visualization Manager"]
    assert config["Global Options"]["Fixed Frame"] == "map"
    topics = {display["Topic"]["Value"] for display in config["Displays"] if "Topic" in display}
    assert topics == {"course_marker", "markers", "odom"}


# ------------------------------------------------------------------------------------- against what the nodes publish

SCENE = LAYOUT["configById"]["3D!ride"]
SCENE_TYPES = ("visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray", "nav_msgs/msg/Odometry")
RVIZ = yaml.safe_load((BRINGUP / "rviz" / "ride.rviz").read_text())["Visualization Manager"]


PUBLISHED = {name if name.startswith("/") else f"/bike/{name}": type_name(topic.kind) for name, topic in TOPICS.items()}
"""Type of each topic of the nodes."""


def test_foxglove_topics_are_published_with_the_types_it_shows() -> None:
    for topic in SCENE["topics"]:
        assert PUBLISHED[topic] in SCENE_TYPES, topic
    assert {path.partition(".")[0] for path in PATHS} <= set(PUBLISHED)
    assert PUBLISHED[LAYOUT["configById"]["RawMessages!events"]["topicPath"]] == "bike_msgs/msg/RideEvent"
    shown = LAYOUT["configById"]["DiagnosticSummary!nodes"]["topicToRender"]
    assert PUBLISHED[shown] == "diagnostic_msgs/msg/DiagnosticArray"


def test_rviz_topics_are_published_with_the_type_of_their_display() -> None:
    for display in RVIZ["Displays"]:
        if "Topic" in display:
            shown = display["Class"].removeprefix("rviz_default_plugins/")
            assert PUBLISHED[f"/bike/{display['Topic']['Value']}"].rpartition("/")[2] == shown


def test_all_frames_lead_to_the_world() -> None:
    """Every frame that is drawn or followed is the world, or a message tells where it is in the world."""
    simulator = Simulator(SimulatorConfig(engine="whipple"))
    snapshot, vehicle = simulator.reset(ResetRequest(course="line")), simulator.vehicle
    links = [make(snapshot, 0) for make in standard_messages.TRANSFORMS]
    shown = {SCENE["followTf"], RVIZ["Views"]["Current"]["Target Frame"]}
    drawn = [standard_messages.odometry(snapshot, vehicle, 0), standard_messages.course_marker(simulator.course, 0)]
    drawn += standard_messages.vehicle_markers(snapshot, vehicle, 0).markers
    assert shown | {message.header.frame_id for message in drawn} == {"map", "odom", "base_footprint"}
    parents = {link.child_frame_id: link.header.frame_id for link in links}
    assert parents == {"odom": "map", "base_footprint": "odom", "base_link": "base_footprint"}
    assert RVIZ["Global Options"]["Fixed Frame"] == "map"


PARAMETERS = yaml.safe_load((BRINGUP / "config" / "ride.yaml").read_text())


@pytest.mark.parametrize(("node", "specs"), [("sim_node", SPECS), ("record", record.SPECS)], ids=["sim_node", "record"])
def test_parameters_of_the_ride_exist_and_have_their_type(node: str, specs: tuple[ParameterSpec, ...]) -> None:
    given = PARAMETERS[f"/**/{node}"]["ros__parameters"]
    types = {spec.name: type(spec.default) for spec in specs}
    assert {name: type(value) for name, value in given.items()} == {name: types[name] for name in given}


def test_parameters_of_the_ride_are_accepted_by_the_simulator() -> None:
    given = PARAMETERS["/**/sim_node"]["ros__parameters"]
    assert NodeSettings.from_parameters({spec.name: spec.default for spec in SPECS} | given).values["mode"] == "free"


def test_launch_file_starts_programs_and_reads_files_that_exist() -> None:
    text = (BRINGUP / "launch" / "ride.launch.py").read_text()
    compile(text, "ride.launch.py", "exec")
    programs = set(re.findall(r'package="(\w+)",\s*executable="(\w+)"', text))
    assert programs == {("bike_sim", "sim_node"), ("bike_policy", "drive"), ("bike_sim", "record"), ("rviz2", "rviz2")}
    for package, program in programs - {("rviz2", "rviz2")}:
        assert (Path(sys.prefix) / "lib" / package / program).exists()
    for folder, name in re.findall(r'SHARE / "(\w+)" / "([\w.]+)"', text):
        assert (BRINGUP / folder / name).exists()
