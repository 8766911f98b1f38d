"""One vehicle in control steps: a batch of one row, read as snapshots. Node, training and evaluation use it."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from bike_sim.course.course import Course
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.batch import Batch
from bike_sim.sim.beginning import Beginning
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.events import DIVERGED, NO_FALL
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.snapshot import CircuitView, Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class RowSnapshots:
    """Snapshots of one row of a batch, with the history that they show."""

    def __init__(self, batch: Batch, row: int) -> None:
        """Take a row of a batch."""
        self._batch, self._row = batch, row
        self._last: Snapshot | None = None

    def begin(self) -> Snapshot:
        """Return the snapshot of a reset."""
        history = self._batch.config.history
        self._rolls: deque[float] = deque(maxlen=history)
        self._steers: deque[float] = deque(maxlen=history)
        return self.take(0, 0.0, 0.0)

    def take(self, step: int, steering: float, throttle: float) -> Snapshot:
        """Return the snapshot after a number of steps since the reset, and the command of the last one."""
        self._last = self._snapshot(step, steering, throttle)
        return self._last

    def _snapshot(self, step: int, steering: float, throttle: float) -> Snapshot:
        batch, rows, row = self._batch, self._batch.rows, self._row
        begun, fall, events = batch.begun(row), batch.fall(row), batch.events(row)
        time = step * batch.config.control_period
        if fall == DIVERGED and step:
            assert self._last is not None, "a ride begins finite"
            return replace(self._last, step=step, time=time, fallen=True, fall=fall, events=events)
        state, signals, circuit = rows.state[row].copy(), rows.signals[row].copy(), None
        preview = rows.preview[row].copy()
        if begun is None or begun.followed is None:
            view = rows.views[row, : lk.PLACE].copy()
        else:
            view = rows.views[row].copy()
            points = view[lk.POINTS :].reshape(3, lk.STATIONS, 3)
            circuit = CircuitView(view[lk.PLACE : lk.CIRCUIT], view[lk.CIRCUIT : lk.POINTS], points, batch.wall(row))
        self._rolls.append(float(state[st.ROLL]))
        self._steers.append(float(state[st.STEER]))
        off_course, finished = batch.flags(row)
        return Snapshot(
            episode=batch.episodes[row],
            step=step,
            time=time,
            state=state,
            look=view[: lk.PLACE],
            steering=steering,
            throttle=throttle,
            steer_torque=batch.plant(row).steer_torque(steering, state, signals),
            preview_x=preview[0],
            preview_y=preview[1],
            roll_history=tuple(self._rolls),
            steer_history=tuple(self._steers),
            fallen=fall != NO_FALL,
            off_course=off_course,
            finished=finished,
            fall=fall,
            signals=signals,
            circuit=circuit,
            events=events,
            opponents=None if batch.traffic is None else batch.opponents[row].copy(),
        )


class Simulator:
    """Rides one vehicle, bicycle or superbike, on paths and circuits.

    A simulator is deterministic: the same request and the same commands give the same snapshots, bit for bit.

    Attributes:
        config: vehicle, engine and steps.
        request: of the present episode.
        batch: of one row; it does the work.
        plant: the vehicle with the engine that begins its rides.
    """

    def __init__(self, config: SimulatorConfig | None = None, disturbances: Disturbances | None = None) -> None:
        """Load the vehicle and start the engine.

        Args:
            config: vehicle, engine and steps.
            disturbances: of what is ridden; those of what the rider sees are not the simulator's.

        Raises:
            ValueError: an invalid parameter. FileNotFoundError: an unknown vehicle.
        """
        self.config = config or SimulatorConfig()
        self.request = ResetRequest()
        self.batch = Batch(1, self.config, disturbances=disturbances)
        self.plant: Plant = self.batch.plant(0)
        self._shown = RowSnapshots(self.batch, 0)
        self._command = np.zeros((1, 2))

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle's parameters."""
        return self.plant.vehicle

    @property
    def begun(self) -> Beginning | None:
        """Beginning of the present episode, with its course, or None before the first."""
        return self.batch.begun(0)

    @property
    def course(self) -> Course | None:
        """The followed line of the present episode, or None before the first."""
        return None if self.begun is None else self.begun.course

    @property
    def track(self) -> Track | None:
        """The circuit of the present episode, or None where there is none."""
        return None if self.begun is None else self.begun.track

    @property
    def episode(self) -> int:
        """Number of the present episode; 0 before the first."""
        return self.batch.episodes[0]

    @episode.setter
    def episode(self, number: int) -> None:
        self.batch.episodes[0] = number

    @property
    def preview(self) -> Preview:
        """The preview of the present episode."""
        return self.plant.preview or self.request.preview

    def at_own_speed(self, request: ResetRequest) -> ResetRequest:
        """Return a request with the default start speed of this vehicle.

        Raises:
            ValueError: an invalid course or position. FileNotFoundError: an unknown course.
        """
        return self.batch.at_own_speed(0, request)

    def check(self, request: ResetRequest) -> None:
        """Check that an episode can begin; the present one continues.

        Raises:
            ValueError: why it cannot. FileNotFoundError: an unknown course.
        """
        self.batch.check(0, request)

    def reset(self, request: ResetRequest) -> Snapshot:
        """Begin an episode.

        Raises:
            ValueError: a request that cannot be met; the current episode is unchanged.
            FileNotFoundError: an unknown course.
        """
        self.batch.reset(0, request)
        self.request = request
        self._step = 0
        return self._shown.begin()

    def step(self, steering: float, throttle: float = 0.0) -> Snapshot:
        """Hold both commands for one control period.

        Physics that diverges ends the episode: the last finite snapshot is shown again, as a fall.

        Args:
            steering: in [-1, 1], see `Batch.step`.
            throttle: in [-1, 1].

        Raises:
            ValueError: a command that is not finite or out of range.
            RuntimeError: no episode was begun.
        """
        if self.begun is None:
            raise RuntimeError("call reset before step")
        if not -1.0 <= steering <= 1.0 or not -1.0 <= throttle <= 1.0:
            raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
        self._command[0, 0], self._command[0, 1] = steering, throttle
        self.batch.advance(self._command)
        self._step += 1
        return self._shown.take(self._step, steering, throttle)

    def close(self) -> None:
        """Release the engine; a second call does nothing."""
        self.batch.close()
