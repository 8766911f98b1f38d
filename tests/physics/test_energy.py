"""The account of energy: it closes, and finds a force that it does not know."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.ground import LEVEL
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.validation.energy import ENTRIES, Account, Periods, account
from bike_sim.vehicles.files import load_superbike

SUBSTEPS = 20


@functools.cache
def weaving(periods: int = 200) -> tuple[Account, float]:
    """Return the account of a ride with turns, drive and brake at 1 ms, and the last speed, m/s."""
    vehicle = load_superbike("gsxr1000")
    engine = CompiledSuperbikeEngine(vehicle, 0.001)
    engine.reset(st.upright_state(30.0, vehicle.rF))
    motion, memory = [], []
    commands = np.array([(0.4 * np.sin(k / 60), 0.3 + 0.5 * np.cos(k / 40)) for k in range(periods)])
    for steering, throttle in commands.tolist():
        motion.append(engine.motion.copy())
        memory.append(engine.memory.copy())
        engine.advance(steering, throttle, SUBSTEPS)
    assert engine.fall == "none"
    ground = np.repeat(LEVEL.record, periods)
    ride = Periods(np.concatenate(motion), np.concatenate(memory), ground, commands, LEVEL.bumps)
    return account(vehicle, ride, 0.001, SUBSTEPS), float(np.linalg.norm(engine.motion["velocity"][0]))


def test_the_account_closes() -> None:
    """A millionth of the engine's work is left over; losses are losses, and the suspension's dampers warm up."""
    found, speed = weaving()
    assert set(found.work) == set(ENTRIES)
    assert abs(found.rest) < 1e-6
    for entry in ("brakes", "air", "tyres_longitudinal", "tyres_lateral", "tyres_rolling"):
        assert found.work[entry] < 0.0, entry
    assert found.work["dampers"] < -1.0
    mass = load_superbike("gsxr1000").mass
    assert found.stored == pytest.approx(0.5 * mass * (speed**2 - 30.0**2), rel=0.1)


def test_what_is_not_counted_is_found() -> None:
    """Without the air's entry the rest is far beyond what is allowed."""
    found, _ = weaving()
    assert abs(Account(found.work | {"air": 0.0}, found.stored).rest) > 0.05
