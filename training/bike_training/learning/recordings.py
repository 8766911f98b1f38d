"""Which rides of a run are recorded, and when; `episode_recording` writes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from stable_baselines3.common.vec_env import VecEnv

from bike_policy.contract.actor import Actor
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.curricula.parts import RideRanges
from bike_training.tasks.base import Task

if TYPE_CHECKING:
    from bike_training.learning.episode_recording import Standing, TrainingRecorder  # needs ROS


class RunRecordings:
    """Records a ride of every n-th validation, and the next one that the learner begins, into ``episodes/``."""

    def __init__(
        self, out: Path, every: int, task: Task, config: SimulatorConfig, env: VecEnv, standing: Callable[[], Standing]
    ) -> None:
        """Prepare to record.

        Args:
            out: folder of the run.
            every: validations between two recordings; 0 records none.
            task: what is learned.
            config: simulator that rides as the environments do.
            env: environments of the training.
            standing: tells where learning stands.
        """
        self._out, self._every, self._task, self._config = out, every, task, config
        self._env, self._standing = env, standing
        self._recorder: TrainingRecorder | None = None

    def is_due(self, validations: int) -> bool:
        """Tell whether the validation with a number, from 1, is recorded."""
        return self._every > 0 and (validations - 1) % self._every == 0

    def record(self, actor: Actor, request: ResetRequest, simulator: Simulator, step: int, part: int) -> None:
        """Record a validation ride now, and the next ride that the learner begins.

        Args:
            actor: who rode.
            request: how the ride began.
            simulator: where it is ridden once more.
            step: learning step of the validation.
            part: part of the curriculum that it was ridden in.
        """
        from bike_training.learning.episode_recording import Standing, TrainingRecorder, record_ride

        path = self._out / "episodes" / f"step_{step:09d}.mcap"
        standing = Standing(step, part, RideRanges(request.speed_range, request.path_ranges))
        record_ride(path, actor, self._task, simulator, request, standing)
        if self._recorder is None:
            self._recorder = TrainingRecorder(self._env, self._task, self._config, self._standing)
        self._recorder.record_next(path.with_name(f"{path.stem}_training.mcap"))

    def close(self) -> None:
        """Finish a recording that is open."""
        if self._recorder is not None:
            self._recorder.close()
