"""A run that is stopped and resumed is the run that was not stopped."""

import csv
import math
import os
import shutil
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.logger import Logger

from bike_sim.sim.batch import COMPILED_ENGINE
from bike_sim.sim.beginning import begin
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.simulator import Simulator
from bike_training.curricula.parts import PARTS, TRANSITION_STEPS, PartsCurriculum
from bike_training.envs.env import BikeEnv
from bike_training.envs.node_process import NodeLost
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.learning.learner import AveragedActor, actor_tensors, build_model
from bike_training.learning.presets import load_preset
from bike_training.learning.process import LearningProcess
from bike_training.learning.run_settings import RunSettings
from bike_training.learning.validation import SideBySide, kept
from bike_training.tasks.path import TASKS

TINY = {
    "learner.layers": [16, 16],
    "learner.batch_size": 32,
    "learner.learning_starts": 80,
    "learner.environments": 8,
    "learner.updates": 2,
    "learner.buffer_size": 5000,
}
COMPILED = SimulatorConfig(engine=COMPILED_ENGINE, time_step=0.01)
CHECKPOINT_FILES = ["state.json", "tensors.safetensors", "replay.npz"]


def learner_settings() -> RunSettings:
    preset = load_preset("fast").changed({"learner": "sb3", "curriculum.validate_every": 160, **TINY})
    return RunSettings(preset, seed=3, checkpoint_every=10_000)


def weights(process: LearningProcess) -> np.ndarray:
    return np.concatenate([part.ravel() for parts in actor_tensors(process.model) for part in parts])


def open_files(folder: Path) -> list[str]:
    """Return the files in a folder that this process holds open."""
    held = (os.path.realpath(link) for link in Path("/proc/self/fd").iterdir())
    return [path for path in held if path.startswith(str(folder.resolve()))]


def test_paper_preset_learns_over_a_simulator(tmp_path):
    """One update a step on PyBullet, as published but tiny."""
    preset = load_preset("paper").changed({"learner.layers": [16, 16], "learner.learning_starts": 50})
    process = LearningProcess(RunSettings(preset, engine="pybullet"), tmp_path, 200)
    process.run()
    assert process.model._n_updates == 150
    assert not open_files(tmp_path)
    resumed = LearningProcess(RunSettings(preset, engine="pybullet"), tmp_path, 260, resume=True)
    resumed.run()
    assert resumed.model._n_updates == 210


@pytest.mark.slow
def test_learning_learns(tmp_path):
    """A few thousand steps must make rides at least twice as long as random ones."""
    changes = {"learner.learning_starts": 1000, "learner.layers": [32, 32], "learner.updates": 16}
    changes |= {"learner.learning_rate": 1.5e-3, "learner.final_learning_rate": 1.5e-3}
    settings = RunSettings(load_preset("fast").changed(changes), seed=1, record_every=0)
    process = LearningProcess(settings, tmp_path, 4400)
    lengths: list[float] = []

    def note(p: LearningProcess) -> None:
        lengths.append(p.env.steps.mean())

    process.run(note)
    early, late = np.mean(lengths[30:90]), np.mean(lengths[-60:])
    assert late > 2.0 * early


def test_without_ros_rides_are_not_recorded_and_learning_goes_on(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "bike_training.learning.episode_recording", raising=False)
    monkeypatch.setitem(sys.modules, "bike_msgs.msg", None)
    process = LearningProcess(replace(learner_settings(), record_every=1), tmp_path, 160)
    with pytest.warns(UserWarning, match="learning goes on: bike_msgs of ROS 2 is missing"):
        process.validate()
    process.run()
    assert not (tmp_path / "episodes").exists()
    assert process.model.num_timesteps == 160


def test_a_folder_with_a_run_is_not_overwritten_and_an_empty_one_not_resumed(tmp_path):
    settings = learner_settings()
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        LearningProcess(settings, tmp_path, 8, resume=True)
    LearningProcess(settings, tmp_path, 8).run()
    with pytest.raises(ValueError, match="already holds a run"):
        LearningProcess(settings, tmp_path, 8)


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_anew(tmp_path):
    process = tiny_process(tmp_path)
    process.validate()
    (tmp_path / "selection.csv").write_text("2,0.1\n")
    process.close()
    tiny_process(tmp_path).close()
    assert len((tmp_path / "validations.csv").read_text().splitlines()) == 1
    assert not (tmp_path / "selection.csv").exists()


