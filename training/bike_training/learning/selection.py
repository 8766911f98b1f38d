"""Selection: once the curriculum is finished, actors are compared on rides that are always the same."""

from __future__ import annotations

from pathlib import Path

from safetensors.numpy import save_file

from bike_policy.contract.actor import Actor
from bike_sim.sim.config import SimulatorConfig
from bike_training.learning.progress import Progress
from bike_training.learning.validation_rides import selection_error
from bike_training.tasks.base import Task


def is_due(progress: Progress, step: int, every: int) -> bool:
    """Tell whether actors are to be compared at a learning step.

    Args:
        progress: of the run.
        step: learning step.
        every: learning steps between two comparisons once the curriculum is finished.
    """
    return progress.curriculum.finished and step - progress.selected_at >= every


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
        The actor's error, as the task compares actors.
    """
    progress.selected_at = step
    actors = out / "actors"
    actors.mkdir(exist_ok=True)
    save_file(actor.tensors(), actors / f"{step:09d}.safetensors")
    error = selection_error(actor, task, config, progress.curriculum.selection_requests(task.preview))
    if error < progress.best_error_m:
        progress.best, progress.best_error_m, progress.best_step = actor, error, step
    return error
