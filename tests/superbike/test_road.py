"""A superbike on the road of a circuit: hills and banking as they lie there, wet patches, run-off, wind, walls."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_sim.course.road import RunOffKind, RunOffPart, Walls, WetPatch, Wind
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.physics.ground import GROUND
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import EventKind
from bike_sim.sim.ground import GRASS_GRIP, GRAVEL_GRIP, GUST_SAMPLES, gust_series, lay_ground, road_of, touch_of
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from tests.circuits import OVAL

BANKED = (
    OVAL
    + """
banking_deg: [[0, 0], [250, 0], [330, -4], [570, -4], [650, 0]]
run_off_kinds:
  - {from_m: 0, to_m: 250, side: both, kind: grass}
"""
)


@pytest.fixture(scope="module")
def oval(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("oval") / "oval.yaml"
    path.write_text(BANKED, encoding="utf-8")
    return path


@pytest.fixture(scope="module", autouse=True)
def middle_of_the_road(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Ride the centre line as the ideal one: nothing here is about lines, which take their time to compute."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BIKE_CACHE", str(tmp_path_factory.mktemp("lines")))  # others ride this circuit's own line
        for name in ("bike_sim.planning.minimum_time.with_fastest_line", "bike_sim.course.racing_line.with_ideal_line"):
            patch.setattr(name, lambda track, *_, **__: track.with_ideal(np.zeros(len(track.centre.s))))
        yield


@pytest.fixture(scope="module")
def machines() -> Iterator[tuple[Simulator, Simulator]]:
    both = tuple(
        Simulator(replace(superbike_config("panigale_v4r"), engine=kind))  # type: ignore[arg-type]
        for kind in ("compiled", "pybullet")
    )
    yield both  # type: ignore[misc]
    for machine in both:
        machine.close()


@pytest.fixture(scope="module")
def track(machines: tuple[Simulator, Simulator], oval: Path) -> Track:
    machines[0].reset(ResetRequest(course=str(oval), speed_range=(10.0, 10.0)))
    assert machines[0].track is not None
    return machines[0].track


def laid(track: Track, progress: float, offset: float, time: float = 0.0) -> tuple[np.void, float, int]:
    """Return the ground under both wheels at one place, the distance beyond the limits, and the wall."""
    record = np.zeros(1, dtype=GROUND)
    x, y, _ = track.points(np.array([progress]), offset)[0]
    place = np.array([progress, offset, progress, offset])
    beyond, _, wall = lay_ground(x, y, x, y, place, time, road_of(track), record)
    return record[0], beyond, wall


def on(track: Track, **surface: object) -> Track:
    return replace(track, surface=replace(track.surface, **surface))  # type: ignore[arg-type]


def started(machine: Simulator, oval: Path, progress: float, offset: float, aside: float, speed: float) -> Snapshot:
    """Begin upright beside the centre line, headed away from it by an angle (rad, to the left)."""
    machine.reset(ResetRequest(course=str(oval), speed_range=(10.0, 10.0)))
    track = machine.track
    assert track is not None
    state = st.upright_state(speed, machine.vehicle.rF)
    state[[st.X, st.Y]] = track.points(np.array([progress]), offset)[0, :2]
    state[st.YAW] = float(track.at(track.centre.heading, progress)) + aside
    return machine.reset(ResetRequest(course=str(oval), initial_state=tuple(state), progress=progress))


# --- the ground of a place ---


@pytest.mark.parametrize(
    ("progress", "offset"), [(120.0, 0.0), (450.0, 4.0), (450.0, -5.0), (700.0, 3.0), (1199.9, 1.0)]
)
def test_the_ground_is_the_surface_of_the_circuit(track: Track, progress: float, offset: float) -> None:
    """Height, slopes and direction under a wheel are those of `Track.points` around it."""
    ground, _, _ = laid(track, progress, offset)
    patch = ground["rear"]
    d = 0.5
    behind, here, ahead = track.points(np.array([progress - d, progress, progress + d]), offset)
    way = math.dist(behind[:2], ahead[:2])
    assert patch["height"] == pytest.approx(here[2], abs=1e-3)
    assert patch["grade"] == pytest.approx((ahead[2] - behind[2]) / way, abs=2e-4)
    aside = math.tan(track.at(track.bank, progress)) * float(track.at(track.centre.curvature, progress))
    along = (ahead[2] - 2.0 * here[2] + behind[2]) / (0.5 * way) ** 2
    assert patch["crest"] == pytest.approx(along - aside, abs=3e-4)
    left = track.points(np.array([progress]), offset + 1.0)[0]
    assert patch["bank"] == pytest.approx(left[2] - here[2], abs=1e-9)
    assert (patch["cos"], patch["sin"]) == pytest.approx(tuple((ahead[:2] - behind[:2]) / way), abs=1e-3)
    assert (patch["x"], patch["y"]) == pytest.approx(tuple(here[:2]))


def test_patches_meet_where_one_control_period_ends(track: Track) -> None:
    """From one period to the next, on the centre line, the road makes no step that a tyre would feel."""
    for progress in np.linspace(0.0, 1190.0, 60):
        first, _, _ = laid(track, progress, 0.0)
        then, _, _ = laid(track, progress + 1.2, 0.0)
        a, b = first["rear"], then["rear"]
        along = a["cos"] * (b["x"] - a["x"]) + a["sin"] * (b["y"] - a["y"])
        left = a["cos"] * (b["y"] - a["y"]) - a["sin"] * (b["x"] - a["x"])
        height = a["height"] + (a["grade"] + 0.5 * a["crest"] * along) * along + a["bank"] * left
        assert b["height"] == pytest.approx(height, abs=1e-4)


def test_bumps_go_on_over_the_start_line(track: Track) -> None:
    rough = on(track, bumps=16e-6, seed=5)
    road = road_of(rough)
    assert road.bumps.shape == (1, 8192)
    before, behind = (laid(rough, s, 0.0)[0]["rear"] for s in (1199.999, 0.001))
    turn = 8192 * 0.1
    apart = (behind["arc"] - before["arc"]) % turn
    assert min(apart, turn - apart) < 0.005
    assert laid(rough, 100.0, 0.0)[0]["rear"]["arc"] == laid(rough, 1300.0, 0.0)[0]["rear"]["arc"]
    assert laid(track, 100.0, 0.0)[0]["rear"]["bumps"] == 0.0


def test_wet_patches_and_run_off_have_their_grip(track: Track) -> None:
    wet = on(track, wet=(WetPatch(100.0, 150.0, 0.6), WetPatch(1150.0, 20.0, 0.7)))
    for progress, grip in ((99.0, 1.0), (125.0, 0.6), (151.0, 1.0), (1180.0, 0.7), (10.0, 0.7), (30.0, 1.0)):
        assert laid(wet, progress, 0.0)[0]["rear"]["grip"] == pytest.approx(grip)
    ground, beyond, wall = laid(wet, 125.0, 7.0)
    assert (beyond, wall) == (pytest.approx(1.0), -1)
    assert ground["rear"]["grip"] == pytest.approx(0.6 * GRASS_GRIP)
    assert ground["rear"]["drag"] > 0.0
    gravel = on(track, run_off=(RunOffPart(0.0, 600.0, "left", RunOffKind.GRAVEL),))
    assert laid(gravel, 125.0, 7.0)[0]["rear"]["grip"] == GRAVEL_GRIP
    assert laid(gravel, 125.0, -7.0)[0]["rear"]["grip"] == GRASS_GRIP
    assert laid(gravel, 125.0, 7.0)[0]["rear"]["drag"] > laid(gravel, 125.0, -7.0)[0]["rear"]["drag"]
    left, right = track.walls()
    assert laid(track, 125.0, float(left[1250]) + 0.1)[2] == 0
    assert laid(track, 125.0, float(right[1250]) - 0.1)[2] == 0


def test_the_edge_of_the_run_off_is_no_step(track: Track) -> None:
    smooth = [laid(track, 125.0, 6.0 + beyond)[0]["rear"]["bumps"] for beyond in (0.0, 0.01, 0.5, 1.0, 3.0)]
    assert smooth[0] == 0.0
    assert smooth[1] == pytest.approx(0.01 * smooth[3])
    assert smooth[2] == pytest.approx(0.5 * smooth[3])
    assert smooth[3] == smooth[4] > 0.0


def test_gusts_have_their_strength_and_their_seed() -> None:
    wind = Wind(speed=8.0, towards=0.3, gusts=0.2, seed=4)
    series = gust_series(wind)
    assert series.shape == (2, GUST_SAMPLES)
    assert series[0].std() == pytest.approx(1.0)
    assert abs(series.mean()) < 1e-9
    assert (series == gust_series(wind)).all()
    assert (series != gust_series(replace(wind, seed=5))).any()
    # what passes in 100 m / 8 m/s goes together, what lies a minute apart does not
    assert np.corrcoef(series[0, :-10], series[0, 10:])[0, 1] > 0.8
    assert abs(np.corrcoef(series[0, :-600], series[0, 600:])[0, 1]) < 0.3


def test_wind_is_that_of_the_circuit(track: Track) -> None:
    steady = on(track, wind=Wind(speed=8.0, towards=math.radians(30.0)))
    ground, _, _ = laid(steady, 10.0, 0.0, time=5.0)
    assert (ground["wind_x"], ground["wind_y"]) == pytest.approx((8.0 * math.cos(0.5236), 4.0), abs=1e-3)
    gusty = on(track, wind=Wind(speed=8.0, towards=math.radians(30.0), gusts=0.2, seed=1))
    speeds = [
        math.hypot(*(laid(gusty, 10.0, 0.0, time=t)[0][name] for name in ("wind_x", "wind_y"))) for t in range(200)
    ]
    assert np.std(speeds) == pytest.approx(1.6, rel=0.5)
    assert np.mean(speeds) == pytest.approx(8.0, rel=0.2)


# --- rides ---


def test_course_points_lie_on_the_banked_road(machines: tuple[Simulator, Simulator], oval: Path) -> None:
    machine = machines[0]
    snapshot = machine.reset(ResetRequest(course=str(oval), speed_range=(20.0, 20.0), progress=440.0))
    assert snapshot.circuit is not None
    assert machine.track is not None
    progress, offset = snapshot.circuit.place[:2]
    here = machine.track.points(np.array([progress]), offset)[0, 2]
    for row, side in ((lk.LEFT, 6.0), (lk.RIGHT, -6.0)):
        beside = machine.track.points(np.array([progress]), side)[0, 2]
        assert snapshot.circuit.points[row, 0, 2] == pytest.approx(beside - here, abs=0.01)
    assert abs(snapshot.circuit.points[lk.LINE, 0, 2]) < 0.01


def test_leaving_the_track_costs_time_and_lean(machines: tuple[Simulator, Simulator], oval: Path) -> None:
    """On grass a machine loses more speed than on the road, and it does not hold what the road does."""
    machine = machines[0]
    ends = {}
    for offset in (0.0, 9.0):
        snapshot = started(machine, oval, 20.0, offset, 0.0, 30.0)
        for _ in range(100):
            snapshot = machine.step(0.0, 0.0)
        ends[offset] = snapshot.speed
        assert not snapshot.fallen
    assert ends[9.0] < ends[0.0] - 0.8
    snapshot = started(machine, oval, 20.0, 9.0, 0.0, 30.0)
    for _ in range(150):
        snapshot = machine.step(-0.7, 0.0)
    assert snapshot.fall == "low_side"


# --- walls ---


@pytest.mark.parametrize("aside", [0.08, -0.08])
def test_a_glancing_touch_scrapes_and_the_ride_goes_on(
    machines: tuple[Simulator, Simulator], oval: Path, track: Track, aside: float
) -> None:
    """In both engines alike: energy is lost, the machine is turned along the wall, and an event tells of it."""
    side = math.copysign(1.0, aside)
    wall = float((track.walls()[0] if side > 0.0 else track.walls()[1])[1500])
    ends = []
    for machine in machines:
        snapshot = started(machine, oval, 130.0, wall - side * 0.5, aside, 25.0)
        before, told = snapshot, []
        for _ in range(100):
            snapshot = machine.step(0.0, 0.0)
            told += [event for event in snapshot.events if event.kind is EventKind.SCRAPE]
            if told and snapshot.circuit is not None and snapshot.circuit.wall is not None:
                touch, before = snapshot.circuit.wall, snapshot
        assert told
        assert (snapshot.fall, snapshot.fallen) == ("none", False)
        assert told[0].value == pytest.approx(touch.speed)
        assert 0.0 < touch.across < 0.5 * machine.vehicle.mass * 3.0**2
        assert touch.across == pytest.approx(0.5 * machine.vehicle.mass * (touch.speed * math.sin(touch.angle)) ** 2)
        assert snapshot.circuit is not None
        assert abs(snapshot.circuit.place[1]) < abs(wall)
        assert snapshot.speed < before.speed
        ends.append(snapshot.state)
    assert ends[0][:3] == pytest.approx(ends[1][:3], abs=1e-6)


def test_a_hit_ends_the_ride(machines: tuple[Simulator, Simulator], oval: Path, track: Track) -> None:
    wall = float(track.walls()[0][1500])
    for machine in machines:
        snapshot = started(machine, oval, 140.0, wall - 1.0, 0.3, 25.0)
        for _ in range(50):
            snapshot = machine.step(0.0, 0.0)
        assert snapshot.fall == "wall"
        assert snapshot.circuit is not None
        assert snapshot.circuit.wall is not None
        assert snapshot.circuit.wall.across > 0.5 * machine.vehicle.mass * 3.0**2


def test_a_scrape_takes_what_restitution_and_friction_take(track: Track) -> None:
    walls = Walls(friction=0.5, restitution=0.25, hit=5.0)
    road = road_of(on(track, walls=walls))
    for side in (1.0, -1.0):
        wall = float((track.walls()[0] if side > 0.0 else track.walls()[1])[1500])
        along = float(track.at(track.centre.heading, 150.0))
        place = np.array([148.6, wall - side * 0.05, 150.0, wall + side * 0.01])
        touch = touch_of(along + side * 0.1, 20.0, place, 2, road)
        across, forward = 20.0 * math.sin(0.1), 20.0 * math.cos(0.1)
        assert touch.approach == pytest.approx(across, rel=1e-3)
        left = forward - 0.5 * 1.25 * across
        assert touch.share * 20.0 == pytest.approx(math.hypot(left, 0.25 * across), rel=1e-3)
        assert 0.1 + side * touch.turn == pytest.approx(-math.atan2(0.25 * across, left), rel=1e-2)
        assert touch_of(along - side * 0.1, 20.0, place, 2, road).share == 1.0  # leaving the wall


def test_a_wall_ends_every_ride_of_a_bicycle(oval: Path) -> None:
    machine = Simulator(SimulatorConfig(engine="whipple"))
    machine.reset(ResetRequest(course=str(oval), speed_range=(5.0, 5.0)))
    track = machine.track
    assert track is not None
    wall = float(track.walls()[0][400])
    state = st.upright_state(5.0, machine.vehicle.rF)
    state[[st.X, st.Y]] = track.points(np.array([40.0]), wall - 0.2)[0, :2]
    state[st.YAW] = float(track.at(track.centre.heading, 40.0)) + 0.05
    seen = [machine.reset(ResetRequest(course=str(oval), initial_state=tuple(state), progress=40.0))]
    seen += [machine.step(0.0, 0.0) for _ in range(40)]
    assert seen[-1].fall == "wall"
    assert [event.kind for snapshot in seen for event in snapshot.events][-1] is EventKind.WALL
    hit = seen[-1].circuit.wall  # type: ignore[union-attr]
    assert hit.energy == pytest.approx(0.5 * machine.vehicle.mass * hit.speed**2)  # type: ignore[union-attr]
    assert seen[-1].speed == 0.0
    assert np.array_equal(seen[-1].state[:3], seen[-2].state[:3])