def test_a_run_goes_on_with_another_simulator(tmp_path):
    """First on the compiled engine with many bicycles, then on PyBullet with two."""
    settings = learner_settings()
    first = LearningProcess(settings, tmp_path, 160)
    first.run()
    preset = settings.preset.changed({"learner.environments": 2, "learner.updates": 1})
    second = LearningProcess(replace(settings, preset=preset, engine="pybullet"), tmp_path, 200, resume=True)
    assert second.model.replay_buffer.size() * 2 == first.model.replay_buffer.size() * 8
    np.testing.assert_array_equal(weights(second), weights(first))
    second.run()
    assert second.model.num_timesteps == 200
    assert second.model._n_updates == first.model._n_updates + 20
    stages = [(stage["engine"], stage["environments"], stage["updates"]) for stage in second.summary()["stages"]]
    assert stages == [("whipple", 8, settings.preset.sac.updates), ("pybullet", 2, 1)]
    assert np.abs(weights(second) - weights(first)).max() > 0.0


def test_a_signal_stops_with_a_whole_checkpoint(tmp_path):
    process = LearningProcess(learner_settings(), tmp_path, 100_000)

    def ask(p: LearningProcess) -> None:
        if p.model.num_timesteps == 400:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(KeyboardInterrupt):
        process.run(ask)
    resumed = LearningProcess(learner_settings(), tmp_path, 440, resume=True)
    assert resumed.model.num_timesteps == 400
    np.testing.assert_array_equal(weights(resumed), weights(process))
    resumed.close()


def tiny_process(folder: Path, **changes) -> LearningProcess:
    settings = replace(learner_settings(), **changes)
    return LearningProcess(
        replace(settings, preset=settings.preset.changed({"learner.environments": 2, "learner.updates": 1})),
        folder,
        400,
    )


def drawn_seeds(process: LearningProcess, monkeypatch, steps: int) -> list[int]:
    """Return the seeds of all rides that a process begins while it makes some more steps."""
    seeds = []

    def note(request, *rest):
        seeds.append(request.seed)
        return begin(request, *rest)

    with monkeypatch.context() as patch:
        patch.setattr("bike_sim.sim.batch.begin", note)
        process.steps = process.model.num_timesteps + steps
        process.run()
    return seeds


@pytest.mark.parametrize("engine", ["whipple", "pybullet"])
def test_neighbouring_seeds_share_no_ride(engine, tmp_path, monkeypatch):
    """Nor a network; neither with each other, nor a run's rides with those that it or another is validated on."""
    drawn, networks = [], []
    for seed in (0, 1):
        process = tiny_process(tmp_path / str(seed), seed=seed, engine=engine)
        networks.append(weights(process))
        progress = process.progress
        requests = progress.curriculum.validation_requests(process.task.preview, progress.rng)
        drawn.append([request.seed for request in requests])
        drawn.append(drawn_seeds(process, monkeypatch, 100))
        assert len(drawn[-1]) > 2
    together = [seed for seeds in drawn for seed in seeds]
    assert len(set(together)) == len(together)
    assert np.abs(networks[0] - networks[1]).max() > 1e-3


def test_a_resumed_run_on_a_simulator_begins_new_rides(tmp_path, monkeypatch):
    first = drawn_seeds(tiny_process(tmp_path, engine="pybullet"), monkeypatch, 100)
    settings = tiny_process(tmp_path / "other", engine="pybullet").settings
    second = drawn_seeds(LearningProcess(settings, tmp_path, 200, resume=True), monkeypatch, 100)
    assert second
    assert not set(first) & set(second)
    # They depend on the seed and on the step and on nothing else.
    assert drawn_seeds(tiny_process(tmp_path / "again", engine="pybullet"), monkeypatch, 100) == first


def test_a_stored_actor_stays_as_it_was():
    """As the best one and the last one that passed a validation are stored while the average goes on."""
    model, averaged = tiny_model(), AveragedActor(0.9)
    averaged.update(model)
    stored = averaged.actor()
    observation = np.linspace(-1.0, 1.0, stored.inputs, dtype=np.float32)
    before = stored.act(observation)
    for parameter in model.actor.parameters():
        parameter.data += 0.5
    averaged.update(model)
    assert averaged.actor().act(observation) != before
    assert stored.act(observation) == before


def tiny_model():
    task = TASKS["lean"]
    env = BatchVecEnv(1, task, PartsCurriculum().episodes(0), COMPILED, seed=0)
    return build_model(replace(load_preset("paper").sac, layers=(4,), buffer_size=10), task, env, seed=0)


