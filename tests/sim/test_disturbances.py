"""Disturbances: none changes no bit, forces obey momentum, both engines agree, seeds repeat, files are checked."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_policy.riders.disturbed import DisturbedRider, measured
from bike_policy.riders.lqr import LqrRider
from bike_sim.course.files import load_track
from bike_sim.course.road import WetPatch
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple import energy, mass_matrix
from bike_sim.physics.engines import make_engine
from bike_sim.physics.ground import GROUND
from bike_sim.sim import look as lk
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import NO_CHANGES, Disturbances, Impulses, RoadChanges, Wind, read_disturbances
from bike_sim.sim.followed_line import FollowedLine
from bike_sim.sim.ground import GRIP, lay_ground
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.worlds import load_disturbances, shipped_disturbances
from bike_sim.vehicles.files import load_superbike, load_vehicle, shipped_superbikes
from bike_training.rollout.rollout import rollout

COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)
BICYCLE = load_vehicle("whipple")


def ridden(disturbances: Disturbances | None, steps: int = 60, course: str = "line"):
    simulator = Simulator(COMPILED, disturbances)
    rider = LqrRider() if disturbances is None else DisturbedRider(LqrRider(), disturbances)
    request = ResetRequest(course=course, speed_range=(4.0, 4.0))
    snapshots = rollout(simulator, rider, request)
    ride = [snapshot for snapshot, _ in zip(snapshots, range(steps), strict=False)]
    simulator.close()
    return np.array([snapshot.state for snapshot in ride])


@pytest.mark.parametrize("engine", ["whipple", "pybullet"])
def test_no_disturbance_changes_no_bit(engine: str) -> None:
    config = SimulatorConfig(engine=engine, time_step=0.005)
    request = ResetRequest(course="benchmark", speed_range=(4.0, 4.0), perturb=True, seed=3)
    states = []
    for disturbances in (None, Disturbances(), Disturbances(wind=Wind(gust_s=2.0))):
        simulator = Simulator(config, disturbances)
        rider = LqrRider() if disturbances is None else DisturbedRider(LqrRider(), disturbances)
        snapshots = rollout(simulator, rider, request)
        states.append([next(snapshots).state for _ in range(40)])
        simulator.close()
    np.testing.assert_array_equal(states[0], states[1])
    np.testing.assert_array_equal(states[0], states[2])


def test_the_mass_matrix_gives_the_kinetic_energy() -> None:
    state = st.upright_state(3.0, BICYCLE.rF)
    state[[st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE]] = 0.3, -0.2, 0.7, -1.1
    rates = state[[st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]]
    mass = mass_matrix(state, BICYCLE.parameters)
    assert 0.5 * rates @ mass @ rates == pytest.approx(energy(state, BICYCLE.parameters)[0], rel=1e-12)
    assert np.linalg.eigvalsh(mass).min() > 0.0


def test_a_push_does_the_work_of_its_force() -> None:
    """The energy that a push adds is force times way of its point, here along the bicycle."""
    engine = make_engine("whipple", BICYCLE, 0.001)
    engine.reset(st.upright_state(5.0, BICYCLE.rF))
    before = sum(energy(engine.state(), BICYCLE.parameters))
    for _ in range(200):
        engine.push(30.0, 0.0, 0.3, 0.9)  # type: ignore[attr-defined]
        engine.hold(0.0, 1)
    after = sum(energy(engine.state(), BICYCLE.parameters))
    assert after - before == pytest.approx(30.0 * engine.state()[st.X], rel=1e-3)


@pytest.mark.parametrize("height", [0.0, 0.9])
def test_both_engines_take_a_push_alike(height: float) -> None:
    ends = []
    for kind in ("whipple", "pybullet"):
        engine = make_engine(kind, BICYCLE, 0.001)
        engine.reset(st.upright_state(5.0, BICYCLE.rF))
        for _ in range(150):
            engine.push(5.0, 40.0, 0.3, height)  # type: ignore[attr-defined]
            engine.hold(0.0, 1)
        ends.append(engine.state())
        engine.close()
    ours, bullet = ends
    assert ours[st.ROLL] < -0.002 or height == 0.0  # pushed to the left at a height, it leans to the left
    places = [st.YAW, st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE]
    np.testing.assert_allclose(bullet[places], ours[places], atol=0.03 * np.abs(ours[places]).max())


def test_rides_repeat_by_seed_and_differ_between_seeds() -> None:
    disturbed = Disturbances(wind=Wind(force_n=5.0, gust_n=5.0), noise={"roll": 0.003}, impulses=Impulses(10.0, 1.0))
    first = ridden(disturbed)
    np.testing.assert_array_equal(first, ridden(disturbed))
    assert np.abs(first - ridden(replace(disturbed, seed=1)))[-1].max() > 1e-6


def test_impulses_come_when_they_should() -> None:
    states = ridden(Disturbances(impulses=Impulses(5.0, 1.0, 0.1)), 50)
    assert np.abs(states[:21, st.ROLL]).max() < 1e-12
    assert np.abs(states[22, st.ROLL]) > 1e-3


def test_commands_and_sight_come_late_by_whole_periods() -> None:
    class Counting:
        name, preview = "counting", None

        def begin(self, *_: object) -> None:
            self.seen: list[int] = []

        def command(self, snapshot):
            self.seen.append(snapshot.step)
            return (0.001 * snapshot.step, 0.0)

    rider, simulator = Counting(), Simulator(COMPILED)
    late = DisturbedRider(rider, Disturbances(command_delay_s=0.1, observation_delay_s=0.05))
    snapshots = rollout(simulator, late, ResetRequest(course="line"))
    applied = [round(next(snapshots).steering / 0.001) for _ in range(8)]
    assert rider.seen == [0, 0, 1, 2, 3, 4, 5]
    assert applied == [0, 0, 0, 0, 0, 1, 2, 3]
    with pytest.raises(ValueError, match="not a whole number of periods"):
        next(rollout(simulator, DisturbedRider(rider, Disturbances(command_delay_s=0.06)), ResetRequest(course="line")))
    simulator.close()


def test_a_snapshot_that_was_missed_or_comes_again_shifts_nothing() -> None:
    known = Disturbances(noise={"roll": 0.01}, command_delay_s=0.1)
    whole, gappy = DisturbedRider(LqrRider(), known), DisturbedRider(LqrRider(), known)
    simulator = Simulator(COMPILED)
    snapshots = [simulator.reset(ResetRequest(course="line", speed_range=(4.0, 4.0)))]
    assert simulator.course is not None
    for rider in (whole, gappy):
        rider.begin(simulator.vehicle, simulator.course, 0.05, simulator.preview)
    for _ in range(12):
        snapshots.append(simulator.step(0.001))
    simulator.close()
    answers = [whole.command(snapshot) for snapshot in snapshots]
    assert len(set(answers)) > 8
    for step, snapshot in enumerate(snapshots):
        if step != 5:
            assert gappy.command(snapshot) == gappy.command(snapshot)
            if step != 7:  # then the answer to the one that was missed would have acted
                assert gappy.command(snapshot) == answers[step]


def test_a_document_is_read_again_as_the_same() -> None:
    known = Disturbances("rough", 3, Wind(45.0, 3.0), Impulses(5.0), {"roll": 0.1}, {"speed": -0.1}, 0.05, 0.1)
    for each in (known, replace(known, drive_torque_nm=2.5, vehicle={"mB": 1.1}), Disturbances()):
        assert read_disturbances(each.to_text(), "other") == each


def test_a_measured_snapshot_is_that_of_a_displaced_bicycle() -> None:
    """Where the bicycle stood elsewhere, it would see what sensors with that error show."""
    simulator = Simulator(COMPILED)
    state = st.upright_state(4.0, BICYCLE.rF)
    state[[st.X, st.Y, st.YAW]] = 20.0, 0.3, 0.1
    shown = []
    for lateral, heading in ((0.0, 0.0), (0.2, -0.05)):
        moved = state.copy()
        moved[st.Y] += lateral
        moved[st.YAW] += heading
        shown.append(simulator.reset(ResetRequest(course="line", initial_state=tuple(moved))))
    simulator.close()
    seen = measured(shown[0], np.array([0.0, 0.0, 0.0, 0.0, 0.2, -0.05, 0.0]))
    np.testing.assert_allclose(seen.state, shown[1].state, atol=1e-12)
    for name in (lk.LATERAL_ERROR, lk.HEADING_ERROR):
        assert seen.look[name] == pytest.approx(shown[1].look[name], abs=1e-9)
    assert seen.look[lk.FRONT_LATERAL_ERROR] == pytest.approx(shown[1].look[lk.FRONT_LATERAL_ERROR], abs=1e-2)
    np.testing.assert_allclose(seen.preview_x, shown[1].preview_x, atol=1e-6)
    np.testing.assert_allclose(seen.preview_y, shown[1].preview_y, atol=1e-6)


def test_a_weak_drive_gives_no_more_than_its_torque() -> None:
    """From rest at 10 deg of set value the steer accelerates as the limited torque lets it, and slower than without."""
    simulator, weak = Simulator(COMPILED), Simulator(COMPILED, Disturbances(drive_torque_nm=0.5))
    for each in (simulator, weak):
        each.reset(ResetRequest(course="line"))
    turned, slowly = (
        abs(each.step(math.radians(10.0) / BICYCLE.max_steer).state[st.STEER]) for each in (simulator, weak)
    )
    assert slowly < 0.5 * turned
    mass = np.linalg.inv(mass_matrix(st.upright_state(4.0, BICYCLE.rF), BICYCLE.parameters))
    assert slowly < 1.2 * 0.5 * mass[1, 1] * 0.5 * 0.05**2
    for each in (simulator, weak):
        each.close()


def test_wrong_parameters_are_ridden_but_not_told() -> None:
    simulator = Simulator(COMPILED, Disturbances(vehicle={"mB": 1.2}))
    assert simulator.vehicle == BICYCLE
    assert simulator.plant.engine.vehicle.mB == pytest.approx(1.2 * BICYCLE.mB)  # type: ignore[attr-defined]
    simulator.close()
    for name in ("rF", "colour"):
        with pytest.raises(ValueError, match="that may be wrong"):
            Simulator(COMPILED, Disturbances(vehicle={name: 1.1}))


OF_ROADS = [name for name in shipped_disturbances() if load_disturbances(name).road != NO_CHANGES]
OF_SUPERBIKES = [name for name in shipped_disturbances() if "." in "".join(load_disturbances(name).vehicle)]
OF_INSTRUMENTS = [name for name in shipped_disturbances() if name.startswith("sensors")] + ["delay_40", "delay_60"]


@pytest.mark.parametrize("name", sorted(set(shipped_disturbances()) - {*OF_SUPERBIKES, *OF_ROADS, *OF_INSTRUMENTS}))
def test_shipped_files_disturb(name: str) -> None:
    known = load_disturbances(name)
    assert known.name == name
    assert known.acts_on_vehicle or known.acts_on_sensors or known.observation_delay_s or known.command_delay_s
    disturbed, calm = (ridden(each, 110, "circle") for each in (known, None))
    # A rider that is told nothing of a late command falls before the end.
    both = min(len(disturbed), len(calm))
    assert both > 10
    assert np.abs(disturbed[:both] - calm[:both]).max() > 1e-6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format: bike.course/1", "its format must be bike.disturbances/1"),
        ("format: bike.disturbances/1\nwinds: {}", "unknown entries"),
        ("format: bike.disturbances/1\nwind: {force: 3}", "wind has no entry"),
        ("format: bike.disturbances/1\nnoise: {smell: 3}", "unknown channels"),
        ("format: bike.disturbances/1\nnoise: {roll: -1}", "noise of roll must be finite and not negative"),
        ("format: bike.disturbances/1\ndrive_torque_nm: 0", "drive_torque_nm must be positive"),
        ("format: bike.disturbances/1\nbias: {roll: much}", "must be a number"),
        ("format: bike.disturbances/1\nbias: {roll: true}", "must be a number"),
        ("format: bike.disturbances/1\nroad: 0.9", "road must be a table"),
        ("format: bike.disturbances/1\nroad: {grip: 0}", "grip must be above 0 and at most 2, got 0.0"),
        ("format: bike.disturbances/1\nroad: {friction: 0.9}", "road has no entry 'friction'"),
        ("format: bike.disturbances/1\nroad: {patches: [[10, 20]]}", "patches must be lists of from_m, to_m and grip"),
        ("format: bike.disturbances/1\nroad: {patches: [[-10, 20, 0.9]]}", "a patch must lie on the lap"),
        ("format: bike.disturbances/1\nroad: {bumps_m3: 2}", "bumps must have a density of 0 to 1 m3"),
        ("format: bike.disturbances/1\nroad: {wind_m_s: 90}", "wind must have a speed of 0 to 60 m/s"),
    ],
)
def test_bad_files_are_named(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        load_disturbances(path)


def test_what_a_superbike_cannot_have_is_refused() -> None:
    config = SimulatorConfig("r1", "compiled", 0.001, 0.02)
    for disturbances in (Disturbances(drive_torque_nm=3.0), Disturbances(wind=Wind(force_n=3.0))):
        with pytest.raises(ValueError, match="is a superbike"):
            Simulator(config, disturbances)
    for name in ("mB", "frame", "front_tyre.colour", "grip.friction", "geometry.wheelbase"):
        with pytest.raises(ValueError, match="that may be wrong"):
            Simulator(config, Disturbances(vehicle={name: 1.1}))


def test_numbers_of_a_superbike_change_with_what_follows_from_them() -> None:
    machine = load_superbike("r1")
    assert machine.scaled({}) == machine
    heavy = machine.scaled({"frame.mass": 1.1, "steering.damper_slow": 0.5})
    assert heavy.mass == pytest.approx(machine.mass + 0.1 * machine.frame.mass)
    assert heavy.com_height * heavy.mass == pytest.approx(
        machine.com_height * machine.mass + 0.1 * machine.frame.mass * machine.frame.height
    )
    assert heavy.D == heavy.steering.damper_slow == 0.5 * machine.D


@pytest.mark.parametrize("engine", ["compiled", "pybullet"])
def test_a_superbike_is_ridden_as_it_is_and_known_as_it_was(engine: str, courses: dict[str, str]) -> None:
    """Rows with wrong parameters ride as such machines do alone, and show the machine that is known."""
    config = SimulatorConfig("r1", engine, 0.002, 0.02)
    request = ResetRequest(course=courses["circuit file"], speed_range=(40.0, 40.0), progress=10.0)
    slippery = load_disturbances("grip_085")
    road = Disturbances(road=RoadChanges(0.8, bumps_m3=16e-6, wind_m_s=20.0, wind_gusts=0.2))
    known = [Disturbances(), slippery, load_disturbances("heavy_machine"), slippery, road]
    batch = Batch(len(known), config, disturbances=known)
    alone = [Simulator(config, each) for each in known]
    assert all(vehicle == batch.vehicle for vehicle in batch.vehicles)
    for row, simulator in enumerate(alone):
        batch.reset(row, request)
        simulator.reset(request)
    for _ in range(40):
        batch.step(np.tile([0.0, -1.0], (len(known), 1)))
        for row, simulator in enumerate(alone):
            np.testing.assert_array_equal(batch.state[row], simulator.step(0.0, -1.0).state)
    np.testing.assert_array_equal(batch.state[1], batch.state[3])
    assert len({tuple(state) for state in batch.state}) == 4
    with pytest.raises(ValueError, match="needs as many disturbances"):
        Batch(2, config, disturbances=[slippery])
    batch.close()
    for simulator in alone:
        simulator.close()


def test_a_road_differs_from_the_circuit_that_is_known(courses: dict[str, str]) -> None:
    """Factors on grip multiply by place, bumps count where they are rougher, line and circuit stay the known ones."""
    changes = RoadChanges(0.9, ((20.0, 40.0, 0.5), (90.0, 10.0, 0.8)), 1e-6, 5.0, 90.0)
    track = load_track(courses["circuit file"])
    wet = replace(track.surface, wet=(WetPatch(0.0, 30.0, 0.5),), bumps=16e-6)
    surface = changes.surface(wet)
    s = np.array([5.0, 15.0, 25.0, 35.0, 60.0, 95.0])
    np.testing.assert_allclose(surface.grip(s), [0.9 * 0.5 * 0.8, 0.45, 0.9 * 0.25, 0.45, 0.9, 0.72], rtol=1e-12)
    assert surface.bumps == 16e-6
    assert surface.wind.towards == pytest.approx(math.pi / 2.0)
    assert NO_CHANGES.surface(wet).wind == wet.wind
    known = FollowedLine(track, 0.0)
    ridden = known.changed(changes)
    assert known.changed(NO_CHANGES) is known
    assert known.changed(replace(changes)) is ridden
    assert (ridden.track, ridden.line, ridden.stations) == (known.track, known.line, known.stations)
    np.testing.assert_array_equal(known.road.table[:, GRIP], 1.0)
    np.testing.assert_array_equal(ridden.road.table[:, GRIP], changes.surface(track.surface).grip(track.centre.s))
    read = read_disturbances(Disturbances(road=changes).to_text(), "again")
    assert read.road == changes


def test_grip_drifts_over_laps_and_never_ends(courses: dict[str, str]) -> None:
    track = load_track(courses["circuit file"])
    known = FollowedLine(track, 0.0)
    grounds = np.zeros(1, dtype=GROUND)
    for drift, laps, expected in ((0.0, 2.5, 0.9), (-0.1, 0.0, 0.9), (-0.1, 2.5, 0.9 * 0.75), (-0.5, 7.0, 0.09)):
        road = known.changed(RoadChanges(0.9, drift_per_lap=drift)).road
        place = np.array([laps * track.length, 0.0, (laps + 1.0) * track.length, 0.0])
        lay_ground(0.0, 0.0, 0.0, 0.0, place, 0.0, road, grounds)
        assert grounds["rear"]["grip"][0] == pytest.approx(expected)
        assert grounds["front"]["grip"][0] == pytest.approx(max(expected + 0.9 * drift, 0.09))
    with pytest.raises(ValueError, match=r"drift_per_lap must lie in \[-0.5, 0.5\], got -0.6"):
        RoadChanges(drift_per_lap=-0.6)


def test_changes_of_a_road_need_a_superbike_on_a_circuit() -> None:
    slippery = load_disturbances("road_090")
    with pytest.raises(ValueError, match="'whipple' is a bicycle"):
        Simulator(COMPILED, slippery)
    simulator = Simulator(SimulatorConfig("r1", "compiled", 0.002, 0.02), slippery)
    with pytest.raises(ValueError, match="course 'line' is a path"):
        simulator.reset(ResetRequest(course="line", speed_range=(20.0, 20.0)))
    simulator.close()


@pytest.mark.parametrize("vehicle", shipped_superbikes())
def test_shipped_files_of_superbikes_disturb_each(vehicle: str) -> None:
    config = SimulatorConfig(vehicle, "compiled", 0.002, 0.02)
    known = [Disturbances(), *map(load_disturbances, OF_SUPERBIKES)]
    batch = Batch(len(known), config, disturbances=known)
    for row in range(len(known)):
        batch.reset(row, ResetRequest(course="line", speed_range=(20.0, 20.0)))
    for step in range(60):
        batch.step(np.tile([0.3 if step < 30 else -0.3, 1.0 if step < 40 else -1.0], (len(known), 1)))
    assert len({tuple(state) for state in batch.state}) == len(known)
    batch.close()
