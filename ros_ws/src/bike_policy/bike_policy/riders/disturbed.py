"""Disturbances between a vehicle and its rider: sensors that err, and delays on the way in and out.

Superbikes have the instruments that batches of them have; see `bike_policy.riders.instruments`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import rows_of
from bike_policy.riders.base import Rider
from bike_policy.riders.estimator import Estimator
from bike_policy.riders.instruments import SENSORS, CommandQueue, Instruments
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.disturbances import CHANNELS, Disturbances
from bike_sim.sim.request import Preview
from bike_sim.sim.sensors import BicycleSensors
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]


class DisturbedRider:
    """A rider that sees late and with errors, and whose commands act late; implements `bike_policy.riders.base.Rider`.

    Until the first command has arrived, the set point is straight ahead.

    Attributes:
        rider: the one that is disturbed.
    """

    def __init__(self, rider: Rider, disturbances: Disturbances) -> None:
        """Take a rider and what disturbs it."""
        self.rider, self._disturbances = rider, disturbances
        self._noise = np.array([disturbances.noise.get(name, 0.0) for name in CHANNELS])
        self._bias = np.array([disturbances.bias.get(name, 0.0) for name in CHANNELS])
        self.name, self.preview = rider.name, rider.preview

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare the rider; see `Rider`.

        Raises:
            ValueError: a delay or a time between fixes that is not a whole number of control periods, or errors of
                sensors that the vehicle does not have.
        """
        known = self._disturbances
        known.check_sensors(vehicle)
        self._seen_late = known.periods(known.observation_delay_s, period)
        self._instruments = Instruments([known], [vehicle], period) if isinstance(vehicle, Superbike) else None
        self._queue = CommandQueue.of([known], period) if self._instruments is None else self._instruments.queue
        self.rider.begin(vehicle, course, period, preview)
        self._seen: deque[Snapshot] = deque()
        self._draws: np.random.Generator | None = None
        self._sensors: BicycleSensors | None = None
        if known.raw_sensors is not None:
            self._sensors = BicycleSensors(vehicle, known, period)
            self._estimator = Estimator(vehicle, course, period, preview, known.raw_sensors)
        self._answered: tuple[int, tuple[float, float] | None] | None = None

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the command that acts now; the same again for a snapshot that is shown again.

        Delays count control periods, not snapshots, so that one that was missed shifts nothing.
        """
        if self._answered is not None and self._answered[0] == snapshot.step:
            return self._answered[1]
        missed = 0 if self._answered is None else snapshot.step - self._answered[0] - 1
        if self._instruments is None:
            answer = self._seen_by_bicyclist(snapshot, missed)
        else:
            answer = self._shown_by(self._instruments, snapshot, missed)
        arrived = self._queue.hold() if answer is None else self._queue.send(np.array([answer]))
        acting = None if answer is None else (float(arrived[0, 0]), float(arrived[0, 1]))
        self._answered = snapshot.step, acting
        return acting

    def _seen_by_bicyclist(self, snapshot: Snapshot, missed: int) -> tuple[float, float] | None:
        """Return the answer to what the rider of a bicycle sees now, after control periods that were missed."""
        for _ in range(missed):
            self._queue.hold()
        seen = self._estimated(snapshot) if self._sensors is not None else measured(snapshot, self._errors(snapshot))
        if seen is None:
            return None
        self._seen.append(seen)
        while len(self._seen) > 1 and self._seen[1].step <= snapshot.step - self._seen_late:
            self._seen.popleft()
        return self.rider.command(self._seen[0])

    def _estimated(self, snapshot: Snapshot) -> Snapshot | None:
        """Return what is made of the sensors' measurements; None where they are not finite."""
        assert self._sensors is not None, "asked for"
        if self._answered is None:
            self._sensors.begin(snapshot)
        state = self._estimator.measure(self._sensors.measure(snapshot))
        return None if state is None else self._estimator.snapshot(state, snapshot.episode, snapshot.step)

    def _shown_by(self, instruments: Instruments, snapshot: Snapshot, missed: int) -> tuple[float, float] | None:
        """Return the answer to what a superbike's instruments show now, after control periods that were missed."""
        rows = rows_of(snapshot)
        if self._answered is None:
            instruments.begin(0, rows)
        for _ in range(missed):
            instruments.miss()
        shown = instruments.shown(rows)
        instruments.go_on()
        if shown is rows:
            return self.rider.command(snapshot)
        circuit = snapshot.circuit
        if circuit is not None:
            circuit = replace(circuit, limits=shown.circuit[0], points=shown.points[0])
        seen = replace(
            snapshot,
            state=shown.state[0],
            look=shown.look[0],
            preview_x=shown.preview_xy[0, 0],
            preview_y=shown.preview_xy[0, 1],
            signals=shown.signals[0],
            circuit=circuit,
        )
        return self.rider.command(seen)

    def _errors(self, snapshot: Snapshot) -> FloatArray:
        """Return the errors of the sensors at a snapshot; those of steps that were missed are drawn and passed over."""
        if self._draws is None:
            self._draws = self._disturbances.generator(snapshot.state, SENSORS)
            self._drawn = snapshot.step - 1
        drawn = self._draws.standard_normal((max(snapshot.step - self._drawn, 1), len(CHANNELS)))
        self._drawn = snapshot.step
        errors: FloatArray = self._bias + self._noise * drawn[-1]
        return errors


def measured(snapshot: Snapshot, errors: FloatArray) -> Snapshot:
    """Return a snapshot as sensors with errors show it; position, preview and front contact move with the rear contact.

    Args:
        snapshot: what is.
        errors: of CHANNELS.
    """
    roll, steer, roll_rate, steer_rate, lateral, heading, speed = errors
    state, look = snapshot.state.copy(), snapshot.look.copy()
    along = float(state[st.YAW] - look[lk.HEADING_ERROR])
    # The points of the path ahead lie as a bicycle sees them that is displaced and turned by the errors.
    turn, base = np.array([math.cos(heading), math.sin(heading)]), float(look[lk.HEADING_ERROR])
    x = snapshot.preview_x - lateral * math.sin(base)
    y = snapshot.preview_y - lateral * math.cos(base)
    ahead = math.hypot(look[lk.FRONT_X] - state[st.X], look[lk.FRONT_Y] - state[st.Y])
    state[[st.X, st.Y]] += lateral * np.array([-math.sin(along), math.cos(along)])
    state[[st.YAW, st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE]] += (heading, roll, steer, roll_rate, steer_rate)
    state[st.FRONT_WHEEL_RATE] *= 1.0 + speed / max(float(look[lk.SPEED]), 1e-6)
    look[[lk.LATERAL_ERROR, lk.HEADING_ERROR, lk.SPEED]] += (lateral, heading, speed)
    look[lk.FRONT_LATERAL_ERROR] += lateral + ahead * math.sin(heading)
    return replace(
        snapshot,
        state=state,
        look=look,
        preview_x=turn[0] * x + turn[1] * y,
        preview_y=turn[0] * y - turn[1] * x,
    )
