"""The reference that shipped policies see stays what it was when they learned, however the classical rider is tuned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_policy.riders.lap_plan import CLASSICAL_SETTINGS, RiderSettings, plan_lap
from bike_policy.riders.race_reference import REFERENCE
from tests.superbike.test_theory import machine_of, wavy

PINNED = {
    ("panigale_v4r", 0.0): (46.5511887679292, 39.145504068165764, 33.980978496873256, 44.81852861425469),
    ("panigale_v4r", 4.0): (46.85332209743761, 39.1673684310492, 34.526653952641176, 43.141695254592854),
    ("r1", 0.0): (47.29193584581983, 39.11326293452147, 32.98001556559606, 44.9479254469933),
    ("r1", 4.0): (47.58082680571411, 39.126089127562224, 33.546426464750006, 43.25385021160455),
}
"""Lap time (s) and speeds at 0, 400 and 800 m (m/s) by machine and height of the hills (m), with brakes
that fade in a deep lean."""


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
