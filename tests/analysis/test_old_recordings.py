"""A recording of an older version of the messages is read as one of today.

`recordings/ride_of_2be20ba.mcap` was recorded by the nodes of commit 2be20ba with its own messages: an oval of 39 m at
4 m/s with the policy shipped then, PyBullet in steps of 1 ms. States, commands, course, events and diagnostics were
copied as they are up to two seconds after the lap, the other topics left out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bike_analysis import open_ride
from bike_analysis.read.container import Container
from bike_analysis.report import analyze

MESSAGES = Path(__file__).parents[2] / "ros_ws" / "src" / "bike_msgs" / "msg"


def fields_of(definition: str) -> set[str]:
    """Names of the first message's fields in a definition."""
    lines = (line.partition("#")[0].split() for line in definition.partition("====")[0].splitlines())
    return {words[1] for words in lines if len(words) == 2}


@pytest.mark.parametrize("name", ["BikeState", "Course"])
def test_its_messages_are_not_those_of_today(old_recording: Path, name: str) -> None:
    old = Container(old_recording)
    assert list(old.messages())
    then = next(schema.data.decode() for schema in old.schemas.values() if schema.name.endswith(f"/{name}"))
    now = (MESSAGES / f"{name}.msg").read_text(encoding="utf-8")
    assert len(fields_of(then)) > 10
    assert fields_of(now) - fields_of(then), "today's have fields that the recording lacks"


def test_it_is_read_without_a_warning(old_recording: Path) -> None:
    recording = open_ride(old_recording)
    assert recording.warnings == ()
    assert (recording.vehicle, recording.simulations) == ("whipple", ())
    (ride,) = recording.rides
    assert ride.course is not None
    assert (ride.course.name, len(ride.course.section_names)) == ("oval", 4)
    assert len(ride.laps) == 1
    states, told = ride.states, next(event for event in ride.events if event.kind == "lap")
    passed = float(np.interp(ride.course.length, states.progress, states.time_s - states.time_s[0]))
    assert ride.figures.best_lap_s == pytest.approx(told.value)
    assert passed == pytest.approx(told.value, abs=1e-3), "time at which the line was crossed, from the states"


def test_its_figures_are_those_of_the_ride(old_recording: Path, tmp_path: Path) -> None:
    figures = analyze([old_recording], tmp_path)["rides"][0]
    assert figures["falls"] == 0
    for name, low, high in (("speed_mean_m_s", 4.0, 4.5), ("max_error_m", 0.1, 0.3), ("roll_min_deg", -25.0, -15.0)):
        assert low < figures[name] < high
