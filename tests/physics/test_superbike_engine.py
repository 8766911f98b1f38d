"""The superbike: set and read back, repeat, mirror, balance of forces, riding, and falls by name.

What concerns the engine itself is tested in Bullet; how a machine rides, in the compiled engine, whose rides are those
of Bullet (`test_compiled_superbike.py`).
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.ground import flat_ground
from bike_sim.physics.superbike import forces as sf
from bike_sim.physics.superbike import statics
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.physics.superbike.forces import fall_of
from bike_sim.physics.superbike.modes import measure_modes
from bike_sim.physics.superbike.records import MEMORY, Attitude
from bike_sim.physics.superbike.rider import through_arms
from bike_sim.schema import SIGNALS
from bike_sim.validation.superbike import (
    at_speed,
    check_pitch_limits,
    check_trail_braking,
    constant,
    drive_shake,
    holding,
    measure_shake,
    ride,
    without_electronics,
)  # fmt: skip
from bike_sim.vehicles.files import load_superbike

signal = SIGNALS.index

STEP = 0.002


DUCATI = load_superbike("panigale_v4r")


@pytest.fixture(scope="module")
def bullet() -> Iterator[BulletSuperbikeEngine]:
    engine = BulletSuperbikeEngine(DUCATI, STEP)
    yield engine
    engine.close()


@pytest.fixture(scope="module")
def engine() -> CompiledSuperbikeEngine:
    return CompiledSuperbikeEngine(DUCATI, STEP)


@pytest.fixture(scope="module")
def bare() -> CompiledSuperbikeEngine:
    """No electronics."""
    return CompiledSuperbikeEngine(without_electronics(DUCATI), STEP)


def test_standing_it_carries_its_weight(bullet: BulletSuperbikeEngine) -> None:
    bullet.reset(st.upright_state(0.0, DUCATI.rF))
    loads = bullet.telemetry()[[signal("rear_load"), signal("front_load")]]
    assert loads == pytest.approx(statics.wheel_loads(DUCATI, 0.0, 0.0, 0.0), rel=1e-9)
    bullet.advance(0.0, 0.0, 100)
    assert bullet.telemetry()[[signal("rear_load"), signal("front_load")]] == pytest.approx(loads, rel=1e-3)


def test_without_losses_it_rolls_on_for_ever() -> None:
    """Forces handed to Bullet one step late would show here as drag; at 2 ms the speed must stay to 1e-6."""
    tyre = {"rolling": 0.0}
    free = replace(
        DUCATI,
        air=replace(DUCATI.air, drag_area=0.0, down_area=0.0),
        motor=replace(DUCATI.motor, engine_brake=0.0),
        front_tyre=replace(DUCATI.front_tyre, **tyre),
        rear_tyre=replace(DUCATI.rear_tyre, **tyre),
    )
    engine = BulletSuperbikeEngine(free, STEP)
    engine.reset(st.upright_state(60.0, free.rF))
    engine.advance(0.0, 0.0, 500)
    before = engine.telemetry()[signal("speed")]
    engine.advance(0.0, 0.0, 1000)
    assert engine.telemetry()[signal("speed")] == pytest.approx(before, rel=1e-6)
    engine.close()


def test_coasting_slows_by_drag_rolling_and_engine(engine: CompiledSuperbikeEngine) -> None:
    at_speed(engine, 50.0, settle=0.5)
    coasting = ride(engine, 2.0, constant(DUCATI, 0.0, 0.0))
    measured = (coasting.speed[-1] - coasting.speed[49]) / (coasting.time[-1] - coasting.time[49])
    speed = float(coasting.speed[75])
    force = statics.rolling_drag(DUCATI, speed) + DUCATI.motor.engine_brake
    assert -measured == pytest.approx(force / statics.inertial_mass(DUCATI), rel=0.01)


def test_telemetry_agrees_with_the_motion(engine: CompiledSuperbikeEngine) -> None:
    at_speed(engine, 40.0, 40.0, 3.0)
    turn = ride(engine, 1.0, holding(DUCATI, 40.0, lambda now: 40.0))
    mean = turn.telemetry.mean(axis=0)
    yaw_rate = np.gradient(turn.states[:, st.YAW], turn.time).mean()
    assert mean[signal("yaw_rate")] == pytest.approx(yaw_rate, rel=1e-3)
    assert mean[signal("acceleration_lat")] == pytest.approx(mean[signal("speed")] * yaw_rate, rel=0.02)
    # the vertical balance: weight and the leaning downforce
    down = 0.5 * DUCATI.air.density * DUCATI.air.down_area * 40.0**2 * math.cos(math.radians(40.0))
    assert mean[signal("rear_load")] + mean[signal("front_load")] == pytest.approx(DUCATI.mass * 9.81 + down, rel=2e-3)
    assert mean[signal("rider_slide")] == pytest.approx(
        -DUCATI.rider.slide * 40.0 / DUCATI.rider.slide_lean_deg, rel=0.05
    )


def test_steering_to_the_left_leans_and_turns_to_the_left(engine: CompiledSuperbikeEngine) -> None:
    at_speed(engine, 30.0)
    ride(engine, 3.0, lambda now, _: (0.5, 0.1))
    state = engine.state()
    assert math.degrees(state[st.ROLL]) == pytest.approx(-0.5 * DUCATI.virtual_rider.max_lean_deg, abs=1.0)
    assert state[st.YAW] > 0.3
    assert state[st.Y] > 1.0


def test_it_begins_by_countersteering(engine: CompiledSuperbikeEngine) -> None:
    at_speed(engine, 40.0)
    first = ride(engine, 0.1, lambda now, _: (-0.5, 0.1))  # to the right
    assert first.telemetry[-1, signal("steer_torque")] > 10.0  # pushes the bars to the left
    assert engine.state()[st.ROLL] > 0.0


@pytest.mark.parametrize(
    ("name", "speed"),
    [("panigale_v4r", 12.0), ("zx10rr", 40.0), ("cbr1000rr_r", 75.0), ("r1", 12.0), ("m1000rr", 40.0), ("r1", 75.0)],
)
def test_lean_step_to_50_deg_and_the_formula(name: str, speed: float) -> None:
    vehicle = load_superbike(name)
    engine = CompiledSuperbikeEngine(vehicle, STEP)
    at_speed(engine, speed)
    step = ride(engine, 5.0, holding(vehicle, speed, lambda now: 50.0))
    engine.close()
    assert step.fall == "none"
    assert step.lean_error < 3.0
    tail = slice(-50, None)
    expected = statics.steady_lateral(vehicle, float(step.lean[tail].mean()), float(step.speed[tail].mean()))
    assert -step.telemetry[tail, signal("acceleration_lat")].mean() == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("check", [check_pitch_limits, check_trail_braking])
def test_checks_of_the_validation_hold(check) -> None:
    assert [c.title for c in check((DUCATI,), STEP) if not c.passed] == []


@pytest.mark.parametrize("speed", [20.0, 60.0])
def test_hands_on_the_bars_keep_weave_and_wobble_damped(speed: float) -> None:
    off, on = (measure_modes(DUCATI, speed, hands=hands) for hands in (False, True))
    assert on.weave.real < -1.0
    assert on.wobble.real < -5.0
    # what he answers through his arms moves the modes of the machine, but is none of them
    assert on.weave.imag == pytest.approx(off.weave.imag, abs=2.0 * math.pi * 1.5)
    assert on.weave.imag > 2.0 * math.pi * 2.0
    assert abs(on.weave - off.weave) > 0.1


def test_what_the_rider_wants_passes_his_arms_as_through_a_system_of_3_hz() -> None:
    rider, step = DUCATI.virtual_rider, 0.002
    reach = rider.arm_frequency * step
    left = math.exp(-reach)
    for hertz in (1.0, 3.0, 8.0):
        w, first, second, swings = 2.0 * math.pi * hertz, 0.0, 0.0, []
        for k in range(1500):
            first, second = through_arms(first, second, math.sin(w * k * step), reach, left)
            swings.append(second)
        passed = 1.0 / (1.0 + (w / rider.arm_frequency) ** 2)
        assert max(swings[750:]) == pytest.approx(passed, rel=0.02)


@pytest.mark.parametrize("name", ["panigale_v4r", "r1"])
def test_it_shakes_neither_on_the_brake_in_a_lean_nor_at_full_drive(name: str) -> None:
    """Under trail braking it did, with 0.2 g, before the rider had arms and camber thrust had no trail."""
    machine = load_superbike(name)
    shakes = measure_shake(machine, STEP, speeds=(15.0, 30.0, 60.0), leans=(45.0, 55.0), brakes=(0.0, 0.4, 1.0))
    assert max(shakes.values()) < 0.05
    assert drive_shake(machine, STEP, 45.0, 15.0, 0.0) < 0.05


# --- falls ---


def test_too_much_throttle_in_a_turn_throws_off_and_the_electronics_save(
    bare: CompiledSuperbikeEngine, engine: CompiledSuperbikeEngine
) -> None:
    falls = []
    for ridden in (bare, engine):
        at_speed(ridden, 30.0, 45.0, 2.5)
        falls.append(ride(ridden, 2.5, constant(DUCATI, 45.0, 1.0)).fall)
    assert falls[0] in ("low_side", "high_side")
    assert falls[1] == "none"


def test_grass_does_not_hold_what_the_track_does(engine: CompiledSuperbikeEngine) -> None:
    at_speed(engine, 30.0, 45.0, 2.5)
    grass = flat_ground(0.5, 0.5)
    assert ride(engine, 2.0, constant(DUCATI, 45.0, 0.1), grass).fall == "low_side"
    at_speed(engine, 30.0)
    assert ride(engine, 2.0, constant(DUCATI, 10.0, 0.1), grass).fall == "none"


def test_standing_still_it_tips_over_and_stays_down(engine: CompiledSuperbikeEngine) -> None:
    start = st.upright_state(0.0, DUCATI.rF)
    start[st.ROLL] = 0.1
    engine.reset(start)
    assert ride(engine, 3.0, constant(DUCATI, 0.0, 0.0)).fall == "tip_over"
    down = engine.state()
    engine.advance(0.0, 1.0, 200)
    assert (engine.state() == down).all()
    engine.reset(st.upright_state(20.0, DUCATI.rF))
    assert engine.fall == "none"


def name_of(
    memory: dict[str, float],
    roll: float = 0.0,
    roll_rate: float = 0.0,
    nose_up: float = 0.0,
    rear: float = 1000.0,
    front: float = 1000.0,
    sliding: bool = False,
    sideways: bool = False,
) -> str:
    record = np.zeros(1, dtype=MEMORY)
    record["slide_age"] = 1e3
    for key, value in memory.items():
        record[key] = value
    attitude = Attitude(roll, roll_rate, roll, 1.0, 0.0, 9.0 if sideways else 20.0, 400.0)
    slip = 1.2 if sliding else 1.0
    return sf.FALL_NAMES[fall_of(attitude, nose_up, slip, rear, front, 0.002, math.radians(75.0), record[0])]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rules_that_name_falls(side: float) -> None:
    flat, slid = side * 1.35, {"slide_side": side, "slide_age": 0.3}
    long_ago = {"slide_side": side, "slide_age": 5.0}
    assert name_of({}, roll=0.9 * side, sliding=True) == "none"
    assert name_of({}, roll=flat) == "tip_over"
    assert name_of(long_ago, roll=flat) == "tip_over"
    assert name_of(slid, roll=flat) == "low_side"
    assert name_of({}, roll=flat, sliding=True) == "low_side"
    assert name_of(slid, roll=-flat) == "high_side"
    assert name_of(slid, roll=0.2 * side, roll_rate=-8.0 * side) == "high_side"
    assert name_of(long_ago, roll=0.2 * side, roll_rate=-8.0 * side) == "none"
    assert name_of(slid, roll=0.2 * side, roll_rate=8.0 * side) == "none"
    assert name_of({}, roll=0.5 * side, sideways=True) == "low_side"


def test_rules_that_name_falls_over_a_wheel() -> None:
    over = math.sin(math.radians(60.0))
    assert name_of({}, nose_up=-over, rear=0.0) == "stoppie"
    assert name_of({}, nose_up=over, front=0.0) == "wheelie"
    assert name_of({}, nose_up=0.5 * over, front=0.0) == "none"
