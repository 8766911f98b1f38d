"""Hooks of the learner's loop: what a run does between two steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, Protocol

from stable_baselines3.common.callbacks import BaseCallback

from bike_training.curricula.base import EndedEpisode
from bike_training.interruption import signals_handled
from bike_training.learning import selection
from bike_training.learning.progress import Progress
from bike_training.learning.run_settings import RunSettings

LOG_EVERY: Final = 1000
"""Learning steps between two rows of the logs."""


class StopLearning(Exception):
    """Ends a run at a point where a checkpoint is whole."""


class Run(Protocol):
    """What of a run the learner's loop calls between two steps.

    Attributes:
        progress: of the run. settings: of the run.
    """

    progress: Progress
    settings: RunSettings

    def validate(self) -> None:
        """Validate the present actor."""
        ...

    def select(self) -> None:
        """Compare the present actor with the best one."""
        ...

    def keep(self) -> None:
        """Keep the present actor on disk."""
        ...

    def save(self) -> None:
        """Write a checkpoint."""
        ...


class LearningCallback(BaseCallback):
    """Validates, selects, logs, saves and reports between two steps of the learner.

    Attributes:
        consistent: whether a checkpoint would be whole now.
        stop_wanted: whether the run is to end before the next step.
    """

    def __init__(self, process: Run, report: Callable[[], None] | None) -> None:
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
        if selection.is_due(progress, self.num_timesteps, preset.curriculum.select_every):
            process.select()
        every = process.settings.keep_every
        if every and self.num_timesteps // every > max(before, 0) // every:
            process.keep()

    def _may_validate(self) -> bool:
        every = self.process.settings.preset.curriculum.validate_every
        return self.process.progress.may_validate(self.num_timesteps, every)

    def validation_is_due(self) -> bool:
        """Tell whether an episode has asked for a validation; asking forgets it."""
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
