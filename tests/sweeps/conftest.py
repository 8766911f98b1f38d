"""Small sweeps: a training that takes two seconds once its packages are loaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from safetensors.numpy import load_file

from tests.tiny import TINY


def tiny(**changes: Any) -> dict[str, Any]:
    """Return the content of a sweep's file."""
    base = {"vehicle": "whipple", "steps": 120, "checkpoint_every": 40, "set": dict(TINY)}
    return {"task": "train", "base": base, **changes}


@pytest.fixture
def write(tmp_path: Path):
    """Writes the file of a sweep."""

    def write(document: dict[str, Any], name: str = "spec.yaml") -> Path:
        path = tmp_path / name
        path.write_text(yaml.safe_dump(document))
        return path

    return write


@pytest.fixture
def drive() -> Iterator[Callable[..., Any]]:
    """Starts drivers, and ends those that a failed test leaves."""
    from .drivers import Driver

    drivers: list[Driver] = []

    def start(*words: Any, **options: Any) -> Driver:
        drivers.append(Driver(*words, **options))
        return drivers[-1]

    yield start
    for driver in drivers:
        if driver.process.poll() is None:
            for process in driver.family():
                process.kill()
            driver.process.wait()


def learned(folder: Path) -> dict[str, Any]:
    """Return what a run has learned and how it was validated, without clocks, for comparison bit for bit."""
    rows = [line.split(",") for line in (folder / "validations.csv").read_text().splitlines()]
    return {
        "tensors": load_file(folder / "checkpoint" / "tensors.safetensors"),
        "replay": dict(np.load(folder / "checkpoint" / "replay.npz")),
        "validations": [row[:1] + row[2:] for row in rows],
    }


def assert_same(mine: dict[str, Any], other: dict[str, Any]) -> None:
    """Check that two runs are the same in every bit."""
    assert mine["validations"] == other["validations"]
    for part in ("tensors", "replay"):
        assert set(mine[part]) == set(other[part])
        for name, array in mine[part].items():
            np.testing.assert_array_equal(array, other[part][name], err_msg=name)
