"""Machines that give way: statics, linkage, modes against the literature, and the same ride in both engines."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.ground import BUMP_SAMPLES, Ground, flat_ground
from bike_sim.physics.superbike import equilibrium, magic_formula, statics
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.physics.superbike.modes import measure_modes
from bike_sim.schema import SIGNALS
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
from bike_sim.validation.superbike import (
    at_speed,
    constant,
    drive_shake,
    holding,
    measure_performance,
    ride,
    signal,
    steady_turns,
)
from bike_sim.vehicles.files import (
    VARIANTS,
    load_superbike,
    load_vehicle,
    shipped_variants,
)
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


@pytest.mark.slow
@pytest.mark.parametrize(("unusual", "count"), [(False, 22), pytest.param(True, 12, marks=pytest.mark.long)])
def test_every_published_figure_is_met(unusual: bool, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Statics, Sharp's eigenvalues at eight speeds, and those of a linear model with joints switched on and off.

    Trees of seven and of ten bodies, which no shipped machine has, take half a minute to be compiled.
    """
    figures = published()
    figures["gsxr1000"]["variants"] = [
        variant
        for variant in figures["gsxr1000"]["variants"]
        if (len(variant.get("without", ())) == 2 or "fork_bending" in variant) == unusual
    ]
    monkeypatch.setattr("bike_sim.validation.published.published", lambda: figures)
    checks = list(check_published(suzuki(), measured_modes(suzuki())))
    assert len(checks) == count
    assert [check.title for check in checks if not check.passed] == []


def test_rides_beside_published_ones() -> None:
    """Torques of steady turns that are as published, lateral acceleration by lean, and road tests."""
    vehicle = suzuki()
    checks = {check.name: check for check in check_rides(vehicle, [], measure_performance(vehicle))}
    assert all(checks[name].passed for name in ("lateral_suspended", "lateral_rigid", "to_100_s", "stop_100_m"))
    # the published radius is that of the loaded wheel, and so short a gear ends sooner
    assert 278.0 < checks["top_km_h"].measured < 285.0
    longer = replace(vehicle.motor, final_ratio=vehicle.motor.final_ratio * 0.297 / 0.317)
    assert 285.0 < measure_performance(replace(vehicle, motor=longer))["top_km_h"] < 295.0


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


def hills() -> Ground:
    """Return a road that climbs, bends over a crest and leans, with bumps of 2 mm, in a gusty cross-wind."""
    ground = flat_ground()
    for wheel in ("rear", "front"):
        for name, value in (("grade", 0.03), ("bank", 0.05), ("crest", -2e-4), ("bumps", 0.002)):
            ground.record[wheel][name] = value
    ground.record["wind_x"], ground.record["wind_y"] = 3.0, -8.0
    steps = np.arange(BUMP_SAMPLES) * (2.0 * math.pi / BUMP_SAMPLES)
    profile = np.sin(137 * steps) + 0.5 * np.sin(419 * steps + 1.0) + 0.3 * np.sin(811 * steps + 2.0)
    return Ground(ground.record, profile[None])


def test_both_engines_ride_alike() -> None:
    """Ten seconds of turning, driving and braking over hills and bumps in wind: the same place within 1e-9 m."""
    vehicle, ground = suzuki(), hills()
    engines = [kind(vehicle, 0.002) for kind in (CompiledSuperbikeEngine, BulletSuperbikeEngine)]
    for engine in engines:
        engine.reset(st.upright_state(30.0, vehicle.rF), ground)
        for k in range(500):
            engine.advance(0.25 * math.sin(k / 40), 0.2 + 0.4 * math.cos(k / 30), 10, ground)
        assert engine.fall == "none"
    states = [engine.state() for engine in engines]
    np.testing.assert_allclose(states[0], states[1], rtol=0.0, atol=1e-9)
    travel = float(engines[0].motion["joints"][0, engines[0].constants["joints"]["travel"][0]])
    assert abs(travel) > 1e-4


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


