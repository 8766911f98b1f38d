"""A superbike on a circuit: what is seen, grip, walls, timing, determinism."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_sim.course.lap_timing import EXACT, Timing
from bike_sim.physics import state as st
from bike_sim.physics.superbike.statics import turning_state
from bike_sim.planning.line_cache import cache_folder, content_key, track_with_line
from bike_sim.sim import beginning
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import EventKind
from bike_sim.sim.followed_line import FollowedLine, start_speed
from bike_sim.sim.ground import GRASS_GRIP, GRAVEL_GRIP
from bike_sim.sim.request import HORIZON, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from tests.circuits import OVAL
from tests.lap_times import samples_of, time_laps

COMPILED = replace(superbike_config("panigale_v4r"), engine="compiled")


@pytest.fixture(scope="module")
def machine() -> Iterator[Simulator]:
    machine = Simulator(COMPILED)
    yield machine
    machine.close()


def request(circuit: Path, **changes: object) -> ResetRequest:
    return ResetRequest(**({"course": str(circuit), "speed_range": (30.0, 30.0)} | changes))  # type: ignore[arg-type]


def timing_of(machine: Simulator) -> Timing:
    return machine.batch.timing(0)


def grips_of(machine: Simulator) -> list[float]:
    """Return the factors on friction that the engine has under the rear and the front wheel."""
    ground = machine.batch.rows.ground
    return [float(ground[wheel]["grip"][0]) for wheel in ("rear", "front")]


def until_the_end(machine: Simulator, snapshot: Snapshot, steering: float, throttle: float) -> list[Snapshot]:
    """Ride with held commands until the machine stops, 20 s at most."""
    seen = [snapshot]
    while not seen[-1].fallen and len(seen) < 1000:
        seen.append(machine.step(steering, throttle))
    return seen


def test_too_fast_a_start_is_refused(machine: Simulator, circuit: Path) -> None:
    machine.reset(request(circuit))
    before = machine.step(0.0, 0.1)
    with pytest.raises(ValueError, match="too fast for the curve"):
        machine.reset(request(circuit, speed_range=(90.0, 90.0)))
    assert machine.step(0.0, 0.1).step == before.step + 1  # the episode before goes on


def test_course_points_are_the_next_six_seconds_between_the_limits(machine: Simulator, circuit: Path) -> None:
    snapshot = machine.reset(request(circuit))
    points = snapshot.circuit.points
    assert points.shape == (3, 20, 3)
    line = points[lk.LINE, :, :2]
    # Chords are a little shorter than the way.
    length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    assert length == pytest.approx(HORIZON * snapshot.speed, rel=0.02)
    across = points[lk.LEFT, :, :2] - points[lk.RIGHT, :, :2]
    assert np.linalg.norm(across, axis=1) == pytest.approx(np.full(20, 12.0), abs=0.05)
    assert points[lk.LEFT, 0, 1] > points[lk.LINE, 0, 1] > points[lk.RIGHT, 0, 1]


def test_course_points_have_the_height_of_the_road(machine: Simulator, tmp_path: Path) -> None:
    hilly = tmp_path / "oval.yaml"
    hilly.write_text(OVAL, encoding="utf-8")
    snapshot = machine.reset(request(hilly, progress=20.0))
    track = machine.track
    assert track is not None
    ahead = 20.0 + HORIZON * snapshot.speed
    climb = float(track.at(track.elevation, ahead) - track.at(track.elevation, 20.0))
    assert snapshot.circuit.points[lk.LINE, -1, 2] == pytest.approx(climb, abs=0.2)
    assert abs(climb) > 1.0


def test_going_straight_on_leaves_the_track_and_meets_the_wall(machine: Simulator, circuit: Path) -> None:
    snapshot = machine.reset(request(circuit))
    seen = until_the_end(machine, snapshot, 0.0, 0.3)
    events = [event for snapshot in seen[1:] for event in snapshot.events]
    assert [event.kind for event in events][-1] is EventKind.WALL
    assert EventKind.OFF_COURSE in [event.kind for event in events]
    hit = seen[-1].circuit.wall
    assert hit is not None
    assert hit.energy == pytest.approx(0.5 * machine.vehicle.mass * hit.speed**2)
    assert events[-1].value == hit.speed > 10.0
    after = machine.step(0.0, 1.0)
    assert after.speed == 0.0
    assert after.state[:3] == pytest.approx(seen[-1].state[:3])
    assert after.events == ()  # a ride ends once
    off = next(snapshot for snapshot in seen if snapshot.circuit.outside > 0.0)
    assert off.off_course
    assert set(grips_of(machine)) <= {GRASS_GRIP, GRAVEL_GRIP}


@pytest.mark.parametrize(
    ("speed", "fall", "off_track"),
    [
        (25.0, "low_side", True),  # at full lean over the limit, where there is less grip
        (3.0, "tip_over", False),  # too slow to be held
    ],
)
def test_falls_have_names(machine: Simulator, circuit: Path, speed: float, fall: str, off_track: bool) -> None:
    snapshot = machine.reset(request(circuit, speed_range=(speed, speed)))
    seen = until_the_end(machine, snapshot, 1.0, 0.0)
    assert [snapshot.fall for snapshot in seen[:-1]] == ["none"] * (len(seen) - 1)
    assert (seen[-1].fall, seen[-1].circuit.wall) == (fall, None)
    assert (seen[-2].circuit.outside > 0.0) == off_track
    events = [event for snapshot in seen[1:] for event in snapshot.events]
    assert events[-1].kind is EventKind.FALL
    assert fall.replace("_", " ") in events[-1].text


def test_timing_from_recorded_points_is_that_of_the_ride(machine: Simulator, circuit: Path) -> None:
    seen = until_the_end(machine, machine.reset(request(circuit)), 0.0, 0.3)
    track = machine.track
    assert track is not None
    again = samples_of(
        track,
        np.array([snapshot.time for snapshot in seen]),
        np.array([snapshot.state[:2] for snapshot in seen]),
        np.array([snapshot.look[[lk.FRONT_X, lk.FRONT_Y]] for snapshot in seen]),
        0.0,
        machine.vehicle.w,
    )
    timing, events = time_laps(track, again)
    assert timing == timing_of(machine)
    kinds = {EventKind.SECTOR, EventKind.LAP, EventKind.OFF_COURSE, EventKind.BACK_ON_COURSE}
    told = [(event, snapshot.circuit.outside) for snapshot in seen for event in snapshot.events if event.kind in kinds]
    assert EventKind.OFF_COURSE in [event.kind for event, _ in told]
    assert [event for event, _ in told] == [
        replace(event, value=outside) if event.kind is EventKind.OFF_COURSE else event
        for event, (_, outside) in zip(events, told, strict=True)
    ]


def test_lines_are_kept_by_what_they_depend_on(machine: Simulator, circuit: Path) -> None:
    track = track_with_line(circuit, machine.plant.envelope)
    kept = cache_folder() / f"{content_key(track, machine.plant.envelope)}.npy"
    assert kept.exists()
    kept.write_bytes(b"torn")
    again = track_with_line(circuit, machine.plant.envelope)
    assert np.array_equal(again.ideal, track.ideal)  # type: ignore[arg-type]


def test_places_that_cannot_be_are_refused_with_their_value(machine: Simulator, circuit: Path) -> None:
    first = machine.reset(request(circuit))
    track = machine.track
    assert track is not None
    with pytest.raises(ValueError, match=f"progress {track.length!r} m lies beyond circuit 'kidney'"):
        machine.reset(request(circuit, progress=track.length))
    for field, value in (
        ("progress", -0.1),
        ("progress", math.inf),
        ("line", -0.5),
        ("line", 1.01),
        ("line", math.nan),
    ):
        with pytest.raises(ValueError, match=f"{field} must be .*{value!r}"):
            request(circuit, **{field: value})
    assert machine.step(0.0).episode == first.episode  # the episode before goes on


def test_paths_have_no_line_to_choose(machine: Simulator) -> None:
    bicycle = Simulator(SimulatorConfig(engine="whipple"))
    for simulator in (bicycle, machine):
        for changes in ({"line": 0.5}, {"progress": 20.0}):
            for course in ("line", "random"):
                with pytest.raises(ValueError, match=f"are for circuits; course '{course}' is a path"):
                    simulator.reset(ResetRequest(course=course, **changes))
    bicycle.close()


def test_start_speed_is_for_the_place_and_the_line(machine: Simulator, circuit: Path) -> None:
    places = np.linspace(0.0, 1200.0, 13)
    track = track_with_line(circuit, machine.plant.envelope)
    lines = {lam: FollowedLine(track, lam) for lam in (0.0, 1.0)}
    speeds = {lam: [start_speed(line, machine.plant.envelope, float(s)) for s in places] for lam, line in lines.items()}
    assert max(speeds[1.0]) > min(speeds[1.0]) + 1.0
    assert speeds[0.0] != speeds[1.0]
    for s, speed in zip(places, speeds[1.0], strict=True):
        assert machine.at_own_speed(request(circuit, progress=float(s))).speed_range == (speed, speed)
        snapshot = machine.reset(request(circuit, progress=float(s), speed_range=(speed, speed)))
        assert snapshot.speed == pytest.approx(speed, rel=0.01)  # of the frame, which leans inwards


@pytest.mark.parametrize("perturb", [False, True])
def test_a_start_rides_the_turn_that_was_asked_for(machine: Simulator, circuit: Path, perturb: bool) -> None:
    snapshot = machine.reset(request(circuit, progress=600.0, perturb=perturb))
    roll, crown = snapshot.state[st.ROLL], machine.vehicle.front_tyre.crown
    assert roll < -0.6
    radius = machine.vehicle.rF - crown * (1.0 - math.cos(roll))
    assert snapshot.state[st.FRONT_WHEEL_RATE] * radius == pytest.approx(30.0, rel=1e-12)
    assert snapshot.look[lk.YAW_RATE] == pytest.approx(30.0 * snapshot.look[lk.CURVATURE], rel=1e-9)
    assert snapshot.state[st.STEER] > 0.0


def test_turning_state_is_the_upright_one_where_nothing_turns(machine: Simulator) -> None:
    assert np.array_equal(turning_state(machine.vehicle, 35.0, 0.0, 0.0), st.upright_state(35.0, machine.vehicle.rF))
    left, right = (turning_state(machine.vehicle, 25.0, sign * 0.8, -sign * 0.4) for sign in (1.0, -1.0))
    assert left == pytest.approx(st.MIRROR_SIGNS * right, abs=1e-12)


def test_an_initial_state_is_found_wherever_it_lies(machine: Simulator, circuit: Path) -> None:
    for progress in (0.0, 500.0, 1280.0):
        first = machine.reset(request(circuit, progress=progress))
        state = tuple(first.state)
        for asked in (0.0, progress):
            again = machine.reset(request(circuit, initial_state=state, progress=asked))
            assert again.circuit.place == pytest.approx(first.circuit.place, abs=EXACT)
            assert again.look[lk.PROGRESS] == pytest.approx(first.look[lk.PROGRESS], abs=1e-6)
            assert again.circuit.wall is None
            assert again.fall == "none"


def test_a_state_just_behind_the_start_is_before_the_first_lap(machine: Simulator, circuit: Path) -> None:
    state = machine.reset(request(circuit)).state
    state[[st.X, st.Y]] -= 2.0 * np.array([math.cos(state[st.YAW]), math.sin(state[st.YAW])])
    snapshot = machine.reset(request(circuit, initial_state=tuple(state)))
    assert snapshot.circuit.place[lk.CENTRE_PROGRESS] == pytest.approx(-2.0, abs=0.2)
    assert not snapshot.finished


def test_grip_of_the_ride_before_is_forgotten(machine: Simulator, circuit: Path) -> None:
    asked = request(circuit, progress=300.0)
    first = machine.reset(asked)
    until_the_end(machine, first, 0.0, 0.3)
    assert grips_of(machine)[0] in (GRASS_GRIP, GRAVEL_GRIP)
    assert np.array_equal(machine.reset(asked).signals, first.signals)
    state = first.state.copy()
    state[[st.X, st.Y]] += 12.0 * np.array([-math.sin(state[st.YAW]), math.cos(state[st.YAW])])
    outside = machine.reset(request(circuit, initial_state=tuple(state)))
    assert outside.circuit.outside > 0.0
    assert set(grips_of(machine)) <= {GRASS_GRIP, GRAVEL_GRIP}


def test_a_refused_reset_leaves_the_ride_alone(machine: Simulator, circuit: Path) -> None:
    before = machine.reset(request(circuit))
    machine.step(0.1, 0.1)
    state, timing = machine.batch.state[0].copy(), timing_of(machine)
    lying = before.state.copy()
    lying[st.ROLL] = 0.5 * math.pi
    for wrong, message in (((1e300, *before.state[1:]), "x_m is 1e[+]300"), (tuple(lying), "roll 90 deg")):
        with pytest.raises(ValueError, match=message):
            machine.reset(request(circuit, initial_state=wrong))
    assert machine.episode == before.episode
    assert np.array_equal(machine.batch.state[0], state)
    assert timing_of(machine) == timing
    assert machine.step(0.1, 0.1).step == 2


def test_a_long_control_period_sees_the_same_places(machine: Simulator, circuit: Path) -> None:
    coarse = Simulator(replace(COMPILED, control_period=0.2))
    asked = request(circuit, speed_range=(40.0, 40.0), progress=400.0)
    at_once, seen = coarse.reset(asked), machine.reset(asked)
    all_at_once = [at_once]
    for _ in range(8):
        at_once = coarse.step(0.0, 0.1)  # 8 m on
        for _ in range(10):
            seen = machine.step(0.0, 0.1)
        assert np.array_equal(at_once.state, seen.state)
        assert at_once.circuit.place == pytest.approx(seen.circuit.place, abs=1e-6)
        all_at_once.append(at_once)
    assert seen.circuit.place[lk.CENTRE_PROGRESS] > 450.0
    assert coarse.track is not None
    again = samples_of(
        coarse.track,
        np.array([snapshot.time for snapshot in all_at_once]),
        np.array([snapshot.state[:2] for snapshot in all_at_once]),
        np.array([snapshot.look[[lk.FRONT_X, lk.FRONT_Y]] for snapshot in all_at_once]),
        400.0,
        400.0 + coarse.vehicle.w,
    )
    assert [sample.progress for sample in again] == [
        snapshot.circuit.place[lk.CENTRE_PROGRESS] for snapshot in all_at_once
    ]
    coarse.close()


def test_a_ride_is_finished_after_a_whole_lap(machine: Simulator, circuit: Path) -> None:
    snapshot = machine.reset(request(circuit, progress=1280.0))
    assert machine.course is not None
    while snapshot.look[lk.PROGRESS] < machine.course.length + 1.0:
        snapshot = machine.step(0.0, 0.0)
        assert not snapshot.fallen
    assert not snapshot.finished


def test_lines_are_computed_where_no_cache_can_be(
    machine: Simulator, circuit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("BIKE_CACHE", str(tmp_path / "file" / "lines"))
    assert track_with_line(circuit, machine.plant.envelope).ideal is not None


def test_lines_that_nobody_asks_for_are_forgotten(
    machine: Simulator, circuit: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(beginning, "LINES_KEPT", 2)
    courses = beginning.Courses()

    def line(lam: float) -> FollowedLine:
        return courses.line(machine.plant, str(circuit), lam)

    first, second = line(1.0), line(0.0)
    assert line(1.0) is first
    line(0.5)  # one too many: the second was not asked for the longest
    assert line(1.0) is first
    again = line(0.0)
    assert again is not second
    assert (again.stations == second.stations).all()
