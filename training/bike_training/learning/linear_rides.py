"""Rides with their derivatives: how a deviation and a command change what follows, to first order.

A bicycle on a path does not notice where it is: only lean, steer and their rates change how it moves. So a control
period is differentiated by five differences of the compiled engine, and what the position changes, of the ride and of
what is seen, follows from geometry. Between rides of one segment nothing is approximated but the order.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray
from numpy.typing import NDArray

from bike_policy.contract.bundle import Actor
from bike_policy.contract.observation import ObservationLayout, Rows
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple import advance, pushed
from bike_sim.sim import look as lk
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Impulses
from bike_training.curricula.base import Episodes
from bike_training.learning.presets import GradientSettings
from bike_training.tasks.path import PathTask

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

DEVIATIONS: Final = ("lateral", "heading", "roll", "steer", "roll_rate", "steer_rate")
"""Deviations of a ride: m to the left, rad, rad/s; signs of the state."""
LATERAL, HEADING = 0, 1
FREE: Final = (st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE)
"""Coordinates of the other deviations."""
INNER: Final = ("roll", "steer", "roll_rate", "steer_rate")
"""The features that show them."""

_BETWEEN: Final = 4.0
"""Mean time between two impulses, s."""
_STEP: Final = 1e-4
"""Of the differences, rad, rad/s, or parts of the largest command."""


class Segment(NamedTuple):
    """Rides of a number of bicycles over a number of control periods; leading dimensions (periods, bicycles).

    Attributes:
        sent: the last answers before the segment, shape (bicycles,).
        seen: observations before each period, shape (..., k).
        sight: their derivatives by the deviations of the same instant, shape (..., k, 6).
        commands: set points of the steering angle that acted, in parts of the largest.
        error: lateral error after each period, m.
        steer_rate: after it, rad/s.
        roll: after it, rad.
        steer: after it, rad.
        motion: deviations after it by those before it and by the command, shape (..., 6, 7).
        across: cosine of the heading error after it: what a lateral deviation adds to the error.
        whole: 1 until the ride has failed, then 0.
    """

    sent: Float32Array
    seen: Float32Array
    sight: Float32Array
    commands: Float32Array
    error: Float32Array
    steer_rate: Float32Array
    roll: Float32Array
    steer: Float32Array
    motion: Float32Array
    across: Float32Array
    whole: Float32Array


@njit(cache=True)
def _varied(states: ndarray, steer_set: ndarray, most: float, period: float, parameters: ndarray) -> ndarray:
    """Return states after a control period: undisturbed, with each of FREE larger by a step, and with the command.

    Two steps of order four are enough for derivatives.

    Args:
        states: shape (n, 10).
        steer_set: rad, shape (n,).
        most: set point of the largest command, rad.
        period: s.
        parameters: flat vehicle parameters.

    Returns:
        Shape (6, n, 10).
    """
    out = np.empty((6, len(states), states.shape[1]))
    for k in range(6):
        for i in range(len(states)):
            out[k, i] = states[i]
            wanted = steer_set[i]
            if 0 < k < 5:
                out[k, i, FREE[k - 1]] += _STEP
            if k == 5:
                wanted += _STEP * most
            advance(out[k, i], wanted, period / 2, 2, parameters)
    return out


def motion_slopes(batch: Batch, commands: FloatArray) -> FloatArray:
    """Return the derivatives of the deviations after a control period, shape (n, 6, 7).

    Args:
        batch: before the period.
        commands: steering in [-1, 1], shape (n,).
    """
    vehicle = batch.vehicle
    period = batch.config.time_step * batch.config.substeps
    varied = _varied(batch.state, commands * vehicle.max_steer, vehicle.max_steer, period, vehicle.parameters)
    after = varied[0]
    sin, cos = np.sin(after[:, st.YAW]), np.cos(after[:, st.YAW])
    slopes = np.zeros((batch.count, len(DEVIATIONS), len(DEVIATIONS) + 1))
    moved = (varied[1:] - after) / _STEP
    slopes[:, LATERAL, 2:] = (cos * moved[..., st.Y] - sin * moved[..., st.X]).T
    for row, place in enumerate((st.YAW, *FREE), start=1):
        slopes[:, row, 2:] = moved[..., place].T
    moved = after[:, [st.X, st.Y]] - batch.state[:, [st.X, st.Y]]
    slopes[:, LATERAL, LATERAL] = np.cos(after[:, st.YAW] - batch.state[:, st.YAW])
    slopes[:, LATERAL, HEADING] = cos * moved[:, 0] + sin * moved[:, 1]
    slopes[:, HEADING, HEADING] = 1.0
    return slopes


class ObservationJacobian:
    """Derivatives of an observation by the deviations."""

    def __init__(self, layout: ObservationLayout) -> None:
        """Take a layout.

        Raises:
            ValueError: it shows where in the map the bicycle is, or a preview that is not linear in its points.
        """
        known = {*INNER, "front_wheel_rate", "speed", "preview_points", "preview_lean"}
        shown = set(layout.terms)
        if not shown <= known:
            raise ValueError(f"layout {layout.name!r} shows {sorted(shown - known)}, which have no slopes")
        self._size, self._first = layout.size, layout.size - layout.preview_count
        self._inner = np.zeros((layout.size, len(DEVIATIONS)))
        for column, name in enumerate(INNER, start=2):
            if name in shown:
                place = layout.names.index(name)
                self._inner[place, column] = layout.gains[place]
        # What is shown of the preview is linear in it.
        count = layout.preview_count
        nothing = Rows.of_path(np.zeros((1, 10)), np.zeros((1, 12)), np.zeros((1, 2, count)))
        aside = np.stack((np.zeros((count, count)), np.eye(count)), axis=1)
        ones = Rows.of_path(np.zeros((count, 10)), np.zeros((count, 12)), aside)
        effect = (layout.observe(ones) - layout.observe(nothing))[:, self._first :]
        self._preview = effect.T.astype(np.float64)

    def slopes(self, preview_x: FloatArray) -> FloatArray:
        """Return the derivatives of observations, shape (n, k, 6).

        That the points run along the line with a bicycle which is not parallel to it is left out: it counts with the
        square of the heading error.

        Args:
            preview_x: of the preview points, m, shape (n, points).
        """
        out = np.empty((len(preview_x), self._size, len(DEVIATIONS)))
        out[...] = self._inner
        out[:, self._first :, LATERAL] = -self._preview.sum(axis=1)
        out[:, self._first :, HEADING] = -preview_x @ self._preview.T
        return out


def push_sideways(batch: Batch, row: int, impulse: float) -> None:
    """Push one bicycle of a batch as the disturbances ``impulses`` do, but at once: the rates take up its momentum.

    Args:
        batch: of bicycles.
        row: of the one that is pushed.
        impulse: to its left, N s.
    """
    where = Impulses()
    change = pushed(batch.state[row], 0.0, impulse, where.ahead_m, where.height_m, batch.vehicle.parameters)
    batch.state[row, [st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]] += change


class LinearRides:
    """Bicycles that ride segment after segment, and begin anew where a ride has failed or was long enough.

    Attributes:
        batch: of bicycles.
        task: what they ride.
    """

    def __init__(
        self,
        settings: GradientSettings,
        task: PathTask,
        episodes: Episodes,
        config: SimulatorConfig,
        seed: int,
        starts: Episodes | None = None,
    ) -> None:
        """Begin a number of rides.

        Args:
            settings: number of bicycles, and differences between rides.
            task: with an observation that :class:`ObservationJacobian` knows.
            episodes: distribution of rides.
            config: of the compiled engine.
            seed: of all draws.
            starts: of the steep share of the rides, which begin anew with every segment, without a push.
        """
        count = settings.bicycles
        self.batch, self.task = Batch(count, config, task.preview), task
        self._episodes, self._sight = episodes, ObservationJacobian(task.layout)
        self._starts, self._starting = starts, round(settings.steep * count)
        self._rng = np.random.default_rng(seed)
        self._settings, self._period = settings, config.time_step * config.substeps
        self._sent = np.zeros(count)
        for row in range(count):
            self._begin(row)
        # They end one after the other.
        self._age = self._rng.integers(0, task.max_steps, size=count)

    def _begin(self, row: int) -> None:
        self._sent[row] = 0.0
        steep = self._starts if row < self._starting else None
        episodes = steep or self._episodes
        self.batch.reset(row, episodes.draw(self._rng, self.task.preview))

    def ride(self, actor: Actor, periods: int, push: float) -> Segment:
        """Ride on for a number of control periods.

        Args:
            actor: the rider.
            periods: control periods.
            push: how strongly rides are pushed, about once in two seconds: standard deviation of the roll and steer
                rates that a push leaves, rad/s.
        """
        batch, task, count = self.batch, self.task, self.batch.count
        ended = task.failed(batch) | (self._age >= task.max_steps)
        ended[: self._starting] = True
        for row in np.flatnonzero(ended):
            self._begin(int(row))
            self._age[row] = 0
        sent = self._sent.astype(np.float32)
        rows: list[Segment] = []
        whole = np.ones(count, dtype=np.bool_)
        for _ in range(periods):
            struck = self._rng.random(count) < self._period / 2.0
            draws = push * self._rng.standard_normal((count, 2)) * struck[:, None]
            draws[: self._starting] = 0.0
            batch.state[:, [st.ROLL_RATE, st.STEER_RATE]] += draws
            if self._settings.impulse:
                self._hit(whole)
            seen = task.layout.observe(batch)
            sight = (self._sight.slopes(batch.preview_xy[:, 0]) * whole[:, None, None]).astype(np.float32)
            speed = batch.look[:, lk.SPEED]
            commands = task.action.to_commands(actor.act_batch(seen), batch.vehicle.max_steer, speed)
            self._sent = commands[:, 0]
            motion = motion_slopes(batch, commands[:, 0]) * whole[:, None, None]
            batch.step(commands)
            rows.append(
                Segment(
                    sent=sent,
                    seen=seen,
                    sight=sight,
                    commands=commands[:, 0].astype(np.float32),
                    error=batch.look[:, lk.LATERAL_ERROR].astype(np.float32),
                    steer_rate=batch.state[:, st.STEER_RATE].astype(np.float32),
                    roll=batch.state[:, st.ROLL].astype(np.float32),
                    steer=batch.state[:, st.STEER].astype(np.float32),
                    motion=motion.astype(np.float32),
                    across=np.cos(batch.look[:, lk.HEADING_ERROR]).astype(np.float32),
                    whole=whole.astype(np.float32),
                )
            )
            whole &= ~task.failed(batch)
        self._age += periods
        segment = Segment(*(np.stack(part) for part in zip(*rows, strict=True)))._replace(sent=sent)
        for part in segment:  # what lies on the ground has no numbers to learn from
            np.nan_to_num(part, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        return segment

    def _hit(self, whole: NDArray[np.bool_]) -> None:
        """Push some of the bicycles that still ride; every second one is never pushed."""
        hit = whole & (self._rng.random(len(whole)) < self._period / _BETWEEN) & (np.arange(len(whole)) % 2 == 1)
        hit[: self._starting] = False
        for row in np.flatnonzero(hit):
            push_sideways(self.batch, int(row), self._settings.impulse * self._rng.uniform(-1.0, 1.0))

    def close(self) -> None:
        """Release the engine."""
        self.batch.close()
