"""Machines that give way: statics, linkage, modes against the literature, and the same ride in both engines."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib import resources
from typing import Any

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.superbike import magic_formula, modes
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.joints import UNIT_RANGE, UNIT_SAMPLES, Chain, Flexure, Joints
from bike_sim.vehicles.parameters import VehicleError
from bike_sim.vehicles.superbike import Superbike


def suzuki() -> Superbike:
    """Return the shipped machine."""
    vehicle = load_vehicle("gsxr1000")
    assert isinstance(vehicle, Superbike)
    return vehicle


def variant(
    twist: float | None = 163e3, torso: bool = True, bending: float | None = None, damper: float = 6.944
) -> Any:
    """Return it as the linear model has it: nothing rolls or drives, and the rider does not slide."""
    vehicle = suzuki()
    assert vehicle.joints is not None
    assert vehicle.joints.head is not None
    head = None if twist is None else replace(vehicle.joints.head, stiffness=twist)
    joints = replace(
        vehicle.joints,
        head=head,
        torso=vehicle.joints.torso if torso else None,
        fork_bending=None if bending is None else Flexure(0.52091, bending, 20.0),
    )
    tyres = {name: replace(getattr(vehicle, name), rolling=0.0) for name in ("front_tyre", "rear_tyre")}
    return replace(
        vehicle,
        **tyres,
        joints=joints,
        steering=replace(vehicle.steering, damper_slow=damper, damper_fast=damper),
        rider=replace(vehicle.rider, slide_frequency=400.0),
        motor=replace(vehicle.motor, crank_momentum=0.0, engine_brake=0.0),
    )


def test_spring_forces_hold_the_design_pose() -> None:
    """Forces of fork and spring unit follow from the masses (virtual work by hand), and the machine stands still."""
    vehicle = suzuki()
    engine = CompiledSuperbikeEngine(vehicle, 0.001)
    unit, fork = (float(engine.constants["joints"][name]["preload"][0]) for name in ("unit", "fork"))
    front = vehicle.mass * vehicle.g * vehicle.com_x / vehicle.w
    below = (vehicle.mF + 7.25) * vehicle.g
    assert fork == pytest.approx((front - below) * math.cos(vehicle.lam), rel=1e-9)
    assert unit == pytest.approx(2006.2, rel=1e-4)  # of the same parts by another program
    engine.reset(st.upright_state(0.0, vehicle.rF))
    engine.advance(0.0, 0.0, 1000)
    assert np.abs(engine.motion["joints"][0, 3:]).max() < 1e-6


def test_linkage_is_the_published_one() -> None:
    """Spring travel by wheel travel over the stroke, to four digits."""
    joints = suzuki().joints
    assert joints is not None
    assert joints.swing_arm is not None
    arm = joints.swing_arm
    angles = np.linspace(-UNIT_RANGE, UNIT_RANGE, UNIT_SAMPLES)
    lengths = arm.unit_lengths()
    assert lengths[UNIT_SAMPLES // 2] == pytest.approx(0.313521, abs=1e-6)
    x, z = -arm.pivot[0], 0.297 - arm.pivot[1]
    rise = z * np.cos(angles) - x * np.sin(angles) - z
    ratio = -np.gradient(lengths, angles) / np.gradient(rise, angles)
    published = {-0.04: 0.5253, -0.02: 0.5396, 0.0: 0.5537, 0.02: 0.5680, 0.04: 0.5833, 0.06: 0.6003, 0.08: 0.6206}
    for travel, value in published.items():
        assert np.interp(travel, rise, ratio) == pytest.approx(value, rel=1e-3)


SHARP = {  # speed, m/s: capsize, weave, wobble, 1/s and rad/s; Sharp (1971), table of model 1
    3.048: (-3.56, 2.01 + 1.63j, -5.20 + 55.7j),
    6.096: (-2.83, -0.18 + 2.09j, -5.91 + 55.8j),
    9.144: (-0.13, -3.36 + 4.56j, -6.42 + 55.5j),
    15.24: (0.08, -6.59 + 11.4j, -6.52 + 54.6j),
    21.336: (0.08, -3.97 + 16.8j, -5.70 + 54.0j),
    30.48: (0.07, -1.82 + 19.2j, -3.94 + 54.3j),
    39.624: (0.05, -1.13 + 20.4j, -2.24 + 55.6j),
    48.768: (0.04, -0.96 + 21.2j, -0.82 + 57.5j),
}


@pytest.mark.parametrize("speed", SHARP)
def test_modes_are_those_of_sharp(speed: float) -> None:
    """The published eigenvalues of his motorcycle, within 0.03 1/s and 0.1 rad/s, in a nonlinear engine."""
    with resources.as_file(resources.files("bike_sim") / "config" / "validation" / "sharp1971.yaml") as path:
        vehicle = load_vehicle(path)
    assert isinstance(vehicle, Superbike)
    step = 2e-5
    engine = CompiledSuperbikeEngine(modes.hands_off(vehicle), step)
    engine.reset(st.upright_state(speed, vehicle.rF))
    engine.advance(0.0, 0.0, round(0.5 / step))
    values = modes.eigenvalues(engine, (0.0, 0.0), modes.LATERAL_STATES, 300)
    for published in SHARP[speed]:
        found = values[np.argmin(np.abs(values - published))]
        assert found.real == pytest.approx(complex(published).real, abs=0.03)
        assert found.imag == pytest.approx(complex(published).imag, abs=0.1)


LINEAR: dict[str, tuple[dict[str, Any], dict[float, tuple[complex | None, complex]]]] = {
    # weave and wobble, 1/s and Hz, of an independent linear model of the same machine with joints switched on and off
    "A": ({}, {20: (-6.69 + 2.95j, -7.04 + 8.24j), 40: (-1.98 + 4.06j, -2.61 + 7.66j)}),
    "B": ({"twist": None}, {40: (-2.22 + 4.05j, -1.28 + 7.73j), 60: (-0.95 + 4.47j, 1.06 + 7.47j)}),
    "C": ({"torso": False}, {40: (-1.02 + 3.80j, -4.38 + 7.46j), 60: (0.90 + 4.32j, -2.46 + 6.59j)}),
    "D": ({"twist": None, "torso": False}, {40: (-1.28 + 3.81j, -2.82 + 7.52j), 60: (0.31 + 4.29j, -0.02 + 6.86j)}),
    "F": ({"twist": 34.1e3}, {13: (None, -2.09 + 7.58j), 40: (-0.94 + 4.04j, -10.13 + 7.55j)}),
    "G": ({"damper": 0.0}, {20: (-7.70 + 3.07j, -1.82 + 7.98j), 60: (-1.68 + 4.44j, 4.62 + 7.38j)}),
    "I": ({"bending": 55300.0}, {40: (-1.31 + 4.04j, -6.98 + 7.44j), 60: (0.99 + 4.57j, -6.22 + 6.39j)}),
}  # fmt: skip


@pytest.mark.parametrize("name", LINEAR)
def test_joints_change_the_modes_as_in_a_linear_model(name: str) -> None:
    """Frequencies within 3 %, real parts within 1 1/s."""
    changed, expected = LINEAR[name]
    vehicle = variant(**changed)
    for speed, pair in expected.items():
        found = modes.measure_modes(vehicle, float(speed))
        for mode, published in zip((found.weave, found.wobble), pair, strict=True):
            if published is not None:
                assert mode.real == pytest.approx(published.real, abs=1.0)
                assert mode.imag / (2.0 * math.pi) == pytest.approx(published.imag, rel=0.03)


def test_both_engines_ride_alike() -> None:
    """Ten seconds of turning, driving and braking: the same place within 1e-9 m."""
    vehicle = suzuki()
    engines = [kind(vehicle, 0.002) for kind in (CompiledSuperbikeEngine, BulletSuperbikeEngine)]
    for engine in engines:
        engine.reset(st.upright_state(30.0, vehicle.rF))
        for k in range(500):
            engine.advance(0.25 * math.sin(k / 40), 0.2 + 0.4 * math.cos(k / 30), 10)
        assert engine.fall == "none"
    states = [engine.state() for engine in engines]
    np.testing.assert_allclose(states[0], states[1], rtol=0.0, atol=1e-9)


def test_a_mirrored_ride_is_the_same_ride() -> None:
    """Joints and measured tyres treat left and right alike, to the last digit but rounding."""
    vehicle, ends = suzuki(), []
    for side in (1.0, -1.0):
        engine = CompiledSuperbikeEngine(vehicle, 0.002)
        engine.reset(st.upright_state(25.0, vehicle.rF))
        for k in range(150):
            engine.advance(side * 0.4 * math.sin(k / 15), 0.2, 10)
        ends.append(engine.state())
    signs = np.ones(st.STATE_SIZE)
    signs[[st.Y, st.YAW, st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE]] = -1.0
    np.testing.assert_allclose(ends[0], signs * ends[1], rtol=1e-9, atol=1e-9)


def test_braking_dives_and_a_high_chain_squats() -> None:
    """The brake presses the fork together and lifts the rear; the drive's chain over the pivot presses the rear."""
    vehicle, travels = suzuki(), {}
    assert vehicle.joints is not None
    assert vehicle.joints.swing_arm is not None
    for height in (None, 0.36, 0.50):
        chain = None if height is None else Chain((0.62, height), 0.0432, 0.0432)
        arm = replace(vehicle.joints.swing_arm, chain=chain)
        engine = CompiledSuperbikeEngine(replace(vehicle, joints=replace(vehicle.joints, swing_arm=arm)), 0.001)
        numbers = engine.constants["joints"][0]
        for throttle in (-0.6, 0.0, 0.6):
            engine.reset(st.upright_state(40.0, vehicle.rF))
            engine.advance(0.0, throttle, 800)
            joints = engine.motion["joints"][0]
            travels[height, throttle] = joints[numbers["travel"]], joints[numbers["swing"]]
    assert travels[None, -0.6][0] > travels[None, 0.0][0] + 0.01 > travels[None, 0.6][0] + 0.02
    assert travels[None, -0.6][1] < travels[None, 0.0][1] - 0.01
    assert travels[0.50, 0.6][1] > travels[0.36, 0.6][1] + 0.01
    assert abs(travels[0.50, -0.6][1] - travels[None, -0.6][1]) < 0.01


