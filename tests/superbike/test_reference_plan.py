"""The reference that shipped policies see stays what it was when they learned, however the classical rider is tuned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, REFERENCE, RiderSettings, plan_lap
from bike_sim.vehicles.files import load_superbike
from tests.circuits import wavy

PINNED = {
    ("panigale_v4r", 0.0): (46.55155836270564, 39.145504068165884, 33.980978312635266, 44.81852876196894),
    ("panigale_v4r", 4.0): (46.85370394384584, 39.16736843104956, 34.52665377850921, 43.14169534320782),
    ("r1", 0.0): (47.2921755542232, 39.11326293452157, 32.98001542242893, 44.947925575931414),
    ("r1", 4.0): (47.581073460056906, 39.126089127562715, 33.54642632889184, 43.25385026728537),
}
"""Lap time (s) and speeds at 0, 400 and 800 m (m/s) by machine and height of the hills (m), with brakes
that fade in a deep lean and stoppie control that keeps more load there."""


@pytest.mark.parametrize(("name", "height"), PINNED)
def test_the_reference_of_policies_is_what_it_was(name: str, height: float) -> None:
    line = wavy()
    hills = height * np.sin(6.0 * np.pi * line.s / line.length) if height else None
    plan = plan_lap(load_superbike(name), replace(line, height=hills), REFERENCE)
    assert (plan.lap_time, *plan.speed[:801:400]) == pytest.approx(PINNED[name, height], rel=1e-9)


def test_what_the_classical_rider_adds_is_off_elsewhere() -> None:
    plain = RiderSettings()
    assert (plain.brake_upright, plain.brake_decline, plain.dip) == (1.0, None, 0.0)
    assert (REFERENCE.brake_upright, REFERENCE.brake_decline, REFERENCE.dip) == (1.0, None, 0.0)
    assert CLASSICAL_SETTINGS.dip > 0.0
