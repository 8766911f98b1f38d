"""The five superbikes are as their makers made them: published figures come back, estimates follow the stated rules."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.physics.superbike import statics
from bike_sim.vehicles.files import SHIPPED, load_superbike


class Published(NamedTuple):
    """Data sheet; SI units, angles in deg, engine speeds in 1/min.

    `press`: downforce (N) and its speed (m/s); none is published for `None`. `rim` and `stroke` (mm) feed the rules.
    """

    wheelbase: float
    caster: float
    trail: float
    wet_mass: float
    seat: float
    power: tuple[float, float]
    torque: tuple[float, float]
    limiter: float
    rear: tuple[int, int]
    rim: float
    stroke: float
    press: tuple[float, float] | None


KGF = 9.81
CAST, FORGED, CARBON = 1.0, 0.85, 0.6
SHEETS = {
    "panigale_v4r": Published(
        1.471, 24.5, 0.100, 193.0, 0.830, (162e3, 15250.0), (112.0, 11500.0), 16500.0, (200, 60), FORGED, 48.4,
        (30.0 * KGF, 270.0 / 3.6),
    ),
    "zx10rr": Published(
        1.450, 25.0, 0.105, 207.0, 0.835, (150e3, 14000.0), (111.8, 11700.0), 14700.0, (190, 55), FORGED, 55.0, None
    ),
    "cbr1000rr_r": Published(
        1.455, 24.0, 0.102, 201.0, 0.830, (160e3, 14500.0), (113.0, 12500.0), 15200.0, (200, 55), CAST, 48.5, None
    ),
    "r1": Published(
        1.405, 24.0, 0.102, 201.0, 0.855, (147e3, 13500.0), (113.0, 11500.0), 14400.0, (190, 55), CAST, 50.9, None
    ),
    "m1000rr": Published(
        1.457, 23.6, 0.0998, 192.0, 0.832, (156e3, 14500.0), (113.0, 11000.0), 15100.0, (200, 55), CARBON, 49.7,
        (16.3 * KGF, 300.0 / 3.6),
    ),
}  # fmt: skip


MACHINES = {name: load_superbike(name) for name in SHEETS}
EACH = pytest.mark.parametrize("name", sorted(SHEETS))


@EACH
def test_geometry_and_mass_are_the_published(name: str) -> None:
    vehicle, sheet = MACHINES[name], SHEETS[name]
    assert vehicle.w == pytest.approx(sheet.wheelbase, rel=1e-3)
    assert math.degrees(vehicle.lam) == pytest.approx(sheet.caster, abs=0.01)
    assert vehicle.c == pytest.approx(sheet.trail, rel=1e-3)
    assert vehicle.mass - vehicle.rider.mass == pytest.approx(sheet.wet_mass, rel=1e-3)
    # the offset that the trail needs lies within what forks have
    assert 0.025 < vehicle.rF * math.sin(vehicle.lam) - vehicle.c * math.cos(vehicle.lam) < 0.035


@EACH
def test_the_curve_peaks_where_and_as_published(name: str) -> None:
    motor, sheet = MACHINES[name].motor, SHEETS[name]
    rpm = np.linspace(3000.0, motor.limiter_rpm, 40001)
    torque = motor.crank_torque(rpm)
    power = torque * rpm * math.pi / 30.0
    for curve, (peak, speed) in ((torque, sheet.torque), (power, sheet.power)):
        assert curve.max() == pytest.approx(peak, rel=0.005)
        assert rpm[curve.argmax()] == pytest.approx(speed, rel=0.005)
    assert motor.limiter_rpm == sheet.limiter
    assert np.abs(np.diff(torque)).max() < 0.01  # N m a step of 0.3 1/min: no jump where its pieces meet


@EACH
def test_tyres_have_their_sizes_and_one_rubber(name: str) -> None:
    vehicle = MACHINES[name]
    width, aspect = SHEETS[name].rear
    inch = 0.0254
    assert vehicle.rR == pytest.approx(17.0 * inch / 2.0 + width * aspect * 1e-5, rel=1e-3)
    assert vehicle.rF == pytest.approx(17.0 * inch / 2.0 + 120 * 70 * 1e-5, rel=1e-3)
    assert vehicle.rear_tyre.crown == pytest.approx(0.09 * width / 190.0, rel=1e-3)
    for wheel in ("rear_tyre", "front_tyre"):
        mine, others = vehicle.machine[wheel], MACHINES["r1"].machine[wheel]
        assert mine["friction"] == others["friction"]
        assert mine["shape"] == others["shape"]


@EACH
def test_wings_press_as_published(name: str) -> None:
    air, press = MACHINES[name].air, SHEETS[name].press
    if press is not None:
        force, speed = press
        assert 0.5 * air.density * air.down_area * speed**2 == pytest.approx(force, rel=0.01)


def test_the_bmw_wings_load_the_front_wheel_as_published() -> None:
    """13.4 of the 16.3 kgf at 300 km/h."""
    bmw = MACHINES["m1000rr"]
    speed = 300.0 / 3.6
    plain = replace(bmw, air=replace(bmw.air, down_area=0.0))
    more = statics.wheel_loads(bmw, 0.0, speed, 0.0)[1] - statics.wheel_loads(plain, 0.0, speed, 0.0)[1]
    assert more == pytest.approx(13.4 * KGF, rel=0.01)


@EACH
def test_estimates_follow_the_rules_in_the_files(name: str) -> None:
    """Inertias, wheels, rider, engine brake and crank by the rules R1 to R8."""
    vehicle, sheet = MACHINES[name], SHEETS[name]
    bodies = yaml.safe_load((SHIPPED / f"{name}.yaml").read_text(encoding="utf-8"))["bodies"]
    frame = vehicle.frame
    assert bodies["centre_height"] == pytest.approx(0.647 * sheet.seat, abs=6e-4)
    assert vehicle.rider.x == pytest.approx(0.38 * sheet.wheelbase, abs=6e-4)
    assert vehicle.rider.height == pytest.approx(sheet.seat - 0.035, abs=6e-4)
    mass = frame.mass / 173.0
    stretch = mass * (vehicle.w / 1.37) ** 2
    expected = (11.4 * mass, 25.3 * stretch, 16.9 * stretch)
    assert (frame.Ixx, frame.Iyy, frame.Izz) == pytest.approx(expected, abs=0.06)
    axis = vehicle.w + vehicle.c - bodies["fork_height"] * math.tan(vehicle.lam)
    offset = vehicle.rF * math.sin(vehicle.lam) - vehicle.c * math.cos(vehicle.lam)
    assert vehicle.xH == pytest.approx(axis + 0.5 * offset / math.cos(vehicle.lam), abs=1e-3)
    width = sheet.rear[0] / 190.0
    tyre = width * (vehicle.rR / MACHINES["r1"].rR) ** 2
    assert vehicle.IFyy == pytest.approx(0.48 * (0.75 + 0.25 * sheet.rim), abs=6e-4)
    assert vehicle.IRyy == pytest.approx(0.64 * (0.75 * tyre + 0.25 * sheet.rim), abs=6e-4)
    assert vehicle.mF == pytest.approx(7.0 - 3.0 * (1.0 - sheet.rim), abs=6e-3)
    assert vehicle.mR == pytest.approx(14.7 - 4.5 * (1.0 - sheet.rim), abs=6e-3)
    motor = vehicle.motor
    assert motor.engine_brake == pytest.approx(16.0 * motor.ratios()[2] / vehicle.rR, abs=0.6)
    momentum = 0.010 * (sheet.stroke / 50.9) ** 2 * motor.peak_power_rpm * math.pi / 30.0
    assert abs(motor.crank_momentum) == pytest.approx(momentum, abs=0.06)
    assert vehicle.brakes.force == pytest.approx(1.3 * vehicle.mass * vehicle.g, abs=0.6)


@given(
    power_rpm=st.floats(1.03, 1.6), drop=st.floats(0.0, 0.35), torque_rpm=st.floats(5000.0, 14000.0),
    low=st.floats(0.3, 1.0),
)  # fmt: skip
def test_any_pair_of_peaks_gives_a_smooth_curve_that_never_exceeds_them(
    power_rpm: float, drop: float, torque_rpm: float, low: float
) -> None:
    """Torque never above its peak; power never above the published one, but where the peaks contradict each other."""
    at = torque_rpm * power_rpm
    published = (1.0 - drop) * 110.0 * at * math.pi / 30.0
    motor = replace(
        MACHINES["r1"].motor, peak_torque=110.0, peak_torque_rpm=torque_rpm, peak_power=published, peak_power_rpm=at,
        limiter_rpm=1.08 * at, low_torque=low,
    )  # fmt: skip
    rpm = np.linspace(0.3 * torque_rpm, motor.limiter_rpm, 4001)
    torque = motor.crank_torque(rpm)
    assert torque.max() <= 110.0 * (1.0 + 1e-9)
    assert np.abs(np.diff(torque)).max() < 1.5
    at_power = float(motor.crank_torque(np.array([at]))[0])
    assert at_power * at * math.pi / 30.0 == pytest.approx(published, rel=1e-9)
