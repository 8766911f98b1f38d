"""The command in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from bike_training.cli import main
from bike_training.commands.reproduce import PAPERS
from bike_training.reproduce.data import Tables, read_data

Again = Callable[[Sequence[str], Path, Tables], None]


@pytest.fixture
def whole_way() -> Callable[[Sequence[str]], dict[str, Any]]:
    """Run `bike` with words and return its figures.

    Ray takes its secret from the environment that it is imported in, so the first run has a process of its own.
    """
    pytest.importorskip("ray")

    def run(words: Sequence[str]) -> dict[str, Any]:
        program = "import sys; from bike_training.cli import main; main()"
        done = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        figures: dict[str, Any] = json.loads(done.stdout)["figures"]
        return figures

    return run


@pytest.fixture
def again_does_nothing() -> Again:
    """Run `bike` with words again, and check that no run is ridden again and the tables stay."""

    def run(words: Sequence[str], out: Path, data: Tables) -> None:
        before = {path: path.stat().st_mtime_ns for path in out.glob("runs/*/*.csv")}
        assert main(words) == 0
        assert {path: path.stat().st_mtime_ns for path in out.glob("runs/*/*.csv")} == before
        again = read_data(PAPERS[words[1]].file, out / "data")
        assert again.keys() == data.keys()
        assert all(again[name].equals(rows) for name, rows in data.items())

    return run