def test_a_full_episode_asks_for_a_validation_only_when_one_is_allowed(tmp_path):
    """After the wait and outside of a transition; one that came sooner is not remembered (Sects. 4.2 and 4.3)."""
    process = tiny_process(tmp_path)
    process.init_callback(process.model)
    every = process.settings.preset.curriculum.validate_every

    def due_after_full_episode(step: int) -> bool:
        process.model.num_timesteps = step
        process.locals = {"infos": [{}, {"TimeLimit.truncated": True}]}
        process.on_step()
        return process.validation_is_due()

    def due_without(step: int) -> bool:
        process.num_timesteps = step
        return process.validation_is_due()

    assert not due_after_full_episode(every - 2)
    assert not due_without(every + 2)
    assert due_after_full_episode(every + 4)
    assert not due_without(every + 6)
    process.progress.curriculum.validated(every + 4, [0.0])
    assert not process.progress.curriculum.may_validate(3 * every)
    assert not due_after_full_episode(3 * every)
    assert not due_without(every + 4 + TRANSITION_STEPS)
    assert due_after_full_episode(every + 4 + TRANSITION_STEPS)
    process.close()


def test_each_session_logs_episodes_in_a_table_of_its_own(tmp_path, monkeypatch):
    """With mean length and return of the episodes, on either engine; a resume keeps the table of the first session."""
    monkeypatch.setattr("bike_training.learning.process.LOG_EVERY", 200)
    for engine in ("whipple", "pybullet"):
        folder = tmp_path / engine
        process = tiny_process(folder, engine=engine)
        process.steps = 210
        process.run()
        first = (folder / "tensorboard" / "progress.csv").read_text()
        row = next(csv.DictReader(first.splitlines()))
        assert 5.0 < float(row["rollout/ep_len_mean"]) < 200.0
        assert 0.0 < float(row["rollout/ep_rew_mean"]) < float(row["rollout/ep_len_mean"])
        resumed = LearningProcess(process.settings, folder, 420, resume=True)
        resumed.run()
        assert (folder / "tensorboard" / "progress.csv").read_text() == first
        second = (folder / "tensorboard" / "progress_from_000000210.csv").read_text()
        assert [row["time/total_timesteps"] for row in csv.DictReader(second.splitlines())] == ["410"]
    assert not open_files(tmp_path)


def test_an_actor_that_swings_ends_no_curriculum_and_is_selected_behind_each_that_does_not(tmp_path, monkeypatch):
    """However well it rides the paths of validations."""
    process, stable = tiny_process(tmp_path), []
    preset = process.settings.preset.changed({"curriculum.stable": True, "curriculum.last_speeds": 2})
    process.settings = replace(process.settings, preset=preset)
    process.progress.curriculum = curriculum = preset.curriculum.make([])
    process.model.set_logger(Logger(None, []))
    monkeypatch.setattr(SideBySide, "errors", lambda self, actor, requests: [0.0] * len(requests))
    ridden = np.zeros((1, 1)), np.ones(1, dtype=bool)
    monkeypatch.setattr("bike_training.learning.process.ride_side_by_side", lambda *_, **__: ridden)
    monkeypatch.setattr("bike_training.learning.process.is_stable", lambda *_: stable.pop())
    while curriculum.part < PARTS:
        process.validate()  # of parts before the last one it does not ask
    process.progress.latest_success = None
    stable += [True, False]
    process.validate()
    assert not curriculum.finished
    assert process.progress.latest_success is not None  # it rode all
    process.validate()
    assert curriculum.finished
    stable += [True, False]
    process.select()
    assert process.progress.selections[-1][1] == process.task.largest_error
    process.select()
    assert process.progress.best_error_m == 0.0
    assert not stable
    process.close()


def test_actors_of_some_steps_stay_also_in_a_run_that_goes_on(tmp_path):
    process = tiny_process(tmp_path / "whole", keep_every=70)
    process.run()
    assert sorted(int(path.stem) for path in (tmp_path / "whole" / "actors").iterdir()) == [70, 140, 210, 280, 350]
    parts = tiny_process(tmp_path / "parts", keep_every=70)

    def stop(process: LearningProcess) -> None:
        if process.model.num_timesteps >= 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        parts.run(stop)
    assert kept(tmp_path / "parts", 141) is None
    LearningProcess(parts.settings, tmp_path / "parts", 400, resume=True).run()
    for step in (70, 71, 350):
        (at, actor), (other_at, other) = kept(tmp_path / "whole", step), kept(tmp_path / "parts", step)
        assert at == other_at == math.ceil(step / 70) * 70
        for name, tensor in other.tensors().items():
            np.testing.assert_array_equal(actor.tensors()[name], tensor)
    assert kept(tmp_path / "whole", 351) is None


def test_rows_that_a_kill_left_behind_the_checkpoint_are_dropped(tmp_path):
    process = tiny_process(tmp_path, checkpoint_every=100)

    def act(p: LearningProcess) -> None:
        if p.model.num_timesteps in (40, 120):
            p.validate()
            p.select()
        if p.model.num_timesteps == 140:
            shutil.copytree(tmp_path, copy)
            raise KeyboardInterrupt

    copy = tmp_path.with_name("killed")
    with pytest.raises(KeyboardInterrupt):
        process.run(act)
    with (copy / "validations.csv").open("a") as file:
        file.write("16")  # a row that the kill cut short
    resumed = LearningProcess(process.settings, copy, 400, resume=True)
    assert resumed.model.num_timesteps == 100
    rows = list(csv.DictReader((copy / "validations.csv").open()))
    assert [row["step"] for row in rows] == ["40"]
    assert [line.split(",")[0] for line in (copy / "selection.csv").read_text().splitlines()] == ["40"]
    resumed.close()


