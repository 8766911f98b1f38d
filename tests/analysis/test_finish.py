"""Rides on open courses are judged up to the finish, however many states were recorded behind it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bike_analysis import compare, open_ride
from bike_analysis.page.ride_view import ride_view
from tests.beside import arc, beside

PERIOD = 0.05  # s
LENGTH = 30.0  # m
OF_THE_RECORDING = {"steps"}
"""Figures that tell of the recording and not of the ride."""


@pytest.fixture
def open_ride_of(circle):
    """Make a ride beside an open course, a line or a curve to the left, that stops some states behind its end."""

    def make(radius: float = math.inf, speed: float = 4.0, behind: int = 1, offset: float = 0.03) -> Any:
        course = arc(LENGTH, radius)
        # A state lies 0.02 m behind the start, so that none lies on the finish.
        way = 0.02 + speed * PERIOD * np.arange(math.ceil((LENGTH - 0.02) / (speed * PERIOD)) + behind)
        states: dict[str, Any] = beside(course, way, offset)
        states |= {
            f"front_{name}": column for name, column in beside(course, way + 1.0, offset).items() if name != "yaw"
        }
        states |= {
            "roll": -0.01 * np.arange(len(way)),
            "speed": np.full(len(way), speed),
            "course_length": np.full(len(way), LENGTH),
            "course_closed": np.full(len(way), False),
            "vehicle": np.full(len(way), "whipple"),
            "steering_command": 0.2 * np.sin(0.37 * np.arange(len(way))),
            "finished": states["progress"] >= LENGTH,
        }
        ride = circle(steps=len(way))
        ride.states = states
        ride.course = ride.course | {
            **{"name": "open", "closed": False, "length": LENGTH, "section_starts": np.array([0.0, 0.5 * LENGTH])},
            **{name: getattr(course, name) for name in ("s", "x", "y", "curvature")},
            **{"width_left": np.full(len(course.s), 0.02), "width_right": np.full(len(course.s), 1.0)},
        }
        return ride

    return make


SHAPES = pytest.mark.parametrize(("radius", "speed"), [(math.inf, 4.0), (math.inf, 7.0), (20.0, 4.0), (20.0, 7.0)])


@SHAPES
def test_equal_rides_have_equal_figures(writer, open_ride_of, tmp_path: Path, radius: float, speed: float) -> None:
    """They are stopped one, two and six states behind the finish."""
    found = []
    for behind in (1, 2, 6):
        path = writer.write(tmp_path / f"{behind}.mcap", [open_ride_of(radius, speed, behind)])
        recording = open_ride(path)
        figures = recording.rides[0].figures
        found.append({name: value for name, value in figures.items() if name not in OF_THE_RECORDING})
        assert len(recording.rides[0].table()) == figures["steps"], "tables keep every recorded state"
    assert found[0] == found[1] == found[2]
    figures = found[0]
    assert figures["max_error_m"] == pytest.approx(0.03, abs=2e-5)
    assert figures["duration_s"] == pytest.approx((LENGTH - 0.02) / speed, abs=1e-4)
    assert figures["max_error_m"] == pytest.approx(max(s["max_error_m"] for s in figures["sections"]))
    assert (figures["ended_by"], figures["off_course"]) == ("finished", 0)
    assert figures["off_track_s"] == pytest.approx(figures["duration_s"]), "0.01 m outside, the front wheel too"


@SHAPES
def test_pages_and_comparisons_end_at_the_finish(
    writer, open_ride_of, tmp_path: Path, radius: float, speed: float
) -> None:
    paths = [writer.write(tmp_path / f"{behind}.mcap", [open_ride_of(radius, speed, behind)]) for behind in (1, 4)]
    first, second = (open_ride(path).rides[0] for path in paths)
    views = [ride_view(ride.evaluated, "ride", "ride").data() for ride in (first, second)]
    assert views[0] == views[1]
    both = compare([first, second])
    begun = both.station_m > 0.1
    np.testing.assert_array_equal(both.column("delta_s")[1][begun], 0.0)
    assert both.column("lateral_error_m")[:, begun].max() == pytest.approx(0.03, abs=2e-5)
    assert both.runs[0].duration_s == both.runs[1].duration_s
    assert both.column("time_s")[0][-1] == pytest.approx(first.figures.duration_s)


def test_without_a_course_what_lies_behind_the_finish_is_left_out(writer, open_ride_of, tmp_path: Path) -> None:
    found = []
    for behind in (1, 3):
        ride = open_ride_of(behind=behind)
        ride.course = None
        path = writer.write(tmp_path / f"{behind}.mcap", [ride])
        found.append(open_ride(path).rides[0].figures)
    assert found[0].max_error_m == found[1].max_error_m == pytest.approx(0.03)
    assert found[0].duration_s == found[1].duration_s


def test_falls_behind_the_finish_are_told_and_running_out_is_not(writer, open_ride_of, tmp_path: Path) -> None:
    ride = open_ride_of(behind=6)
    count = ride.steps
    ride.states["off_course"] = np.arange(count) >= count - 6
    ride.states["fallen"] = np.arange(count) >= count - 1
    figures = open_ride(writer.write(tmp_path / "ride.mcap", [ride])).rides[0].figures
    assert (figures.ended_by, figures.off_course, figures.falls) == ("finished", 0, 1)


def test_a_ride_that_stops_before_the_finish_is_judged_whole(writer, open_ride_of, tmp_path: Path) -> None:
    ride = open_ride_of()
    ride.states = {name: column[:-5] for name, column in ride.states.items()}
    recorded = open_ride(writer.write(tmp_path / "ride.mcap", [ride])).rides[0]
    assert recorded.evaluated is recorded
