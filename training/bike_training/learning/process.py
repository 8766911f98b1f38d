"""A learning process: learner, environments, curriculum, validations, logs and checkpoints together."""

from __future__ import annotations

import contextlib
import csv
import json
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from safetensors.numpy import save_file
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from bike_policy.contract.actor import Actor
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.curricula.base import Episodes
from bike_training.curricula.parts import PartsCurriculum, RideRanges
from bike_training.envs.env import BikeEnv
from bike_training.envs.node_process import NodeLost
from bike_training.envs.vec_env import BatchVecEnv, SimulatorVecEnv
from bike_training.interruption import signals_handled
from bike_training.learning.checkpoint import (
    drop_rows_after,
    holds_run,
    load_model,
    load_process_state,
    save_checkpoint,
    write_whole,
)
from bike_training.learning.learner import AveragedActor, actor_tensors, build_model
from bike_training.learning.progress import Progress
from bike_training.learning.run_settings import TRAINING_DRAWS, VALIDATION_DRAWS, RunSettings, draws
from bike_training.learning.validation_rides import (
    draw_requests,
    selection_error,
    validate_batch,
    validate_simulator,
)
from bike_training.tasks.base import Task
from bike_training.tasks.path import DISTANCE_THRESHOLD

if TYPE_CHECKING:
    from bike_training.learning.episode_recording import TrainingRecorder  # needs ROS

SELECT_EVERY: Final = 10_000
"""Learning steps between two comparisons of actors once the curriculum is finished."""

LOG_EVERY: Final = 1000
"""Learning steps between two rows of the logs."""

VALIDATION_COLUMNS: Final = ("step", "seconds", "part", "mean_error_m", "max_error_m", "passed", "updates")


class StopLearning(Exception):
    """Ends a run at a point where a checkpoint is whole."""


def make_environment(settings: RunSettings, task: Task, episodes: Episodes) -> VecEnv:
    """Return the vector environment of a run, not yet seeded for it."""
    count = settings.preset.environments
    if settings.compiled:
        return BatchVecEnv(count, task, episodes, settings.simulator(), settings.seed)
    # The monitor tells length and return of each episode, as the compiled environment does itself.
    return SimulatorVecEnv(count, lambda: Monitor(BikeEnv(settings.client, task, episodes, settings.simulator())))


