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

from bike_policy.contract.actor import Actor
from bike_policy.contract.observation import ObservationLayout, SeenBlocks
from bike_sim.physics import state as st
from bike_sim.physics.whipple_engine import advance
from bike_sim.sim import look as lk
from bike_sim.sim.bicycle_batch import CompiledBatch
from bike_sim.sim.config import SimulatorConfig
from bike_training.curricula.base import Episodes
from bike_training.tasks.path import PathTask

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

DEVIATIONS: Final = ("lateral", "heading", "roll", "steer", "roll_rate", "steer_rate")
"""What a ride may deviate in: m to the left, rad, rad/s; signs of the state."""
LATERAL, HEADING = 0, 1
FREE: Final = (st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE)
"""Coordinates of the other deviations."""
INNER: Final = ("roll", "steer", "roll_rate", "steer_rate")
"""The features that show them."""

_STEP: Final = 1e-4
"""Of the differences, rad, rad/s, or parts of the largest command."""


class Segment(NamedTuple):
    """Rides of a number of bicycles over a number of control periods; leading dimensions (periods, bicycles).

    Attributes:
        seen: observations before each period, and in the end, shape (periods + 1, bicycles, k).
        commands: set points of the steering angle, in parts of the largest.
        error: lateral error after each period, m. steer_rate: after it, rad/s.
        motion: deviations after it by those before it and by the command, shape (..., 6, 7).
        sight: observation by the deviations of the same instant, after it, shape (..., k, 6).
        across: cosine of the heading error after it: what a lateral deviation adds to the error.
        whole: 1 until the ride has failed, then 0.
    """

    seen: Float32Array
    commands: Float32Array
    error: Float32Array
    steer_rate: Float32Array
    motion: Float32Array
    sight: Float32Array
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


def motion_slopes(batch: CompiledBatch, commands: FloatArray) -> FloatArray:
    """Return the derivatives of the deviations after a control period, shape (n, 6, 7).

    Args:
        batch: before the period.
        commands: steering in [-1, 1], shape (n,).
    """
    vehicle = batch.vehicle
    period = batch.time_step * batch.substeps
    varied = _varied(batch.state, commands * vehicle.max_steer, vehicle.max_steer, period, vehicle.parameters)
    after = varied[0]
    sin, cos = np.sin(after[:, st.YAW]), np.cos(after[:, st.YAW])
    slopes = np.zeros((batch.count, len(DEVIATIONS), len(DEVIATIONS) + 1))
    moved = (varied[1:] - after) / _STEP
    slopes[:, LATERAL, 2:] = (cos * moved[..., st.Y] - sin * moved[..., st.X]).T
    for row, place in enumerate((st.YAW, *FREE), start=1):
        slopes[:, row, 2:] = moved[..., place].T
    way = after[:, [st.X, st.Y]] - batch.state[:, [st.X, st.Y]]
    slopes[:, LATERAL, LATERAL] = np.cos(after[:, st.YAW] - batch.state[:, st.YAW])
    slopes[:, LATERAL, HEADING] = cos * way[:, 0] + sin * way[:, 1]
    slopes[:, HEADING, HEADING] = 1.0
    return slopes


class Sight:
    """Derivatives of an observation by the deviations."""

    def __init__(self, layout: ObservationLayout) -> None:
        """Take a layout.

        Raises:
            ValueError: it shows where in the map the bicycle is.
        """
        known = {*INNER, "front_wheel_rate", "speed"}
        if not set(layout.features) <= known:
            raise ValueError(
                f"layout {layout.name!r} shows {sorted(set(layout.features) - known)}, which have no slopes"
            )
        self._size, self._first = layout.size, len(layout.features)
        self._inner = np.zeros((layout.size, len(DEVIATIONS)))
        for column, name in enumerate(INNER, start=2):
            if name in layout.features:
                place = layout.features.index(name)
                self._inner[place, column] = layout.scales[place]
        # What is shown of the preview is linear in it.
        nothing = SeenBlocks(np.zeros((1, 10)), np.zeros((1, 12)), np.zeros((1, layout.preview_count)))
        ones = nothing._replace(
            state=np.zeros((layout.preview_count, 10)),
            look=np.zeros((layout.preview_count, 12)),
            preview_y=np.eye(layout.preview_count),
        )
        shown = (layout.observe(ones) - layout.observe(nothing))[:, self._first :]
        self._preview = shown.T.astype(np.float64)

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


