"""`bike bench`: every part measures, in a short run."""

from __future__ import annotations

import math
import shutil
from typing import Any

import pytest

from bike_training.commands.bench import PARTS, load_part

pytestmark = pytest.mark.ros

SHORT: dict[str, dict[str, Any]] = {
    "physics": {"rounds": 1},
    "environment": {"scale": 0.02},
    "ros": {"rounds": 3, "steps": 10},
    "recorder": {"rates": (500,), "duration": 0.5},
    "analysis": {"duration": 4.0},
    "live": {"rounds": 1},
}
FEW = {"ROUNDS": 1, "PUBLISHERS": 1, "FIRST_REPORTS": 5, "REPORTS": 4, "PAGE_SIZE": (600, 400)}
"""What modules have of such constants."""


@pytest.mark.slow
@pytest.mark.parametrize("part", PARTS)
def test_each_part_measures(part: str, compiled: None, oval: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module, sizes = load_part(part), SHORT[part]
    if part == "physics":
        pytest.importorskip("exudyn")
        monkeypatch.setattr(module, "EXUDYN_SETTINGS", module.EXUDYN_SETTINGS[:1])
    if part == "live":
        sizes = sizes | {"with_page": shutil.which("chromium") is not None}
    for name, value in FEW.items():
        monkeypatch.setattr(module, name, value, raising=False)
    if part in ("analysis", "environment"):
        monkeypatch.setattr(module, "CIRCUIT", oval)
    figures = module.measure(**sizes)
    numbers = {name: value for name, value in figures.items() if isinstance(value, float)}
    assert numbers
    assert all(math.isfinite(value) and value >= 0.0 for value in numbers.values()), numbers
    if part == "analysis":
        assert figures["hour_messages"] > 2000.0
