"""The summary of a run, ``run.json``: what was asked for and what came of it so far."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

    from bike_training.learning.progress import Progress
    from bike_training.learning.run_settings import RunSettings


def summarise(settings: RunSettings, progress: Progress, model: OffPolicyAlgorithm) -> dict[str, Any]:
    """Return what a run did so far as plain values."""
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


def source_commit() -> str:
    """Return the commit of the sources, with ``-dirty`` for changed ones, or ``unknown`` outside a checkout."""
    here = Path(__file__).parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
