"""A second linearisation of machines whose joints give way: Lagrange's equations by SymPy, tyres by their coefficients.

Of the engine nothing but the list of bodies is used. A machine that runs straight is alike to the left and to the
right, so that to first order nothing that moves in its plane acts across it: height, pitch, suspension and spin of the
wheels keep the values at which the forces in the plane balance. There the equations of all that moves across it are
linearised: sway, yaw and roll of the frame, steering, the rider's slide, his torso, the head that twists, the fork that
bends, and both side slips, which lag. The engine's matrix is that of states pushed and watched over one step,
extrapolated to no step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp
import yaml
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, fsolve
from sympy import Matrix

from bike_sim.physics import state as st
from bike_sim.physics.multibody.tree import Body, Joint, outward
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.physics.superbike.modes import (
    hands_off,
    holding_throttle,
    joint_states,
    lateral_states,
    transition_matrix,
)
from bike_sim.physics.superbike.pose import superbike_tree
from bike_sim.validation.superbike import holding, ride, signal
from bike_sim.vehicles.files import SHIPPED, load_superbike
from bike_sim.vehicles.joints import UNIT_RANGE, UNIT_SAMPLES, Flexure
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

SPEEDS = (5.0, 10.0, 20.0, 35.0, 50.0, 65.0, 80.0)
STEPS = tuple(4e-4 / 2**k for k in range(4))
WHEELS = ("rear", "front")
AT_WHEEL = ("load", "along", "ka", "kg", "ma", "mg", "lag", "spin")
"""Load and force along it, N; derivatives of Fy and Mz by slip and camber; relaxation length, m; spin momentum."""
IN_PLANE = ("x", "z", "pitch", "swing_arm", "fork_slider")
ZERO = sp.S.Zero
UP, LEFT = Matrix([0, 0, 1]), Matrix([0, 1, 0])


def turn(axis: Matrix, angle: sp.Symbol) -> Matrix:
    """Rotation about a unit axis; across the machine to first order, as derivatives at zero are all that is asked."""
    cross = Matrix([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    if angle.name not in IN_PLANE:
        return sp.eye(3) + angle * cross
    return sp.eye(3) + sp.sin(angle) * cross + (1 - sp.cos(angle)) * cross * cross


def slopes(rows: Matrix, by: Matrix, still: dict[sp.Symbol, Any]) -> Matrix:
    """Derivatives of rows by symbols, a column each, where all of `still` are zero."""
    alone = ((symbol, rows.xreplace({other: ZERO for other in still if other is not symbol})) for symbol in by)
    return Matrix.hstack(*(column.diff(symbol).xreplace({symbol: ZERO}) for symbol, column in alone))


class Kinematics:
    """Where the bodies are over the coordinates, and how their points move with each of them.

    A wheel's own spin is no coordinate: its carrier's pose is as good, since a wheel is round.
    """

    def __init__(self, tree: tuple[Body, ...]) -> None:
        self.tree = tree
        self.across = ["y", "yaw", "roll", *(b.name for b in tree[1:] if not b.wheel and b.name not in IN_PLANE)]
        self.names = [*self.across, *IN_PLANE]
        self.q = {name: sp.Symbol(name) for name in self.names}
        q, along = self.q, Matrix([1, 0, 0])
        heading = turn(UP, q["yaw"])
        rolled = heading * turn(along, q["roll"])
        origin = Matrix(tree[0].centre) + Matrix([q["x"], q["y"], q["z"]])
        turns = {"yaw": UP, "roll": heading * along, "pitch": rolled * LEFT}
        self.origins, self.turns = {0: origin}, {0: rolled * turn(LEFT, q["pitch"])}
        slides = {name: (Joint.PRISMATIC, sp.eye(3)[:, k], origin) for k, name in enumerate("xyz")}
        self.moved = {0: slides | {name: (Joint.REVOLUTE, axis, origin) for name, axis in turns.items()}}
        for i in outward(tree)[1:]:
            body = tree[i]
            point, axis = self.at(body.parent, body.point), self.turns[body.parent] * Matrix(body.axis)
            self.origins[i], self.turns[i], self.moved[i] = point, self.turns[body.parent], self.moved[body.parent]
            if body.wheel:
                continue
            if body.joint is Joint.REVOLUTE:
                self.turns[i] = self.turns[i] * turn(Matrix(body.axis), self.q[body.name])
            else:
                self.origins[i] = point + axis * self.q[body.name]
            self.moved[i] = self.moved[i] | {body.name: (body.joint, axis, point)}

    def at(self, i: int, place: Any) -> Matrix:
        """Where that point of a body is that is at a place in the design pose, m."""
        return self.origins[i] + self.turns[i] * Matrix(place - (self.tree[i].point if i else self.tree[0].centre))

    def rates(self, i: int, point: Matrix) -> tuple[Matrix, Matrix]:
        """Velocity of a body at a point and its angular velocity by each coordinate's rate, shape (3, coordinates)."""
        moves, spins = ([sp.zeros(3, 1) for _ in self.names] for _ in range(2))
        for name, (joint, axis, on) in self.moved[i].items():
            k = self.names.index(name)
            moves[k] = axis
            if joint is Joint.REVOLUTE:
                moves[k], spins[k] = axis.cross(point - on), axis
        return Matrix.hstack(*moves), Matrix.hstack(*spins)


