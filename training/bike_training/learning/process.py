"""A run of learning: learner, environments, curriculum, validations, recordings and checkpoints together.

`run` is what `bike train` and whoever runs many of them call, from settings to summary.
"""

from __future__ import annotations

import contextlib
import json
import math
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from safetensors.numpy import load_file
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from bike_policy.contract.bundle import Actor, Bundle
from bike_policy.riders.base import LearnedRider
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.files import load_vehicle
from bike_training.arguments import write_whole
from bike_training.curricula.base import EndedEpisode, Episodes
from bike_training.curricula.parts import RideRanges
from bike_training.curricula.rivals import RivalsSettings
from bike_training.envs.env import BikeEnv
from bike_training.envs.node_process import NodeLost
from bike_training.envs.race_vec_env import RaceVecEnv
from bike_training.envs.vec_env import BatchVecEnv, SimulatorVecEnv
from bike_training.interruption import signals_handled
from bike_training.learning.checkpoint import Checkpoint, find_checkpoint, holds_run, save_checkpoint
from bike_training.learning.learner import AveragedActor, actor_tensors, build_model
from bike_training.learning.presets import GradientSettings
from bike_training.learning.progress import Progress
from bike_training.learning.run_settings import (
    IMITATED,
    TRAINING_DRAWS,
    VALIDATION_DRAWS,
    RunSettings,
    draws,
    source_commit,
)
from bike_training.learning.validation import SideBySide, keep, ride_side_by_side
from bike_training.learning_packages import missing_package
from bike_training.rollout.stability import is_stable
from bike_training.settings import to_plain
from bike_training.tasks.base import Task
from bike_training.tasks.race import RaceTask

if TYPE_CHECKING:
    from bike_training.learning.episode_recording import Standing, TrainingRecorder
    from bike_training.learning.imitation import Imitation

LOG_EVERY: Final = 1000
"""Learning steps between two rows of the logs."""


class StopLearning(Exception):
    """Ends a run at a point where a checkpoint is whole."""


def make_environment(settings: RunSettings, task: Task, episodes: Episodes) -> VecEnv:
    """Return the vector environment of a run, not yet seeded for it."""
    count = settings.preset.sac.environments
    if isinstance(settings.preset.curriculum, RivalsSettings):
        if not settings.compiled or not isinstance(task, RaceTask):
            raise ValueError("curriculum rivals is for superbikes on the compiled engine in this process")
        return RaceVecEnv(count, task, episodes, settings.simulator(), settings.seed, settings.machines)
    if settings.compiled:
        return BatchVecEnv(count, task, episodes, settings.simulator(), settings.seed, settings.machines)
    # The monitor tells length and return of each episode, as the compiled environment does itself.
    return SimulatorVecEnv(
        count, lambda row: Monitor(BikeEnv(settings.client, task, episodes, settings.simulator(row), row))
    )


