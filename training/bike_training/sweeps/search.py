"""A search for settings: Ray Tune with Optuna's sampler, and ASHA that stops what is hopeless.

Sources: Akiba et al., Optuna, KDD 2019; Li et al., A System for Massively Parallel Hyperparameter Tuning, MLSys 2020.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bike_training.sweeps.cluster import ray_cluster
from bike_training.sweeps.driver import Place
from bike_training.sweeps.jobs import TrainJob
from bike_training.sweeps.runs import FINISHED, execute
from bike_training.sweeps.spec import METRICS, RunSpec, SearchSpace, Sweep, with_settings

if TYPE_CHECKING:
    from bike_training.learning.process import LearningProcess  # needs the learning packages

TRIALS_FOLDER: Final = "trials"
REPORT_EVERY: Final = 1000
"""Learning steps between two reports of a trial."""
Show = Callable[[int, str], None]
"""Called with the number of trials that have ended, and how the last one did."""

UNKNOWN_ERROR_M: Final = 1e3
"""Stands for an error that is not known yet, m."""


def search(sweep: Sweep, out: Path, place: Place, show: Show) -> dict[str, Any]:
    """Search, or go on with a search that was stopped.

    Args:
        sweep: with a search.
        out: folder of the sweep; trials are in ``trials``.
        place: where.
        show: where to show it.

    Returns:
        Plain values: the best settings with their value, and every trial.

    Raises:
        ConnectionError: no cluster at the address. ValueError: no trial came to a report.
    """
    assert sweep.search is not None
    space, run = sweep.search, sweep.runs[0]
    with ray_cluster(out, place.address, place.cores):
        import optuna
        from ray import tune
        from ray.tune.schedulers import ASHAScheduler
        from ray.tune.search.optuna import OptunaSearch

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        trainable = tune.with_resources(
            tune.with_parameters(_trial, run=run, trials=(out / TRIALS_FOLDER).resolve()),
            tune.PlacementGroupFactory([{"CPU": run.cores, "memory": int(run.memory_gb * 1e9)}]),
        )
        mode = METRICS[space.metric]
        path = out / TRIALS_FOLDER / "tune"
        failure = tune.FailureConfig(max_failures=sweep.retries)
        quiet = tune.RunConfig(
            name=path.name,
            storage_path=str(path.parent.resolve()),
            failure_config=failure,
            verbose=0,
            callbacks=[_teller(tune, space.metric, show)],
        )
        if tune.Tuner.can_restore(str(path.resolve())):
            tuner = tune.Tuner.restore(str(path.resolve()), trainable, resume_unfinished=True, restart_errored=True)
        else:
            total = run.job().settings.preset.sac.steps  # type: ignore[attr-defined]
            config = tune.TuneConfig(
                metric=space.metric,
                mode=mode,
                num_samples=space.trials,
                search_alg=OptunaSearch(seed=space.seed),
                scheduler=ASHAScheduler(
                    time_attr="step",
                    max_t=max(total, space.grace_steps + 1),
                    grace_period=space.grace_steps,
                    reduction_factor=space.reduction,
                ),
            )
            tuner = tune.Tuner(trainable, param_space=_ranges(tune, space), tune_config=config, run_config=quiet)
        return _figures(tuner.fit(), space.metric, mode)


def _ranges(tune: Any, space: SearchSpace) -> dict[str, Any]:
    """Return what is drawn from; choices as text, for Optuna takes no lists."""
    return {
        name: tune.choice([_text(value) for value in values]) if kind == "choice" else getattr(tune, kind)(*values)
        for name, (kind, values) in space.settings.items()
    }


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _trial(config: Mapping[str, Any], run: RunSpec, trials: Path) -> None:
    """Train with settings that were drawn; a process of Ray Tune does this."""
    from ray import tune

    trial = RunSpec(run.task, with_settings(run.entries, config), dict(config), run.cores, run.memory_gb)
    reported = -REPORT_EVERY

    def watch(process: LearningProcess) -> None:
        nonlocal reported
        step = process.model.num_timesteps
        if step - reported >= REPORT_EVERY or process.progress.curriculum.finished:
            reported = step
            tune.report({"step": step, **standing(process)})

    job = TrainJob.from_entries(trial.entries)
    record = execute(trial, trials / trial.name, job=replace(job, watch=watch))
    if record["status"] != FINISHED:
        raise RuntimeError(record.get("error", "interrupted"))


def standing(process: LearningProcess) -> dict[str, float]:
    """Return how far a training has come, for every metric that can be searched for."""
    progress, model = process.progress, process.model
    lengths = [episode["l"] for episode in model.ep_info_buffer or []]
    steps = float(sum(lengths)) / len(lengths) if lengths else 0.0
    advance = progress.curriculum.part + min(1.0, steps / process.task.max_steps)
    if progress.curriculum.finished_at is not None:
        advance = progress.curriculum.part + 1.0 + (process.steps - progress.curriculum.finished_at) / process.steps
    error = progress.recent_error_m
    return {
        "advance": advance,
        "episode_steps": steps,
        "mean_error_m": UNKNOWN_ERROR_M if math.isnan(error) else error,
    }


def _teller(tune: Any, metric: str, show: Show) -> Any:
    class Teller(tune.Callback):  # type: ignore[misc]
        ended = 0

        def on_trial_complete(self, iteration: int, trials: Any, trial: Any, **info: Any) -> None:
            self.ended += 1
            last = trial.last_result or {}
            settings = ", ".join(f"{name}={value}" for name, value in trial.config.items())
            show(self.ended, f"{settings}: {metric} {last.get(metric, math.nan):.4g} at step {last.get('step', 0)}")

    return Teller()


def _figures(results: Any, metric: str, mode: str) -> dict[str, Any]:
    trials = [
        {
            "settings": dict(result.config or {}),
            "value": (result.metrics or {}).get(metric),
            "steps": (result.metrics or {}).get("step", 0),
            "error": str(result.error).strip().splitlines()[-1][:300] if result.error else None,
        }
        for result in results
    ]
    trials.sort(key=lambda trial: json.dumps(trial["settings"], sort_keys=True))  # Tune lists them as it pleases
    known = [trial for trial in trials if trial["value"] is not None]
    if not known:
        raise ValueError(f"no trial came to a report; the first says: {trials[0]['error'] if trials else 'nothing'}")
    best = (max if mode == "max" else min)(known, key=lambda trial: trial["value"])
    return {"metric": metric, "mode": mode, "best": best, "trials": trials}
