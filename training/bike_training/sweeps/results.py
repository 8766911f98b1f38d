"""Tables of a sweep from the folders of its runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

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
        **{
            f"{SETTING}{name.removeprefix('set.').replace('.', '_')}": json.dumps(value)
            if isinstance(value, list | dict)
            else value
            for name, value in run.varied.items()
            if name != "seed"
        },
        **{
            f"{FIGURE}{name}": value
            for name, value in result.get("figures", {}).items()
            if value is None or isinstance(value, int | float | str)
        },
    }
