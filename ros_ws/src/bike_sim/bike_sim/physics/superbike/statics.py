"""Steady states of a superbike in closed form: lateral acceleration against lean; limits of turn, drive and brake.

Independent of the engine: it is what the simulated steady turns are compared with, and where the envelope for lap-time
simulation comes from. Written in the plane across the machine; sideways is positive into the turn.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.superbike import equilibrium
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]


def steady_lateral(vehicle: Superbike, lean: float, speed: float) -> float:
    """Return the lateral acceleration of a steady turn at a lean (rad, >= 0) and speed (m/s), m/s^2.

    Balance of moments about the line through both contact points, which the toroidal tyres move towards the lean and
    the sliding rider's weight counters:

        m a z + (a / u) H cos(lean) - (a / u)^2 K sin(lean) cos(lean) = m g y - D c sin(lean)

    with the centre of mass at y (into the turn) and z (above the ground), the spin momentum H of wheels and crankshaft,
    K the integral of z^2 - y^2 over the mass about its centre in the machine's own axes, the downforce D, and the
    crown radius c.
    """
    return float(equilibrium.steady_lateral(lean, speed, vehicle.g, spread(vehicle), vehicle.machine))


def turning_state(vehicle: Superbike, speed: float, roll: float, yaw_rate: float) -> st.StateVector:
    """Return the minimal state at the origin in which a machine rolls through a turn at a given lean.

    The front wheel turns on its crown, which is nearer to the axle the more it leans, and it is steered so that both
    wheels roll without slip. In a steady turn the tyres ask for a little more steer: 0.1 deg more at 20 deg of lean,
    0.2 to 0.6 deg at 55 deg.

    Args:
        vehicle: the machine.
        speed: of the rear contact point, m/s.
        roll: rad, positive to the right.
        yaw_rate: rad/s, positive to the left; more than the steering stop allows gives the stop.
    """
    state = st.upright_state(speed, vehicle.rF - vehicle.front_tyre.crown * (1.0 - math.cos(roll)))
    state[st.ROLL] = roll
    if yaw_rate != 0.0:
        _steer_into(state, yaw_rate, vehicle.max_steer, vehicle.parameters)
    return state


@njit(cache=True)
def _steer_into(state: st.StateVector, yaw_rate: float, most: float, parameters: FloatArray) -> None:
    """Write the steer with which a state has a yaw rate (rad/s) into it, `most` (rad) at the most."""
    low, high = 0.0, math.copysign(most, yaw_rate)
    for _ in range(50):
        state[st.STEER] = steer = 0.5 * (low + high)
        if abs(kinematics.yaw_rate(state, parameters)) < abs(yaw_rate):
            low = steer
        else:
            high = steer


def spread(vehicle: Superbike) -> float:
    """Return the integral of z^2 - y^2 over the mass about its common centre, in the machine's axes, kg m2."""
    height = vehicle.com_height
    bodies = (
        (vehicle.mR, vehicle.rR, vehicle.IRyy, vehicle.IRxx),
        (vehicle.mF, vehicle.rF, vehicle.IFyy, vehicle.IFxx),
        (vehicle.mB, -vehicle.zB, vehicle.IByy, vehicle.IBzz),
        (vehicle.mH, -vehicle.zH, vehicle.IHyy, vehicle.IHzz),
    )
    return sum(mass * (z - height) ** 2 + i_yy - i_zz for mass, z, i_yy, i_zz in bodies)


def sway_length(vehicle: Superbike) -> float:
    """Return the length of the pendulum that a machine is about the line of contacts, m.

    The moment of inertia about that line by mass and height of the centre.
    """
    bodies = (
        (vehicle.mR, vehicle.rR, vehicle.IRxx),
        (vehicle.mF, vehicle.rF, vehicle.IFxx),
        (vehicle.mB, -vehicle.zB, vehicle.IBxx),
        (vehicle.mH, -vehicle.zH, vehicle.IHxx),
    )
    return sum(mass * z**2 + i_xx for mass, z, i_xx in bodies) / (vehicle.mass * vehicle.com_height)


def drag(vehicle: Superbike, speed: float) -> float:
    """Return the drag at a speed (m/s), N."""
    return 0.5 * vehicle.air.density * vehicle.air.drag_area * speed**2


def wheel_loads(vehicle: Superbike, lean: float, speed: float, thrust: float) -> tuple[float, float]:
    """Return the rear and the front load, N, with a thrust (N, negative braking) at the ground.

    What the thrust accelerates are also the spinning wheels, whose moment goes through the frame to the loads.
    """
    cos_lean = math.cos(lean)
    x, height = vehicle.centre_of_mass
    air = vehicle.air
    down = 0.5 * air.density * air.down_area * speed**2 * cos_lean
    weight = vehicle.mass * vehicle.g
    pull = drag(vehicle, speed)
    spin = (vehicle.IRyy / vehicle.rR + vehicle.IFyy / vehicle.rF) / vehicle.mass
    front = (
        weight * x
        + down * air.x
        - pull * (air.height - height) * cos_lean
        - thrust * height * cos_lean
        - (thrust - pull) * spin
    ) / vehicle.w
    return weight + down - front, front


def side_forces(vehicle: Superbike, lean: float, speed: float) -> tuple[float, float]:
    """Return the rear and the front tyre's side force of a steady turn, N, positive into the turn."""
    lateral = vehicle.mass * steady_lateral(vehicle, lean, speed)
    air = vehicle.air
    outward = 0.5 * air.density * air.down_area * speed**2 * math.sin(lean)  # downforce leans with the machine
    x, _ = vehicle.centre_of_mass
    # Drag acts well inside the line of contacts, the thrust on it: both turn the machine in and relieve the front tyre
    inside = (air.height - vehicle.rear_tyre.crown) * math.sin(lean)
    front = (lateral * x + outward * air.x - drag(vehicle, speed) * inside) / vehicle.w
    return lateral + outward - front, front


def inertial_mass(vehicle: Superbike) -> float:
    """Return the mass that thrust accelerates, the spinning wheels included, kg."""
    return vehicle.mass + vehicle.IRyy / vehicle.rR**2 + vehicle.IFyy / vehicle.rF**2


def rolling_drag(vehicle: Superbike, speed: float) -> float:
    """Return drag and rolling resistance, N."""
    rear, front = wheel_loads(vehicle, 0.0, speed, 0.0)
    return drag(vehicle, speed) + vehicle.rear_tyre.rolling * rear + vehicle.front_tyre.rolling * front


def engine_force(vehicle: Superbike, speed: float) -> float:
    """Return the full-throttle force at the rear tyre in the best gear, N, at the slip that it needs."""
    table, tyre = vehicle.wheel_torque, vehicle.rear_tyre
    force = 0.0
    for _ in range(8):
        rear, _front = wheel_loads(vehicle, 0.0, speed, force)
        # slip of a linear tyre: full throttle is far from its peak where the engine is the limit
        wheel_speed = speed * (1.0 + force / (tyre.slip_stiffness * rear)) / vehicle.rR
        position = wheel_speed / vehicle.wheel_torque_spacing
        force = 0.5 * (force + float(np.interp(position, np.arange(table.size), table, right=0.0)) / vehicle.rR)
    return force