def tyre_of(p: dict[str, float]) -> Callable[[float, float], list[float]]:
    """Return what a tyre does on an upright wheel, by load and longitudinal slip.

    These are Fx, the derivatives of Fy and Mz by side slip and by camber, and the cornering stiffness, from the
    formulas of Sharp, Evangelou and Limebeer (2004) in their axes (z down), without terms whose derivatives vanish.
    """
    load, slip, side, camber = sp.symbols("load slip side camber")
    d = (load - p["Fz0"]) / p["Fz0"]

    def bent(b: Any, e: Any, x: Any) -> Any:
        return b * x - e * (b * x - sp.atan(b * x))

    peak_x, stiff = (p["pDx1"] + p["pDx2"] * d) * load, load * (p["pKx1"] + p["pKx2"] * d) * sp.exp(p["pKx3"] * d)
    curve = (p["pEx1"] + p["pEx2"] * d + p["pEx3"] * d**2) * (1 - p["pEx4"] * sp.sign(slip))
    along = peak_x * sp.sin(p["pCx1"] * sp.atan(bent(stiff / (p["pCx1"] * peak_x), curve, slip)))
    peak = load * p["pDy1"] * sp.exp(p["pDy2"] * d)
    corner = p["pKy1"] * p["Fz0"] * sp.sin(p["pKy2"] * sp.atan(load / (p["pKy3"] * p["Fz0"])))
    thrust = (p["pKy6"] + p["pKy7"] * d) * load
    by_side = p["pCy1"] * sp.atan(bent(corner / (p["pCy1"] * peak), p["pEy1"], side))
    by_camber = p["pCy2"] * sp.atan(bent(thrust / (p["pCy2"] * peak), p["pEy5"], camber))
    share = sp.cos(p["rCy1"] * sp.atan(p["rBy1"] * sp.cos(sp.atan(p["rBy2"] * p["rBy3"])) * slip))
    across, equal = share * peak * sp.sin(by_side + by_camber), stiff * slip / corner
    bow = p["qEz1"] + p["qEz2"] * d + p["qEz3"] * d**2
    trail = sp.cos(p["qCz1"] * sp.atan(bent(p["qBz1"] + p["qBz2"] * d, bow, equal)))
    trail *= load * p["rc"] / p["Fz0"] * (p["qDz1"] + p["qDz2"] * d)
    reach = (p["qBz9"] + p["qBz10"] * corner / peak) * equal
    moment = load * p["rc"] * (p["qDz8"] + p["qDz9"] * d) * camber / sp.sqrt(1 + reach**2)
    moment -= trail * across.xreplace({camber: ZERO})
    upright = {side: ZERO, camber: ZERO}
    by = [force.diff(symbol).xreplace(upright) for force in (across, moment) for symbol in (side, camber)]
    found: Callable[[float, float], list[float]] = sp.lambdify((load, slip), [along, *by, corner], "math")
    return found


