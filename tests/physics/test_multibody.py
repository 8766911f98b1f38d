"""Trees of bodies: the compiled algorithm and Bullet agree on joints that a tree has beside a machine's."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.multibody import articulated
from bike_sim.physics.multibody.bullet import BulletTree, bullet
from bike_sim.physics.multibody.tree import Body, Joint
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.pose import superbike_tree
from bike_sim.vehicles.files import load_superbike

VEHICLE = load_superbike("zx10rr")
MASS, SPRING, DAMPER = 12.0, 9000.0, 60.0
SPRUNG = Body(
    "case", MASS, np.array([-0.3, 0.0, 0.9]), np.diag([0.2, 0.3, 0.25]), Joint.PRISMATIC, 0,
    np.array([-0.3, 0.0, 0.9]), np.array([0.0, 0.0, 1.0]), spring=SPRING, damper=DAMPER,
)  # fmt: skip
TWISTING = Body(
    "head", 3.0, np.array([0.4, 0.0, 1.0]), np.diag([0.02, 0.03, 0.02]), Joint.REVOLUTE, 0, np.array([0.4, 0.0, 0.9]),
    np.array([1.0, 0.0, 0.0]), spring=4000.0, damper=2.0,
)  # fmt: skip
STEP, GRAVITY = 0.0005, 9.81


def a_motion(tree: tuple[Body, ...]) -> np.ndarray:
    """Return a leaning, turning machine with all joints in motion."""
    motion = np.zeros(1, dtype=articulated.motion_record(len(tree)))
    quaternion = np.array([0.2, -0.1, 0.4, 0.9])
    motion["position"], motion["orientation"] = (3.0, -2.0, 0.6), quaternion / np.linalg.norm(quaternion)
    motion["velocity"], motion["omega"] = (31.0, 4.0, 0.3), (0.2, -0.1, 0.6)
    motion["joints"], motion["rates"] = (40.0, 0.05, -0.03, 0.02), (90.0, 0.3, 0.2, -0.1)
    return motion


def test_both_move_a_tree_with_further_joints_alike() -> None:
    """A wheel, a fork, a head that twists and a case on a spring: as many bodies as a rigid machine has."""
    tree = (*superbike_tree(VEHICLE)[:3], TWISTING, SPRUNG)
    wrenches = np.random.default_rng(5).normal(0.0, [3000.0] * 3 + [500.0] * 3 + [300.0, 20.0, 30.0, 400.0], (50, 10))
    ends = a_motion(tree), a_motion(tree)
    record, work, world = (
        articulated.tree_record(tree, GRAVITY), articulated.workspace(len(tree)), BulletTree(tree, GRAVITY, STEP)
    )  # fmt: skip
    world.place(ends[1])
    for wrench in wrenches.tolist():
        force, torque, joints = tuple(wrench[:3]), tuple(wrench[3:6]), tuple(wrench[6:])
        articulated.accelerate(ends[0][0], force, torque, joints, record[0], work[0])
        articulated.integrate(ends[0][0], work[0], STEP)
        world.step(ends[1], force, torque, joints)
    world.close()
    for name in ends[0].dtype.names:
        np.testing.assert_allclose(ends[0][name], ends[1][name], rtol=1e-9, atol=1e-9)
    assert abs(ends[0]["velocity"][0, 0] - 31.0) > 0.01


def test_a_closed_engine_refuses_to_go_on() -> None:
    engine = BulletSuperbikeEngine(VEHICLE, STEP)
    engine.close()
    engine.close()
    for act in (lambda: engine.advance(0.0, 0.0, 1), lambda: engine.reset(st.upright_state(9.0, VEHICLE.rF))):
        with pytest.raises(RuntimeError, match="engine of vehicle 'zx10rr' is closed"):
            act()


def test_a_forgotten_engine_gives_its_world_back() -> None:
    engine = BulletSuperbikeEngine(VEHICLE, STEP)
    alive, client = weakref.ref(engine), engine._bodies.client
    assert bullet.isConnected(client)
    del engine
    gc.collect()
    assert alive() is None
    assert not bullet.isConnected(client)
