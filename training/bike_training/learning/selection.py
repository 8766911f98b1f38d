"""Selection: once the curriculum is finished, actors are compared on rides that are always the same."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from safetensors.numpy import load_file, save_file

from bike_policy.contract.actor import Actor
from bike_sim.sim.config import SimulatorConfig
from bike_training.learning.progress import Progress
from bike_training.learning.validation_rides import selection_error
from bike_training.tasks.base import Task

ACTORS: Final = "actors"
"""Folder of a run for actors that are kept."""


def is_due(progress: Progress, step: int, every: int) -> bool:
    """Tell whether actors are to be compared at a learning step.

    Args:
        progress: of the run.
        step: learning step.
        every: learning steps between two comparisons once the curriculum is finished.
    """
    return progress.curriculum.finished and step - progress.selected_at >= every


def keep(out: Path, actor: Actor, step: int) -> None:
    """Keep the actor of a learning step on disk.

    Args:
        out: folder of the run.
        actor: the present one.
        step: learning step.
    """
    actors = out / ACTORS
    actors.mkdir(exist_ok=True)
    save_file(actor.tensors(), actors / f"{step:09d}.safetensors")


def kept(out: Path, step: int) -> tuple[int, Actor] | None:
    """Return the first actor that a run has kept from a learning step on, with its own step; None without one."""
    for path in sorted((out / ACTORS).glob("*.safetensors")):
        if int(path.stem) >= step:
            return int(path.stem), Actor.from_tensors(load_file(path))
    return None


def compare(
    out: Path,
    actor: Actor,
    progress: Progress,
    step: int,
    task: Task,
    config: SimulatorConfig,
    machines: Sequence[str] = (),
) -> float:
    """Keep the present actor on disk, and compare it with the best one so far.

    Args:
        out: folder of the run.
        actor: the present one.
        progress: of the run; it remembers the best.
        step: learning step.
        task: what is ridden.
        config: where it is ridden.
        machines: that the rides take in turn, where there are several.

    Returns:
        The actor's error, as the task compares actors.
    """
    progress.selected_at = step
    keep(out, actor, step)
    error = selection_error(actor, task, config, progress.curriculum.selection_requests(task.preview), machines)
    if error < progress.best_error_m:
        progress.best, progress.best_error_m, progress.best_step = actor, error, step
    return error