class LearningProcess:
    """Runs a preset until its steps are done, it is stopped, or its curriculum is finished."""

    def __init__(self, settings: RunSettings, out: Path, steps: int, resume: bool = False) -> None:
        """Prepare a run.

        Args:
            settings: what it is.
            out: its folder.
            steps: learning steps in all, earlier sessions included.
            resume: go on from the checkpoint in ``out``.

        Raises:
            FileNotFoundError: nothing to resume from.
            ValueError: the folder holds another run and resume is off, or what it holds cannot be read.
            NodeLost: a simulator behind ROS did not start.
        """
        if steps < 1:
            raise ValueError(f"learning steps must be at least 1, got {steps}")
        self.settings, self.out, self.steps = settings, out, steps
        self.task = settings.preset.make_task()
        self._simulator: Simulator | None = None
        self._recorder: TrainingRecorder | None = None
        self.progress = Progress(
            PartsCurriculum(settings.preset.refine),
            AveragedActor(settings.preset.averaging),
            np.random.default_rng(draws(settings.seed, VALIDATION_DRAWS)),
        )
        self._opened = contextlib.ExitStack()
        try:
            if resume:
                self._take_up()
            else:
                self._begin()
        except BaseException:
            self.close()
            raise
        self.model.set_logger(Logger(None, []))  # logs are written while it runs
        stage = {"client": settings.client, "engine": settings.engine, "from_step": self.model.num_timesteps}
        stages = self.progress.extra.setdefault("stages", [])
        if not stages or (stages[-1]["client"], stages[-1]["engine"]) != (settings.client, settings.engine):
            stages.append(stage)

    def _begin(self) -> None:
        if holds_run(self.out):
            raise ValueError(f"{self.out} already holds a run; resume it or choose another folder")
        self.out.mkdir(parents=True, exist_ok=True)
        self.env = make_environment(self.settings, self.task, self._episodes(0))
        self._opened.callback(self.env.close)
        self.model = build_model(self.settings.preset, self.task, self.env, self.settings.seed)
        self._seed_rides()
        with (self.out / "validations.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerow(VALIDATION_COLUMNS)
        (self.out / "selection.csv").unlink(missing_ok=True)  # of a run that was killed before its first checkpoint

    def _take_up(self) -> None:
        settings, stored = self.settings, load_process_state(self.out)
        self.progress = stored["progress"]
        goes_on = settings.compiled and stored["env"] is not None
        self.env = stored["env"] if goes_on else make_environment(settings, self.task, self._episodes(stored["step"]))
        self._opened.callback(self.env.close)
        self.model = load_model(self.out, self.env)
        self.model.gradient_steps = settings.preset.updates
        if not goes_on:
            self.model._last_obs = None  # a simulator's rides cannot be taken up again: they begin anew
        if not goes_on or stored["step"] == 0:
            self._seed_rides()
        for name in ("validations.csv", "selection.csv"):
            drop_rows_after(self.out / name, self.progress.handled_at)

    def _seed_rides(self) -> None:
        """Seed the rides from the present step on; the learner seeds them with its own seed when it is made."""
        sequence = draws(self.settings.seed, TRAINING_DRAWS, self.model.num_timesteps)
        self.env.seed(int(sequence.generate_state(1, np.uint64)[0]))

    def _episodes(self, step: int) -> RideRanges:
        return self.progress.curriculum.episodes(step)

    def run(self, report: Callable[[LearningProcess], None] | None = None) -> None:
        """Learn; a checkpoint is written at the end, also when stopped by SIGINT, SIGTERM or SIGHUP.

        Args:
            report: called after each step of all bicycles, to show progress.

        Raises:
            KeyboardInterrupt: stopped by a signal, between two steps and with a checkpoint.
            NodeLost: a simulator behind ROS was lost; with a checkpoint too, for its rides begin anew anyway.
        """
        done = self.model.num_timesteps
        callback = _Callback(self, report)
        try:
            if done < self.steps:
                self._open_logs()
                with _stopping_between_steps(callback):
                    self.model.learn(
                        self.steps - done, callback=callback, log_interval=None, reset_num_timesteps=done == 0
                    )
        except StopLearning:
            pass
        except NodeLost:
            # The step that was lost is neither counted nor stored.
            callback.consistent = callback.consistent or not self.settings.compiled
            raise
        finally:
            try:
                if callback.consistent:
                    self.save()
            finally:
                self.close()

    def close(self) -> None:
        """Close environments, simulators and logs, also where closing one fails; a run that has ended has done so."""
        self._opened.close()

    def _open_logs(self) -> None:
        """Begin the logs of a session; each has its own table, for the logger overwrites what it finds."""
        folder, step = str(self.out / "tensorboard"), self.model.num_timesteps
        suffix = f"_from_{step:09d}" if step else ""
        logger = Logger(folder, [make_output_format("tensorboard", folder), make_output_format("csv", folder, suffix)])
        self.model.set_logger(logger)

        def close() -> None:
            self.model.set_logger(Logger(None, []))
            logger.close()

        self._opened.callback(close)

    def save(self) -> None:
        """Write a checkpoint and the summary of the run."""
        env = self.env if self.settings.compiled else None
        save_checkpoint(self.out, self.model, {"progress": self.progress, "env": env, "step": self.model.num_timesteps})
        write_whole(self.out / "run.json", json.dumps(self.summary(), indent=1))

    def summary(self) -> dict[str, Any]:
        """Return what the run did so far as plain values."""
        settings, progress = self.settings, self.progress
        return {
            "preset": settings.preset.to_card(),
            "seed": settings.seed,
            "stages": progress.extra["stages"],
            "commit": source_commit(),
            "steps": self.model.num_timesteps,
            "updates": self.model._n_updates,
            "seconds": round(progress.seconds, 1),
            "part": progress.curriculum.part,
            "finished_at_step": progress.curriculum.finished_at,
            "finished_after_s": progress.extra.get("finished_after_s"),
            "success_step": progress.success_step,
            "best_step": progress.best_step,
            "best_selection_rms_m": round(progress.best_error_m, 5) if progress.best else None,
        }

    def actor(self) -> Actor:
        """Return the actor that would be deployed now."""
        if self.settings.preset.averaging and self.progress.averaged.count:
            return self.progress.averaged.actor()
        return Actor(*actor_tensors(self.model))

    def validate(self) -> None:
        """Ride a validation, write it down, and move the curriculum on if it was fully successful."""
        progress, step = self.progress, self.model.num_timesteps
        actor = self.actor()
        requests = draw_requests(self.task, progress.curriculum.validation(), progress.rng)
        errors = self._ride(actor, requests)
        part = progress.curriculum.part
        passed = progress.curriculum.validated(step, errors)
        succeeded = max(errors) <= 0.2 / DISTANCE_THRESHOLD
        progress.recent_error_m = float(np.mean(errors) * DISTANCE_THRESHOLD)
        progress.validated_at, progress.validation_due = step, False
        progress.validations += 1
        if succeeded:
            progress.latest_success, progress.success_step = actor, step
        if passed and progress.curriculum.finished:
            progress.extra["finished_after_s"] = round(progress.seconds, 1)
        row = (
            step,
            round(progress.seconds, 2),
            part,
            round(progress.recent_error_m, 5),
            round(max(errors) * DISTANCE_THRESHOLD, 5),
            int(succeeded),
            self.model._n_updates,
        )
        with (self.out / "validations.csv").open("a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerow(row)
        self.model.logger.record("validation/mean_error_m", progress.recent_error_m)
        self.model.logger.record("validation/max_error_m", max(errors) * DISTANCE_THRESHOLD)
        self.model.logger.record("curriculum/part", progress.curriculum.part)
        self.model.logger.dump(step)
        self._record(actor, requests[0], part)

    def select(self) -> None:
        """Keep the present actor, and compare it with the best one so far on rides that are always the same."""
        progress, step = self.progress, self.model.num_timesteps
        progress.selected_at = step
        actor = self.actor()
        actors = self.out / "actors"
        actors.mkdir(exist_ok=True)
        save_file(actor.tensors(), actors / f"{step:09d}.safetensors")
        error = selection_error(actor, self.task, self.settings.compiled_simulator())
        if error < progress.best_error_m:
            progress.best, progress.best_error_m, progress.best_step = actor, error, step
        with (self.out / "selection.csv").open("a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerow((step, round(error, 6)))
        self.model.logger.record("selection/rms_error_m", error)

    def _ride(self, actor: Actor, requests: list[ResetRequest]) -> list[float]:
        if self.settings.compiled:
            return validate_batch(actor, self.task, self.settings.simulator(), requests)
        return validate_simulator(actor, self.task, self._validation_simulator(), requests)

    def _validation_simulator(self) -> Simulator:
        if self._simulator is None:
            # In this process for every client: the rides are the same bit for bit, and ten times faster.
            self._simulator = Simulator(self.settings.simulator())
            self._opened.callback(self._close_simulator)
        return self._simulator

    def _close_simulator(self) -> None:
        simulator, self._simulator = self._simulator, None
        if simulator is not None:
            simulator.close()

    def _record(self, actor: Actor, request: ResetRequest, part: int) -> None:
        """Record a ride of a validation, and the next one that the learner begins, where a recording is due."""
        every = self.settings.record_every
        if not every or (self.progress.validations - 1) % every:
            return
        from bike_training.learning.episode_recording import Standing, TrainingRecorder, record_ride

        path = self.out / "episodes" / f"step_{self.model.num_timesteps:09d}.mcap"
        standing = Standing(self.model.num_timesteps, part, RideRanges(request.speed_range, request.path_ranges))
        record_ride(path, actor, self.task, self._validation_simulator(), request, standing)

        def now() -> Standing:
            step = self.model.num_timesteps
            return Standing(step, self.progress.curriculum.part, self._episodes(step))

        if self._recorder is None:
            self._recorder = TrainingRecorder(self.env, self.task, self.settings.simulator(), now)
            self._opened.callback(self._recorder.close)
        self._recorder.record_next(path.with_name(f"{path.stem}_training.mcap"))


class _Callback(BaseCallback):
    """Hooks of the learner's loop."""

    def __init__(self, process: LearningProcess, report: Callable[[LearningProcess], None] | None) -> None:
        super().__init__()
        self.process = process
        self.report = report
        self.clock = time.perf_counter()
        self.saved_at = 0
        self.logged_at = 0
        self.consistent = True
        self.stop_wanted = False

    def _on_training_start(self) -> None:
        self.clock = time.perf_counter()
        self.saved_at = self.logged_at = self.num_timesteps

    def _tick(self) -> None:
        now = time.perf_counter()
        self.process.progress.seconds += now - self.clock
        self.clock = now

    def _on_rollout_start(self) -> None:
        # Between two steps everything is whole: the last transition is stored and learned from.
        self.consistent = True
        process, settings = self.process, self.process.settings
        progress = process.progress
        self._tick()
        if progress.handled_at != self.num_timesteps:
            progress.handled_at = self.num_timesteps
            if self.num_timesteps > settings.preset.learning_starts:
                progress.averaged.update(self.model, max(1, settings.preset.updates))
            if self._validation_is_due():
                process.validate()
            if progress.curriculum.finished and self.num_timesteps - progress.selected_at >= SELECT_EVERY:
                process.select()
        if self.num_timesteps - self.logged_at >= LOG_EVERY:
            self.logged_at = self.num_timesteps
            self.model.dump_logs()  # type: ignore[attr-defined]
        if self.num_timesteps - self.saved_at >= settings.checkpoint_every:
            self.saved_at = self.num_timesteps
            process.save()
        if self.report:
            self.report(process)
        if self.stop_wanted:
            raise KeyboardInterrupt
        if settings.until_finished and progress.curriculum.finished:
            raise StopLearning
        self.training_env.env_method("set_episodes", process._episodes(self.num_timesteps))
        self.consistent = False

    def _may_validate(self) -> bool:
        every = self.process.settings.preset.validate_every
        return self.process.progress.may_validate(self.num_timesteps, every)

    def _validation_is_due(self) -> bool:
        progress = self.process.progress
        due, progress.validation_due = progress.validation_due, False
        # Older checkpoints may hold a demand of an episode that ended during the wait.
        return due and self._may_validate()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                episode, context = info["episode"], info.get("context", ())
                self.process.progress.curriculum.ended(context, float(episode["r"]), int(episode["l"]))
        if any(info.get("TimeLimit.truncated") for info in self.locals["infos"]) and self._may_validate():
            self.process.progress.validation_due = True
        return True

    def _on_training_end(self) -> None:
        self._tick()
        self.consistent = True


@contextmanager
def _stopping_between_steps(callback: _Callback) -> Iterator[None]:
    """Let the signals that end a program end a run where its checkpoint is whole; a second one ends it at once."""

    def stop(number: int, frame: FrameType | None) -> None:
        if callback.stop_wanted:
            raise KeyboardInterrupt
        callback.stop_wanted = True

    with signals_handled(stop):
        yield


def source_commit() -> str:
    """Return the commit of the sources, with ``-dirty`` for changed ones, or ``unknown`` outside a checkout."""
    here = Path(__file__).parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
