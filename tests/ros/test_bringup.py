"""Files of bike_bringup against what they refer to: programs, parameters, and fields of messages."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from bike_analysis.read.columns import MessageSchema
from bike_analysis.read.container import Container
from bike_sim.ros import record
from bike_sim.ros.node_tools import ParameterSpec
from bike_sim.ros.sim_node import SPECS, NodeSettings
from bike_sim.vehicles.files import load_vehicle, shipped_superbikes
from bike_training.cli import main

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
PATHS = paths(LAYOUT)


@pytest.mark.parametrize("path", [*PATHS, *paths(SUPERBIKE)])
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


@pytest.mark.parametrize("layout", [LAYOUT, SUPERBIKE])
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
FRAME_TYPES = ("geometry_msgs/msg/TransformStamped", "tf2_msgs/msg/TFMessage")
RVIZ = yaml.safe_load((BRINGUP / "rviz" / "ride.rviz").read_text())["Visualization Manager"]


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory, compiled: None) -> Path:
    """A short ride of the real nodes."""
    folder = tmp_path_factory.mktemp("bringup")
    course = folder / "short.yaml"
    elements = "elements:\n  - {line: 6.0}\n  - {arc: {radius_m: 10.0, angle_deg: 60.0}}\n"
    head = "format: bike.course/1\nname: short\ndescription: A bend.\nclosed: false\noff_course_limit_m: 3.5\n"
    course.write_text(head + elements)
    assert main(["ride", "--course", str(course), "--engine", "whipple", "--out", str(folder), "--json"]) == 0
    return folder / "ride.mcap"


@pytest.fixture(scope="module")
def messages(ride: Path) -> dict[str, tuple[MessageSchema, list[Any]]]:
    """Type and messages of each recorded topic."""
    container = Container(ride)
    found: dict[str, tuple[MessageSchema, list[Any]]] = {}
    for raw in container.messages():
        channel = container.channels[raw.channel]
        if channel.topic not in found:
            schema = container.schemas[channel.schema_id]
            found[channel.topic] = (MessageSchema(schema.name, schema.data.decode()), [])
        kind, list_of = found[channel.topic]
        list_of.append(kind.decode(raw.data))
    return found


@pytest.mark.ros
def test_foxglove_topics_are_published_with_the_types_and_fields_it_shows(messages) -> None:
    for topic in SCENE["topics"]:
        assert messages[topic][0].name in SCENE_TYPES, topic
    for path in PATHS:
        topic, *parts = path.split(".")
        if parts:
            assert parts[0] in messages[topic][0].fields(), path
    assert messages[LAYOUT["configById"]["RawMessages!events"]["topicPath"]][0].name == "bike_msgs/msg/RideEvent"
    shown = LAYOUT["configById"]["DiagnosticSummary!nodes"]["topicToRender"]
    assert messages[shown][0].name == "diagnostic_msgs/msg/DiagnosticArray"


@pytest.mark.ros
def test_rviz_topics_are_published_with_the_type_of_their_display(messages) -> None:
    for display in RVIZ["Displays"]:
        if "Topic" in display:
            shown = display["Class"].removeprefix("rviz_default_plugins/")
            assert messages[f"/bike/{display['Topic']['Value']}"][0].name.rpartition("/")[2] == shown


@pytest.mark.ros
def test_all_frames_lead_to_the_world(messages) -> None:
    """Every frame that is drawn or followed is the world, or a message tells where it is in the world."""
    parents: dict[str, str] = {}
    for kind, sent in messages.values():
        if kind.name in FRAME_TYPES:
            for link in [t for message in sent for t in getattr(message, "transforms", [message])]:
                parents[link.child_frame_id] = link.header.frame_id
    shown = {SCENE["followTf"], RVIZ["Views"]["Current"]["Target Frame"]}
    for topic in SCENE["topics"]:
        for message in messages[topic][1]:
            shown |= {part.header.frame_id for part in getattr(message, "markers", [message])}
    assert shown == {"map", "odom", "base_footprint"}
    assert parents == {"odom": "map", "base_footprint": "odom", "base_link": "base_footprint"}
    assert RVIZ["Global Options"]["Fixed Frame"] == "map"


@pytest.mark.ros
def test_a_recorded_ride_has_its_first_state_and_command(messages) -> None:
    """However late the nodes find each other, which is different each time."""
    states, commands = ({message.step for message in messages[f"/bike/{name}"][1]} for name in ("state", "command"))
    assert states == set(range(len(states)))
    assert len(states) > 40
    assert commands >= states - {max(states)}


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
