"""Bullet from compiled code: the same motion, bit for bit, as by PyBullet's functions for Python."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from bike_sim.physics import articulated, bullet_world
from bike_sim.physics import state as st
from bike_sim.physics.pybullet_tree import build_tree, bullet, set_free
from bike_sim.physics.superbike.start import superbike_tree
from bike_sim.physics.superbike_engine import SuperbikeEngine
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

VEHICLE = load_vehicle("zx10rr")
assert isinstance(VEHICLE, Superbike)
TREE = superbike_tree(VEHICLE)
STEP, GRAVITY = 0.002, VEHICLE.g
JOINTS = tuple(range(len(TREE) - 1))


def a_motion() -> np.ndarray:
    """Return a leaning, turning machine with all joints in motion."""
    motion = np.zeros(1, dtype=articulated.motion_record(len(TREE)))
    quaternion = np.array([0.2, -0.1, 0.4, 0.9])
    motion["position"], motion["orientation"] = (3.0, -2.0, 0.6), quaternion / np.linalg.norm(quaternion)
    motion["velocity"], motion["omega"] = (31.0, 4.0, 0.3), (0.2, -0.1, 0.6)
    motion["joints"], motion["rates"] = (40.0, 0.05, -33.0, 0.1), (90.0, 0.3, 95.0, -0.2)
    return motion


def by_functions(motion: np.ndarray, wrenches: np.ndarray) -> np.ndarray:
    """Return the motion after steps under forces with PyBullet's functions."""
    client = bullet.connect(bullet.DIRECT)
    bullet.setTimeStep(STEP, client)
    bullet.setGravity(0.0, 0.0, -GRAVITY, client)
    body = build_tree(client, TREE)
    set_free(client, body)
    begin = motion[0]
    bullet.resetBasePositionAndOrientation(body, begin["position"], begin["orientation"], client)
    bullet.resetBaseVelocity(body, begin["velocity"], begin["omega"], client)
    for joint in JOINTS:
        bullet.resetJointState(body, joint, begin["joints"][joint], begin["rates"][joint], client)
    for wrench in wrenches:
        position, _ = bullet.getBasePositionAndOrientation(body, client)
        bullet.applyExternalForce(body, -1, wrench[:3], position, bullet.WORLD_FRAME, client)
        bullet.applyExternalTorque(body, -1, wrench[3:6], bullet.WORLD_FRAME, client)
        for joint in JOINTS:
            bullet.setJointMotorControl2(
                body, joint, bullet.TORQUE_CONTROL, force=wrench[6 + joint], physicsClientId=client
            )
        bullet.stepSimulation(client)
    end = np.zeros_like(motion)
    end["position"], end["orientation"] = bullet.getBasePositionAndOrientation(body, client)
    end["velocity"], end["omega"] = bullet.getBaseVelocity(body, client)
    joints = bullet.getJointStates(body, JOINTS, client)
    end["joints"], end["rates"] = [joint[0] for joint in joints], [joint[1] for joint in joints]
    bullet.disconnect(client)
    return end


def test_the_motion_is_that_of_pybullets_functions() -> None:
    rng = np.random.default_rng(5)
    wrenches = rng.normal(0.0, [3000.0, 3000.0, 3000.0, 500.0, 500.0, 500.0, 300.0, 20.0, 300.0, 400.0], (50, 10))
    motion = a_motion()
    world, body = bullet_world.make_world(TREE, GRAVITY, STEP)
    bullet_world.place(world, body, motion)
    for wrench in wrenches.tolist():
        bullet_world.step(world, body, motion[0], tuple(wrench[:3]), tuple(wrench[3:6]), tuple(wrench[6:]))
    bullet_world.close_world(world)
    assert motion.tobytes() == by_functions(a_motion(), wrenches).tobytes()
    assert abs(motion["velocity"][0, 0] - 31.0) > 0.1


def test_placing_reads_back_what_bullet_holds() -> None:
    motion = a_motion()
    world, body = bullet_world.make_world(TREE, GRAVITY, STEP)
    bullet_world.place(world, body, motion)
    bullet_world.close_world(world)
    for name in motion.dtype.names:
        np.testing.assert_allclose(motion[name], a_motion()[name], rtol=1e-15)


def test_a_closed_engine_refuses_to_go_on() -> None:
    assert isinstance(VEHICLE, Superbike)
    engine = SuperbikeEngine(VEHICLE, STEP)
    engine.close()
    engine.close()
    for act in (lambda: engine.advance(0.0, 1), lambda: engine.reset(st.upright_state(9.0, VEHICLE.rF))):
        with pytest.raises(RuntimeError, match="engine of vehicle 'zx10rr' is closed"):
            act()


def test_a_forgotten_engine_gives_its_world_back(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(VEHICLE, Superbike)
    closed: list[int] = []
    monkeypatch.setattr("bike_sim.physics.superbike_engine.close_world", closed.append)
    engine = SuperbikeEngine(VEHICLE, STEP)
    alive, world = weakref.ref(engine), engine._world
    del engine
    gc.collect()
    assert alive() is None
    assert closed == [world]
    bullet_world.close_world(world)


def test_a_library_without_the_c_interface_is_named() -> None:
    with pytest.raises(ImportError, match="does not export b3NoSuchFunction"):
        bullet_world._address("b3NoSuchFunction")