class LearningProcess(BaseCallback):
    """Runs a preset until its steps are done, it is stopped, or its curriculum is finished.

    Between two steps of the learner it validates, selects, logs, saves and reports.

    Attributes:
        settings: of the run.
        out: its folder.
        steps: learning steps in all.
        task: task to learn.
        env: where.
        model: the learner.
        progress: how far it has come.
    """

    model: BaseAlgorithm

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
        super().__init__()
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
        self._report: Callable[[LearningProcess], None] | None = None
        self._clock, self._saved_at, self._logged_at = time.perf_counter(), 0, 0
        self._consistent, self._stop_wanted = True, False
        self._opened = contextlib.ExitStack()
        self._validation: SideBySide | None = None
        self._recorder: TrainingRecorder | None = None
        try:
            if resume:
                self._take_up()
            else:
                self._begin()
        except BaseException:
            self.close()
            raise
        self.progress.write_tables(out, self.task.error_name)
        self.model.set_logger(Logger(None, []))  # logs are written while it runs
        self._note_stage()

    def _begin(self) -> None:
        if holds_run(self.out):
            raise ValueError(f"{self.out} already holds a run; resume it or choose another folder")
        self.out.mkdir(parents=True, exist_ok=True)
        self._make_learner(0)
        self._seed_rides()

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

    def _make_learner(self, step: int) -> None:
        settings = self.settings
        self.env = make_environment(settings, self.task, self.progress.curriculum.episodes(step))
        self._opened.callback(self.env.close)
        start = Actor.from_tensors(load_file(self.out / IMITATED)) if settings.preset.sac.rounds else None
        self.model = build_model(settings.preset.sac, self.task, self.env, settings.seed, start)

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
        done, self._report = self.model.num_timesteps, report

        def stop(number: int, frame: FrameType | None) -> None:
            if self._stop_wanted:
                raise KeyboardInterrupt  # the second one ends it at once
            self._stop_wanted = True

        try:
            if done < self.steps:
                self._open_logs()
                with signals_handled(stop):
                    self.model.learn(self.steps - done, callback=self, log_interval=None, reset_num_timesteps=done == 0)
        except StopLearning:
            pass
        except NodeLost:
            # The step that was lost is neither counted nor stored.
            self._consistent = self._consistent or not self.settings.compiled
            raise
        finally:
            try:
                if self._consistent:
                    self.save()
            finally:
                self.close()

    def _on_training_start(self) -> None:
        self._clock = time.perf_counter()
        self._saved_at = self._logged_at = self.num_timesteps

    def _tick(self) -> None:
        before, self._clock = self._clock, time.perf_counter()
        self.progress.seconds += self._clock - before

    def _on_rollout_start(self) -> None:
        # Between two steps everything is whole: the last transition is stored and learned from.
        self._consistent = True
        step, progress = self.num_timesteps, self.progress
        self._tick()
        if progress.handled_at != step:
            before, progress.handled_at = progress.handled_at, step
            self._take_step(before)
        if step - self._logged_at >= LOG_EVERY:
            self._logged_at = step
            for name, value in progress.curriculum.figures().items():
                self.logger.record(f"curriculum/{name}", value)
            self.model.dump_logs()
        if step - self._saved_at >= self.settings.checkpoint_every:
            self._saved_at = step
            self.save()
        if self._report:
            self._report(self)
        if self._stop_wanted:
            raise KeyboardInterrupt
        if self.settings.until_finished and progress.curriculum.finished:
            raise StopLearning
        self.training_env.env_method("set_episodes", progress.curriculum.episodes(step))
        self._consistent = False

    def _take_step(self, before: int) -> None:
        """Average the actor after a step, and validate, compare and keep it where that is due.

        Args:
            before: learning step of the one before.
        """
        step, progress, preset = self.num_timesteps, self.progress, self.settings.preset
        if step > preset.sac.learning_starts:
            progress.averaged.update(self.model, max(1, preset.sac.updates))
        if self.validation_is_due():
            self.validate()
        if progress.curriculum.finished and step - progress.selected_at >= preset.curriculum.select_every:
            self.select()
        every = self.settings.keep_every
        if every and step // every > max(before, 0) // every:
            keep(self.out, self.actor(), step)

    def _may_validate(self) -> bool:
        """Return whether an episode that reaches its full length now asks for a validation.

        One that does so during the wait or while the intervals grow asks for none later (Weyrer et al. 2026, Sects.
        4.2, 4.3).
        """
        progress, step = self.progress, self.num_timesteps
        waited = step - progress.validated_at >= self.settings.preset.curriculum.validate_every
        return waited and progress.curriculum.may_validate(step)

    def validation_is_due(self) -> bool:
        """Return whether an episode has asked for a validation; asking forgets it."""
        due, self.progress.validation_due = self.progress.validation_due, False
        return due and self._may_validate()

    def _on_step(self) -> bool:
        if self._recorder is not None:
            seen, before = np.asarray(self.model._last_obs)[0], self.num_timesteps - self.env.num_envs
            self._recorder.stepped(seen, self.locals["actions"][0], lambda: self._standing(before))
        for info in self.locals["infos"]:
            if "episode" in info:
                episode, failed = info["episode"], not info.get("TimeLimit.truncated", False)
                self.progress.curriculum.ended(
                    EndedEpisode(info["request"], float(episode["r"]), int(episode["l"]), failed, info["progress"])
                )
        if any(info.get("TimeLimit.truncated") for info in self.locals["infos"]) and self._may_validate():
            self.progress.validation_due = True
        return True

    def _on_training_end(self) -> None:
        self._tick()
        self._consistent = True

    def close(self) -> None:
        """Close environments, simulators and logs, also where closing one fails; a run that has ended has done so."""
        try:
            self._opened.close()
        finally:
            together, self._validation = self._validation, None
            if together is not None:
                together.close()

    def _open_logs(self) -> None:
        """Log this session; each has its own table, for the logger overwrites what it finds."""
        folder, step = str(self.out / "tensorboard"), self.model.num_timesteps
        suffix = f"_from_{step:09d}" if step else ""
        formats = [make_output_format("tensorboard", folder), make_output_format("csv", folder, suffix)]
        logger = Logger(folder, formats)
        self.model.set_logger(logger)
        self._opened.callback(logger.close)
        self._opened.callback(self.model.set_logger, Logger(None, []))

    def save(self) -> None:
        """Write a checkpoint and the summary of the run."""
        rides = self.env.state_dict() if isinstance(self.env, BatchVecEnv) else None
        state = {"progress": self.progress.state_dict(), "env": rides, "step": self.model.num_timesteps}
        save_checkpoint(self.out, self.model, state)
        write_whole(self.out / "run.json", json.dumps(self.summary(), indent=1))

    def summary(self) -> dict[str, Any]:
        """Return what the run did so far as plain values."""
        settings, progress, model = self.settings, self.progress, self.model
        return {
            "vehicle": settings.vehicle,
            "preset": settings.preset.to_plain(),
            "seed": settings.seed,
            "stages": progress.stages,
            "commit": source_commit(),
            "steps": model.num_timesteps,
            "updates": model._n_updates,
            "seconds": round(progress.seconds, 1),
            "part": progress.curriculum.part,
            "finished_at_step": progress.curriculum.finished_at,
            "finished_after_s": progress.finished_after,
            "success_step": progress.success_step,
            "best_step": progress.best_step,
            f"best_selection_{'excess' if settings.superbike else 'rms_m'}": (
                round(progress.best_error_m, 5) if progress.best else None
            ),
        }

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
        progress, curriculum, task = self.progress, self.progress.curriculum, self.task
        step, part, actor = self.model.num_timesteps, curriculum.part, self.actor()
        requests = curriculum.validation_requests(task.preview, progress.rng)
        errors = self._side_by_side(len(requests)).errors(actor, requests)
        succeeded = curriculum.passes(errors)
        stable = not (succeeded and curriculum.asks_for_stability) or self._is_stable(actor)
        passed = stable and curriculum.validated(step, errors)
        mean, largest = float(np.mean(errors) * task.largest_error), max(errors) * task.largest_error
        progress.recent_error_m, progress.validated_at, progress.validation_due = mean, step, False
        if succeeded:
            progress.latest_success, progress.success_step = actor, step
        if passed and curriculum.finished:
            progress.finished_after = round(progress.seconds, 1)
        figures = (round(mean, 5), round(largest, 5), int(succeeded))
        progress.validations.append([step, round(progress.seconds, 2), part, *figures, self.model._n_updates])
        progress.write_tables(self.out, task.error_name)
        logger = self.model.logger
        logger.record(f"validation/mean_{task.error_name}", mean)
        logger.record(f"validation/max_{task.error_name}", largest)
        logger.record("curriculum/part", curriculum.part)
        logger.dump(step)
        every, period = self.settings.record_every, self.settings.preset.curriculum.validate_every
        last = step // period == self.steps // period or (self.settings.until_finished and curriculum.finished)
        if every and (last or (len(progress.validations) - 1) % every == 0):
            self._record(actor, requests[0], step, part)

    def _is_stable(self, actor: Actor) -> bool:
        """Return whether the closed loop of an actor is stable."""
        config, task, name = self.settings.compiled_simulator(), self.task, self.settings.vehicle
        vehicle = load_vehicle(name)
        layout = self.settings.preset.deployed_layout
        bundle = Bundle(vehicle.name, actor, layout, task.action, vehicle.name, config.control_period)
        return is_stable(LearnedRider(bundle), config)

    def _side_by_side(self, count: int) -> SideBySide:
        """Return vehicles for a number of rides: those of the last validation, unless it had another number.

        They are in this process: their bits are those of every client, ten times as fast.
        """
        if self._validation is None or self._validation.count != count:
            if self._validation is not None:
                self._validation.close()
            settings = self.settings
            self._validation = SideBySide(self.task, count, settings.simulator(), settings.machines)
        return self._validation

    def _record(self, actor: Actor, request: ResetRequest, step: int, part: int) -> None:
        """Record a validation ride into ``episodes/``, and the next ride that the learner begins.

        Without ROS 2, whose messages recordings hold, a warning says once that none is made.

        Args:
            actor: the rider.
            request: of the ride.
            step: learning step of the validation.
            part: part of the curriculum that it was ridden in.
        """
        try:
            from bike_training.learning.episode_recording import Standing, TrainingRecorder, record_ride
        except ModuleNotFoundError as error:
            package = missing_package(error)
            if package is None:
                raise
            warnings.warn(f"rides are not recorded, learning goes on: {package} of ROS 2 is missing", stacklevel=2)
            return

        path, config = self.out / "episodes" / f"step_{step:09d}.mcap", self.settings.simulator()
        standing = Standing(step, part, RideRanges(request.speed_range, request.path_ranges))
        record_ride(path, actor, self.task, config, request, standing)
        if self._recorder is None:
            self._recorder = TrainingRecorder(self.env, self.task, config)
            self._opened.callback(self._recorder.close)
        self._recorder.record_next(path.with_name(f"{path.stem}_training.mcap"))

    def select(self) -> None:
        """Keep the present actor, and compare it with the best one so far."""
        progress, step, task, actor = self.progress, self.model.num_timesteps, self.task, self.actor()
        progress.selected_at = step
        keep(self.out, actor, step)
        requests = progress.curriculum.selection_requests(task.preview)
        config, machines = self.settings.compiled_simulator(), self.settings.machines
        error = task.selection_error(*ride_side_by_side(actor, task, config, requests, machines=machines))
        better = error < progress.best_error_m
        if better and progress.curriculum.compares_stability and not self._is_stable(actor):
            error += task.largest_error  # behind each one that is
        if error < progress.best_error_m:
            progress.best, progress.best_error_m, progress.best_step = actor, error, step
        progress.selections.append([step, round(error, 6)])
        progress.write_tables(self.out, task.error_name)
        self.model.logger.record(f"selection/{task.error_name}", error)

    def _standing(self, step: int) -> Standing:
        """Return where learning stands at a learning step, for recordings."""
        from bike_training.learning.episode_recording import Standing

        curriculum = self.progress.curriculum
        episodes = curriculum.episodes(step)
        return Standing(step, curriculum.part, episodes if isinstance(episodes, RideRanges) else None)


