"""Files of bike_bringup against what they refer to: programs, parameters, and fields of messages."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from bike_sim import record
from bike_sim.node_settings import SPECS, NodeSettings
from bike_sim.node_tools import ParameterSpec

ROOT = Path(__file__).parents[2]
BRINGUP = ROOT / "ros_ws" / "src" / "bike_bringup"
MESSAGES = ROOT / "ros_ws" / "src" / "bike_msgs" / "msg"
TOPIC_TYPES = {"/bike/state": "BikeState", "/bike/command": "BikeCommand"}
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


PATHS = [text for key, text in strings(LAYOUT) if key in ("value", "path") and text.startswith("/")]


@pytest.mark.parametrize("path", PATHS)
def test_foxglove_shows_fields_that_exist(path: str) -> None:
    topic, field = path.split(".")
    assert field in fields(TOPIC_TYPES[topic])


def test_foxglove_places_every_panel_that_it_configures_and_no_other() -> None:
    placed = [text for key, text in strings(LAYOUT["layout"]) if key in ("first", "second")]
    assert len(PATHS) >= 7
    assert sorted(placed) == sorted(LAYOUT["configById"])


def test_rviz_shows_topics_of_the_namespace_in_the_world_frame() -> None:
    config = yaml.safe_load((BRINGUP / "rviz" / "ride.rviz").read_text())["Visualization Manager"]
    assert config["Global Options"]["Fixed Frame"] == "map"
    topics = {display["Topic"]["Value"] for display in config["Displays"] if "Topic" in display}
    assert topics == {"/bike/course_marker", "/bike/markers", "/bike/odom"}


PARAMETERS = yaml.safe_load((BRINGUP / "config" / "ride.yaml").read_text())


@pytest.mark.parametrize(("node", "specs"), [("sim_node", SPECS), ("record", record.SPECS)], ids=["sim_node", "record"])
def test_parameters_of_the_ride_exist_and_have_their_type(node: str, specs: tuple[ParameterSpec, ...]) -> None:
    given = PARAMETERS[f"/**/{node}"]["ros__parameters"]
    types = {spec.name: type(spec.default) for spec in specs}
    assert {name: type(value) for name, value in given.items()} == {name: types[name] for name in given}


def test_parameters_of_the_ride_are_accepted_by_the_simulator() -> None:
    given = PARAMETERS["/**/sim_node"]["ros__parameters"]
    assert NodeSettings.from_parameters({spec.name: spec.default for spec in SPECS} | given).mode == "free"


def test_launch_file_starts_programs_and_reads_files_that_exist() -> None:
    text = (BRINGUP / "launch" / "ride.launch.py").read_text()
    compile(text, "ride.launch.py", "exec")
    programs = set(re.findall(r'package="(\w+)",\s*executable="(\w+)"', text))
    assert programs == {("bike_sim", "sim_node"), ("bike_policy", "drive"), ("bike_sim", "record"), ("rviz2", "rviz2")}
    for package, program in programs - {("rviz2", "rviz2")}:
        assert (Path(sys.prefix) / "lib" / package / program).exists()
    for folder, name in re.findall(r'SHARE / "(\w+)" / "([\w.]+)"', text):
        assert (BRINGUP / folder / name).exists()
