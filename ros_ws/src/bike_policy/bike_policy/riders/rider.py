"""The protocol of a rider, which answers snapshots with commands in process and in the policy node."""

from __future__ import annotations

from typing import Protocol

from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class Rider(Protocol):
    """Answers snapshots with commands.

    Attributes:
        name: for people and recordings.
        preview: the preview that it needs; None where it takes any.
    """

    name: str
    preview: Preview | None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare for an episode.

        Args:
            vehicle: to be ridden.
            course: the followed line.
            period: control period, s.
            preview: the preview that snapshots will hold.

        Raises:
            ValueError: this rider cannot ride that, naming the difference.
        """
        ...

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return steering and throttle in [-1, 1], or None for a snapshot that is not finite."""
        ...
