"""The compiled kinematics and equations of motion against a second, plain model of four rigid bodies.

The model here is a chain of rotation matrices (z up, appendix A of Weyrer et al. 2026) with nothing solved and
nothing simplified. Positions come from the chain; velocities, accelerations and momenta come from finite
differences of positions. It shares the pitch with the compiled code, and that is checked by the contact height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from bike_sim.physics import kinematics as kin
from bike_sim.physics import state as st
from bike_sim.physics.bicycle import whipple
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle

Array = NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])
VEHICLE = load_vehicle("whipple")


@dataclass
class Body:
    """One rigid body in the map frame: mass, inertia in its own axes, centre of mass, orientation."""

    mass: float
    inertia: Array
    position: Array
    rotation: Array


def rotation(axis: int, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def symmetric(xx: float, xz: float, yy: float, zz: float) -> Array:
    """Inertia tensor in z-up axes from published z-down components."""
    return np.array([[xx, 0.0, -xz], [0.0, yy, 0.0], [-xz, 0.0, zz]])


def chain(state: Array, v: Vehicle) -> list[Body]:
    """Return rear wheel, rear body, handlebar, front wheel."""
    x, y, yaw, roll, steer, rear_angle, front_angle = state[:7]
    lean = rotation(2, yaw) @ rotation(0, roll)
    body = lean @ rotation(1, kin.pitch(roll, steer, v.parameters))
    fork = body @ rotation(1, -v.lam) @ rotation(2, steer) @ rotation(1, v.lam)
    rear_hub = np.array([x, y, 0.0]) + lean @ [0.0, 0.0, v.rR]
    head = rear_hub + body @ [v.w + v.c, 0.0, -v.rR]  # where the steering axis meets the ground when upright
    return [
        Body(v.mR, symmetric(v.IRxx, 0.0, v.IRyy, v.IRxx), rear_hub, body @ rotation(1, rear_angle)),
        Body(v.mB, symmetric(v.IBxx, v.IBxz, v.IByy, v.IBzz), rear_hub + body @ [v.xB, 0.0, -v.zB - v.rR], body),
        Body(v.mH, symmetric(v.IHxx, v.IHxz, v.IHyy, v.IHzz), head + fork @ [v.xH - v.w - v.c, 0.0, -v.zH], fork),
        Body(
            v.mF,
            symmetric(v.IFxx, 0.0, v.IFyy, v.IFxx),
            head + fork @ [-v.c, 0.0, v.rF],
            fork @ rotation(1, front_angle),
        ),
    ]


def lowest_point(wheel: Body, radius: float) -> Array:
    """Return the lowest point of a thin disc."""
    axle = wheel.rotation[:, 1]
    down = -UP + (UP @ axle) * axle
    return wheel.position + radius * down / np.linalg.norm(down)


def spin_vector(derivative: Array, matrix: Array) -> Array:
    """Return the angular velocity from the derivative of an orientation."""
    skew = derivative @ matrix.T
    return np.array([skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]]) / 2.0


def motion_along(state: Array, rates: Array, v: Vehicle) -> list[tuple[Array, Array]]:
    """Return velocity and angular velocity of the bodies for given rates of the seven coordinates."""
    step = 1e-5
    shift = np.zeros(st.STATE_SIZE)
    shift[:7] = step * rates[:7]
    ahead, behind = chain(state + shift, v), chain(state - shift, v)
    now = chain(state, v)
    return [
        (
            (a.position - b.position) / (2 * step),
            spin_vector((a.rotation - b.rotation) / (2 * step), n.rotation),
        )
        for a, b, n in zip(ahead, behind, now, strict=True)
    ]


def random_states(count: int, seed: int) -> list[Array]:
    """Return wild states: 40 deg of lean, 60 deg of steer, any yaw, fast rates, forward and backward."""
    rng = np.random.default_rng(seed)
    low = np.array([-5, -5, -3, -0.7, -1.05, -3, -3, -2, -3, -15], dtype=float)
    return list(rng.uniform(low, -low, size=(count, st.STATE_SIZE)))


@pytest.mark.parametrize("roll_deg", [-70, -45, -10, 0, 30, 60])
@pytest.mark.parametrize("steer_deg", [-75, -30, 0, 5, 70])
def test_both_wheels_touch_the_ground(roll_deg: float, steer_deg: float) -> None:
    state = np.zeros(st.STATE_SIZE)
    state[[st.X, st.Y, st.YAW]] = 1.0, -2.0, 0.4
    state[[st.ROLL, st.STEER]] = np.radians([roll_deg, steer_deg])
    bodies = chain(state, VEHICLE)
    rear, front = lowest_point(bodies[0], VEHICLE.rR), lowest_point(bodies[3], VEHICLE.rF)
    np.testing.assert_allclose(rear, [1.0, -2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(front, [*kin.front_contact(state, VEHICLE.parameters), 0.0], atol=1e-12)
    assert kin.wheelbase(state[st.ROLL], state[st.STEER], VEHICLE.parameters) == pytest.approx(
        np.linalg.norm(front - rear), abs=1e-12
    )


@pytest.mark.parametrize("state", random_states(12, seed=1))
def test_wheels_roll_without_slip(state: Array) -> None:
    rates = whipple.derivative(state, 0.0, VEHICLE.parameters)
    bodies = chain(state, VEHICLE)
    motion = motion_along(state, rates, VEHICLE)
    for index, radius in ((0, VEHICLE.rR), (3, VEHICLE.rF)):
        velocity, spin = motion[index]
        at_contact = velocity + np.cross(spin, lowest_point(bodies[index], radius) - bodies[index].position)
        np.testing.assert_allclose(at_contact, 0.0, atol=1e-7)


@pytest.mark.parametrize("state", random_states(12, seed=2))
def test_energy_is_that_of_the_four_bodies(state: Array) -> None:
    rates = whipple.derivative(state, 0.0, VEHICLE.parameters)
    kinetic = potential = 0.0
    for body, (velocity, spin) in zip(chain(state, VEHICLE), motion_along(state, rates, VEHICLE), strict=True):
        inertia = body.rotation @ body.inertia @ body.rotation.T
        kinetic += 0.5 * body.mass * velocity @ velocity + 0.5 * spin @ inertia @ spin
        potential += body.mass * VEHICLE.g * body.position[2]
    assert whipple.energy(state, VEHICLE.parameters) == pytest.approx((kinetic, potential), rel=1e-7)


@pytest.mark.parametrize("state", random_states(8, seed=3))
def test_motion_obeys_newton_and_euler(state: Array) -> None:
    """The virtual power of inertia, weight and steering torque vanishes for each of the three free motions.

    Fourth-order differences with 0.5 ms: the fastest harmonic is the wheels' 15 rad/s, whose fifth derivative times
    h^4 / 30 is 2e-9 of its amplitude; 1e-6 of the sum of magnitudes leaves room for the sharper roll and steer.
    """
    p, h, steer_set = VEHICLE.parameters, 5e-4, 0.3
    path = {}
    for k in range(-4, 5):
        path[k] = state.copy()
        assert whipple.advance(path[k], steer_set, k * h / 8, 8, p)
    stencil = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
    bodies = {k: chain(path[k], VEHICLE) for k in path}

    def difference(values: dict[int, Array], k: int) -> Array:
        return sum(weight * values[k + j] for j, weight in stencil.items()) / h

    torque = -VEHICLE.P * (state[st.STEER] - steer_set) - VEHICLE.D * state[st.STEER_RATE]
    partial = []
    for index in (st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE):
        unit = state.copy()
        unit[st.ROLL_RATE :] = 0.0
        unit[index] = 1.0
        partial.append(motion_along(state, whipple.derivative(unit, 0.0, p), VEHICLE))
    power, scale = np.array([0.0, -torque, 0.0]), np.zeros(3)
    for b in range(4):
        positions = {k: bodies[k][b].position for k in path}
        rotations = {k: bodies[k][b].rotation for k in path}
        velocity = {k: difference(positions, k) for k in range(-2, 3)}
        momentum = {}
        for k in range(-2, 3):
            spin = spin_vector(difference(rotations, k), rotations[k])
            momentum[k] = rotations[k] @ bodies[0][b].inertia @ rotations[k].T @ spin
        force = bodies[0][b].mass * (difference(velocity, 0) + VEHICLE.g * UP)
        moment = difference(momentum, 0)
        for r in range(3):
            linear, angular = partial[r][b]
            power[r] += force @ linear + moment @ angular
            scale[r] += np.abs(force) @ np.abs(linear) + np.abs(moment) @ np.abs(angular)
    assert np.all(np.abs(power) < 1e-6 * scale), (power, scale)