@pytest.mark.parametrize("survivor", ["checkpoint.new", "checkpoint.old"])
def test_a_kill_between_the_renames_of_a_checkpoint_costs_nothing(survivor, tmp_path):
    process = tiny_process(tmp_path)
    process.steps = 40
    process.run()
    (tmp_path / "checkpoint").rename(tmp_path / survivor)
    if survivor == "checkpoint.old":
        (tmp_path / "checkpoint.new").mkdir()  # one whose writing was not finished
    resumed = LearningProcess(process.settings, tmp_path, 60, resume=True)
    assert resumed.model.num_timesteps == 40
    resumed.run()
    assert sorted(path.name for path in tmp_path.glob("checkpoint*")) == ["checkpoint"]


def test_a_damaged_checkpoint_is_named(tmp_path):
    process = tiny_process(tmp_path)
    process.steps = 40
    process.run()
    for name in CHECKPOINT_FILES:
        path = tmp_path / "checkpoint" / name
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
        with pytest.raises(ValueError, match=rf"{name} cannot be read .*damaged") as told:
            LearningProcess(process.settings, tmp_path, 60, resume=True)
        assert "\n" not in str(told.value)
        path.write_bytes(whole)


class Closed:
    """Counts what a process closes."""

    def __init__(self, monkeypatch, broken: bool = False) -> None:
        self.count = 0
        close = BikeEnv.close

        def counted(env: BikeEnv) -> None:
            self.count += 1
            close(env)
            if broken:
                raise OSError("cannot close")

        monkeypatch.setattr(BikeEnv, "close", counted)


@pytest.mark.parametrize(("name", "count"), [("envs.env.make_client", 1), ("learning.process.build_model", 2)])
def test_environments_are_closed_when_one_of_them_or_the_learner_cannot_be_made(name, count, tmp_path, monkeypatch):
    """As when Ctrl-C comes while simulators start one after the other."""
    closed, made = Closed(monkeypatch), []

    def make(*args) -> Simulator:
        if made or "model" in name:
            raise KeyboardInterrupt
        made.append(Simulator(*args[1:]))
        return made[0]

    monkeypatch.setattr(f"bike_training.{name}", make)
    with pytest.raises(KeyboardInterrupt):
        tiny_process(tmp_path, engine="pybullet")
    assert closed.count == count


@pytest.mark.parametrize("broken", [False, True])
def test_all_is_closed_when_the_last_checkpoint_cannot_be_written(broken, tmp_path, monkeypatch):
    """Also where closing an environment fails."""
    closed = Closed(monkeypatch, broken)
    process = tiny_process(tmp_path, engine="pybullet")
    process.steps = 20

    def full(*args) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr("bike_training.learning.process.save_checkpoint", full)
    with pytest.raises(OSError, match="cannot close" if broken else "No space"):
        process.run(lambda p: p.validate() if p.model.num_timesteps == 10 else None)
    assert closed.count == 2
    assert not open_files(tmp_path)


def test_a_process_can_be_asked_after_its_run_and_tells_what_the_task_measures(tmp_path):
    process = tiny_process(tmp_path, engine="pybullet")
    process.steps = 20
    assert process.words() == "part 1"
    process.run(lambda p: p.validate() if p.model.num_timesteps == 10 else None)
    process.validate()
    assert process.words() == f"part 1, validation {process.progress.recent_error_m:.3f} error_m"
    process.close()
    assert len((tmp_path / "validations.csv").read_text().splitlines()) == 3


@pytest.mark.parametrize("step", [0, 30])
def test_a_lost_simulator_leaves_a_checkpoint(step, tmp_path, monkeypatch):
    """For rides on simulators begin anew anyway when a run goes on."""
    process = tiny_process(tmp_path, engine="pybullet")
    name = "step" if step else "reset"
    method = getattr(Simulator, name)

    def lost(simulator, *args):
        if process.model.num_timesteps >= step:
            raise NodeLost("the simulator is gone")
        return method(simulator, *args)

    with monkeypatch.context() as patch:
        patch.setattr(Simulator, name, lost)
        with pytest.raises(NodeLost):
            process.run()
    resumed = LearningProcess(process.settings, tmp_path, 60, resume=True)
    assert resumed.model.num_timesteps == step
    resumed.run()
    assert resumed.model.num_timesteps == 60
