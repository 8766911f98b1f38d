"""The reference that shipped policies see stays what it was when they learned, however the classical rider is tuned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_policy.riders.lap_plan import CLASSICAL_SETTINGS, RiderSettings, plan_lap
from bike_policy.riders.race_reference import REFERENCE
from tests.superbike.test_theory import machine_of, wavy

PINNED = {
    ("panigale_v4r", 0.0): (46.41327305281444, 39.889076260142346, 33.97047035697591, 44.796033467696205),
    ("panigale_v4r", 4.0): (46.72029852430222, 39.87749516040391, 34.51564287317364, 43.11733983499873),
    ("r1", 0.0): (47.17555642278093, 39.85405598800635, 32.967300938357894, 44.92776664342386),
    ("r1", 4.0): (47.468041064851754, 39.84377083493951, 33.533272214852296, 43.232496845644064),
}
"""Lap time (s) and speeds at 0, 400 and 800 m (m/s) by machine and height of the hills (m), of 2026-11-22."""


@pytest.mark.parametrize(("name", "height"), PINNED)
def test_the_reference_of_policies_is_what_it_was(name: str, height: float) -> None:
    line = wavy()
    hills = height * np.sin(6.0 * np.pi * line.s / line.length) if height else None
    plan = plan_lap(machine_of(name), replace(line, height=hills), REFERENCE)
    assert (plan.lap_time, *plan.speed[:801:400]) == pytest.approx(PINNED[name, height], rel=1e-9)


def test_what_the_classical_rider_adds_is_off_elsewhere() -> None:
    plain = RiderSettings()
    assert (plain.brake_upright, plain.brake_decline, plain.dip) == (1.0, None, 0.0)
    assert (REFERENCE.brake_upright, REFERENCE.brake_decline, REFERENCE.dip) == (1.0, None, 0.0)
    assert CLASSICAL_SETTINGS.dip > 0.0