@pytest.mark.parametrize(
    ("lean", "speed", "throttle"),
    [(0.0, 70.0, None), (30.0, 30.0, None), (50.0, 30.0, None), (0.0, 60.0, -0.3), (0.0, 30.0, 0.5)],
)
def test_springs_settle_where_quasi_steady_limits_take_them(lean: float, speed: float, throttle: float | None) -> None:
    """Travels under the loads of a ride, with squat and dive; in a turn the lean turns as the closed form says."""
    vehicle = load_superbike("panigale_v4r_suspended")
    engine = at_speed(CompiledSuperbikeEngine(vehicle, 0.001), speed)
    if throttle is None:
        recorded = ride(engine, 6.0, holding(vehicle, speed, lean)).tail(0.5)
    else:
        recorded = ride(engine, 1.5, constant(vehicle, lean, throttle)).tail(0.1)
    told = recorded.telemetry.mean(axis=0)
    mean = {quantity.name: float(told[signal(quantity.name)]) for quantity in SIGNALS}
    at = abs(float(recorded.lean.mean()))
    rear, front = (
        mean[f"{wheel}_load"] * math.cos(at) + abs(mean[f"{wheel}_force_lat"]) * math.sin(at)
        for wheel in ("rear", "front")
    )
    thrust = mean["rear_force_long"] + mean["front_force_long"]
    swing, travel = equilibrium.travels(rear, front, thrust, vehicle.machine)
    assert vehicle.joints is not None
    assert vehicle.joints.swing_arm is not None
    shortening = vehicle.joints.swing_arm.strut.compression / vehicle.rear_trim.most
    assert travel == pytest.approx(mean["fork_travel"], abs=0.004)
    assert swing * shortening == pytest.approx(mean["shock_travel"], abs=0.0025)
    if lean > 0.0:
        lateral = statics.steady_lateral(vehicle, at, float(recorded.speed.mean()))
        assert lateral == pytest.approx(abs(mean["acceleration_lat"]), rel=3e-3)
        rigid = statics.steady_lateral(replace(vehicle, joints=None), at, float(recorded.speed.mean()))
        assert lateral < rigid


def test_a_file_without_joints_is_rigid() -> None:
    """No joint of the five machines gives way, and one whose joints are empty differs by its loaded radii only."""
    vehicle = load_vehicle("panigale_v4r")
    assert isinstance(vehicle, Superbike)
    assert vehicle.joints is None
    assert len(CompiledSuperbikeEngine(vehicle, 0.002).tree) == 5
    assert len(CompiledSuperbikeEngine(replace(vehicle, joints=Joints()), 0.002).tree) == 5


