"""Another library's dynamics of the same trees: Pinocchio, from the same list of bodies."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from bike_sim.physics.multibody import articulated
from bike_sim.physics.multibody.tree import Body, Joint, outward, principal_axes
from bike_sim.physics.multibody.vectors import conjugate, rotate
from bike_sim.physics.superbike.pose import superbike_tree
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.joints import Flexure
from bike_sim.vehicles.superbike import Superbike

GRAVITY = 9.81


def machine(name: str) -> Superbike:
    """Return a machine, with a fork that bends besides where it has joints."""
    vehicle = load_superbike(name)
    if vehicle.joints is None:
        return vehicle
    return replace(vehicle, joints=replace(vehicle.joints, fork_bending=Flexure(0.521, 55300.0, 20.0)))


def model_of(tree: tuple[Body, ...]) -> tuple[Any, list[int]]:
    """Return Pinocchio's model of a tree, and where it keeps each joint's rate."""
    turn, _ = principal_axes(tree[0].inertia)
    to_base = np.array([rotate(conjugate(turn), axis) for axis in np.eye(3)]).T
    model, numbers, places = pin.Model(), {}, [0] * (len(tree) - 1)
    for i in outward(tree):
        body = tree[i]
        tensor, arm = to_base @ body.inertia @ to_base.T, to_base @ (body.centre - body.point)
        if i == 0:
            kind, parent, origin, arm = pin.JointModelFreeFlyer(), 0, np.zeros(3), np.zeros(3)
        else:
            slides = body.joint is Joint.PRISMATIC
            form = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
            start = tree[body.parent].point if body.parent else tree[0].centre
            kind, parent, origin = form(to_base @ body.axis), numbers[body.parent], to_base @ (body.point - start)
        numbers[i] = model.addJoint(parent, kind, pin.SE3(np.eye(3), origin), body.name)
        model.appendBodyToJoint(numbers[i], pin.Inertia(body.mass, arm, tensor), pin.SE3.Identity())
        if i:
            places[i - 1] = model.joints[numbers[i]].idx_v
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    return model, places


@pytest.mark.parametrize("name", ["panigale_v4r", "gsxr1000"])
@settings(max_examples=20)
@given(seed=some.integers(0, 2**32 - 1))
def test_accelerations_are_those_of_another_library(name: str, seed: int) -> None:
    """Random poses, speeds, forces and loads on the joints, to 1e-9 of the largest acceleration."""
    tree = superbike_tree(machine(name))
    count = len(tree)
    random = np.random.default_rng(seed)
    motion = np.zeros(1, dtype=articulated.motion_record(count))
    orientation = random.normal(size=4)
    motion["orientation"] = orientation / np.linalg.norm(orientation)
    motion["position"], motion["velocity"], motion["omega"] = random.normal(size=(3, 3)) * 5.0
    motion["joints"] = random.normal(size=count - 1) * 0.3
    motion["rates"] = random.normal(size=count - 1) * 10.0
    force, torque = random.normal(size=3) * 3000.0, random.normal(size=3) * 300.0
    loads = random.normal(size=count - 1) * 100.0

    work = articulated.workspace(count)
    record = articulated.tree_record(tree, GRAVITY)
    articulated.accelerate(motion[0], tuple(force), tuple(torque), loads, record[0], work[0])
    ours = np.concatenate([work["linear"][0], work["angular"][0], work["rates"][0]])

    model, places = model_of(tree)
    now = motion[0]
    base = np.array([rotate(now["orientation"], axis) for axis in np.eye(3)]).T
    q, v, tau = np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv)
    q[:7] = *now["position"], *now["orientation"]
    v[:3], v[3:6] = base.T @ now["velocity"], base.T @ now["omega"]
    tau[:3], tau[3:6] = base.T @ force, base.T @ torque
    passive = np.array([body.spring for body in tree[1:]]), np.array([body.damper for body in tree[1:]])
    for joint, place in enumerate(places):
        q[place + 1], v[place] = now["joints"][joint], now["rates"][joint]
        tau[place] = loads[joint] - passive[0][joint] * q[place + 1] - passive[1][joint] * v[place]
    a = pin.aba(model, model.createData(), q, v, tau)
    theirs = np.concatenate([base @ (a[:3] + np.cross(v[3:6], v[:3])), base @ a[3:6], a[places]])
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-9 * np.abs(theirs).max())
