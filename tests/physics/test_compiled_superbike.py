"""The superbike without Bullet: against Bullet, against conservation laws, alone and among others."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.engines import make_engine
from bike_sim.physics.multibody import articulated, vectors
from bike_sim.physics.multibody.tree import Body, Joint
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


# --- against Bullet ---


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


# --- conservation ---


def thrown(tree: tuple[Body, ...], seed: int) -> np.ndarray:
    """Return a random motion of a tree in the air."""
    rng = np.random.default_rng(seed)
    motion = np.zeros(1, dtype=articulated.motion_record(len(tree)))
    orientation = rng.normal(size=4)
    motion["orientation"] = orientation / np.linalg.norm(orientation)
    motion["velocity"], motion["omega"] = rng.uniform(-20.0, 20.0, 3), rng.uniform(-3.0, 3.0, 3)
    count = len(tree) - 1
    motion["joints"] = rng.uniform(-0.3, 0.3, count)
    motion["rates"] = rng.uniform(-1.0, 1.0, count) * [200.0 if body.wheel else 2.0 for body in tree[1:]]
    return motion


def momenta(motion: np.ndarray, tree: tuple[Body, ...]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return energy (J, without gravity), momentum and angular momentum about the map's origin, body by body."""
    m = motion[0]
    turn = articulated.principal_axes(tree[0].inertia)[0]
    frame = vectors.multiply(np.array(m["orientation"]), vectors.conjugate(turn))
    places = [(frame, np.array(m["position"]), np.array(m["velocity"]), np.array(m["omega"]))]
    points = [tree[0].centre]
    for body, q, rate in zip(tree[1:], m["joints"], m["rates"], strict=True):
        carrier, origin, velocity, omega = places[body.parent]
        arm = vectors.rotate(carrier, body.point - points[body.parent])
        axis = vectors.rotate(carrier, body.axis)
        place, speed = origin + arm, velocity + np.cross(omega, arm)
        if body.joint is Joint.PRISMATIC:
            place, speed = place + q * axis, speed + np.cross(omega, q * axis) + rate * axis
            places.append((carrier, place, speed, omega))
        else:
            places.append(
                (vectors.multiply(carrier, vectors.axis_angle(body.axis, q)), place, speed, omega + rate * axis)
            )
        points.append(body.point)
    energy, momentum, spin = 0.0, np.zeros(3), np.zeros(3)
    for body, point, (orientation, place, velocity, omega) in zip(tree, points, places, strict=True):
        arm = vectors.rotate(orientation, body.centre - point)
        centre, speed = place + arm, velocity + np.cross(omega, arm)
        local = vectors.rotate(vectors.conjugate(orientation), omega)
        own = vectors.rotate(orientation, body.inertia @ local)
        energy += 0.5 * body.mass * speed @ speed + 0.5 * local @ body.inertia @ local
        momentum += body.mass * speed
        spin += body.mass * np.cross(centre, speed) + own
    return energy, momentum, spin


def flight(tree: tuple[Body, ...], motion: np.ndarray, step: float, seconds: float, gravity: float = 0.0) -> None:
    record, work = articulated.tree_record(tree, gravity), articulated.workspace(len(tree))
    nothing = (0.0, 0.0, 0.0)
    for _ in range(round(seconds / step)):
        articulated.accelerate(motion[0], nothing, nothing, (0.0,) * (len(tree) - 1), record[0], work[0])
        articulated.integrate(motion[0], work[0], step)


@pytest.mark.parametrize("seed", range(3))
def test_without_forces_energy_and_momenta_stay(seed: int) -> None:
    """They are not what the algorithm computes with, and they stay as well as a first order step can hold them."""
    tree = superbike_tree(DUCATI)
    drifts = []
    for step in (4e-4, 1e-4):
        motion = thrown(tree, seed)
        before = momenta(motion, tree)
        flight(tree, motion, step, 0.2)
        after = momenta(motion, tree)
        drifts.append([np.abs(a - b).max() / np.abs(b).max() for a, b in zip(after, before, strict=True)])
    coarse, fine = np.array(drifts)
    assert (fine < 1e-3).all()
    assert (fine < 0.35 * coarse).all()  # first order: a quarter


def test_in_free_fall_nothing_turns_for_gravity() -> None:
    tree = superbike_tree(DUCATI)
    falling, floating = thrown(tree, 7), thrown(tree, 7)
    flight(tree, falling, 0.001, 0.3, gravity=9.81)
    flight(tree, floating, 0.001, 0.3)
    for name in ("orientation", "omega", "joints", "rates"):
        assert falling[name] == pytest.approx(floating[name], rel=1e-9, abs=1e-9)
    assert falling["velocity"][0, 2] - floating["velocity"][0, 2] == pytest.approx(-9.81 * 0.3)


def test_a_thrust_moves_the_whole_mass() -> None:
    """A force through the common centre of mass accelerates it by force over mass, whatever the joints do."""
    tree, force = superbike_tree(DUCATI), np.array([300.0, -200.0, 500.0])
    record, work, motion = (
        articulated.tree_record(tree, 0.0),
        articulated.workspace(len(tree)),
        thrown(superbike_tree(DUCATI), 3),
    )
    _, before, _ = momenta(motion, tree)
    articulated.accelerate(motion[0], tuple(force), (5.0, 7.0, -3.0), (1.0, -2.0, 3.0, 50.0), record[0], work[0])
    articulated.integrate(motion[0], work[0], 1e-7)
    _, after, _ = momenta(motion, tree)
    assert (after - before) / 1e-7 == pytest.approx(force, rel=1e-3, abs=0.5)


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