SETTINGS_FILE: Final = "settings.json"


def imitate(settings: RunSettings, out: Path, report: Callable[[Imitation], None]) -> None:
    """Make the actor that a run begins with, or go on making it; nothing where it is there.

    Args:
        settings: of the run.
        out: its folder.
        report: called after each round.

    Raises:
        ValueError: rides that are not stepped by the compiled engine in this process, or a race with a guide.
    """
    if not settings.compiled:
        raise ValueError("setting learner.rounds is for the compiled engine in this process")
    if (out / IMITATED).is_file():
        return
    from bike_training.learning.imitation import Imitation  # late: it takes JAX

    vehicles = [load_vehicle(name) for name in settings.machines]
    episodes = settings.preset.curriculum.make(vehicles).imitated()
    with contextlib.closing(make_environment(settings, settings.preset.task, episodes)) as env:
        Imitation(env, settings.preset.sac, settings.seed).run(out, report)


def run(
    settings: RunSettings,
    out: Path,
    report: Callable[[LearningProcess], None] | None = None,
    resume: bool = False,
    report_round: Callable[[Imitation], None] = lambda _: None,
) -> dict[str, Any]:
    """Learn until the run has ended or is stopped.

    Args:
        settings: of the run; its result depends on them alone.
        out: its folder.
        report: called after each step of all vehicles, to show progress.
        resume: go on from the checkpoint in ``out``.
        report_round: called after each round of imitation.

    Returns:
        The summary, as in ``run.json``, with ``interrupted``: whether a signal stopped the run before its end.

    Raises:
        FileNotFoundError: nothing to resume from, or an unknown vehicle.
        ValueError: the folder holds another run, what it holds cannot be read, or settings that do not fit together.
        NodeLost: a simulator behind ROS did not start or was lost.
    """
    if isinstance(settings.preset.learner, GradientSettings):
        raise ValueError(f"preset {settings.preset.name!r} learns by gradients; see `GradientLearning`")
    if settings.preset.sac.rounds:
        if not resume and (holds_run(out) or (out / IMITATED).is_file()):
            raise ValueError(f"{out} already holds a run; resume it or choose another folder")
        out.mkdir(parents=True, exist_ok=True)
        write_whole(out / SETTINGS_FILE, json.dumps(to_plain(settings), indent=1))
        imitate(settings, out, report_round)
        resume = resume and find_checkpoint(out) is not None
    interrupted = False
    try:
        with contextlib.closing(LearningProcess(settings, out, settings.preset.sac.steps, resume=resume)) as process:
            # Only now: nothing stays of a run that cannot be.
            write_whole(out / SETTINGS_FILE, json.dumps(to_plain(settings), indent=1))
            try:
                process.run(report)
            except KeyboardInterrupt:
                interrupted = True
    except NodeLost as error:
        if find_checkpoint(out) is None:
            raise
        raise NodeLost(f"{error}; go on from the checkpoint in {out} with --resume") from error
    return process.summary() | {"interrupted": interrupted}


def stored_settings(out: Path) -> RunSettings:
    """Return the settings of the run in a folder.

    Raises:
        FileNotFoundError: it holds none. ValueError: they cannot be read.
    """
    path = out / SETTINGS_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{out} holds no run to resume ({path.name} is missing)")
    try:
        return RunSettings.from_plain(json.loads(path.read_text(encoding="utf-8")))
    except ValueError as error:
        raise ValueError(
            f"{path} cannot be read ({error}); it is damaged, or another version of this software wrote it"
        ) from error
