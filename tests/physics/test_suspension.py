"""Machines that give way: statics, linkage, modes against the literature, and the same ride in both engines."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import yaml

from bike_sim.physics import state as st
from bike_sim.physics.superbike import magic_formula
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.validation.published import (
    FOLDER,
    check_published,
    check_rides,
    machine_of_table,
    measured_modes,
    nearest,
    published,
    straight_eigenvalues,
)
from bike_sim.validation.superbike import measure_performance, signal, steady_turns
from bike_sim.vehicles.files import SHIPPED, load_superbike, load_vehicle, vehicle_from_document
from bike_sim.vehicles.joints import UNIT_RANGE, UNIT_SAMPLES, Chain, Joints
from bike_sim.vehicles.parameters import VehicleError
from bike_sim.vehicles.superbike import Superbike


def suzuki() -> Superbike:
    """Return the shipped machine."""
    return load_superbike("gsxr1000")


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


def test_every_published_figure_is_met() -> None:
    """Statics, Sharp's eigenvalues at eight speeds, and those of a linear model with joints switched on and off."""
    checks = list(check_published(suzuki(), measured_modes(suzuki())))
    assert len(checks) == 22
    assert [check.title for check in checks if not check.passed] == []


def test_rides_beside_published_ones() -> None:
    """Torques of steady turns that are as published, lateral acceleration by lean, and road tests."""
    vehicle = suzuki()
    checks = {check.name: check for check in check_rides(vehicle, [], measure_performance(vehicle))}
    assert all(checks[name].passed for name in ("lateral_suspended", "lateral_rigid", "to_100_s", "stop_100_m"))
    # the published radius is that of the loaded wheel, and so short a gear ends sooner
    assert 278.0 < checks["top_km_h"].measured < 285.0
    longer = replace(vehicle.motor, final_ratio=vehicle.motor.final_ratio * 0.297 / 0.317)
    assert 285.0 < measure_performance(replace(vehicle, motor=longer)).top_km_h < 295.0


def test_torque_of_steady_turns() -> None:
    """Slopes at 2 deg are those of a linear model of the same machine, and at 14 m/s those of the published table."""
    table = published()["gsxr1000"]["steady_torque"]
    turns = list(steady_turns(machine_of_table(suzuki()), table["speed_m_s"][:2], table["roll_rad"][:2]))
    torques = np.array([turn.telemetry[:, signal("steer_torque")].mean() for turn in turns]).reshape(2, 2)
    np.testing.assert_allclose(torques[:, 0] / table["roll_rad"][0], table["linear_slope_nm_rad"][:2], rtol=0.04)
    np.testing.assert_allclose(torques[0], np.array(table["torque_nm"])[:2, 0], rtol=0.06)


def test_another_machine_is_not_sharps() -> None:
    """A trail of 10 mm more, or a tyre that lags in side slip alone, misses his table."""
    with resources.as_file(FOLDER / "sharp1971.yaml") as path:
        vehicle = load_superbike(path)
    speed, wanted = 30.48, -3.94 + 54.3j
    changed = (
        replace(vehicle, c=vehicle.c + 0.01),
        replace(vehicle, front_tyre=replace(vehicle.front_tyre, camber_lag=0.0)),
    )
    assert abs(nearest(straight_eigenvalues(vehicle, speed, 1e-4, 0.0), wanted) - wanted) < 0.1
    for other in changed:
        assert abs(nearest(straight_eigenvalues(other, speed, 1e-4, 0.0), wanted) - wanted) > 0.3


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
    document = yaml.safe_load((SHIPPED / "gsxr1000.yaml").read_text(encoding="utf-8"))
    coefficients = document["front_tyre"].pop("magic_formula")
    short = {name: value for name, value in coefficients.items() if name != "pKy6"}
    for wrong, named in ((short, "pKy6"), (coefficients | {"pKz1": 1.0}, "pKz1")):
        tyre = document["front_tyre"] | {"magic_formula": wrong}
        with pytest.raises(VehicleError, match=f"front_tyre.magic_formula: .*{named}"):
            vehicle_from_document(document | {"front_tyre": tyre}, "mine")


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
    tyre = suzuki().machine[("rear_tyre", "front_tyre")[place]]["magic_formula"]
    fx, fy, mz, _ = magic_formula.forces(slip, drift, camber, float(tyre["Fz0"]), 1.0, tyre)
    np.testing.assert_allclose((fx, -fy), expected[:2], rtol=0.0, atol=0.006)
    assert -mz == pytest.approx(expected[2], abs=0.0006)
    mirrored = magic_formula.forces(slip, -drift, -camber, float(tyre["Fz0"]), 1.0, tyre)
    assert mirrored[:3] == (fx, -fy, -mz)