@pytest.mark.parametrize("name", shipped_variants())
def test_suspended_machines_are_the_rigid_ones_on_springs(name: str) -> None:
    """Masses stay, each number has its source, it stands still, and hands off or on nothing grows at 20 and 60 m/s."""
    vehicle, rigid = load_superbike(name), load_superbike(name.removesuffix("_suspended"))
    assert vehicle.mass == pytest.approx(rigid.mass)
    assert vehicle.centre_of_mass == pytest.approx(rigid.centre_of_mass, abs=1e-3)
    assert vehicle.electronics.reference_mass == pytest.approx(vehicle.mass)
    files = VARIANTS / f"{name}.yaml", VARIANTS / "parts" / "suspended.yaml"
    lines = [line for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    values = [line for line in lines if re.match(r"\s+\w+: ([-\d.\[]|{)", line)]
    assert len(values) > 40
    assert [line for line in values if not re.search(r"# .*\[(S\d|maker|estimate)", line)] == []
    engine = CompiledSuperbikeEngine(vehicle, 0.002)
    engine.reset(st.upright_state(0.0, vehicle.rF))
    engine.advance(0.0, 0.0, 250)
    assert np.abs(engine.motion["joints"][0, 3:]).max() < 1e-6
    for speed in (20.0, 60.0):
        for hands in (False, True):
            modes = measure_modes(vehicle, speed, hands=hands)
            assert max(modes.weave.real, modes.wobble.real) < 0.0
    # a step of 2 ms damps weave: what the rider does at full drive with a light front wheel must bear a fine one
    assert drive_shake(vehicle, 0.0005, 45.0, 15.0, 0.0) < 0.15


def _tir(coefficients: Mapping[str, float]) -> str:
    """Return the text of a file of a tyre's coefficients."""
    names = {"Fz0": "FNOMIN", "rc": "CROWN_RADIUS"}
    lines = [f"{names.get(name, name.upper())} = {value!r}  $ comment" for name, value in coefficients.items()]
    return "\n".join(["[MODEL]", "FITTYP = 'MC'", "PHY1 = 0.01", *lines])


def test_a_tir_file_gives_the_same_forces(tmp_path: Path) -> None:
    """Coefficients in a file beside the vehicle's, which stands on a base, are those in the base itself."""
    vehicle = suzuki()
    coefficients = vehicle.front_tyre.magic_formula
    assert coefficients is not None
    (tmp_path / "front.tir").write_text(_tir(vars(coefficients)), encoding="utf-8")
    path = tmp_path / "mine.yaml"
    path.write_text("base: gsxr1000\nname: mine\nfront_tyre: {magic_formula: front.tir}\n", encoding="utf-8")
    mine = load_superbike(path)
    assert replace(mine, name=vehicle.name) == vehicle
    for load, drift in ((600.0, 0.02), (1800.0, -0.05)):
        one, other = (
            magic_formula.forces(0.03, drift, 0.4, load, 1.0, each.machine["front_tyre"]["magic_formula"])
            for each in (mine, vehicle)
        )
        assert one == other


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("PKY6 = ", "PKX6 = "), "front_tyre.magic_formula = 'front.tir' lacks PKY6$"),
        (("PKY6 = ", "PKY6 = about "), "'front.tir', line 28: PKY6 = about 0.69677 is not a number$"),
        (("PKY6 = ", "PKY7 = "), "'front.tir', line 29: PKY7 = -0.03077 is given twice$"),
        ((" = ", " : "), "'front.tir' has no coefficient of a motorcycle tyre"),
        (("[MODEL]", "\0"), "'front.tir' is a binary file"),
    ],
)
def test_a_broken_tir_file_is_refused(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    """One line names the vehicle, the file, and what is wrong there."""
    coefficients = suzuki().front_tyre.magic_formula
    assert coefficients is not None
    (tmp_path / "front.tir").write_text(_tir(vars(coefficients)).replace(*change), encoding="utf-8")
    path = tmp_path / "mine.yaml"
    path.write_text("base: gsxr1000\nname: mine\nfront_tyre: {magic_formula: front.tir}\n", encoding="utf-8")
    with pytest.raises(VehicleError, match=f"vehicle '.*mine.yaml': .*{message}"):
        load_superbike(path)


def test_bases_that_cannot_be_are_refused(tmp_path: Path) -> None:
    """A base that does not exist, that stands on itself, that is no name, and a tyre's file that is not there."""
    path = tmp_path / "mine.yaml"
    for text, error, message in (
        ("base: tandem", FileNotFoundError, "no vehicle 'tandem'"),
        ("base: other.yaml", FileNotFoundError, "does not exist"),
        ("base: mine.yaml", VehicleError, "one base too many"),
        ("base: [1]", VehicleError, r"base = a list is no name of a vehicle"),
        ("base: []", VehicleError, r"base = a list is no name of a vehicle"),
        ("base: [r1, tandem]", FileNotFoundError, "no vehicle 'tandem'"),
        ("front_tyre: {magic_formula: none.tir}", VehicleError, "'none.tir' does not exist beside the vehicle's file"),
        ("front_tyre: {magic_formula: tyre.txt}", VehicleError, "'tyre.txt' is no name of a .tir file"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(error, match=message):
            load_superbike(path)


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
