"""Small courses of each kind, quick to compute, for every vehicle."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

STADIUM = """format: bike.track/1
name: stadium
length_m: 1028.3
transition_m: 30
width_m: 12
elements:
  - {straight_m: 200}
  - {arc: {length_m: 314.16, angle_deg: 180}, corner: "1"}
  - {straight_m: 200}
  - {arc: {length_m: 314.16, angle_deg: 180}, corner: "2"}
"""


@pytest.fixture(scope="session")
def courses(tmp_path_factory: pytest.TempPathFactory, kidney: Path) -> dict[str, str]:
    """Names and files of courses, by kind."""
    folder = tmp_path_factory.mktemp("courses")
    (folder / "stadium.yaml").write_text(STADIUM, encoding="utf-8")
    rows = "\n".join(f"{float(x):.3f},{2.0 * math.sin(x / 40.0):.6f}" for x in range(300))
    (folder / "open.csv").write_text(f"x_m,y_m\n{rows}\n", encoding="utf-8")
    return {
        "path": "line",
        "closed path": "circle",
        "random path": "random",
        "circuit": "cremona",
        "circuit file": str(folder / "stadium.yaml"),
        "CSV of a circuit": str(kidney),
        "CSV of a path": str(folder / "open.csv"),
    }
