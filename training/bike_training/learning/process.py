"""A learning process: learner, environments, curriculum, validations, logs and checkpoints together."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from bike_policy.contract.actor import Actor
from bike_sim.vehicles.files import load_vehicle
from bike_training.curricula.base import Episodes
from bike_training.curricula.parts import RideRanges
from bike_training.envs.env import BikeEnv
from bike_training.envs.node_process import NodeLost
from bike_training.envs.vec_env import BatchVecEnv, SimulatorVecEnv
from bike_training.learning import selection, validation
from bike_training.learning.callback import LearningCallback, StopLearning, stopping_between_steps
from bike_training.learning.checkpoint import Checkpoint, holds_run, save_checkpoint, write_whole
from bike_training.learning.learner import AveragedActor, actor_tensors, build_model
from bike_training.learning.logs import RunTables, no_logger, session_logger
from bike_training.learning.progress import Progress
from bike_training.learning.recordings import RunRecordings
from bike_training.learning.run_settings import TRAINING_DRAWS, VALIDATION_DRAWS, RunSettings, draws
from bike_training.learning.summary import summarise
from bike_training.tasks.base import Task

if TYPE_CHECKING:
    from bike_training.learning.episode_recording import Standing  # needs ROS


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
        settings: what it is. out: its folder. steps: learning steps in all. task: what is learned.
        env: where. model: the learner. progress: how far it has come.
    """

    def __init__(self, settings: RunSettings, out: Path, steps: int, resume: bool = False) -> None:
        """Prepare a run.

        Args:
            settings: what it is.
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
        self._recordings = RunRecordings(
            out, settings.record_every, self.task, settings.simulator(), self.env, self._standing
        )
        self._opened.callback(self._recordings.close)
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
        if self._recordings.is_due(progress.validations):
            self._recordings.record(actor, requests[0], self._validator.simulator(), step, result.part)

    def select(self) -> None:
        """Keep the present actor, and compare it with the best one so far."""
        step = self.model.num_timesteps
        config, machines = self.settings.compiled_simulator(), self.settings.machines
        error = selection.compare(self.out, self.actor(), self.progress, step, self.task, config, machines)
        self._tables.add_selection(step, error)
        self.model.logger.record(f"selection/{self.task.error_name}", error)

    def keep(self) -> None:
        """Keep the present actor on disk."""
        selection.keep(self.out, self.actor(), self.model.num_timesteps)

    def _standing(self) -> Standing:
        """Return where learning stands, for recordings."""
        from bike_training.learning.episode_recording import Standing

        step, curriculum = self.model.num_timesteps, self.progress.curriculum
        episodes = curriculum.episodes(step)
        return Standing(step, curriculum.part, episodes if isinstance(episodes, RideRanges) else None)
