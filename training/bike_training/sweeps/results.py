"""Tables of a sweep from the folders of its runs; its finished runs in MLflow, for those who keep theirs there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import pandas as pd

from bike_analysis.sweeps.tables import (
    CURVE_COLUMNS,
    CURVES_TABLE,
    FIGURE,
    RUN_COLUMNS,
    RUNS_TABLE,
    SETTING,
    write_table,
)
from bike_training.sweeps.jobs import JOBS
from bike_training.sweeps.runs import Plan, PlannedRun, result_of

DIGEST_TAG: Final = "bike.digest"
"""Tag with the identity of a run, by which it is found again and not logged twice."""
BATCH: Final = 1000
"""Metrics of one request; MLflow takes no more."""


def write_tables(plan: Plan, out: Path) -> None:
    """Write both tables into the folder of a sweep.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        OSError: they cannot be written.
    """
    write_table(runs_table(plan), out / RUNS_TABLE)
    write_table(curves_table(plan), out / CURVES_TABLE)


def runs_table(plan: Plan) -> pd.DataFrame:
    """Return one row for each run of a sweep, in the order of its file."""
    rows = [_run_row(planned) for planned in plan.runs]
    table = pd.DataFrame(rows)
    for name, kind in RUN_COLUMNS.items():
        table[name] = pd.array(list(table[name]), dtype=kind)  # type: ignore[call-overload]
    others = [name for name in table.columns if name not in RUN_COLUMNS]
    return table[[*RUN_COLUMNS, *others]]


def curves_table(plan: Plan) -> pd.DataFrame:
    """Return one row for each point of a curve of a run, also of runs that have not finished."""
    parts = []
    for planned in plan.runs:
        job = JOBS[planned.run.task]
        points = job.curve(planned.folder)
        part = pd.DataFrame(points, columns=["quantity", "x", "value"])
        part.insert(0, "run", planned.folder.name)
        part.insert(1, "group", planned.run.group)
        part.insert(2, "seed", planned.run.entries.get("seed"))
        part.insert(4, "axis", job.axis)
        parts.append(part.astype(dict(CURVE_COLUMNS)))
    return pd.concat(parts, ignore_index=True)


def _run_row(planned: PlannedRun) -> dict[str, Any]:
    run, result = planned.run, result_of(planned.folder) or {}
    return {
        "run": planned.folder.name,
        "digest": run.digest,
        "task": run.task,
        "group": run.group,
        "seed": run.entries.get("seed"),
        "status": planned.status,
        "error": planned.error or None,
        **{name: result.get(name) for name in ("seconds", "cpu_seconds", "attempts", "host", "commit")},
        **{name: result.get(name) for name in ("started_at", "ended_at")},
        "entries": json.dumps(run.entries, sort_keys=True),
        **{f"{SETTING}{_column(name)}": _cell(value) for name, value in run.varied.items() if name != "seed"},
        **{f"{FIGURE}{name}": value for name, value in _figures(result).items()},
    }


def _figures(result: Mapping[str, Any]) -> dict[str, Any]:
    figures = result.get("figures", {})
    return {name: value for name, value in figures.items() if value is None or isinstance(value, int | float | str)}


def _column(name: str) -> str:
    return name.removeprefix("set.").replace(".", "_")


def _cell(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | dict) else value


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
