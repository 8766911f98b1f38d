"""Rides of the real nodes come out again from their recording, bit for bit."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

from bike_policy.contract.bundle import load_bundle
from bike_policy.contract.observation import RACE_LAYOUTS
from bike_policy.riders.disturbed import DisturbedRider
from bike_policy.riders.rider import make_rider
from bike_sim.physics import state as st
from bike_sim.physics.superbike.engine import TIME_STEP
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.worlds import load_disturbances
from bike_training.curricula.parts import PartsCurriculum
from bike_training.envs.env import BikeEnv
from bike_training.explain.observations import read_observations
from bike_training.learning.episode_recording import Standing, TrainingRecorder
from bike_training.replay import Replay, read_rides, ride_again
from bike_training.rollout.rollout import rollout
from bike_training.tasks.path import TASKS

pytestmark = pytest.mark.ros

CONFIG = SimulatorConfig(engine="pybullet", time_step=0.005)


def replays(path: Path) -> list[Replay]:
    return [ride_again(recorded) for recorded in read_rides(path)[1]]


def end(*programs) -> None:
    assert [program.end()[0] for program in programs] == [0] * len(programs)


@pytest.mark.slow
def test_rides_in_lockstep_come_out_the_same(ros, policy, tmp_path: Path) -> None:
    """The ride that the node begins, and one asked for at random; a recorder starts before the node, another after."""
    paths = [tmp_path / "early" / "ride.mcap", tmp_path / "late" / "ride.mcap"]
    early = ros.start("bike_sim.ros.record", path=str(paths[0]))
    simulator = ros.simulator(course="circle")
    probe = ros.probe()
    late = ros.start("bike_sim.ros.record", path=str(paths[1]))
    probe.pause(True)
    driver = ros.start("bike_policy.drive", policy=policy)
    probe.until(lambda: all(probe.records("episode", "state", "command", file=path) for path in paths))
    probe.pause(False)
    probe.until(lambda: probe.states[-1].step > 30)
    assert probe.reset(ResetRequest(seed=8, speed_range=(4.0, 4.5), perturb=True)).success
    probe.until(lambda: probe.states[-1].episode == 2 and probe.states[-1].step > 30)
    end(driver, early, late, simulator)
    for path in paths:
        found = replays(path)
        assert [replay.same for replay in found] == [True, True]
        assert all(replay.states == replay.recorded_states > 25 for replay in found)
        assert (found[0].config.engine, found[0].config.time_step, found[0].learned) == ("pybullet", 0.005, 0)


DISTURBANCES = """format: bike.disturbances/1
seed: 3
wind: {force_n: 5.0, gust_n: 5.0}
impulses: {impulse_ns: 8.0, every_s: 0.5}
noise: {roll: 0.002, lateral: 0.01}
bias: {roll: 0.003}
command_delay_s: 0.05
drive_torque_nm: 6.0
vehicle: {mB: 1.1}
"""


def test_a_disturbed_ride_is_the_same_everywhere(ros, policy, tmp_path: Path) -> None:
    """One file: through the nodes, replayed from their recording, in this process, and in a batch."""
    path, file = tmp_path / "ride.mcap", tmp_path / "rough.yaml"
    file.write_text(DISTURBANCES)
    recorder = ros.start("bike_sim.ros.record", path=str(path))
    simulator = ros.simulator(course="circle", disturbances=str(file))
    probe = ros.probe()
    probe.pause(True)
    driver = ros.start("bike_policy.drive", policy=policy, disturbances=str(file))
    probe.until(lambda: probe.records("episode", "state", "command", "disturbances"))
    probe.pause(False)
    probe.until(lambda: probe.states[-1].step > 60 or probe.states[-1].fallen)
    end(driver, recorder, simulator)
    (recorded,) = read_rides(path)[1]
    known = load_disturbances(file)
    assert recorded.disturbances == known
    replay = ride_again(recorded)
    assert replay.same
    assert replay.states == replay.recorded_states > 40
    assert recorded.start is not None
    assert not ride_again(dataclasses.replace(recorded, disturbances=None)).same
    steps = replay.states - 1
    here = Simulator(CONFIG, known)
    snapshots = rollout(here, DisturbedRider(make_rider(policy), known), recorded.start.request)
    ride = [snapshot for snapshot, _ in zip(snapshots, range(steps + 1), strict=False)]
    here.close()
    batch = Batch(2, CONFIG, recorded.start.request.preview, known)
    for row in range(2):
        batch.reset(row, recorded.start.request)
    for snapshot in ride[1:]:
        batch.step(np.full((2, 2), [snapshot.steering, snapshot.throttle]))
    for row in range(2):
        np.testing.assert_array_equal(batch.state[row], ride[-1].state)
    batch.close()
    for name, place in (("x", st.X), ("roll", st.ROLL), ("steer_rate", st.STEER_RATE)):
        np.testing.assert_array_equal(recorded.columns[name][: steps + 1], [one.state[place] for one in ride])


def test_a_ride_of_a_learner_behind_ros_comes_out_the_same(tmp_path: Path) -> None:
    """The simulator of the training is a node; the recording holds what the learner got from it."""
    ranges, path = PartsCurriculum().episodes(0), tmp_path / "training.mcap"
    env = DummyVecEnv([lambda: BikeEnv("ros", "lean", ranges, CONFIG)])
    env.seed(2)
    try:
        recorder = TrainingRecorder(env, TASKS["lean"], CONFIG)
        last, still, seen = env.reset()[0], np.zeros((1, 1), dtype=np.float32), []
        recorder.record_next(path)
        while recorder.recording or not seen:
            seen += [last] if recorder.recording else []
            after = env.step(still)[0][0]
            recorder.stepped(last, still[0], lambda: Standing(0, 1, ranges))
            last = after
    finally:
        env.close()
    (recorded,) = read_rides(path)[1]
    replay = ride_again(recorded)
    assert replay.same
    assert replay.learned == replay.states - 1 == len(seen) > 20
    assert recorded.learned is not None
    np.testing.assert_array_equal(recorded.learned.observation, seen)


def test_a_ride_by_the_clock_comes_out_the_same(ros, tmp_path: Path) -> None:
    """Free mode: commands come when they come, some periods repeat the last, and silence sets it straight."""
    path = tmp_path / "ride.mcap"
    recorder = ros.start("bike_sim.ros.record", path=str(path))
    simulator = ros.simulator(mode="free", command_timeout_s=0.2, real_time_factor=2.0)
    probe = ros.probe()
    probe.until(lambda: probe.records("episode", "state") and probe.commands.get_subscription_count() == 2)
    for steering in (0.02, -0.03, 0.01):
        probe.command(probe.states[-1], steering, episode=0)  # answers no particular state, so it is never too late
        probe.until(lambda steering=steering: probe.states[-1].steering_command == steering)
    probe.until(lambda: probe.states[-1].steering_command == 0.0)
    end(recorder, simulator)
    ((replay, recorded),) = zip(replays(path), read_rides(path)[1], strict=True)
    assert replay.same
    assert replay.missing == 0
    applied = recorded.columns["steering_command"]
    assert set(applied) == {0.0, 0.02, -0.03, 0.01}
    assert applied[-1] == 0.0
    assert len(applied) > 10


def test_a_superbike_comes_out_the_same(ros, tmp_path: Path) -> None:
    """Its tyres, engine and rider have inner states that no message shows: they begin as the request says."""
    circuit = tmp_path / "ring.csv"
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    rows = "\n".join(f"{150.0 * np.cos(a):.4f},{150.0 * np.sin(a):.4f},6.0,6.0" for a in angle)
    circuit.write_text(f"# x_m,y_m,w_tr_right_m,w_tr_left_m\n{rows}\n")
    path = tmp_path / "ride.mcap"
    recorder = ros.start("bike_sim.ros.record", path=str(path))
    simulator = ros.simulator(
        vehicle="panigale_v4r", course=str(circuit), time_step=TIME_STEP, line=0.5, progress=40.0, speed=20.0, seed=4
    )
    probe = ros.probe()
    probe.until(lambda: probe.records("episode", "state") and probe.commands.get_subscription_count() == 2)
    state = probe.states[-1]
    for step in range(150):
        state = probe.answer(state, -state.roll + 0.05 * np.sin(0.1 * step), throttle=0.4 * np.cos(0.05 * step))
    end(recorder, simulator)
    (replay,) = replays(path)
    assert replay.same
    assert replay.states == replay.recorded_states == 151
    bundle = load_bundle("spdl_barcelona")
    seen = read_observations(path, bundle)  # what a policy that races would have seen of it
    assert seen.observations.shape == (50, RACE_LAYOUTS["compact"].size)
    assert seen.differ > 0.1
    with pytest.raises(ValueError, match="no section 'chicane'"):
        read_observations(path, bundle, "chicane")
