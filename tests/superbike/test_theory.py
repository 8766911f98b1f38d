"""The theoretical lap of a machine: its equilibrium, the path of its mass, and that it is a lower bound of rides."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS
from bike_policy.riders.classical import ClassicalRider
from bike_sim.course.files import load_track
from bike_sim.physics import state as start
from bike_sim.physics.superbike import equilibrium as eq
from bike_sim.physics.superbike import statics
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.planning.envelope import envelope
from bike_sim.planning.lap_limit import MassPath, corner_speed_of, lap_limit, least_rate, mass_path
from bike_sim.planning.passing import ROLL_FREEDOM, passings, speeds_of_own_path
from bike_sim.schema import SIGNALS
from bike_sim.validation.superbike import at_speed, holding, ride
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike
from bike_training.rollout.laps import ride_laps
from tests.circuits import wavy

signal = SIGNALS.index

NAMES = ("panigale_v4r", "zx10rr", "cbr1000rr_r", "r1", "m1000rr")


DUCATI = load_superbike("panigale_v4r")
LIMITS = envelope(DUCATI)


def turn_of(machine: Superbike, lean: float, speed: float) -> eq.Turn:
    lateral = statics.steady_lateral(machine, lean, speed)
    return eq.Turn(speed, lean, lateral, machine.g, statics.inertial_mass(machine))


# ------------------------------------------------------------------------------------------------------- equilibrium


@pytest.mark.parametrize(("speed", "lean"), [(20.0, 30.0), (40.0, 50.0), (40.0, 55.0)])
def test_wheels_in_a_turn_are_those_of_the_simulation(speed: float, lean: float) -> None:
    engine = CompiledSuperbikeEngine(DUCATI, 0.002)
    at_speed(engine, speed)
    recorded = ride(engine, 6.0, holding(DUCATI, speed, lambda now: lean))
    engine.close()
    tail = recorded.time > 5.0
    told = recorded.telemetry[tail].mean(axis=0)
    turn = turn_of(DUCATI, float(abs(recorded.lean[tail].mean())), float(told[signal("speed")]))
    rear, front = (DUCATI.machine[name] for name in ("rear_tyre", "front_tyre"))
    wheels = eq.wheels(turn, float(told[signal("rear_force_long")]), DUCATI.machine)
    assert wheels.rear == pytest.approx(told[signal("rear_load")], rel=0.02)
    assert wheels.front == pytest.approx(told[signal("front_load")], rel=0.02)
    assert wheels.rear_side == pytest.approx(abs(told[signal("rear_force_lat")]), rel=0.05)
    assert wheels.front_side == pytest.approx(abs(told[signal("front_force_lat")]), rel=0.05)
    drifts = (
        eq.tan_slip_angle_of(wheels.rear, wheels.rear_side, float(told[signal("rear_force_long")]), turn.lean, rear),
        eq.tan_slip_angle_of(wheels.front, wheels.front_side, 0.0, turn.lean, front),
    )
    assert drifts == pytest.approx(
        (abs(told[signal("rear_slip_angle")]), abs(told[signal("front_slip_angle")])), rel=0.12, abs=2e-3
    )


def test_braking_burdens_the_front_tyre_and_driving_relieves_it() -> None:
    turn = turn_of(DUCATI, math.radians(45.0), 30.0)
    braked, coasting, driven = (eq.wheels(turn, f, DUCATI.machine) for f in (-1000.0, 0.0, 1000.0))
    assert braked.front_side > coasting.front_side > driven.front_side
    assert braked.rear_side < coasting.rear_side < driven.rear_side
    assert braked.front > coasting.front > driven.front
    for wheels in (braked, coasting, driven):
        total = wheels.rear_side + wheels.front_side
        assert total == pytest.approx(coasting.rear_side + coasting.front_side, rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_envelope_shrinks_where_it_must(name: str) -> None:
    limits = envelope(load_superbike(name))
    for speed in (15.0, 30.0, 60.0):
        lateral = np.linspace(0.3, 1.0, 30) * float(limits.lateral(speed))
        assert np.all(np.diff(limits.drive(speed, lateral)) < 0.02)
        assert np.all(limits.drive(speed, lateral, roll_rate=0.5) <= limits.drive(speed, lateral) + 1e-9)
        # Full friction is no steady turn: drift costs more than what the tyre has left to drive with.
        assert limits.drive(speed, lateral[-1]) < 0.0
        assert limits.lateral(speed, 0.8) < limits.lateral(speed) < limits.lateral(speed, 1.2)
        assert limits.brake(speed, 5.0, 0.8) < limits.brake(speed, 5.0, 1.2)
    dry = load_superbike(name)
    rear, front = (replace(tyre, friction=0.5 * tyre.friction) for tyre in (dry.rear_tyre, dry.front_tyre))
    wet = envelope(replace(dry, rear_tyre=rear, front_tyre=front))
    assert np.all(wet.lateral_max < 0.6 * limits.lateral_max)


def heavier(machine: Superbike, factor: float) -> Superbike:
    """Return a machine with all masses and inertias times a factor: centre of mass and weight distribution stay."""
    bodies = [f"m{body}" for body in "RBHF"] + [f"I{body}{axes}" for body in "RBHF" for axes in ("xx", "yy")]
    bodies += [f"I{body}{axes}" for body in "BH" for axes in ("zz", "xz")]
    parts = {
        name: replace(part, **{key: factor * getattr(part, key) for key in ("mass", "Ixx", "Iyy", "Izz", "Ixz")})
        for name, part in (("frame", machine.frame), ("rider", machine.rider))
    }
    return replace(machine, **parts, **{name: factor * getattr(machine, name) for name in bodies})


def test_a_heavier_machine_is_slower(circuit: Path) -> None:
    """Ten kilograms more cost time, where friction falls with load and the electronics' loads grow with the mass.

    So it is with the suspended machines as they are shipped.
    """
    tyres = {name: replace(getattr(DUCATI, name), friction_slope=0.2) for name in ("front_tyre", "rear_tyre")}
    aids = replace(DUCATI.electronics, reference_mass=DUCATI.mass)
    changed = replace(DUCATI, **tyres, electronics=aids)
    for machine, name in ((changed, circuit), (load_superbike("panigale_v4r_suspended"), "cremona")):
        line = load_track(name).centre
        light, heavy = (
            lap_limit(envelope(each), line).lap_time for each in (machine, heavier(machine, 1.0 + 10.0 / machine.mass))
        )
        assert 3e-4 * light < heavy - light < 0.01 * light


@pytest.mark.parametrize("name", ["panigale_v4r", "r1"])
def test_shifts_cost_speed_in_the_quarter_mile_and_in_the_envelope(name: str) -> None:
    """Both engine and envelope lose 1 to 4 km/h in 5 s by shifts of 50 ms."""
    rigid = load_superbike(name)
    shifting = replace(rigid, motor=replace(rigid.motor, shift_time=0.05))
    trapped = []
    for machine in (rigid, shifting):
        engine = CompiledSuperbikeEngine(machine, 0.002)
        engine.reset(start.upright_state(20.0, machine.rF))
        engine.advance(0.0, 1.0, 2500)
        assert engine.fall == "none"
        trapped.append(float(engine.telemetry()[signal("speed")]))
    measured = trapped[0] - trapped[1]
    speeds = np.linspace(20.0, 90.0, 800)
    reached = []
    for machine in (rigid, shifting):
        time = np.concatenate(([0.0], np.cumsum(np.diff(speeds) / envelope(machine).drive(speeds)[1:])))
        reached.append(float(np.interp(5.0, time, speeds)))
    assert 0.2 < measured < 2.0
    assert reached[0] - reached[1] == pytest.approx(measured, abs=0.3)


@given(st.floats(1e-4, 0.08), st.floats(-0.01, 0.008))
def test_a_curve_over_a_crest_takes_all_that_there_is(bend: float, dip: float) -> None:
    """The speed fits the load that it has itself; over a crest, taking one from the other swings for ever."""
    speed = corner_speed_of(LIMITS.limits, bend, dip, 0.0)
    held = float(LIMITS.lateral(speed, 1.0 + dip * speed**2 / 9.81))
    if speed < LIMITS.speeds[-1]:
        assert held == pytest.approx(speed**2 * bend, abs=1e-5)
    else:
        assert held >= speed**2 * bend


def test_a_sustained_turn_is_what_the_simulation_holds() -> None:
    # 57 deg are held at 40 m/s in simulation, 58 deg are not (docs/explanation/superbike.md).
    lateral = np.linspace(0.7, 1.0, 200) * float(LIMITS.lateral(40.0))
    most = lateral[np.flatnonzero(LIMITS.drive(40.0, lateral) >= 0.0)[-1]]
    assert statics.steady_lateral(DUCATI, math.radians(55.5), 40.0) < most
    assert most < statics.steady_lateral(DUCATI, math.radians(58.5), 40.0)


# --------------------------------------------------------------------------------------------------- path of the mass


def follow(bend: np.ndarray, speed: float, step: float, rounds: int = 8) -> MassPath:
    count = len(bend)
    flat = np.zeros(count)
    path = MassPath(bend, np.full(count, step), np.ones(count), flat, flat, flat)
    for _ in range(rounds):
        path = mass_path(LIMITS, bend, np.full(count, speed), step, flat, flat, path)
    return path


@given(st.floats(60.0, 400.0), st.floats(0.2, 0.95), st.sampled_from((-1.0, 1.0)))
def test_on_a_circle_the_mass_leans_as_in_a_steady_turn(radius: float, share: float, side: float) -> None:
    speed = math.sqrt(share * 14.0 * radius)
    path = follow(np.full(64, side / radius), speed, 1.0)
    lean = abs(float(path.lean[0]))
    assert statics.steady_lateral(DUCATI, lean, speed) == pytest.approx(speed**2 / radius, rel=0.01)
    inside, _ = eq.turning_place(lean, DUCATI.machine)
    assert np.sign(path.lean) == pytest.approx(side)
    assert path.distance == pytest.approx(1.0 - inside / radius, rel=1e-4)
    # The same lateral acceleration on a shorter radius: (v s)^2 / (s R) with the stretch s.
    assert abs(path.bend[0]) * (speed * path.stretch[0]) ** 2 == pytest.approx(speed**2 / radius, rel=0.01)


def test_what_a_line_asks_for_a_moment_hardly_moves_the_mass() -> None:
    # Small waves: lean = a / g / (1 + w^2 L / g), the pendulum's answer, here with the machine's slope A'(0).
    speed, step, count, amplitude = 40.0, 1.0, 400, 0.5
    slope = statics.steady_lateral(DUCATI, 0.02, speed) / 0.02
    for waves in (2, 10, 40):
        s = np.arange(count) * step
        frequency = 2.0 * math.pi * waves * speed / (count * step)
        bend = amplitude / speed**2 * np.cos(frequency * s / speed)
        path = follow(bend, speed, step)
        expected = amplitude / (slope + frequency**2 * LIMITS.sway)
        assert np.abs(path.lean).max() == pytest.approx(expected, rel=0.05)


@given(st.floats(-0.008, 0.008))
def test_on_a_crest_it_leans_more_for_the_same_curve(dip: float) -> None:
    speed, radius, count = 20.0, 60.0, 64
    flat, bend = np.zeros(count), np.full(count, 1.0 / radius)
    path = MassPath(bend, np.ones(count), np.ones(count), flat, flat, flat)
    for _ in range(8):
        path = mass_path(LIMITS, bend, np.full(count, speed), 1.0, flat, np.full(count, dip), path)
    load = 1.0 + dip * speed**2 / 9.81
    lateral = load * statics.steady_lateral(DUCATI, float(path.lean[0]), speed)
    assert lateral == pytest.approx(speed**2 / radius, rel=0.01)


def test_refinement_converges_and_mirrors() -> None:
    line = wavy()
    mirrored = replace(line, y=-line.y, heading=-line.heading, curvature=-line.curvature)
    laps = [lap_limit(LIMITS, line, step).lap_time for step in (2.0, 1.0, 0.5)]
    assert laps[1] == pytest.approx(laps[2], rel=1e-3)
    assert lap_limit(LIMITS, mirrored).lap_time == pytest.approx(laps[1], rel=1e-6)


def test_every_effect_costs_what_it_should() -> None:
    line = wavy()
    full = lap_limit(LIMITS, line).lap_time
    count = LIMITS.drive_table.shape[3]
    no_rolling = replace(LIMITS, drive_table=np.repeat(LIMITS.drive_table[..., :1], count, axis=3))
    any_lean_rate = replace(LIMITS, lean_rate=np.full_like(LIMITS.lean_rate, 1e3))
    mass_on_the_line = replace(LIMITS, inside=0.0 * LIMITS.inside, height=0.0 * LIMITS.height, sway=0.0)
    assert lap_limit(no_rolling, line).lap_time < full - 0.05
    assert lap_limit(any_lean_rate, line).lap_time <= full + 1e-3
    assert lap_limit(mass_on_the_line, line).lap_time != pytest.approx(full, abs=0.05)


def test_lean_rates_stay_within_the_rider() -> None:
    lap = lap_limit(LIMITS, wavy())
    most = np.interp(lap.speed, LIMITS.speeds, LIMITS.lean_rate)
    assert np.mean(np.abs(lap.roll_rate) > 1.05 * most) < 0.02


@given(st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(5.0, 90.0)), min_size=3, max_size=60), st.floats(0.0, 1.0))
def test_the_least_rate_is_that_of_the_points_that_are_near_in_time(
    points: list[tuple[float, float]], freedom: float
) -> None:
    rate, speed = np.array(points).T
    n, step = len(rate), 2.0
    found = least_rate(rate, speed, step, freedom)
    for i in range(n):
        near = {i}
        for way in (-1, 1):
            left, j = freedom, i
            while (left := left - step / speed[j]) >= 0.0 and len(near) < n:
                j = (j + way) % n
                near.add(j)
        assert found[i] == min(abs(rate[j]) for j in near)


def test_who_may_roll_sooner_or_later_is_no_slower() -> None:
    line = wavy()
    bound, freer, freest = (lap_limit(LIMITS, line, roll_freedom=freedom).lap_time for freedom in (0.0, 0.1, 0.2))
    assert freest < freer < bound
    assert freest > 0.99 * bound


# -------------------------------------------------------------------------------------------------------- lower bound


def test_passings_tell_gains_that_are_lost_again_from_those_that_are_not() -> None:
    theoretical = np.full(999, 30.0)
    progress = np.arange(0.0, 999.0)
    fast = np.where((progress > 300.0) & (progress < 320.0), 31.0, 30.0)
    (kept,) = passings(theoretical, progress, fast)
    assert not kept.repaid
    assert (kept.begin, kept.end) == pytest.approx((301.0, 319.0))
    assert kept.excess == pytest.approx(1.0 / 30.0)
    assert kept.gained == pytest.approx(20.0 * (1.0 / 30.0 - 1.0 / 31.0), rel=0.1)
    slow = np.where((progress > 340.0) & (progress < 380.0), 29.0, fast)
    (lost,) = passings(theoretical, progress, slow)
    assert lost.repaid
    assert passings(theoretical, progress, np.full(999, 30.2)) == ()


def test_the_theory_of_a_ridden_path_is_that_of_the_line_it_was() -> None:
    track = load_track("barcelona")
    s = track.centre.s
    track = track.with_ideal(2.0 * np.sin(2.0 * np.pi * 9.0 * s / track.length))
    line = track.line(1.0)
    limit = lap_limit(LIMITS, line, roll_freedom=ROLL_FREEDOM)
    progress = np.arange(0.7, track.length, 1.3)
    offset = track.at(track.ideal, progress)
    found, later = (speeds_of_own_path(track, LIMITS, progress + laps * track.length, offset) for laps in (0, 3))
    assert later == pytest.approx(found, rel=1e-6)
    # by the points themselves: the nearest sample of the line to each point of the path
    nearest = cKDTree(np.column_stack([line.x, line.y])).query(track.points(progress, offset)[:, :2])[1]
    assert found == pytest.approx(limit.speed_at(line.s[nearest]), rel=2e-3)


def test_a_path_that_does_not_close_is_led_to_its_beginning() -> None:
    track = load_track("barcelona")
    progress = np.arange(0.7, track.length, 1.3)
    drifting = speeds_of_own_path(track, LIMITS, progress, 0.4 * progress / track.length)
    closed = speeds_of_own_path(track, LIMITS, progress, np.zeros(len(progress)))
    assert drifting == pytest.approx(closed, rel=0.01)


def check_bound(name: str, course: str | Path, lateral: float) -> None:
    ride, passings = ride_laps(
        name, course, 1, rider=ClassicalRider(replace(CLASSICAL_SETTINGS, lateral=lateral)), engine="compiled"
    )
    if ride["laps"]:
        assert min(ride["excess"], ride["closest_excess"]) > -0.001
    assert all(passing.repaid for passing in passings)


def test_no_ride_is_under_the_theoretical_lap(circuit: Path) -> None:
    check_bound("panigale_v4r", circuit, 0.9)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(300, 320))
def test_no_ride_on_more_circuits_is_under_the_theoretical_lap(seed: int) -> None:
    check_bound(NAMES[seed % 5], f"random_circuit:{seed}", (0.86, 0.89, 0.92)[seed % 3])
