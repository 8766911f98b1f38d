"""Observations of a policy on a recorded ride, without ROS, by riding it again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis import Ride
from bike_policy.contract.bundle import Bundle
from bike_policy.riders.rider import learned_rider
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_training.replay import RecordedCommands, read_rides, ride_with

WHOLE_RIDE: Final = "all"
"""Name of the section that is all of a ride."""


@dataclass(frozen=True)
class RecordedObservations:
    """Observations of a policy on a part of a recorded ride, one a decision.

    Attributes:
        recording: the file.
        course: name of the course; empty where it was not recorded.
        section: name of the section, or WHOLE_RIDE.
        observations: through the policy's layout, shape (n, size).
        differ: largest difference of the policy's commands to the recorded ones, as a part of the largest command.
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


class Onlooker:
    """A policy that sees a ride which other commands ride; implements `bike_policy.riders.base.Rider`.

    Attributes:
        steps: control steps at which it decided.
        seen: what it saw then.
        differ: see `RecordedObservations`.
    """

    preview: Preview | None = None

    def __init__(self, bundle: Bundle, commands: RecordedCommands) -> None:
        """Take the policy and the commands that are ridden."""
        self.name = bundle.name
        self._policy, self._commands = learned_rider(bundle), commands
        self.steps: list[int] = []
        self.seen: list[NDArray[np.float32]] = []
        self.differ = 0.0

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare the policy; see `Rider`."""
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


def read_observations(
    path: Path,
    bundle: Bundle,
    section: str = WHOLE_RIDE,
    number: int = 1,
    report: Callable[[int, int], None] | None = None,
) -> RecordedObservations:
    """Ride a recorded ride again, and return what a policy, real or hypothetical, sees of a section.

    Args:
        path: recording.
        bundle: policy.
        section: name of a section of the course, or WHOLE_RIDE.
        number: which ride of the recording, from 1.
        report: called with steps ridden and steps in all, to show progress.

    Raises:
        FileNotFoundError: there is no such recording, or its vehicle or course is not here.
        ValueError: it has no such ride or section, cannot be ridden again, or shows what this policy cannot use.
    """
    _, rides = read_rides(path)
    if not 1 <= number <= len(rides):
        raise ValueError(f"{path} has {len(rides)} ride(s), there is no ride {number}")
    source = rides[number - 1]
    ride = source.ride
    bundle.check_fit(source.vehicle, float(ride.states.control_period[0]))
    inside = ride.states.step[_in_section(ride, section, path) & ~ride.states.fallen]
    riders: list[Onlooker] = []

    def onlooker(commands: RecordedCommands) -> Onlooker:
        riders.append(Onlooker(bundle, commands))
        return riders[0]

    ride_with(source, onlooker, report)
    chosen = np.isin(riders[0].steps, inside)
    if np.sum(chosen) < 2:
        raise ValueError(f"{path}: a policy decides {np.sum(chosen)} times in section {section!r}, at least 2 needed")
    course = ride.course.name if ride.course else ""
    return RecordedObservations(path, course, section, np.stack(riders[0].seen)[chosen], riders[0].differ)


def _in_section(ride: Ride, section: str, path: Path) -> NDArray[np.bool_]:
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
