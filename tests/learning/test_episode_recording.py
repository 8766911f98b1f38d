"""Recordings of training are recordings like any other, and tell what was learned from."""

import json
import resource
import warnings
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from bike_analysis.read.columns import MessageSchema
from bike_analysis.read.container import Container
from bike_analysis.report import analyze
from bike_policy.contract.bundle import Actor
from bike_policy.contract.observation import ObservationLayout, Rows
from bike_sim.physics.state import FIELDS
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.request import ResetRequest
from bike_training.curricula.parts import REFINEMENT, PartsCurriculum
from bike_training.envs.env import BikeEnv
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.learning.learner import actor_tensors
from bike_training.learning.presets import load_preset
from bike_training.learning.process import LearningProcess
from bike_training.learning.run_settings import RunSettings
from bike_training.replay import read_rides, ride_again
from bike_training.tasks.path import TASKS, PathTask
from bike_training.tasks.race import RaceTask

pytest.importorskip("rclpy")
from bike_training.learning.episode_recording import Standing, TrainingRecorder, record_ride

COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)
PYBULLET = SimulatorConfig(engine="pybullet", time_step=0.005)
SHARP_AND_UPRIGHT = {"path_linear": 0.4, "path_peak": 0.4, "upright": 0.2}
SHORT = replace(TASKS["lean"], weights=SHARP_AND_UPRIGHT, max_steps=12)
RANGES = PartsCurriculum().episodes(0)
LEAN = TASKS["lean"]
STILL = Actor([np.zeros((1, LEAN.layout.size), dtype="f4")], [np.zeros(1, dtype="f4")])
"""Does nothing."""
REQUEST = ResetRequest(seed=1, speed_range=RANGES.speed, path_ranges=RANGES.paths, perturb=True, preview=LEAN.preview)


def messages(path: Path, topic: str) -> list:
    """Decode all messages of a topic."""
    box = Container(path)
    found = []
    for message in box.messages():
        channel = box.channels[message.channel]
        if channel.topic == topic:
            schema = box.schemas[channel.schema_id]
            found.append(MessageSchema(schema.name, schema.data.decode()).decode(message.data))
    return found


def blocks_of(state) -> Rows:
    """Return what a recorded state shows."""
    blocks = (np.array([getattr(state, name) for name in names]) for names in (FIELDS, lk.FIELDS))
    return Rows.of_path(*(block[None] for block in blocks), np.array([[state.preview_x, state.preview_y]]))


def notes(path: Path) -> dict:
    box = Container(path)
    list(box.blocks())
    return box.metadata["ride_notes"]


@pytest.fixture(scope="module")
def validation(tmp_path_factory) -> Path:
    """A recorded validation ride of an actor that does nothing."""
    path = tmp_path_factory.mktemp("validation") / "episode.mcap"
    record_ride(path, STILL, LEAN, COMPILED, REQUEST, Standing(4000, 2, RANGES))
    return path


def test_recorded_ride_reads_back(validation, tmp_path):
    figures = analyze(validation, tmp_path)
    (ride,) = figures["rides"]
    assert ride["course"] == "random"
    assert ride["falls"] == 1  # nobody steers
    assert ride["lost_steps"] == 0
    assert not figures["truncated"]
    steps = messages(validation, "/bike/learning/step")
    assert len(steps) + 1 == len(messages(validation, "/bike/state"))
    assert {(step.learning_step, step.part, step.deterministic) for step in steps} == {(4000, 2, True)}
    assert [step.terminated for step in steps] == [False] * (len(steps) - 1) + [True]
    for step in steps:
        assert (step.speed_min, step.speed_max) == ([4.0], [4.0])
        assert (step.radius_min, step.quintic_width_max) == ([14.0], [2.0])


def test_every_state_has_its_course_points_and_its_history_of_lean(validation):
    states = messages(validation, "/bike/state")
    for topic in ("/bike/course_points", "/bike/lean_history"):
        assert [message.step for message in messages(validation, topic)] == [state.step for state in states]


def test_what_the_policy_saw_is_made_of_the_recorded_states(validation):
    """The recording alone is enough to make the observation again, by the layout that it notes."""
    task = json.loads(notes(validation)["task"])
    layout = ObservationLayout.from_card(task["layout"])
    states, steps = messages(validation, "/bike/state"), messages(validation, "/bike/learning/step")
    for state, step in zip(states, steps, strict=False):
        seen = layout.observe(blocks_of(state))[0]
        assert (state.episode, state.step) == (step.episode, step.step)
        assert tuple(step.feature_names) == layout.names
        np.testing.assert_array_equal(seen, step.observation)


