"""The motorcycle tyre: numbers by hand, symmetry, the friction ellipse, relaxation."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from bike_sim.physics.superbike import tyres
from bike_sim.physics.superbike.contact import lowest_point
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import TYRE, Tyre

VEHICLE = load_superbike("panigale_v4r")
# Round numbers, so that the arithmetic below can be checked on paper
PLAIN = Tyre(
    crown=0.06, stiffness=100_000.0, damping=1000.0, nominal_load=2000.0, cornering=14.0, cornering_slope=9.0,
    camber=0.8, friction=1.5, friction_ratio=0.8, camber_fade=0.1, shape=1.5, slip_stiffness=20.0, relaxation=0.2,
    slip_relaxation=0.1, trail=0.03, twist=0.04, rolling=0.01,
)  # fmt: skip


def row(tyre: Tyre) -> np.void:
    record = np.zeros(1, dtype=TYRE)[0]
    for name in TYRE.names[:-1]:
        record[name] = getattr(tyre, name)
    return record


PLAIN_ROW = row(PLAIN)
slips = some.floats(-3.0, 3.0)
cambers = some.floats(-1.2, 1.2)
loads = some.floats(1.0, 6000.0)


def test_side_slip_by_hand() -> None:
    # k = 14 at the nominal load; s = 14 * 0.05 / 1.5 = 0.46667; F = 1.5 * 2000 * sin(1.5 * atan(0.46667 / 1.5))
    # atan(0.311111) = 0.301615; sin(0.452422) = 0.437144; F = 1311.43 N to the right of a drift to the left
    fx, fy, _, s = tyres.forces(0.0, 0.05, 0.0, 2000.0, 1.0, PLAIN_ROW)
    assert s == pytest.approx(0.466667, abs=1e-6)
    assert fy == pytest.approx(-1311.43, abs=0.05)
    assert fx == 0.0


def test_drive_by_hand() -> None:
    # mu_x = 1.5 * 0.8 = 1.2; s = 20 * 0.06 / 1.2 = 1; F = 1.2 * 2000 * sin(1.5 * atan(1 / 1.5)) = 2400 * sin(0.882004)
    fx, fy, mz, s = tyres.forces(0.06, 0.0, 0.0, 2000.0, 1.0, PLAIN_ROW)
    assert s == pytest.approx(1.0)
    assert fx == pytest.approx(2400.0 * math.sin(0.882004), abs=0.01)
    assert fy == mz == 0.0


def test_camber_thrust_pushes_into_the_lean() -> None:
    # small camber: Fy = -0.8 * 0.02 * 2000 = -32 N (to the right when leaning right), the curve bends by 0.01 %
    _, fy, _, _ = tyres.forces(0.0, 0.0, 0.02, 2000.0, 1.0, PLAIN_ROW)
    assert fy == pytest.approx(-32.0, rel=2e-3)


def test_moments_by_hand() -> None:
    # side slip alone: s = 0.466667, F = -1311.43 N (above); peak at 1.5 tan(60 deg) = 2.598076, so 0.820380 adheres
    # Mz = 0.03 * 0.820380 * 1311.43 = 32.276 N m towards where the tyre goes, to the left
    _, _, aligning, _ = tyres.forces(0.0, 0.05, 0.0, 2000.0, 1.0, PLAIN_ROW)
    assert aligning == pytest.approx(32.276, abs=0.01)
    # lean alone, 0.2 rad: mu = 1.5 / 1.004, s = 0.16 / mu = 0.107093, so 0.958780 adheres
    # Mz = -0.958780 * 2000 * 0.04 * atan(0.3) / 1.5 = -14.903 N m, into the lean; camber thrust has no trail
    _, _, twisting, _ = tyres.forces(0.0, 0.0, 0.2, 2000.0, 1.0, PLAIN_ROW)
    assert twisting == pytest.approx(-14.903, abs=0.01)


@given(cambers, loads)
def test_camber_twists_a_tyre_into_its_lean(camber: float, load: float) -> None:
    _, _, moment, _ = tyres.forces(0.0, 0.0, camber, load, 1.0, PLAIN_ROW)
    assert moment * camber <= 0.0
    assert abs(moment) <= PLAIN.twist * load * abs(camber) + 1e-9


@given(some.floats(0.4, 3.0), cambers, loads)
def test_a_sliding_tyre_has_no_moment(drift: float, camber: float, load: float) -> None:
    _, _, moment, s = tyres.forces(0.0, math.copysign(drift, camber), camber, load, 1.0, PLAIN_ROW)
    assert moment == 0.0 or s < tyres.peak_slip(PLAIN_ROW)


def test_cornering_coefficient_falls_with_load() -> None:
    assert tyres.cornering_coefficient(2000.0, PLAIN_ROW) == 14.0
    assert tyres.cornering_coefficient(3000.0, PLAIN_ROW) == pytest.approx(14.0 - 5.0 * 0.5)
    assert tyres.cornering_coefficient(1e6, PLAIN_ROW) == pytest.approx(0.3 * 14.0)


def test_peak_is_where_and_as_high_as_it_says() -> None:
    at = tyres.peak_slip(PLAIN_ROW)
    assert at == pytest.approx(1.5 * math.tan(math.pi / 3.0))
    drifts = np.linspace(0.0, 1.0, 20001)
    found = np.array([tyres.forces(0.0, d, 0.0, 2000.0, 1.0, PLAIN_ROW)[1::2] for d in drifts])
    best = int(np.argmin(found[:, 0]))
    assert found[best, 1] == pytest.approx(at, rel=1e-3)
    assert found[best, 0] == pytest.approx(-1.5 * 2000.0, rel=1e-8)


@given(slips, slips, cambers, loads)
def test_mirror(slip: float, drift: float, camber: float, load: float) -> None:
    fx, fy, mz, s = tyres.forces(slip, drift, camber, load, 1.0, PLAIN_ROW)
    assert tyres.forces(slip, -drift, -camber, load, 1.0, PLAIN_ROW) == (fx, -fy, -mz, s)


@given(slips, slips, cambers, loads, some.floats(0.1, 1.0))
def test_friction_ellipse_is_never_left(slip: float, drift: float, camber: float, load: float, grip: float) -> None:
    for tyre in (PLAIN_ROW, VEHICLE.machine["rear_tyre"], VEHICLE.machine["front_tyre"]):
        fx, fy, _, _ = tyres.forces(slip, drift, camber, load, grip, tyre)
        mu = tyres.friction(camber, load, tyre) * grip * load
        assert math.hypot(fx / (mu * tyre["friction_ratio"]), fy / mu) <= 1.0 + 1e-12


@given(cambers, loads, loads)
def test_friction_falls_with_load_where_the_file_says_so(camber: float, one: float, other: float) -> None:
    """By the slope at the nominal load; without one it is the same at every load."""
    falling = row(replace(PLAIN, friction_slope=0.1))
    low, high = sorted((one, other))
    assert tyres.friction(camber, low, falling) >= tyres.friction(camber, high, falling)
    assert tyres.friction(camber, 2000.0, falling) == tyres.friction(camber, low, PLAIN_ROW)
    assert tyres.friction(0.0, 2200.0, falling) == pytest.approx(1.5 * math.exp(-0.01))


@given(slips, slips, cambers)
def test_no_load_no_force(slip: float, drift: float, camber: float) -> None:
    assert tyres.forces(slip, drift, camber, 0.0, 1.0, PLAIN_ROW) == (0.0, 0.0, 0.0, 0.0)


@given(slips, some.floats(-0.5, 0.5), some.floats(-0.2, 0.2), some.floats(100.0, 4000.0))
def test_side_force_resists_side_slip_upright(slip: float, drift: float, camber: float, load: float) -> None:
    fx, fy, mz, _ = tyres.forces(slip, drift, 0.0, load, 1.0, PLAIN_ROW)
    assert fx * slip >= 0.0
    assert fy * drift <= 0.0
    assert mz * drift >= 0.0  # the trail turns the wheel towards where it goes


@given(some.floats(-1.0, 1.0), some.floats(-5.0, 5.0), some.floats(0.0, 90.0), some.floats(0.05, 0.5))
def test_relaxation_is_exact_for_any_step(value: float, slip_velocity: float, speed: float, length: float) -> None:
    """Two halves of a step make the same as the whole, however coarse, and all as the closed solution."""
    step = 0.05
    whole = tyres.relax(value, slip_velocity, speed, length, step)
    half = tyres.relax(value, slip_velocity, speed, length, 0.5 * step)
    assert tyres.relax(half, slip_velocity, speed, length, 0.5 * step) == pytest.approx(whole, rel=1e-9, abs=1e-9)
    if speed > 0.1:
        steady = slip_velocity / speed
        assert whole == pytest.approx(steady + (value - steady) * math.exp(-speed * step / length), rel=1e-9, abs=1e-9)


def test_relaxation_at_standstill_is_a_spring() -> None:
    assert tyres.relax(0.1, 0.4, 0.0, 0.2, 0.01) == pytest.approx(0.1 + 0.4 * 0.01 / 0.2)


@given(some.floats(-1.2, 1.2), some.floats(0.0, 1.0))
def test_lowest_point_of_a_torus_against_search(camber: float, height: float) -> None:
    """The closed lowest point is the lowest of a sampled torus."""
    radius, crown = 0.3, 0.06
    around, across = np.meshgrid(np.linspace(0, 2 * np.pi, 721), np.linspace(0, 2 * np.pi, 361))
    outward = (radius - crown) + crown * np.cos(across)
    in_plane, along_axle = -outward * np.cos(around), crown * np.sin(across)  # axle along y, turned about x
    z = height + in_plane * math.cos(camber) + along_axle * math.sin(camber)
    axle = (0.0, math.cos(camber), math.sin(camber))
    point = lowest_point((0.0, 0.0, height), axle, radius, crown, (0.0, 0.0, 1.0))
    assert point[2] == pytest.approx(z.min(), abs=2e-5)


def test_normal_load_pushes_only() -> None:
    assert tyres.normal_load(0.001, -5.0, PLAIN_ROW) == 0.0
    assert tyres.normal_load(-0.01, 0.0, PLAIN_ROW) == pytest.approx(1000.0)
    assert tyres.normal_load(-0.01, -0.1, PLAIN_ROW) == pytest.approx(1100.0)
    assert tyres.normal_load(-0.01, 2.0, PLAIN_ROW) == 0.0


def test_a_flatter_curve_keeps_its_slope() -> None:
    sharp = row(replace(PLAIN, shape=1.8))
    slopes = [tyres.forces(0.0, 1e-6, 0.0, 2000.0, 1.0, tyre)[1] for tyre in (PLAIN_ROW, sharp)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-6)
    assert slopes[0] == pytest.approx(-14.0 * 2000.0 * 1e-6, rel=1e-6)