def test_a_file_without_joints_is_rigid() -> None:
    """No joint of the five machines gives way, and one whose joints are empty differs by its loaded radii only."""
    vehicle = load_vehicle("panigale_v4r")
    assert isinstance(vehicle, Superbike)
    assert vehicle.joints is None
    assert len(CompiledSuperbikeEngine(vehicle, 0.002).tree) == 5
    assert len(CompiledSuperbikeEngine(replace(vehicle, joints=Joints()), 0.002).tree) == 5


def test_coefficients_are_complete() -> None:
    """A tyre whose coefficients lack one or have one too many is refused by name."""
    tyre = suzuki().front_tyre
    assert tyre.magic_formula is not None
    with pytest.raises(VehicleError, match="pKy6"):
        replace(tyre, magic_formula={k: v for k, v in tyre.magic_formula.items() if k != "pKy6"})
    with pytest.raises(VehicleError, match="pKz1"):
        replace(tyre, magic_formula=tyre.magic_formula | {"pKz1": 1.0})


@pytest.mark.parametrize(
    ("place", "slip", "drift", "camber", "expected"),
    [  # of an implementation of its own of the same formulas: Fx, Fy (N), Mz (N m) in the axes of the authors
        (1, 0.0, 0.02, 0.0, (0.0, 364.67, -4.218)),
        (1, 0.0, 0.0, 0.3, (0.0, 265.01, 8.800)),
        (1, 0.0, -0.02, 0.3, (0.0, -100.94, 13.078)),
        (1, 0.05, 0.03, 0.2, (1059.93, 677.57, -0.738)),
        (1, -0.08, 0.03, 0.5, (-1340.36, 940.99, 5.628)),
        (0, 0.0, 0.02, 0.3, (0.0, 674.77, 10.029)),
        (0, 0.05, 0.03, 0.2, (1530.40, 768.66, 0.805)),
        (0, -0.08, 0.03, 0.5, (-1924.05, 971.71, 8.739)),
    ],
)
def test_magic_formula(
    place: int, slip: float, drift: float, camber: float, expected: tuple[float, float, float]
) -> None:
    """Forces and moment of both tyres at their nominal loads, to the last digit printed, and mirrored."""
    tyre = suzuki().machine[("rear_tyre", "front_tyre")[place]]["magic"]
    fx, fy, mz, _ = magic_formula.forces(slip, drift, camber, float(tyre["Fz0"]), 1.0, tyre)
    np.testing.assert_allclose((fx, -fy), expected[:2], rtol=0.0, atol=0.006)
    assert -mz == pytest.approx(expected[2], abs=0.0006)
    mirrored = magic_formula.forces(slip, -drift, -camber, float(tyre["Fz0"]), 1.0, tyre)
    assert mirrored[:3] == (fx, -fy, -mz)
