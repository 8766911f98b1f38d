"""The superbike without Bullet against Bullet; `test_second_opinion.py` holds its dynamics against another library."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.engines import make_engine
from bike_sim.physics.multibody import articulated
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.physics.superbike.pose import superbike_tree
from bike_sim.validation.superbike import without_electronics
from bike_sim.vehicles.files import load_superbike, load_vehicle
from bike_sim.vehicles.superbike import Superbike

STEP = 0.002


DUCATI, YAMAHA = load_superbike("panigale_v4r"), load_superbike("r1")


def slalom(engine: BulletSuperbikeEngine | CompiledSuperbikeEngine, seconds: float, speed: float = 30.0) -> np.ndarray:
    """Return the states of a slalom with throttle and brake, a row each 20 ms."""
    engine.reset(st.upright_state(speed, engine.vehicle.rF))
    rows = []
    for k in range(round(seconds / 0.02)):
        now = 0.02 * k
        engine.advance(0.7 * math.sin(0.9 * now), 0.5 * math.sin(0.7 * now) + 0.1, round(0.02 / engine.time_step))
        rows.append(engine.state())
    return np.array(rows)


@pytest.mark.parametrize("vehicle", [DUCATI, YAMAHA], ids=lambda vehicle: vehicle.name)
def test_rides_are_those_of_bullet(vehicle: Superbike) -> None:
    """Not a line of the dynamics is shared, and 5 s of slalom end within nanometres of each other."""
    rides = [slalom(make_engine(kind, vehicle, STEP), 5.0) for kind in ("compiled", "pybullet")]  # type: ignore[arg-type]
    assert np.abs(rides[0] - rides[1]).max() < 1e-8
    assert np.abs(rides[0][:, st.ROLL]).max() > 0.6


def test_falls_are_those_of_bullet() -> None:
    ends = []
    bare = without_electronics(DUCATI)
    for kind in (CompiledSuperbikeEngine, BulletSuperbikeEngine):
        engine = kind(bare, STEP)
        engine.reset(st.upright_state(45.0, bare.rF))
        engine.advance(0.8, 0.2, 1000)
        engine.advance(0.8, -1.0, 1500)
        ends.append((engine.fall, engine.state()))
        engine.advance(0.0, 1.0, 100)
        assert (engine.state() == ends[-1][1]).all()  # it stays where it lies
        engine.close()
    assert ends[0][0] == ends[1][0] == "low_side"
    assert ends[0][1] == pytest.approx(ends[1][1], abs=1e-3)


def test_a_bicycle_rides_on_whipple_instead() -> None:
    assert isinstance(make_engine("compiled", DUCATI, STEP), CompiledSuperbikeEngine)
    with pytest.raises(ValueError, match="choose whipple"):
        make_engine("compiled", load_vehicle("whipple"), STEP)
    with pytest.raises(ValueError, match="no superbike"):
        CompiledSuperbikeEngine(load_vehicle("whipple"), STEP)  # type: ignore[arg-type]


def test_what_hangs_on_nothing_is_refused() -> None:
    tree = superbike_tree(DUCATI)
    with pytest.raises(ValueError, match="body 'fork' must hang by a joint on another body"):
        articulated.tree_record((*tree[:2], replace(tree[2], parent=3), *tree[3:]), 9.81)
    with pytest.raises(ValueError, match="the first on none"):
        articulated.tree_record(tree[1:], 9.81)


def test_a_reset_sets_what_bullet_has() -> None:
    rng = np.random.default_rng(2)
    engines = CompiledSuperbikeEngine(DUCATI, STEP), BulletSuperbikeEngine(DUCATI, STEP)
    for _ in range(20):
        state = rng.uniform(-1.0, 1.0, st.STATE_SIZE)
        state[st.STEER] *= 0.3
        state[st.FRONT_WHEEL_RATE] = rng.uniform(0.0, 90.0) / DUCATI.rF
        for engine in engines:
            engine.reset(state)
        assert engines[0].state() == pytest.approx(state, rel=1e-9, abs=1e-9)
        assert engines[0].telemetry() == pytest.approx(engines[1].telemetry(), rel=1e-9, abs=1e-6)
        assert (engines[0].memory == engines[1].memory).all()


def test_yaw_counts_its_turns() -> None:
    engine = CompiledSuperbikeEngine(DUCATI, STEP)
    engine.reset(st.upright_state(15.0, DUCATI.rF))
    engine.advance(0.7, 0.15, 15000)  # one call
    assert engine.fall == "none"
    assert engine.state()[st.YAW] > 2.0 * math.pi
