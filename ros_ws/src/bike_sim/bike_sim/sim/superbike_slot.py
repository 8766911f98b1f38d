"""Superbikes on the compiled engine in one loop; see `slots.EngineSlot`. Rows may ride different machines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.ground import BUMP_SAMPLES
from bike_sim.physics.multibody import articulated
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine, Model, Rides, advance
from bike_sim.physics.superbike.forces import TELEMETRY
from bike_sim.physics.superbike.pose import LARGEST_TREE, deflect
from bike_sim.physics.superbike.records import MEMORY, discretise_command
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.observation import BatchState, array_at, call
from bike_sim.sim.plant import Plant
from bike_sim.sim.slots import EngineSlot, bytes_of

FloatArray = NDArray[np.float64]


class Bodies(NamedTuple):
    """Machines of the rows, and all that their dynamics remember.

    Attributes:
        constants: records of `records.CONSTANTS`, one a machine.
        trees: records of `articulated.tree_record`, one a machine.
        machine: place of each row's machine.
        motion: of the bodies, one a row.
        memory: of the forces, one a row.
        work: scratch memory of the dynamics, shape (1,).
    """

    constants: Any
    trees: Any
    machine: NDArray[np.int64]
    motion: Any
    memory: Any
    work: Any


class SuperbikeSlot(EngineSlot):
    """Superbikes on the compiled engine.

    Attributes:
        bodies: of all rows.
    """

    compiled = True

    def __init__(self, plants: Sequence[Plant], config: SimulatorConfig) -> None:
        """Take the plants of all rows."""
        super().__init__(plants, config)
        count = len(plants)
        self._machines: list[Plant] = []
        self.bodies = Bodies(
            np.zeros(0),
            np.zeros(0),
            np.zeros(count, dtype=np.int64),
            np.zeros(count, dtype=articulated.motion_record(LARGEST_TREE)),
            np.zeros(count, dtype=MEMORY),
            articulated.workspace(LARGEST_TREE),
        )
        self._telemetry: Any = None  # the signals of the rows, by name

    def begin(self, row: int, plant: Plant) -> None:
        """Take the plant of a row, which has been reset, with its motion."""
        super().begin(row, plant)
        if plant not in self._machines:
            self._machines.append(plant)
            engines = [_engine_of(machine) for machine in self._machines]
            self.bodies = self.bodies._replace(
                constants=np.concatenate([engine.constants for engine in engines]),
                trees=np.concatenate(
                    [articulated.tree_record(engine.tree, engine.vehicle.g, LARGEST_TREE) for engine in engines]
                ),
            )
        bodies, engine = self.bodies, _engine_of(plant)
        bodies.machine[row] = self._machines.index(plant)
        bodies.memory[row] = engine.memory[0]
        for name in engine.motion.dtype.names or ():
            part = engine.motion[name][0]
            bodies.motion[name][row, : part.size] = part

    def advance(self, commands: FloatArray, rows: BatchState) -> None:
        """Move the rows; see `EngineSlot`."""
        if self._telemetry is None:
            self._telemetry = rows.moved_signals.view(TELEMETRY).reshape(-1)
        call(_advance_superbikes, commands, *self._form, rows, self._telemetry, self.bodies)

    def state_dict(self) -> dict[str, Any]:
        """Return motion and memory; see `EngineSlot`."""
        return {name: bytes_of(getattr(self.bodies, name)).copy() for name in ("motion", "memory")}

    def restore(self, stored: dict[str, Any]) -> None:
        """Go on; see `EngineSlot`."""
        for name, array in stored.items():
            bytes_of(getattr(self.bodies, name))[...] = array


@njit(cache=True)
def _advance_superbikes(
    commands: FloatArray, time_step: float, steps: int, rows: BatchState, telemetry: Any, bodies: Bodies
) -> None:
    for i in range(len(commands)):
        ride = rows.ride[i]
        if rows.steps[i] < 0 or ride.stopped:
            continue
        if ride.touched:
            x, y, scrape = rows.state[i, st.X], rows.state[i, st.Y], ride.scrape
            deflect(bodies.motion[i : i + 1], x, y, scrape[0], scrape[1], scrape[2], scrape[3])
        model = Model(bodies.constants[bodies.machine[i]], bodies.trees[bodies.machine[i]], bodies.work[0])
        command = discretise_command((commands[i, 0], commands[i, 1], time_step), model.constants)
        bumps = array_at(rows.around[i].bumps, 1, BUMP_SAMPLES)
        moved = Rides(rows.moved[i], bodies.motion[i], bodies.memory[i], telemetry[i])
        rows.fall[i] = advance(moved, model, command, rows.ground[i], bumps, steps)


def _engine_of(plant: Plant) -> CompiledSuperbikeEngine:
    engine = plant.engine
    assert isinstance(engine, CompiledSuperbikeEngine), "the slot is of this engine"
    return engine
