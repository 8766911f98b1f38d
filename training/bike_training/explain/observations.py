"""Observations of a policy on a recorded ride, without ROS: on a path from its states, in a race by riding it again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis import Ride, find_rides, read_recording
from bike_analysis.read.columns import ColumnReader
from bike_analysis.read.container import find_files
from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import Rows
from bike_policy.riders.racing import RacingRider
from bike_sim.course.course import Course
from bike_sim.physics.state import FIELDS
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_training.explain.shap_values import outputs_of
from bike_training.replay import RecordedCommands, RideSource, blocks_of, read_rides, ride_with

WHOLE_RIDE: Final = "all"
"""Name of the section that is all of a ride."""

_PREVIEW_FIELDS: Final = ("preview_by_time", "preview_interval", "preview_y")


@dataclass(frozen=True)
class RecordedObservations:
    """Observations of a policy on a part of a recorded ride, one a decision.

    Attributes:
        recording: the file.
        course: name of the course; empty where it was not recorded.
        section: name of the section, or WHOLE_RIDE.
        observations: through the policy's layout, shape (n, size).
        differ: largest difference of the policy's commands to the recorded ones, as a part of the largest command; NaN
            where none were recorded.
    """

    recording: Path
    course: str
    section: str
    observations: NDArray[np.float32]
    differ: float


def policy_of(notes: dict[str, str], recording: Path) -> str:
    """Return the policy that drove, as the recorder noted it.

    Raises:
        ValueError: it was not noted.
    """
    if not notes.get("policy"):
        raise ValueError(f"{recording} does not say which policy drove; name it with --policy")
    return notes["policy"]


def read_observations(path: Path, bundle: Bundle, section: str, number: int = 1) -> RecordedObservations:
    """Return the observations of a policy, real or hypothetical, on a section of a recorded ride.

    Args:
        path: recording.
        bundle: policy.
        section: name of a section of the course, or WHOLE_RIDE.
        number: which ride of the recording, from 1.

    Raises:
        FileNotFoundError: there is no such recording.
        ValueError: it is no recording of a ride, has no such ride or section, or shows what this policy cannot use.
    """
    recording = read_recording(path)
    rides = find_rides(recording)
    if not 1 <= number <= len(rides):
        raise ValueError(f"{recording.path} has {len(rides)} ride(s), there is no ride {number}")
    ride = rides[number - 1]
    bundle.check_fit(recording.vehicle, float(ride.states.control_period[0]))
    rows = np.flatnonzero(rows_of(ride, section, recording.path) & ~ride.states.fallen)
    if len(rows) < 2:
        raise ValueError(
            f"{recording.path}: section {section!r} of ride {number} has {len(rows)} states, at least 2 needed"
        )
    states = ride.states.take(rows)
    columns = _columns(path, f"{recording.namespace}/state", states.order)
    commands = dict(zip(ride.commands.step.tolist(), ride.commands.steering.tolist(), strict=True))
    steering = np.array([commands.get(step, np.nan) for step in states.step.tolist()])
    observations = _observe(bundle, columns)
    answers = np.clip(outputs_of(bundle, observations) / float(states.steering_limit[0]), -1.0, 1.0)
    known = np.isfinite(steering)
    differ = float(np.abs(answers - steering)[known].max()) if known.any() else float("nan")
    course = ride.course.name if ride.course else ""
    return RecordedObservations(recording.path, course, section, observations, differ)


def rows_of(ride: Ride, section: str, path: Path) -> NDArray[np.bool_]:
    """Return which states of a ride are in a section.

    Args:
        ride: of a recording.
        section: name of a section of its course, or WHOLE_RIDE.
        path: of the recording, for messages.

    Raises:
        ValueError: the course has no such section.
    """
    if section == WHOLE_RIDE:
        return np.ones(len(ride.states), dtype=bool)
    course = ride.course
    if course is None or section not in course.section_names:
        known = [*dict.fromkeys(course.section_names if course else ()), WHOLE_RIDE]
        raise ValueError(f"{path}: its course has no section {section!r}; there is {', '.join(known)}")
    places = [place for place, name in enumerate(course.section_names) if name == section]
    return np.isin(ride.section_of(), places)


def _columns(path: Path, topic: str, orders: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Read minimal states and previews of the messages at given indices of a recording."""
    reader: ColumnReader | None = None
    for _, kind, block, rows, before in blocks_of(find_files(path), {topic}):
        rows = rows[np.isin(before + block.first + rows, orders)]
        if not len(rows):
            continue
        if reader is None:
            missing = {*FIELDS, *lk.FIELDS, *_PREVIEW_FIELDS} - kind.fields()
            if missing:
                raise ValueError(f"{path}: {topic} has no {', '.join(sorted(missing))}, which observations are made of")
            reader = ColumnReader(kind, (*FIELDS, *lk.FIELDS, *_PREVIEW_FIELDS))
        reader.add_block(block.contents, block.begin[rows], block.end[rows])
    assert reader is not None, "the orders are those of messages that have been read"
    return reader.finish()


