"""From snapshots to decisions on a circuit."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.race import RaceLayout
from bike_policy.contract.rows import Row, row_of
from bike_policy.riders.race_plan_verification import rehearsed_racer
from bike_policy.riders.racer import Racer
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class RacePolicy:
    """Decides every so many control periods on a circuit, and remembers what it has decided.

    A decision belongs to the steps from a multiple of ``repeat`` on, counted from the reset. Where states are lost, or
    the rider is started in the middle of a ride, it decides at once: memory begins with what it sees then.

    Attributes:
        seen: observation of the last decision, shape (layout size,); None before the first.
    """

    seen: NDArray[np.float32] | None = None

    def __init__(self, bundle: Bundle, layout: RaceLayout) -> None:
        """Answer a made-up observation once; the first one of a process takes longer than all others."""
        self._bundle, self._layout = bundle, layout
        self._racer: Racer | None = None
        self._vehicle: Vehicle | None = None
        self._course: Course | None = None
        self._decided: tuple[int, int] | None = None
        bundle.actor.act(np.zeros(layout.size, dtype=np.float32))

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Plan the lap; see `bike_policy.riders.learned.PolicyAdapter`.

        Raises:
            ValueError: a vehicle that is no superbike, or an open line.
        """
        if self._racer is None or self._vehicle is not vehicle:
            self._racer, self._vehicle = rehearsed_racer(self._bundle, vehicle, period, 1), vehicle
        self._racer.prepare(course)
        self._course, self._decided = course, None

    def command(self, snapshot: Snapshot) -> tuple[float, float]:
        """Return the command of this control period; see `bike_policy.riders.learned.PolicyAdapter`.

        Raises:
            ValueError: a course that is no circuit, or a snapshot that is not finite.
        """
        assert self._racer is not None, "begin comes first"
        row = row_of(snapshot)
        number = snapshot.episode, snapshot.step // self._layout.repeat
        if number != self._decided:
            self._decide(self._racer, snapshot, row)
            self._decided = number
        steering, throttle = self._racer.commands(row)[0].tolist()
        if not math.isfinite(steering + throttle):
            raise ValueError("the guide has no answer to a state that is not finite")
        return steering, throttle

    def _decide(self, racer: Racer, snapshot: Snapshot, row: Row) -> None:
        assert self._course is not None, "begin comes first"
        if snapshot.circuit is None:
            raise ValueError("this policy rides circuits; the course shows no limits")
        if self._decided is None or self._decided[0] != snapshot.episode:
            racer.begin(0, row, self._course)
        seen = racer.observe(row)
        if not np.isfinite(seen).all():
            raise ValueError("observation holds a value that is not finite")
        self.seen = seen[0]
        racer.decide(row, seen)