def test_rewards_are_those_of_the_next_state_and_the_sum_of_their_terms(validation):
    task = PathTask.from_card(json.loads(notes(validation)["task"]))
    states, steps = messages(validation, "/bike/state"), messages(validation, "/bike/learning/step")
    for state, step in zip(states[1:], steps, strict=True):
        terms = task.reward_terms(blocks_of(state))
        assert dict(zip(step.reward_names, step.reward_terms, strict=True)) == terms
        assert step.reward == sum(step.reward_terms)
        assert (state.steering_command, [0.0]) == (step.steering, list(step.action))


def test_a_superbikes_whole_action_is_recorded(tmp_path):
    task = RaceTask(validation_duration=0.3)
    biases = np.array([0.2, 0.4], dtype="f4")
    actor = Actor([np.zeros((2, task.layout.size), dtype="f4")], [biases])
    request = ResetRequest(course="barcelona", speed_range=(40.0, 40.0), progress=200.0)
    config = replace(superbike_config("panigale_v4r"), engine="compiled")
    path = tmp_path / "episode.mcap"
    record_ride(path, actor, task, config, request, Standing(4000, 1, None))
    steps = messages(path, "/bike/learning/step")
    assert len(steps) == 5
    for step in steps:
        np.testing.assert_array_equal(step.action, actor.act(np.zeros(task.layout.size, dtype="f4")))
    assert len(messages(path, "/bike/telemetry")) == 1 + 5 * task.repeat
    (replayed,) = read_rides(path)[1]
    assert ride_again(replayed).same
    assert ride_again(replayed).learned == 5


def compiled() -> VecEnv:
    return BatchVecEnv(2, SHORT, RANGES, COMPILED, seed=3)


def bullets() -> VecEnv:
    env = DummyVecEnv([lambda: BikeEnv("local", SHORT, RANGES, PYBULLET)] * 2)
    env.seed(3)
    return env


@pytest.mark.parametrize(("make", "config"), [(compiled, COMPILED), (bullets, PYBULLET)])
def test_rides_of_the_learner_are_recorded_as_it_learned_from_them(make, config, tmp_path):
    """Two episodes make a ride; what is recorded is what environment and policy exchanged."""
    env, path = make(), tmp_path / "training.mcap"
    recorder = TrainingRecorder(env, SHORT, config)
    seen, rng = [env.reset()], np.random.default_rng(0)
    actions, rewards = [], []
    recorder.record_next(path)
    for made in range(5 * SHORT.max_steps):  # the first ride, of two episodes, has begun already
        actions.append(rng.uniform(-0.02, 0.02, (2, 1)).astype(np.float32))
        observations, reward, _, _ = env.step(actions[-1])
        standing = Standing(2 * made, 5, REFINEMENT)
        recorder.stepped(seen[-1][0], actions[-1][0], lambda standing=standing: standing)
        seen.append(observations)
        rewards.append(reward)
    recorder.close()
    first, last = 2 * SHORT.max_steps, 4 * SHORT.max_steps
    steps = messages(path, "/bike/learning/step")
    assert len(steps) == last - first
    np.testing.assert_array_equal([s.observation for s in steps], [s[0] for s in seen[first:last]])
    np.testing.assert_array_equal([s.action for s in steps], [a[0] for a in actions[first:last]])
    np.testing.assert_array_equal(np.float32([s.reward for s in steps]), [r[0] for r in rewards[first:last]])
    assert [s.learning_step for s in steps] == list(range(2 * first, 2 * last, 2))
    assert [s.learning_episode for s in steps] == [1] * SHORT.max_steps + [2] * SHORT.max_steps
    assert [s.learning_episode_step for s in steps] == 2 * list(range(SHORT.max_steps))
    assert [k for k, s in enumerate(steps) if s.truncated] == [SHORT.max_steps - 1, 2 * SHORT.max_steps - 1]
    assert not any(s.terminated or s.deterministic for s in steps)
    sets = (REFINEMENT, *REFINEMENT.also)
    assert len(sets) > 1
    np.testing.assert_array_equal(steps[0].speed_max, [ranges.speed[1] for ranges in sets])
    np.testing.assert_array_equal(steps[0].radius_min, [ranges.paths.radius_min for ranges in sets])
    assert set(steps[0].reward_names) == {"path_linear", "path_peak", "upright"}
    assert (recorder.recording, len(messages(path, "/bike/episode"))) == (False, 1)


