"""A learning process: learner, environments, curriculum, validations, recordings and checkpoints together."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from bike_policy.contract.bundle import Actor
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.files import load_vehicle
from bike_training.curricula.base import EndedEpisode, Episodes
from bike_training.curricula.parts import RideRanges
from bike_training.envs.env import BikeEnv
from bike_training.envs.node_process import NodeLost
from bike_training.envs.vec_env import BatchVecEnv, SimulatorVecEnv
from bike_training.interruption import signals_handled
from bike_training.learning import validation
from bike_training.learning.checkpoint import Checkpoint, holds_run, save_checkpoint, write_whole
from bike_training.learning.learner import AveragedActor, actor_tensors, build_model
from bike_training.learning.progress import Progress, RunTables, no_logger, session_logger, summarise
from bike_training.learning.run_settings import TRAINING_DRAWS, VALIDATION_DRAWS, RunSettings, draws
from bike_training.tasks.base import Task

if TYPE_CHECKING:
    from bike_training.learning.episode_recording import Standing, TrainingRecorder


LOG_EVERY: Final = 1000
"""Learning steps between two rows of the logs."""


class StopLearning(Exception):
    """Ends a run at a point where a checkpoint is whole."""


class LearningCallback(BaseCallback):
    """Validates, selects, logs, saves and reports between two steps of the learner.

    Attributes:
        consistent: whether a checkpoint would be whole now.
        stop_wanted: whether the run is to end before the next step.
    """

    def __init__(self, process: LearningProcess, report: Callable[[], None] | None) -> None:
        """Serve a run; `report` is called between two steps."""
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
        process, progress = self.process, self.process.progress
        self._tick()
        if progress.handled_at != self.num_timesteps:
            before, progress.handled_at = progress.handled_at, self.num_timesteps
            self._take_step(before)
        if self.num_timesteps - self.logged_at >= LOG_EVERY:
            self.logged_at = self.num_timesteps
            for name, value in progress.curriculum.figures().items():
                self.logger.record(f"curriculum/{name}", value)
            self.model.dump_logs()  # type: ignore[attr-defined]
        if self.num_timesteps - self.saved_at >= process.settings.checkpoint_every:
            self.saved_at = self.num_timesteps
            process.save()
        if self.report:
            self.report()
        if self.stop_wanted:
            raise KeyboardInterrupt
        if process.settings.until_finished and progress.curriculum.finished:
            raise StopLearning
        episodes = progress.curriculum.episodes(self.num_timesteps)
        self.training_env.env_method("set_episodes", episodes)
        self.consistent = False

    def _take_step(self, before: int) -> None:
        """Average the actor after a step, and validate, compare and keep it where that is due.

        Args:
            before: learning step of the one before.
        """
        process, progress = self.process, self.process.progress
        preset = process.settings.preset
        if self.num_timesteps > preset.sac.learning_starts:
            progress.averaged.update(self.model, max(1, preset.sac.updates))  # type: ignore[arg-type]
        if self.validation_is_due():
            process.validate()
        if validation.comparison_is_due(progress, self.num_timesteps, preset.curriculum.select_every):
            process.select()
        every = process.settings.keep_every
        if every and self.num_timesteps // every > max(before, 0) // every:
            process.keep()

    def _may_validate(self) -> bool:
        every = self.process.settings.preset.curriculum.validate_every
        return self.process.progress.may_validate(self.num_timesteps, every)

    def validation_is_due(self) -> bool:
        """Return whether an episode has asked for a validation; asking forgets it."""
        progress = self.process.progress
        due, progress.validation_due = progress.validation_due, False
        return due and self._may_validate()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                episode, failed = info["episode"], not info.get("TimeLimit.truncated", False)
                self.process.progress.curriculum.ended(
                    EndedEpisode(info["request"], float(episode["r"]), int(episode["l"]), failed, info["progress"])
                )
        if any(info.get("TimeLimit.truncated") for info in self.locals["infos"]) and self._may_validate():
            self.process.progress.validation_due = True
        return True

    def _on_training_end(self) -> None:
        self._tick()
        self.consistent = True


@contextmanager
def stopping_between_steps(callback: LearningCallback) -> Iterator[None]:
    """Let the signals that end a program end a run where its checkpoint is whole; a second one ends it at once."""

    def stop(number: int, frame: FrameType | None) -> None:
        if callback.stop_wanted:
            raise KeyboardInterrupt
        callback.stop_wanted = True

    with signals_handled(stop):
        yield


def make_environment(settings: RunSettings, task: Task, episodes: Episodes) -> VecEnv:
    """Return the vector environment of a run, not yet seeded for it."""
    count = settings.preset.sac.environments
    if settings.compiled:
        return BatchVecEnv(count, task, episodes, settings.simulator(), settings.seed, settings.machines)
    # The monitor tells length and return of each episode, as the compiled environment does itself.
    return SimulatorVecEnv(
        count, lambda row: Monitor(BikeEnv(settings.client, task, episodes, settings.simulator(row), row))
    )


class LearningProcess:
    """Runs a preset until its steps are done, it is stopped, or its curriculum is finished.

    Attributes:
        settings: of the run.
        out: its folder.
        steps: learning steps in all.
        task: task to learn.
        env: where.
        model: the learner.
        progress: how far it has come.
    """

    def __init__(self, settings: RunSettings, out: Path, steps: int, resume: bool = False) -> None:
        """Prepare a run.

        Args:
            settings: of the run.
            out: its folder.
            steps: learning steps in all, earlier sessions included.
            resume: go on from the checkpoint in ``out``.

        Raises:
            FileNotFoundError: nothing to resume from, or an unknown vehicle.
            ValueError: the folder holds another run and resume is off, what it holds cannot be read, or the task is not
                for the vehicle.
            NodeLost: a simulator behind ROS did not start.
        """
        if steps < 1:
            raise ValueError(f"learning steps must be at least 1, got {steps}")
        preset = settings.preset
        vehicles = [load_vehicle(name) for name in settings.machines]
        for vehicle in vehicles:
            preset.task.check_vehicle(vehicle)
        self.settings, self.out, self.steps, self.task = settings, out, steps, preset.task
        self.progress = Progress(
            preset.curriculum.make(vehicles),
            AveragedActor(preset.sac.averaging),
            np.random.default_rng(draws(settings.seed, VALIDATION_DRAWS)),
        )
        self._tables = RunTables(out, self.task.error_name)
        self._opened = contextlib.ExitStack()
        self._validator = validation.Validator(settings, self.task)
        try:
            if resume:
                self._take_up()
            else:
                self._begin()
        except BaseException:
            self.close()
            raise
        self._recorder: TrainingRecorder | None = None
        self.model.set_logger(no_logger())  # logs are written while it runs
        self._note_stage()

    def _begin(self) -> None:
        if holds_run(self.out):
            raise ValueError(f"{self.out} already holds a run; resume it or choose another folder")
        self.out.mkdir(parents=True, exist_ok=True)
        self._make_learner(0)
        self._seed_rides()
        self._tables.begin()

    def _take_up(self) -> None:
        checkpoint = Checkpoint(self.out)
        with checkpoint.reading():
            self.progress.restore(checkpoint.run["progress"])
            step, rides = checkpoint.run["step"], checkpoint.run["env"]
        self._make_learner(step)
        checkpoint.restore(self.model)
        goes_on = isinstance(self.env, BatchVecEnv) and rides is not None
        if goes_on:
            with checkpoint.reading():
                self.env.restore(rides)  # type: ignore[attr-defined]
        else:
            self.model._last_obs = None  # a simulator's rides cannot be taken up again: they begin anew
        if not goes_on or step == 0:
            self._seed_rides()
        self._tables.drop_after(self.progress.handled_at)

    def _make_learner(self, step: int) -> None:
        settings = self.settings
        self.env = make_environment(settings, self.task, self.progress.curriculum.episodes(step))
        self._opened.callback(self.env.close)
        self.model = build_model(settings.preset.sac, self.task, self.env, settings.seed)

    def _seed_rides(self) -> None:
        """Seed the rides from the present step on; the learner seeds them with its own seed when it is made."""
        sequence = draws(self.settings.seed, TRAINING_DRAWS, self.model.num_timesteps)
        self.env.seed(int(sequence.generate_state(1, np.uint64)[0]))

    def _note_stage(self) -> None:
        """Write down where the run rides from here on, if that is somewhere else than before."""
        settings, stages = self.settings, self.progress.stages
        # The preset of the card is the last session's; how many rode before is told here alone.
        where = {
            "client": settings.client,
            "engine": settings.engine,
            "environments": settings.preset.sac.environments,
            "updates": settings.preset.sac.updates,
        }
        if not stages or any(stages[-1].get(name) != value for name, value in where.items()):
            stages.append({**where, "from_step": self.model.num_timesteps})

    def run(self, report: Callable[[LearningProcess], None] | None = None) -> None:
        """Learn; a checkpoint is written at the end, also when stopped by SIGINT, SIGTERM or SIGHUP.

        Args:
            report: called after each step of all vehicles, to show progress.

        Raises:
            KeyboardInterrupt: stopped by a signal, between two steps and with a checkpoint.
            NodeLost: a simulator behind ROS was lost; with a checkpoint too, for its rides begin anew anyway.
        """
        done = self.model.num_timesteps
        callback = LearningCallback(self, None if report is None else lambda: report(self))
        try:
            if done < self.steps:
                self._open_logs()
                with stopping_between_steps(callback):
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
        try:
            self._opened.close()
        finally:
            self._validator.close()

    def _open_logs(self) -> None:
        logger = session_logger(self.out, self.model.num_timesteps)
        self.model.set_logger(logger)

        def close() -> None:
            self.model.set_logger(no_logger())
            logger.close()

        self._opened.callback(close)

    def save(self) -> None:
        """Write a checkpoint and the summary of the run."""
        rides = self.env.state_dict() if isinstance(self.env, BatchVecEnv) else None
        state = {"progress": self.progress.state_dict(), "env": rides, "step": self.model.num_timesteps}
        save_checkpoint(self.out, self.model, state)
        write_whole(self.out / "run.json", json.dumps(self.summary(), indent=1))

    def summary(self) -> dict[str, Any]:
        """Return what the run did so far as plain values."""
        return summarise(self.settings, self.progress, self.model)

    def words(self) -> str:
        """Return in a few words how far the curriculum is, and what the last validation came to."""
        curriculum, error = self.progress.curriculum, self.progress.recent_error_m
        part = "curriculum done" if curriculum.finished else f"part {curriculum.part}"
        return part if math.isnan(error) else f"{part}, validation {error:.3f} {self.task.error_name}"

    def actor(self) -> Actor:
        """Return the actor that would be deployed now."""
        if self.settings.preset.sac.averaging and self.progress.averaged.count:
            return self.progress.averaged.actor()
        return Actor(*actor_tensors(self.model))

    def validate(self) -> None:
        """Ride a validation, write it down, and move the curriculum on if it was fully successful."""
        progress, step, actor = self.progress, self.model.num_timesteps, self.actor()
        requests = progress.curriculum.validation_requests(self.task.preview, progress.rng)
        errors = self._validator.ride(actor, requests)
        result = validation.take_in(progress, actor, step, errors, self.task.largest_error)
        self._tables.add_validation(
            (
                step,
                round(progress.seconds, 2),
                result.part,
                round(result.mean_error, 5),
                round(result.max_error, 5),
                int(result.succeeded),
                self.model._n_updates,
            )
        )
        logger = self.model.logger
        logger.record(f"validation/mean_{self.task.error_name}", result.mean_error)
        logger.record(f"validation/max_{self.task.error_name}", result.max_error)
        logger.record("curriculum/part", progress.curriculum.part)
        logger.dump(step)
        every, period = self.settings.record_every, self.settings.preset.curriculum.validate_every
        last = step // period == self.steps // period or (self.settings.until_finished and progress.curriculum.finished)
        if every and (last or (progress.validations - 1) % every == 0):
            self._record(actor, requests[0], step, result.part)

    def _record(self, actor: Actor, request: ResetRequest, step: int, part: int) -> None:
        """Record a validation ride into ``episodes/``, and the next ride that the learner begins.

        Args:
            actor: the rider.
            request: of the ride.
            step: learning step of the validation.
            part: part of the curriculum that it was ridden in.
        """
        from bike_training.learning.episode_recording import Standing, TrainingRecorder, record_ride

        path = self.out / "episodes" / f"step_{step:09d}.mcap"
        standing = Standing(step, part, RideRanges(request.speed_range, request.path_ranges))
        record_ride(path, actor, self.task, self._validator.simulator(), request, standing)
        if self._recorder is None:
            self._recorder = TrainingRecorder(self.env, self.task, self.settings.simulator(), self._standing)
            self._opened.callback(self._recorder.close)
        self._recorder.record_next(path.with_name(f"{path.stem}_training.mcap"))

    def select(self) -> None:
        """Keep the present actor, and compare it with the best one so far."""
        step = self.model.num_timesteps
        config, machines = self.settings.compiled_simulator(), self.settings.machines
        error = validation.compare(self.out, self.actor(), self.progress, step, self.task, config, machines)
        self._tables.add_selection(step, error)
        self.model.logger.record(f"selection/{self.task.error_name}", error)

    def keep(self) -> None:
        """Keep the present actor on disk."""
        validation.keep(self.out, self.actor(), self.model.num_timesteps)

    def _standing(self) -> Standing:
        """Return where learning stands, for recordings."""
        from bike_training.learning.episode_recording import Standing

        step, curriculum = self.model.num_timesteps, self.progress.curriculum
        episodes = curriculum.episodes(step)
        return Standing(step, curriculum.part, episodes if isinstance(episodes, RideRanges) else None)
