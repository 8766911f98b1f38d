"""The command in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

import pytest


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