def _observe(bundle: Bundle, columns: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
    layout, preview = bundle.layout, columns["preview_y"]
    picked = layout.pick_preview(
        bool(columns["preview_by_time"][0]), float(columns["preview_interval"][0]), preview.shape[1]
    )
    state, look = (np.stack([columns[name] for name in names], axis=1) for names in (FIELDS, lk.FIELDS))
    observations = layout.observe(Rows.of_path(state, look, preview[:, picked]))
    if not np.isfinite(observations).all():
        raise ValueError("the recorded states hold values that are not finite")
    return observations


class Onlooker:
    """A policy that sees a ride which other commands ride; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        steps: control steps at which it decided.
        seen: what it saw then.
        differ: see `RecordedObservations`.
    """

    preview: Preview | None = None

    def __init__(self, bundle: Bundle, commands: RecordedCommands) -> None:
        """Take the policy and the commands that are ridden."""
        self.name = bundle.name
        self._policy, self._commands = RacingRider(bundle), commands
        self.steps: list[int] = []
        self.seen: list[NDArray[np.float32]] = []
        self.differ = 0.0

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Plan the lap; see `Rider`."""
        self._policy.begin(vehicle, course, period, preview)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Look, and return the recorded command."""
        ridden = self._commands.command(snapshot)
        before = self._policy.seen
        own = self._policy.command(snapshot)
        if self._policy.seen is not before and self._policy.seen is not None and own and ridden:
            self.steps.append(snapshot.step)
            self.seen.append(self._policy.seen)
            self.differ = max(self.differ, *(abs(a - b) for a, b in zip(own, ridden, strict=True)))
        return ridden


def read_race(
    path: Path,
    bundle: Bundle,
    section: str | None = None,
    number: int = 1,
    report: Callable[[int, int], None] | None = None,
) -> RecordedObservations:
    """Ride a recorded ride again, and return what a racing policy sees of a section.

    Args:
        path: recording.
        bundle: policy that races.
        section: name of a section of the circuit; None for the whole ride.
        number: which ride of the recording, from 1.
        report: called with steps ridden and steps in all, to show progress.

    Raises:
        FileNotFoundError: there is no such recording, or its vehicle or circuit is not here.
        ValueError: it has no such ride or section, cannot be ridden again, or shows what this policy cannot use.
    """
    _, rides = read_rides(path)
    if not 1 <= number <= len(rides):
        raise ValueError(f"{path} has {len(rides)} ride(s), there is no ride {number}")
    source = rides[number - 1]
    bundle.check_fit(source.vehicle, float(source.ride.states.control_period[0]))
    riders: list[Onlooker] = []

    def onlooker(commands: RecordedCommands) -> Onlooker:
        riders.append(Onlooker(bundle, commands))
        return riders[0]

    ride_with(source, onlooker, report)
    chosen = np.isin(riders[0].steps, _steps_of(source, section or WHOLE_RIDE, path))
    if np.sum(chosen) < 2:
        raise ValueError(f"{path}: a policy decides {np.sum(chosen)} times in section {section!r}, at least 2 needed")
    course = source.ride.course.name if source.ride.course else ""
    observations = np.stack(riders[0].seen)[chosen]
    return RecordedObservations(path, course, section or WHOLE_RIDE, observations, riders[0].differ)


def _steps_of(source: RideSource, section: str, path: Path) -> NDArray[np.int64]:
    """Return the control steps that lie in a section."""
    return source.ride.states.step[rows_of(source.ride, section, path) & ~source.ride.states.fallen]
