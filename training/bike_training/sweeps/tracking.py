"""Finished runs as runs of MLflow, for those who keep theirs there; an option that nothing else needs."""

from __future__ import annotations

import json
from importlib.util import find_spec
from typing import Any, Final

from bike_training.sweeps.jobs import JOBS
from bike_training.sweeps.plan import Plan
from bike_training.sweeps.records import result_of

DIGEST_TAG: Final = "bike.digest"
"""Tag with the identity of a run, by which it is found again and not logged twice."""
BATCH: Final = 1000
"""Metrics of one request; MLflow takes no more."""


def check_mlflow() -> None:
    """Check that MLflow is there.

    Raises:
        ValueError: it is not installed.
    """
    if find_spec("mlflow") is None:
        raise ValueError("--mlflow needs MLflow: pip install mlflow-skinny")


def log_runs(plan: Plan, name: str, uri: str) -> int:
    """Log the finished runs of a sweep that are not there yet, with settings, figures and curves.

    Args:
        plan: the sweep as it stands.
        name: of the experiment.
        uri: of the tracking server, or of a file store.

    Returns:
        How many were logged.

    Raises:
        ConnectionError: the server does not take them.
    """
    from mlflow import MlflowClient, MlflowException
    from mlflow.entities import Metric, Param, RunTag

    try:
        client = MlflowClient(uri)
        known = client.get_experiment_by_name(name)
        experiment = known.experiment_id if known else client.create_experiment(name)
        logged = 0
        for planned in plan.runs:
            result = result_of(planned.folder)
            there = client.search_runs([experiment], f"tags.`{DIGEST_TAG}` = '{planned.run.digest}'", max_results=1)
            if result is None or there:
                continue
            run = client.create_run(experiment, run_name=planned.folder.name)
            numbers = {k: v for k, v in result["figures"].items() if isinstance(v, int | float)}
            metrics = [Metric(k, float(v), 0, 0) for k, v in numbers.items()]
            metrics += [Metric(k, y, 0, round(x)) for k, x, y in JOBS[planned.run.task].curve(planned.folder)]
            params = [Param(k, _text(v)) for k, v in planned.run.entries.items()]
            client.log_batch(run.info.run_id, params=params, tags=[RunTag("task", planned.run.task)])
            for first in range(0, len(metrics), BATCH):
                client.log_batch(run.info.run_id, metrics=metrics[first : first + BATCH])
            # Last: a run that was logged in part is logged anew.
            client.set_tag(run.info.run_id, DIGEST_TAG, planned.run.digest)
            client.set_terminated(run.info.run_id)
            logged += 1
    except MlflowException as error:
        raise ConnectionError(f"--mlflow {uri}: {str(error).splitlines()[0][:300]}") from None
    return logged


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
