"""The classical rider: what it plans, what it answers, and that it laps."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, plan_lap, reserved
from bike_policy.planning.line_law import MISSING, P_SPEED
from bike_sim.physics import state as st
from bike_sim.physics.state import upright_state
from bike_sim.physics.superbike.engine import TIME_STEP, CompiledSuperbikeEngine
from bike_sim.physics.superbike.statics import turning_state
from bike_sim.planning.envelope import Envelope, envelope
from bike_sim.planning.lap_limit import lap_limit
from bike_sim.planning.line_cache import track_with_line
from bike_sim.schema import SIGNALS
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike
from bike_training import cli
from bike_training.rollout.laps import ALLOWED_EXCESS, ride_laps
from tests.circuits import OVAL, LineController, circle

signal = SIGNALS.index


@pytest.fixture(scope="module")
def limits(panigale: Superbike) -> Envelope:
    return envelope(panigale)


def test_plan_keeps_its_reserve(panigale: Superbike, limits: Envelope) -> None:
    for radius in (25.0, 80.0):
        line = circle(radius)
        plan, limit = LineController(panigale, line, 0.02).plan.profile, lap_limit(limits, line)
        # The limit of a circle is what is held at constant speed, 0.9 of what an apex may take for a moment, so a plan
        # with 0.92 of the latter asks for all of it; tables between samples leave 0.03 %.
        assert 0.8 < plan.lateral.max() / limit.lateral.max() < 1.001
        assert np.abs(plan.lean).max() < 1.001 * np.abs(limit.lean).max()
    careful = reserved(panigale, CLASSICAL_SETTINGS)
    assert np.all(careful.brake(careful.speeds) < limits.brake(limits.speeds))
    assert np.all(careful.lateral_max < limits.lateral_max)
    assert np.all(careful.lean_rate < limits.lean_rate)
    # However much the tyres would give, braking leaves room for turning, in a deep lean most of all: there a machine
    # on the brake weaves.
    least = float(limits.brake(30.0))
    for use, room in ((0.5, 0.98), (0.7, 0.98), (0.9, 0.96), (0.97, 0.9)):
        turning = use * float(careful.lateral(30.0))
        assert careful.brake(30.0, turning) < room * limits.brake(30.0, turning)
        assert careful.brake(30.0, turning) < least
        least = float(careful.brake(30.0, turning))


def test_speed_is_that_of_the_contacts(panigale: Superbike) -> None:
    """The frame leans 0.4 m inwards: on a line of 25 m radius 2 % of speed, 4 % of what the tyres have to hold."""
    radius, speed = 25.0, 15.0
    engine = CompiledSuperbikeEngine(panigale, TIME_STEP)
    engine.reset(turning_state(panigale, speed, -math.atan(speed**2 / radius / 9.81), speed / radius))
    told = float(engine.telemetry()[signal("speed")])
    engine.close()
    assert told < 0.99 * speed
    seen = (told, -math.atan(speed**2 / radius / 9.81), 10.0, 0.0, 0.0)
    rider = LineController(panigale, circle(radius), 0.02)
    rider.command(*seen)
    missing = rider.law.memory[0, MISSING]
    assert float(rider.plan.profile.speed_at(10.0)) - missing == pytest.approx(speed, rel=3e-3)


def test_engine_braking_never_locks_the_rear_wheel(panigale: Superbike) -> None:
    engine = CompiledSuperbikeEngine(panigale, 0.002)
    engine.reset(upright_state(60.0, panigale.rF))
    slips = []
    for _ in range(150):
        engine.advance(0.0, -0.8, 10)
        slips.append(engine.telemetry()[signal("rear_slip")])
    assert engine.fall == "none"
    assert engine.telemetry()[signal("speed")] < 30.0
    assert min(slips) > -0.3
    engine.close()


def test_steady_on_the_line_asks_for_the_lean_of_the_turn(panigale: Superbike) -> None:
    rider = LineController(panigale, circle(80.0), 0.02)
    speed = 25.0
    lean = float(np.interp(speed**2 / 80.0, rider.law.leans.row(speed), rider.law.leans.leans))
    table = rider.plan.table.copy()
    table[:, P_SPEED] = speed
    rider.plan = rider.plan._replace(table=table)
    rider.reset()
    steering, _ = rider.command(speed, -lean, 40.0, 0.0, 0.0)
    assert steering == pytest.approx(lean / math.radians(panigale.virtual_rider.max_lean_deg), abs=0.01)


def test_turns_back_to_the_line_and_mirrors(panigale: Superbike) -> None:
    line = circle(5000.0)
    rider = LineController(panigale, line, 0.02)
    speed = 40.0

    def steering(error: float, heading: float) -> float:
        rider.reset()
        return rider.command(speed, 0.0, 100.0, error, heading)[0]

    middle = steering(0.0, 0.0)
    assert steering(1.0, 0.0) < middle < steering(-1.0, 0.0)
    assert steering(0.0, 0.05) < middle < steering(0.0, -0.05)
    left, right = steering(1.0, 0.0) - middle, steering(-1.0, 0.0) - middle
    assert left == pytest.approx(-right, rel=0.1)


def test_brakes_when_too_fast_and_drives_when_too_slow(panigale: Superbike) -> None:
    rider = LineController(panigale, circle(80.0), 0.02)
    wanted = float(rider.plan.profile.speed_at(10.0))
    _, brake = rider.command(wanted + 8.0, -0.5, 10.0, 0.0, 0.0)
    _, drive = rider.command(wanted - 8.0, -0.5, 10.0, 0.0, 0.0)
    assert brake < -0.2
    assert drive > 0.3


def test_same_state_again_gets_the_same_answer(panigale: Superbike) -> None:
    rider = LineController(panigale, circle(80.0), 0.02)
    rider.command(25.0, -0.6, 40.0, 0.3, 0.01)
    seen = (25.0, -0.6, 40.5, 0.32, 0.01)
    assert rider.command(*seen) == rider.command(*seen)


def test_lost_states_do_not_steepen_the_rate_of_the_error(panigale: Superbike) -> None:
    rider = LineController(panigale, circle(80.0), 0.01)

    def last_answer(every: int) -> float:
        rider.reset()
        answers = [rider.command(25.0, -0.6, 40.0 + 0.25 * k, 0.005 * k, 0.0)[0] for k in range(0, 13, every)]
        return answers[-1]

    assert last_answer(2) == pytest.approx(last_answer(1), abs=1e-9)


@pytest.mark.parametrize("period", [0.01, 0.02, 0.05])
def test_front_does_not_shake_at_full_drive_whatever_the_control_period(period: float) -> None:
    panigale = load_superbike("r1")  # the machine with the lightest front wheel
    radius, speed = 5000.0, 40.0
    rider = LineController(panigale, circle(radius, 1.0), period)
    engine = CompiledSuperbikeEngine(panigale, TIME_STEP)
    state = upright_state(speed, panigale.rF)
    state[st.Y], state[st.ROLL] = 1.0, -math.atan(speed**2 / radius / panigale.g)  # one metre inside the line
    engine.reset(state)
    rates = []
    for _ in range(round(5.0 / period)):
        state = engine.state()
        x, y = float(state[st.X]), float(state[st.Y]) - radius
        along = math.atan2(x, -y)
        heading = math.remainder(float(state[st.YAW]) - along, 2.0 * math.pi)
        now = float(engine.telemetry()[signal("speed")])
        seen = (now, float(state[st.ROLL]), along * radius, radius - math.hypot(x, y), heading)
        engine.advance(*rider.command(*seen), round(period / TIME_STEP))
        rates.append(float(engine.state()[st.STEER_RATE]))
    assert engine.fall == "none"
    assert engine.telemetry()[signal("speed")] > speed + 15.0
    engine.close()
    assert np.std(rates[-round(2.0 / period) :]) < 4.0  # rad/s; fed, this weave grows to 10


@pytest.fixture(scope="module")
def level_lap(tmp_path_factory: pytest.TempPathFactory) -> float:
    """Time of a lap of the level oval, s."""
    path = tmp_path_factory.mktemp("level") / "level.yaml"
    path.write_text(OVAL, encoding="utf-8")
    ride, _ = ride_laps("panigale_v4r", path, 1, engine="compiled")
    assert ride["end"] == "finished"
    return float(ride["lap_s"])


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [-8, 4])
def test_laps_banked_curves(tmp_path: Path, degrees: int, level_lap: float) -> None:
    """Planned as on a level road, curves whose outside is the lower side by 4 degrees threw every machine down."""
    path = tmp_path / "oval.yaml"
    path.write_text(f"{OVAL}banking_deg: [[0, {degrees}], [600, {degrees}]]\n", encoding="utf-8")
    ride, passings = ride_laps("panigale_v4r", path, 1, engine="compiled")
    assert ride["end"] == "finished"
    assert ride["excess"] > 0.0
    assert passings == ()
    assert (ride["lap_s"] > level_lap) == (degrees > 0)


def test_rehearses_on_the_wet(panigale: Superbike, tmp_path: Path) -> None:
    """A curve with three quarters of the friction throws a rider down who knows only of dry roads."""
    path = tmp_path / "oval.yaml"
    path.write_text(f"{OVAL}wet:\n  - {{from_m: 400, to_m: 450, grip: 0.75}}\n", encoding="utf-8")
    ride, _ = ride_laps("panigale_v4r", path, 1, engine="compiled")
    assert ride["end"] == "finished"
    line = track_with_line(path, envelope(panigale)).line(1.0)
    assert ride["plan_s"] > 1.005 * plan_lap(panigale, line, CLASSICAL_SETTINGS).lap_time


def test_a_start_line_in_a_bend_is_begun_slowly(tmp_path: Path) -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 120, endpoint=False)
    rows = "\n".join(f"{70.0 * math.cos(a):.4f},{70.0 * math.sin(a):.4f},5.0,5.0" for a in angle)
    path = tmp_path / "bowl.csv"
    path.write_text(f"# x_m,y_m,w_tr_right_m,w_tr_left_m\n{rows}\n", encoding="utf-8")
    ride, _ = ride_laps("cbr1000rr_r", path, laps=1, engine="compiled")
    assert (ride["end"], ride["valid_laps"]) == ("finished", 1)


@pytest.mark.slow
def test_command_laps_a_circuit_it_has_never_seen(circuit: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--vehicle", "panigale_v4r", "--course", str(circuit), "--rider", "classical", "--laps", "2"]
    words += ["--engine", "compiled"]
    code = cli.main(["ride", *words, "--json"])
    answer = json.loads(capsys.readouterr().out)
    assert code == 0
    (pair,) = answer["figures"]["pairs"]
    assert (pair["vehicle"], pair["end"], pair["laps"], pair["valid_laps"]) == ("panigale_v4r", "finished", 2, 2)
    assert pair["falls"] == pair["walls"] == 0
    assert pair["closest_limit_s"] < pair["limit_s"] < pair["lap_s"]
    assert 0.0 < pair["excess"] < pair["closest_excess"] < ALLOWED_EXCESS


def test_bicycles_and_unknown_circuits_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["ride", "--vehicle", "whipple", "--laps", "1"]) == 2
    assert "--laps is for a superbike" in capsys.readouterr().err
    assert cli.main(["ride", "--vehicle", "r1", "--course", "nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err
