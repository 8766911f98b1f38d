"""What a racing policy sees on a recorded ride.

Its observations hold what it did and saw before, so they are not made of one state: the ride is ridden again with the
recorded commands, and the policy looks on from the beginning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.riders.racing import RacingRider
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_training.explain.observations import WHOLE_RIDE, rows_of
from bike_training.replay.recorded_rides import RideSource, read_rides
from bike_training.replay.replaying import RecordedCommands, ride_with


@dataclass(frozen=True)
class RaceObservations:
    """Observations of a racing policy on a part of a recorded ride, one a decision.

    Attributes:
        recording: the file.
        course: name of the circuit.
        section: name of the section, or `WHOLE_RIDE`.
        observations: through the policy's layout, shape (n, size).
        differ: largest difference of the policy's commands to the recorded ones in the decisions' first control
            periods, as a part of the largest command; 0 where it drove.
    """

    recording: Path
    course: str
    section: str
    observations: NDArray[np.float32]
    differ: float


class Onlooker:
    """A policy that sees a ride which other commands ride; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        steps: control steps at which it decided. seen: what it saw then. differ: see `RaceObservations`.
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
    tell: Callable[[int, int], None] | None = None,
) -> RaceObservations:
    """Ride a recorded ride again, and return what a racing policy sees of a section.

    Args:
        path: recording.
        bundle: policy that races.
        section: name of a section of the circuit; None for the whole ride.
        number: which ride of the recording, from 1.
        tell: called with steps ridden and steps in all, to show progress.

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

    ride_with(source, onlooker, tell)
    chosen = np.isin(riders[0].steps, _steps_of(source, section or WHOLE_RIDE, path))
    if np.sum(chosen) < 2:
        raise ValueError(f"{path}: a policy decides {np.sum(chosen)} times in section {section!r}, at least 2 needed")
    return RaceObservations(
        recording=path,
        course=source.ride.course.name if source.ride.course else "",
        section=section or WHOLE_RIDE,
        observations=np.stack(riders[0].seen)[chosen],
        differ=riders[0].differ,
    )


def _steps_of(source: RideSource, section: str, path: Path) -> NDArray[np.int64]:
    """Return the control steps that lie in a section."""
    return source.ride.states.step[rows_of(source.ride, section, path) & ~source.ride.states.fallen]
