"""The simulated schedule of docs/scaling.md: what must hold whatever the costs are."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.sweep_schedule import Setting, simulate

FREE = Setting(runs=60, machines=3, boot=0.0, load=0.0, head_seconds=0.0, told_seconds=0.0, checkpoint_bytes=0.0)


def test_without_costs_equal_runs_take_what_their_work_takes() -> None:
    found = simulate(replace(FREE, spread=0.0, seconds=150.0))
    assert found["hours"] * 3600.0 == pytest.approx(60 / 6 * 150.0)
    assert found["efficiency"] == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["boot", "load", "head_seconds", "checkpoint_bytes"])
def test_each_cost_makes_it_longer(name: str) -> None:
    costly = replace(FREE, **{name: getattr(Setting(), name)})
    assert simulate(costly)["hours"] > simulate(FREE)["hours"]
    assert 0.0 < simulate(costly)["efficiency"] <= 1.0


def test_a_head_that_takes_all_the_time_is_what_decides() -> None:
    found = simulate(replace(FREE, head_seconds=100.0, seconds=10.0, spread=0.0))
    assert found["hours"] * 3600.0 == pytest.approx(60 * 100.0 + 10.0)
    assert found["head_busy"] == pytest.approx(1.0, abs=0.01)