class Machine:
    """Equations of what moves across a machine, linear about straight running: ``M a + (G - C) v - K q = S slips``."""

    def __init__(self, vehicle: Superbike, tyres: dict[str, dict[str, float]]) -> None:
        self.vehicle, self.motion, self.tyres = vehicle, Kinematics(superbike_tree(vehicle)), tyres
        self.tyre = {wheel: tyre_of(coefficients) for wheel, coefficients in tyres.items()}
        self.radii = {"rear": vehicle.rR, "front": vehicle.rF}
        v, motion, q = vehicle, self.motion, self.motion.q
        speed, rate = sp.Symbol("speed"), {name: sp.Symbol(f"{name}_rate") for name in motion.across}
        rates = Matrix([*rate.values(), speed, *[0] * (len(IN_PLANE) - 1)])
        of = {wheel: sp.symbols([f"{wheel}_{name}" for name in AT_WHEEL]) for wheel in WHEELS}
        slips = Matrix(sp.symbols("rear_slip front_slip"))
        lateral, count = Matrix([q[name] for name in motion.across]), len(motion.across)
        still: dict[sp.Symbol, Any] = dict.fromkeys([*lateral, *rate.values(), *slips], ZERO)

        mass, gyro, lags, heights = sp.zeros(count), sp.zeros(count), [], []
        force = sp.zeros(len(motion.names), 1)  # generalised, on each coordinate
        for i, body in enumerate(motion.tree):
            moves, spins = motion.rates(i, motion.at(i, body.centre))
            force -= moves.T * UP * body.mass * v.g
            shift, spin, turned = (each.xreplace(still) for each in (moves, spins, motion.turns[i]))
            tensor = turned * Matrix(body.inertia) * turned.T
            mass += (body.mass * shift.T * shift + spin.T * tensor * spin)[:count, :count]
            if body.name in motion.across:
                force[motion.across.index(body.name)] -= body.spring * q[body.name] + body.damper * rate[body.name]

        def momentum(i: int, size: Any) -> Matrix:
            """Coriolis terms of a spin momentum about the axle that a body carries."""
            by = slopes((motion.rates(i, motion.origins[i])[1].T * motion.turns[i] * LEFT)[:count, :], lateral, still)
            return size * (by - by.T)

        gyro += momentum(0, v.motor.crank_momentum)
        for k, wheel in enumerate(WHEELS):
            load, along, ka, kg, ma, mg, lag, spin = of[wheel]
            hub = next(body for body in motion.tree if body.name == f"{wheel}_wheel")
            tyre, ring, axle = getattr(v, f"{wheel}_tyre"), self.radii[wheel], motion.turns[hub.parent] * LEFT
            lean, ring = axle.dot(UP), ring - tyre.crown
            level = sp.sqrt(1 - lean**2)
            left = (axle - lean * UP) / level
            touch = motion.at(hub.parent, hub.point) + ring * (lean * axle - UP) / level - tyre.crown * UP
            moves, spins = motion.rates(hub.parent, touch)
            side, twist = -(ka * slips[k] + kg * lean), -(ma * slips[k] + mg * lean)  # y to the left, z up
            force += moves.T * (along * left.cross(UP) + side * left + load * UP) + spins.T * UP * twist
            # the slip is that of the crown's centre
            aside = (moves * rates + tyre.crown * (spins * rates).cross(UP)).dot(left)
            lags.append((aside - speed * slips[k]) / lag)
            gyro += momentum(hub.parent, spin)
            heights.append(touch[2].xreplace(still))
        wind = motion.rates(0, motion.origins[0])[0] * rates
        fast = sp.sqrt(wind.dot(wind))
        air = -0.5 * v.air.density * fast * (v.air.drag_area * wind + v.air.down_area * fast * motion.turns[0] * UP)
        force += motion.rates(0, motion.at(0, np.array([v.air.x, 0.0, v.air.height])))[0].T * air
        stiff, seat, steer = v.rider.slide_frequency, motion.across.index("rider"), motion.across.index("fork")
        force[seat] -= v.rider.mass * stiff * (stiff * q["rider"] + 2.0 * rate["rider"])
        force[steer] -= v.steering.damper_slow * rate["fork"]

        pose = [q[name] for name in IN_PLANE]
        inputs = [*pose, speed, *of["rear"], *of["front"]]
        parts = Matrix(force[:count]), Matrix(lags)
        blocks = [slopes(part, by, still) for part in parts for by in (lateral, Matrix([*rate.values()]), slips)]
        self.matrices = sp.lambdify(inputs, [mass, gyro, *blocks], "numpy", cse=True)
        self.balance = sp.lambdify(inputs, [*Matrix(force[count:]).xreplace(still)], "math", cse=True)
        self.heights = sp.lambdify(pose, heights, "math")

    def straight(self, speed: float) -> list[float]:
        """Return the equations' inputs at a speed, m/s: pose, loads and slips with which the plane's forces balance."""
        v = self.vehicle
        joints: Any = v.joints
        front = v.mass * v.g * v.com_x / v.w
        static, tyres = (v.mass * v.g - front, front), (v.rear_tyre, v.front_tyre)
        unit, fork = joints.swing_arm.strut.stiffness, joints.fork.strut.stiffness
        length = CubicSpline(np.linspace(-UNIT_RANGE, UNIT_RANGE, UNIT_SAMPLES), joints.swing_arm.unit_lengths())
        rest = self.balance(*np.zeros(6), static[0], *np.zeros(7), static[1], *np.zeros(7))
        preload = -rest[3] / float(length(0.0, 1)), rest[4]

        def wheels(pose: Any, thrust: float) -> list[tuple[float, float]]:
            heights = self.heights(*pose)
            loads = [n - tyre.stiffness * z for n, tyre, z in zip(static, tyres, heights, strict=True)]
            return [(loads[0], thrust), (loads[1], -v.front_tyre.rolling * loads[1])]

        def unbalanced(unknown: Any) -> list[float]:
            pose = 0.0, *unknown[:4]
            acting = [[*wheel, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0] for wheel in wheels(pose, unknown[4])]
            x, z, pitch, swing, travel = self.balance(*pose, speed, *acting[0], *acting[1])
            arm, pressed = pose[3:]
            swing += (preload[0] + unit * float(length(0.0) - length(arm))) * float(length(arm, 1))
            return [x, z, pitch, swing, travel - preload[1] - fork * pressed]

        found = fsolve(unbalanced, [0.0] * 4 + [0.2 * speed**2])
        np.testing.assert_allclose(unbalanced(found), 0.0, atol=1e-5)
        values = [0.0, *found[:4], speed]
        for wheel, (load, along) in zip(WHEELS, wheels((0.0, *found[:4]), found[4]), strict=True):
            c, tyre = self.tyres[wheel], self.tyre[wheel]
            slip = brentq(lambda k, tyre=tyre, n=load, f=along: tyre(n, k)[0] - f, -0.1, 0.1, xtol=1e-14)
            _, ka, kg, ma, mg, corner = tyre(load, slip)
            lag = corner * (c["c0"] + c["c1"] * speed + c["c2"] * speed**2)
            inertia = v.IRyy if wheel == "rear" else v.IFyy
            values += [load, along, ka, kg, ma, mg, lag, inertia * speed * (1.0 + slip) / self.radii[wheel]]
        return values

    def eigenvalues(self, speed: float) -> NDArray[np.complex128]:
        """Return the eigenvalues at a speed (m/s), 1/s, but the two zeros of where it is and which way it heads."""
        mass, gyro, *blocks = self.matrices(*self.straight(speed))
        by_place, by_rate, by_slip, lag, lag_rate, lag_slip = blocks
        inverse, n = np.linalg.inv(mass), len(mass)
        top = np.hstack([np.zeros((n, n)), np.eye(n), np.zeros((n, 2))])
        middle = inverse @ np.hstack([by_place, by_rate - gyro, by_slip])
        values = np.linalg.eigvals(np.vstack([top, middle, np.hstack([lag, lag_rate, lag_slip])]))
        return np.asarray(values[np.argsort(np.abs(values))[2:]])


