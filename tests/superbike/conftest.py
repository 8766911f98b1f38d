"""A small circuit, quick to compute, that all tests of riding superbikes share; lines are kept for the session only."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session", autouse=True)
def own_cache(own_lines: Path) -> Path:
    return own_lines


def write_circuit(path: Path) -> Path:
    """Write a circuit of about 1.3 km with left and right bends as a CSV file."""
    angle = np.linspace(0.0, 2.0 * math.pi, 160, endpoint=False)
    radius = 190.0 + 45.0 * np.cos(2.0 * angle) + 22.0 * np.sin(3.0 * angle)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    rows = "\n".join(f"{x:.4f},{y:.4f},6.0,6.0" for x, y in points)
    path.write_text(f"# x_m,y_m,w_tr_right_m,w_tr_left_m\n{rows}\n", encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def circuit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A circuit that nothing was tuned on."""
    return write_circuit(tmp_path_factory.mktemp("circuits") / "kidney.csv")
