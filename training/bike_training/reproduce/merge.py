"""Tables of several places put together, as of machines that have each done some of the seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bike_training.reproduce.data import Data, read_data
from bike_training.reproduce.paper import Kind, Paper


def read_all(paper: Paper[Kind, Data], folders: Sequence[Path]) -> Data:
    """Read the tables of folders and put them together.

    Raises:
        FileNotFoundError, ValueError: as of `read_data` and `merge`, or a folder is named twice.
    """
    for place, folder in enumerate(folders):
        if folder.resolve() in [other.resolve() for other in folders[:place]]:
            raise ValueError(f"{folder} is named twice")
    return merge(paper, {str(folder): read_data(folder, paper.tables) for folder in folders})


def merge(paper: Paper[Kind, Data], parts: Mapping[str, Data]) -> Data:
    """Put tables together that hold different runs.

    Args:
        paper: whose they are.
        parts: at least one, by a name for where they are from.

    Raises:
        ValueError: a run is in two of them.
    """
    everywhere = tuple(parts.values())
    if len(everywhere) == 1:
        return everywhere[0]
    _check_apart(parts)

    def place(row: Any) -> tuple[int, int]:
        """Return the order of rows: as of a single folder, one seed of all settings first."""
        return row.seed, paper.experiment.settings.index(row.setting)

    of_runs = {
        name: tuple(sorted((row for part in everywhere for row in getattr(part, name)), key=place))
        for name in ("runs", "validations", *paper.ridden)
    }
    return paper.choose(replace(everywhere[0], **of_runs), everywhere)


def _check_apart(parts: Mapping[str, Data]) -> None:
    places: dict[tuple[str, int], str] = {}
    for name, part in parts.items():
        twice = [run for run in part.runs if places.setdefault((run.setting, run.seed), name) != name]
        if twice:
            run = twice[0]
            others = f" ({len(twice) - 1} more)" if len(twice) > 1 else ""
            where = f"{places[run.setting, run.seed]} and {name}"
            raise ValueError(f"{where} both have seed {run.seed} of {run.setting}{others}; a run may be in one of them")