def of_engine(vehicle: Superbike, speed: float) -> tuple[float, NDArray[np.complex128]]:
    """Return the speed that the engine holds, m/s, and its eigenvalues there, 1/s, hands off."""
    vehicle = hands_off(vehicle)
    settled = CompiledSuperbikeEngine(vehicle, 0.002)
    settled.reset(st.upright_state(speed, vehicle.rF))
    command, lateral = holding(vehicle, speed, 0.0), lateral_states(settled)
    for _ in range(5):
        ride(settled, 4.0, command)
        # what rounding leaves of motion to the side would grow where the machine is unstable
        motion = settled.motion[0]
        motion["velocity"][1], motion["omega"][[0, 2]], motion["orientation"][[0, 2]] = 0.0, 0.0, 0.0
        for name, (field, number) in joint_states(settled).items():
            motion[field][number] *= name not in lateral
        settled.memory["rear_tan_slip_angle"], settled.memory["front_tan_slip_angle"] = 0.0, 0.0
    held = float(settled.telemetry()[signal("speed")])
    matrices = []
    for step in STEPS:
        engine = CompiledSuperbikeEngine(vehicle, step)
        engine.motion[:], engine.memory[:] = settled.motion, settled.memory
        after = transition_matrix(engine, (0.0, holding_throttle(vehicle, held)), lateral, 1)
        matrices.append((after - np.eye(len(lateral))) / step)
    for k in range(1, len(STEPS)):  # Richardson: the error has all powers of the step
        matrices = [(2**k * fine - coarse) / (2**k - 1) for coarse, fine in pairwise(matrices)]
    return held, np.asarray(np.linalg.eigvals(matrices[0]))