def test_a_run_records_validations_and_rides_of_the_learner_and_learns_the_same(tmp_path):
    """Recording changes nothing in what is learned, and checkpoints are written while it goes on."""
    tiny = {"layers": [8, 8], "batch_size": 32, "learning_starts": 400, "updates": 1}
    preset = load_preset("fast").changed({"learner": "sb3", **{f"learner.{name}": tiny[name] for name in tiny}})

    def learned(name: str, record_every: int) -> np.ndarray:
        settings = RunSettings(preset, seed=3, record_every=record_every, checkpoint_every=400)
        process = LearningProcess(settings, tmp_path / name, 1200)

        def ask_for_validation(p: LearningProcess) -> None:
            if p.model.num_timesteps == 160:
                p.validate()

        process.run(ask_for_validation)
        assert len(process.progress.validations) == 1
        return np.concatenate([part.ravel() for parts in actor_tensors(process.model) for part in parts])

    np.testing.assert_array_equal(learned("recorded", 1), learned("plain", 0))
    assert not (tmp_path / "plain" / "episodes").exists()
    folder = tmp_path / "recorded" / "episodes"
    assert sorted(path.name for path in folder.iterdir()) == ["step_000000160.mcap", "step_000000160_training.mcap"]
    validated, trained = (messages(path, "/bike/learning/step") for path in sorted(folder.iterdir()))
    assert {step.learning_step for step in validated} == {160}
    steps = [step.learning_step for step in trained]
    assert steps == list(range(steps[0], steps[-1] + 1, 8))
    assert steps[0] >= 160
    assert trained[-1].terminated
    assert {step.part for step in (*validated, *trained)} == {1}


@contextmanager
def small_disk(size: int):
    """Limit the files that this process may write, as a disk that is full does.

    Not a fixture: the test runner, whose own output may be a file, writes before fixtures are torn down.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("validation")  # compiles what is not compiled yet: the compiler's cache needs the disk too
@pytest.mark.parametrize("size", [0, 40_000])
def test_a_full_disk_ends_the_recording_and_not_the_learning(size, tmp_path):
    """From the first byte or amid a ride: one warning with path and reason, then the environment goes on as before."""
    task = replace(SHORT, max_steps=400)
    env, path = BatchVecEnv(2, task, RANGES, COMPILED, seed=3), tmp_path / "training.mcap"
    recorder, seen, still = TrainingRecorder(env, task, COMPILED), [env.reset()], np.zeros((2, 1), dtype=np.float32)

    def step() -> None:
        after = env.step(still)[0]
        recorder.stepped(seen[-1][0], still[0], lambda: Standing(0, 1, RANGES))
        seen[:] = [after]

    def record_one_ride() -> None:
        recorder.record_next(path)
        while not recorder.recording:
            step()
        recorder.close()

    record_one_ride()  # compiles the environment too
    path.unlink()
    recorder.record_next(path)
    with small_disk(size), warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        for _ in range(2000):  # nobody steers: rides are short, and those after the first are recorded no more
            step()
    recorder.close()
    told_of_path = [str(warning.message) for warning in told if str(path) in str(warning.message)]
    assert len(told_of_path) == 1
    assert "File too large" in told_of_path[0]
    assert not recorder.recording
    assert path.stat().st_size <= size
    record_one_ride()  # and once there is room again
    assert messages(path, "/bike/episode")


@pytest.mark.usefixtures("validation")
@pytest.mark.parametrize(
    ("size", "reason"), [(0, "File too large"), (20_000, "File too large"), (None, "cannot be made")]
)
def test_validation_rides_that_cannot_be_recorded_are_told_of(size, reason, tmp_path):
    path = tmp_path / "folder" / "episode.mcap"
    if size is None:
        (tmp_path / "folder").write_text("a file is in the way", encoding="utf-8")
    room = nullcontext() if size is None else small_disk(size)
    with room, pytest.warns(UserWarning, match=f"episode.mcap is not recorded further.*{reason}"):
        record_ride(path, STILL, LEAN, COMPILED, REQUEST, Standing(4000, 2, RANGES))
