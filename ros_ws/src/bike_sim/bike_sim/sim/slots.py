"""Engines in the slot of a step that moves rows for one control period: one by one, or in a compiled loop.

A slot brings the rows that ride from `BatchState.state` to `BatchState.moved`, with telemetry and falls; all else is
the same for every engine (:mod:`bike_sim.sim.batch`). Rows that have not begun or are held by a wall stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple import advance as advance_bicycle
from bike_sim.physics.ground import BUMP_SAMPLES, Ground
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.observation import TIP_OVER, BatchState, array_at, call
from bike_sim.sim.plant import Plant

FloatArray = NDArray[np.float64]


class EngineSlot:
    """Engines of any kind, one a row, in turn; their rides cannot be continued, for contacts are not exposed.

    Attributes:
        plants: the vehicle of each row with its engine.
        compiled: whether engines are shared, for they only begin rides.
    """

    compiled = False

    def __init__(self, plants: Sequence[Plant], config: SimulatorConfig) -> None:
        """Take the plants of all rows."""
        self.plants, self.config = list(plants), config
        self._form = float(config.time_step), config.substeps

    def begin(self, row: int, plant: Plant) -> None:
        """Take the plant of a row, which has been reset."""
        self.plants[row] = plant

    def advance(self, commands: FloatArray, rows: BatchState) -> None:
        """Move the rows with commands in [-1, 1], shape (n, 2), held for a control period."""
        for row, plant in enumerate(self.plants):
            ride = rows.ride[row]
            engine: Any = plant.engine  # of superbikes where a wall is scraped
            if rows.steps[row] < 0 or ride["stopped"]:
                continue
            if ride["touched"]:
                engine.deflect(*rows.state[row, [st.X, st.Y]].tolist(), *ride["scrape"].tolist())
            ground = Ground(rows.ground[row : row + 1], array_at(int(rows.around[row]["bumps"]), 1, BUMP_SAMPLES))
            steering, throttle = commands[row].tolist()
            plant.advance(steering, throttle, self.config.substeps, ground)
            rows.moved[row], rows.fall[row] = engine.state(), plant.fall()
            rows.moved_signals[row, : len(plant.signal_names)] = engine.telemetry()

    def state_dict(self) -> dict[str, Any] | None:
        """Return what :meth:`restore` needs beside the rows; None where rides cannot be continued."""
        return None

    def restore(self, stored: dict[str, Any]) -> None:
        """Go on where :meth:`state_dict` was taken.

        Raises:
            ValueError: rides that cannot be continued.
        """
        raise ValueError(f"rides on engine {self.config.engine!r} cannot be taken up in the middle")


class BicycleSlot(EngineSlot):
    """Bicycles on the compiled Whipple engine."""

    compiled = True

    def __init__(self, plants: Sequence[Plant], config: SimulatorConfig) -> None:
        """Take the plants of all rows."""
        super().__init__(plants, config)
        self._lying = np.zeros(len(plants), dtype=np.bool_)

    def begin(self, row: int, plant: Plant) -> None:
        """Take the plant of a row, which has been reset."""
        super().begin(row, plant)
        self._lying[row] = False

    def advance(self, commands: FloatArray, rows: BatchState) -> None:
        """Move the rows; see `EngineSlot`."""
        call(_advance_bicycles, commands, *self._form, rows, self._lying)

    def state_dict(self) -> dict[str, Any]:
        """Return which bicycles lie; see `EngineSlot`."""
        return {"lying": self._lying.copy()}

    def restore(self, stored: dict[str, Any]) -> None:
        """Go on; see `EngineSlot`."""
        self._lying[:] = stored["lying"]


@njit(cache=True)
def _advance_bicycles(
    commands: FloatArray, time_step: float, steps: int, rows: BatchState, lying: NDArray[np.bool_]
) -> None:
    for i in range(len(commands)):
        if rows.steps[i] < 0 or rows.ride[i].stopped:
            continue
        vehicle, moved = rows.vehicle[i], rows.moved[i]
        if not lying[i]:
            steer_set = commands[i, 0] * vehicle.max_steer
            lying[i] = not advance_bicycle(moved, steer_set, time_step, steps, rows.parameters[i])
        rows.fall[i] = TIP_OVER if lying[i] or abs(moved[st.ROLL]) > vehicle.fall_roll else 0


def bytes_of(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array of numbers, or the bytes of an array of records, as files without pickle take them; a view."""
    return array if array.dtype.names is None else array.view(np.uint8).reshape(len(array), -1)