class LinearRides:
    """Bicycles that ride segment after segment, and begin anew where a ride has failed or was long enough.

    Attributes:
        batch: of bicycles. task: what they ride.
    """

    def __init__(self, count: int, task: PathTask, episodes: Episodes, config: SimulatorConfig, seed: int) -> None:
        """Begin a number of rides.

        Args:
            count: number of bicycles.
            task: with an observation that :class:`Sight` knows.
            episodes: where rides are drawn from.
            config: of the compiled engine.
            seed: of all draws.
        """
        self.batch = CompiledBatch(count, config, task.preview)
        self.task = task
        self._episodes, self._sight = episodes, Sight(task.layout)
        self._rng = np.random.default_rng(seed)
        for row in range(count):
            self._begin(row)
        # They end one after the other.
        self._age = self._rng.integers(0, task.max_steps, size=count)

    def _begin(self, row: int) -> None:
        self.batch.reset(row, self._episodes.draw(self._rng, self.task.preview))

    def ride(self, actor: Actor, periods: int, push: float) -> Segment:
        """Ride on for a number of control periods.

        Args:
            actor: who rides.
            periods: control periods.
            push: how strongly rides are pushed, about once in two seconds: standard deviation of the roll and steer
                rates that a push leaves, rad/s.
        """
        batch, task, count = self.batch, self.task, self.batch.count
        for row in np.flatnonzero(task.failed(batch) | (self._age >= task.max_steps)):
            self._begin(int(row))
            self._age[row] = 0
        size, wide = task.layout.size, len(DEVIATIONS)
        shape = (periods, count)
        segment = Segment(
            seen=np.zeros((periods + 1, count, size), np.float32),
            commands=np.zeros(shape, np.float32),
            error=np.zeros(shape, np.float32),
            steer_rate=np.zeros(shape, np.float32),
            motion=np.zeros((*shape, wide, wide + 1), np.float32),
            sight=np.zeros((*shape, size, wide), np.float32),
            across=np.zeros(shape, np.float32),
            whole=np.zeros(shape, np.float32),
        )
        whole = np.ones(count, dtype=np.bool_)
        commands = np.zeros((count, 2))
        segment.seen[0] = task.layout.observe(batch)
        for k in range(periods):
            pushed = self._rng.random(count) < batch.time_step * batch.substeps / 2.0
            draws = push * self._rng.standard_normal((count, 2)) * pushed[:, None]
            batch.state[:, [st.ROLL_RATE, st.STEER_RATE]] += draws
            segment.seen[k] = task.layout.observe(batch)
            commands[:] = task.action.to_commands(actor.act_batch(segment.seen[k]), batch.vehicle.max_steer)
            segment.commands[k], segment.whole[k] = commands[:, 0], whole
            segment.motion[k] = motion_slopes(batch, commands[:, 0]) * whole[:, None, None]
            batch.step(commands)
            segment.error[k] = batch.look[:, lk.LATERAL_ERROR]
            segment.across[k] = np.cos(batch.look[:, lk.HEADING_ERROR])
            segment.steer_rate[k] = batch.state[:, st.STEER_RATE]
            segment.sight[k] = self._sight.slopes(batch.preview_x) * whole[:, None, None]
            segment.seen[k + 1] = task.layout.observe(batch)
            whole &= ~task.failed(batch)
        self._age += periods
        return Segment(*(np.nan_to_num(part, nan=0.0, posinf=0.0, neginf=0.0) for part in segment))

    def close(self) -> None:
        """Release the engine."""
        self.batch.close()
