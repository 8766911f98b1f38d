"""From snapshots to decisions on a circuit."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.race import RaceEyes, RaceLayout
from bike_policy.contract.rows import Row, row_of
from bike_policy.riders.race_guide import RaceGuide, commands_of
from bike_policy.riders.race_reference import References
from bike_sim.course.course import Course
from bike_sim.physics.superbike_forces import TELEMETRY_NAMES
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class RaceSight:
    """Decides every so many control periods on a circuit, and remembers what it has decided.

    A decision belongs to the steps from a multiple of ``repeat`` on, counted from the reset. Where states are lost, or
    the rider is started in the middle of a ride, it decides at once: memory begins with what it sees then.

    Attributes:
        seen: observation of the last decision, shape (layout size,); None before the first.
    """

    seen: NDArray[np.float32] | None = None

    def __init__(self, bundle: Bundle, layout: RaceLayout) -> None:
        """Answer a made-up observation once; the first one of a process takes longer than all others."""
        self._actor, self._layout = bundle.actor, layout
        self._columns = bundle.action
        self._eyes: RaceEyes | None = None
        self._guide: RaceGuide | None = None
        self._references: References | None = None
        self._vehicle: Vehicle | None = None
        self._course: Course | None = None
        self._decided: tuple[int, int] | None = None
        self._actor.act(np.zeros(layout.size, dtype=np.float32))

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Plan the lap; see `bike_policy.riders.learned.Sight`.

        Raises:
            ValueError: a vehicle that is no superbike, or an open line.
        """
        if self._references is None or self._vehicle is not vehicle:
            self._references, self._vehicle = References(vehicle), vehicle
            self._guide = RaceGuide(vehicle, period, 1) if self._columns.guided else None
            self._eyes = RaceEyes(self._layout, 1, TELEMETRY_NAMES, self._guide)
        self._references.of(course)
        if self._guide is not None:
            self._guide.begin(0, course)  # plans the lap before the ride
        self._course, self._decided = course, None

    def command(self, snapshot: Snapshot) -> tuple[float, float]:
        """Return what the present decision becomes in this control period; see `bike_policy.riders.learned.Sight`.

        Raises:
            ValueError: a course that is no circuit, or a snapshot that is not finite.
        """
        assert self._vehicle is not None, "begin comes first"
        row = row_of(snapshot)
        number = snapshot.episode, snapshot.step // self._layout.repeat
        if number != self._decided:
            self._decide(snapshot, row)
            self._decided = number
        assert self._eyes is not None
        commands = commands_of(self._columns, self._guide, self._eyes, row, self._vehicle.max_steer)
        steering, throttle = commands[0].tolist()
        if not math.isfinite(steering + throttle):
            raise ValueError("the guide has no answer to a state that is not finite")
        return steering, throttle

    def _decide(self, snapshot: Snapshot, row: Row) -> None:
        assert self._eyes is not None, "begin comes first"
        assert self._references is not None
        assert self._course is not None
        if snapshot.circuit is None:
            raise ValueError("this policy rides circuits; the course shows no limits")
        if self._decided is None or self._decided[0] != snapshot.episode:
            if self._guide is not None:
                self._guide.begin(0, self._course)
            self._eyes.begin(0, row, self._references.of(self._course))
        self.seen = self._eyes.observe(row)[0]
        self._eyes.act(row, self._actor.act(self.seen)[None])
