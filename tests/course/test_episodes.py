"""Episodes of a bicycle on a course: what a request may ask for, and where a ride is found."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from bike_sim.course.course import MAX_LENGTH
from bike_sim.course.files import load_course
from bike_sim.course.random_courses import CURRICULUM_PATHS, PathRanges, random_course
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import SEED_LIMIT, STATE_LIMIT, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import SHIPPED


@pytest.fixture
def simulator() -> Simulator:
    return Simulator(SimulatorConfig(engine="whipple", time_step=0.005))


def state_at(simulator: Simulator, s: float, aside: float = 0.0) -> tuple[float, ...]:
    """Return a state that rolls along the benchmark path at an arc length, m."""
    course = load_course("benchmark")
    i = round(s / course.spacing)
    state = st.upright_state(4.0, simulator.vehicle.rF)
    heading = course.heading[i]
    state[: st.ROLL] = course.x[i] - aside * math.sin(heading), course.y[i] + aside * math.cos(heading), heading
    return tuple(state)


@pytest.mark.parametrize("s", [0.0, 123.4, 300.0])
def test_an_initial_state_is_found_wherever_it_lies(simulator: Simulator, s: float) -> None:
    snapshot = simulator.reset(ResetRequest(course="benchmark", initial_state=state_at(simulator, s, 0.5)))
    assert snapshot.look[lk.PROGRESS] == pytest.approx(s, abs=0.1)
    assert snapshot.look[lk.LATERAL_ERROR] == pytest.approx(0.5, abs=1e-3)
    assert not snapshot.off_course


def test_a_closed_course_is_finished_after_a_whole_lap(simulator: Simulator) -> None:
    course = load_course("benchmark")
    snapshot = simulator.reset(ResetRequest(course="benchmark", initial_state=state_at(simulator, 365.0)))
    for _ in range(40):
        snapshot = simulator.step(0.0)
    assert snapshot.look[lk.PROGRESS] > course.length
    assert not snapshot.finished


def test_at_a_crossing_the_branch_is_found_that_is_ridden() -> None:
    t = np.linspace(0.0, 2.0 * math.pi, 4001)
    x, y = 50.0 * np.sin(t), 25.0 * np.sin(2.0 * t)
    eight = load_course("benchmark").__class__(
        "eight", np.arange(4001) * 0.1, x, y, np.unwrap(np.arctan2(np.gradient(y), np.gradient(x))), np.zeros(4001)
    )
    there = eight.nearest(0.02, 0.0, eight.heading[2000])
    assert there == pytest.approx(200.0, abs=0.3)
    assert eight.nearest(0.02, 0.0, eight.heading[0]) == pytest.approx(0.0, abs=0.3)


def test_places_on_a_closed_course_are_of_the_lap_that_is_expected() -> None:
    circle = load_course("circle")
    behind = circle.length - 2.0
    x, y, heading = (float(np.interp(behind, circle.s, column)) for column in (circle.x, circle.y, circle.heading))
    assert circle.nearest(x, y, heading) == pytest.approx(-2.0, abs=0.06)
    assert circle.nearest(x, y, heading, 60.0) == pytest.approx(behind, abs=0.06)
    assert circle.nearest(circle.x[5], circle.y[5], circle.heading[5], behind) == pytest.approx(
        circle.length + circle.s[5]
    )


@pytest.mark.parametrize("period", [0.5, 1.0, 2.0])
def test_a_long_control_period_stays_on_the_course(period: float) -> None:
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.005, control_period=period))
    snapshot = simulator.reset(ResetRequest(course="line", speed_range=(6.0, 6.0)))
    for _ in range(round(4.0 / period)):
        snapshot = simulator.step(0.0)
    assert snapshot.look[lk.PROGRESS] == pytest.approx(24.0, abs=1e-6)
    assert snapshot.look[lk.FRONT_PROGRESS] == pytest.approx(25.02, abs=1e-6)
    assert not snapshot.off_course


def test_a_limit_beyond_the_engine_is_a_fall_all_the_same(tmp_path: Path) -> None:
    document = yaml.safe_load((SHIPPED / "whipple.yaml").read_text(encoding="utf-8"))
    document["limits"]["fall_roll_deg"] = 80.0
    path = tmp_path / "late.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    simulator = Simulator(SimulatorConfig(vehicle=str(path), engine="whipple", time_step=0.005))
    snapshot = simulator.reset(ResetRequest(course="line"))
    for _ in range(100):
        snapshot = simulator.step(0.3)
    assert snapshot.fallen
    assert not simulator.reset(ResetRequest(course="line")).fallen
    simulator.close()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path_length": 1e9}, "path length must be at most 100000 m, got 1000000000.0 m"),
        ({"path_length": math.nextafter(MAX_LENGTH, math.inf)}, "path length must be at most"),
        ({"speed_range": (4.0, 1e6)}, "speed of up to 1000000.0 m/s asks for a random path of 1.2e[+]08 m"),
        ({"seed": SEED_LIMIT + 1}, f"seed must be 0 to {SEED_LIMIT} .* got {SEED_LIMIT + 1}"),
        ({"seed": -1}, "seed must be 0 to .* got -1"),
        ({"initial_state": (0.0,) * 7 + (1e10, 0.0, 0.0)}, "roll_rate_rad_s is 10000000000.0, beyond"),
    ],
)
def test_requests_beyond_all_sense_are_refused_with_their_value(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ResetRequest(**changes)  # type: ignore[arg-type]


def test_what_is_just_within_the_limits_is_taken() -> None:
    ResetRequest(seed=SEED_LIMIT, path_length=MAX_LENGTH, initial_state=(STATE_LIMIT,) * st.STATE_SIZE)
    ResetRequest(course="line", speed_range=(1e6, 1e6))
    ResetRequest(speed_range=(1e6, 1e6), path_length=50.0)


@pytest.mark.parametrize("name", ["radius", "quintic_length", "quintic_width"])
def test_elements_longer_than_any_course_are_refused(name: str) -> None:
    values = {"radius": 8.0, "quintic_length": 14.0, "quintic_width": 2.0}
    ranges = {f"{key}_{end}": value for key, value in values.items() for end in ("min", "max")}
    with pytest.raises(ValueError, match=f"{name}_max must be at most 100000 m, got 1000000000000.0"):
        PathRanges(**ranges | {f"{name}_max": 1e12})


@pytest.mark.parametrize("length", [1e9, math.inf, math.nan, 0.0, -5.0])
def test_random_paths_have_a_length_that_can_be(length: float) -> None:
    with pytest.raises(ValueError, match="length of a random path"):
        random_course(np.random.default_rng(0), CURRICULUM_PATHS[0], length)


@pytest.mark.parametrize("engine", ["whipple", "pybullet"])
@pytest.mark.parametrize("roll", [0.5 * math.pi, 2.0, -3.1])
def test_a_roll_that_would_be_another_state_is_refused(engine: str, roll: float) -> None:
    simulator = Simulator(SimulatorConfig(engine=engine))
    before = simulator.reset(ResetRequest(course="line"))
    state = before.state.copy()
    state[st.ROLL] = roll
    with pytest.raises(ValueError, match=f"roll {math.degrees(roll):.6g} deg"):
        simulator.reset(ResetRequest(course="line", initial_state=tuple(state)))
    after = simulator.step(0.0)
    assert (after.episode, after.step) == (before.episode, 1)
    simulator.close()
