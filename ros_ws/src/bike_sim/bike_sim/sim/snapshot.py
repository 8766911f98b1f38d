"""The snapshot: the record of one control instant, in named blocks, the same in process and behind ROS."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.sim import look as lk
from bike_sim.sim.events import CONTACT as CONTACT
from bike_sim.sim.events import DIVERGED as DIVERGED
from bike_sim.sim.events import NO_FALL as NO_FALL
from bike_sim.sim.events import TIPPED as TIPPED
from bike_sim.sim.events import WALL as WALL
from bike_sim.sim.events import Event, WallHit

FloatArray = NDArray[np.float64]

NO_SIGNALS: Final = np.zeros(0)
"""Signals of a vehicle that has none."""
NO_SIGNALS.setflags(write=False)


@dataclass(frozen=True, slots=True)
class CircuitView:
    """Position of a vehicle between the limits of a circuit, and the course points ahead.

    Attributes:
        place: arc length and lateral offset (positive left) of the rear, then of the front contact point relative to
            the centre line, m, in the order of :mod:`bike_sim.sim.look`.
        limits: position relative to the limits, in the order of `schema.LIMITS`.
        points: the followed line and both limits ahead, x, y, z in base_footprint, m, shape (3, lk.STATIONS, 3).
        wall: the touch of a wall at this instant, or the hit that ended the ride; None where there was none.
    """

    place: FloatArray
    limits: FloatArray
    points: FloatArray
    wall: WallHit | None

    @property
    def outside(self) -> float:
        """Distance beyond the limits of the contact point that is less far out, m; negative on the track."""
        return float(self.limits[lk.OUTSIDE])


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything known at one control instant. Units, frames and signs are those of ``bike_msgs/BikeState``.

    Attributes:
        episode: number of the reset, from 1.
        step: control steps since the reset.
        time: s since the reset.
        state: the ten minimal coordinates.
        look: derived quantities in the order of :mod:`bike_sim.sim.look`; on a circuit relative to the followed line.
        signals: telemetry in the order of the plant's `signal_names`; empty for bicycles.
        steering: applied steering command in [-1, 1].
        throttle: the same for throttle and brake.
        steer_torque: torque of the steering drive or the rider, Nm, positive to the left.
        preview_x: points of the followed line ahead, m, base_footprint.
        preview_y: m, base_footprint.
        roll_history: rad, oldest first.
        steer_history: rad, oldest first.
        fallen: the ride is over: fallen, stopped by a wall, or diverged.
        off_course: distance beyond the course's limit; on a circuit both contact points beyond the limits.
        finished: the end of an open course is reached, or a closed course was ridden once from where the ride began.
        fall: cause of the end: NO_FALL while the ride continues, else a name of `forces.FALL_NAMES`, TIPPED,
            WALL, DIVERGED or CONTACT.
        circuit: place, limits and course points; None where there is no circuit.
        events: since the previous snapshot, in the order of time.
        opponents: nearest others in a race, in the order of `schema.OPPONENT_SLOTS` and `schema.OPPONENT`, shape
            (slots, numbers), as ``bike_msgs/Opponents`` carries them; None where there is no race.
    """

    episode: int
    step: int
    time: float
    state: FloatArray
    look: FloatArray
    steering: float
    throttle: float
    steer_torque: float
    preview_x: FloatArray
    preview_y: FloatArray
    roll_history: tuple[float, ...]
    steer_history: tuple[float, ...]
    fallen: bool
    off_course: bool
    finished: bool
    fall: str = NO_FALL
    signals: FloatArray = field(default_factory=lambda: NO_SIGNALS)
    circuit: CircuitView | None = None
    events: tuple[Event, ...] = ()
    opponents: FloatArray | None = None

    @property
    def distance(self) -> float:
        """Distance of the rear contact to the followed line, t_0 = d(P, P_P0), m."""
        return abs(float(self.look[lk.LATERAL_ERROR]))

    @property
    def speed(self) -> float:
        """Forward speed, m/s."""
        return float(self.look[lk.SPEED])

    @property
    def progress(self) -> float:
        """Arc length of the vehicle, m: along the centre line of a circuit, else along the course."""
        return float(self.look[lk.PROGRESS] if self.circuit is None else self.circuit.place[lk.CENTRE_PROGRESS])