@pytest.mark.parametrize(
    ("left_out", "speeds"),
    [
        ("fork_bending", SPEEDS[::2]),
        # trees that no shipped machine has are compiled first
        *(pytest.param(part, SPEEDS, marks=pytest.mark.long) for part in ("torso", "")),
    ],
)
def test_eigenvalues_are_those_of_another_linearisation(left_out: str, speeds: tuple[float, ...]) -> None:
    """All of them, at 5 to 80 m/s, to 1e-5 of their size."""
    shipped = load_superbike("gsxr1000")
    joints: Any = replace(shipped.joints, fork_bending=Flexure(0.521, 55300.0, 20.0))
    motor = replace(shipped.motor, peak_power=180e3, peak_torque=160.0)  # that of the machine ends below 80 m/s
    vehicle = replace(shipped, joints=replace(joints, **({left_out: None} if left_out else {})), motor=motor)
    document = yaml.safe_load((SHIPPED / "gsxr1000.yaml").read_text(encoding="utf-8"))
    machine = Machine(vehicle, {wheel: document[f"{wheel}_tyre"]["magic_formula"] for wheel in WHEELS})
    for speed in speeds:
        held, measured = of_engine(vehicle, speed)
        assert held == pytest.approx(speed, abs=1e-5)
        wanted = machine.eigenvalues(held)
        nearest = np.abs(wanted[:, None] - measured).argmin(axis=1)
        assert sorted(nearest) == list(range(len(wanted))) == list(range(len(measured)))
        np.testing.assert_allclose(np.abs(measured[nearest] / wanted - 1.0), 0.0, atol=1e-5)
