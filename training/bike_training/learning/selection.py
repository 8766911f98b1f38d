"""Selection: once the curriculum is finished, actors are compared on rides that are always the same."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from safetensors.numpy import save_file

from bike_policy.contract.actor import Actor
from bike_sim.sim.config import SimulatorConfig
from bike_training.learning.progress import Progress
from bike_training.learning.validation_rides import rms_error
from bike_training.tasks.base import Task

SELECT_EVERY: Final = 10_000
"""Learning steps between two comparisons of actors once the curriculum is finished."""


def is_due(progress: Progress, step: int) -> bool:
    """Tell whether actors are to be compared at a learning step."""
    return progress.curriculum.finished and step - progress.selected_at >= SELECT_EVERY


def compare(out: Path, actor: Actor, progress: Progress, step: int, task: Task, config: SimulatorConfig) -> float:
    """Keep the present actor on disk, and compare it with the best one so far.

    Args:
        out: folder of the run.
        actor: the present one.
        progress: of the run; it remembers the best.
        step: learning step.
        task: what is ridden.
        config: where it is ridden.

    Returns:
        The actor's RMS error, m.
    """
    progress.selected_at = step
    actors = out / "actors"
    actors.mkdir(exist_ok=True)
    save_file(actor.tensors(), actors / f"{step:09d}.safetensors")
    error = rms_error(actor, task, config, progress.curriculum.selection_requests(task.preview))
    if error < progress.best_error_m:
        progress.best, progress.best_error_m, progress.best_step = actor, error, step
    return error
