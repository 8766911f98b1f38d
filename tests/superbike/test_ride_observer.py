"""The observer of superbikes: it finds noise, old fixes, delays and hidden tyres, and shows what is near the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from bike_policy.contract.observation import Rows
from bike_policy.planning.grip import AdaptiveLaw
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS
from bike_policy.planning.ride_observer import RideObserver
from bike_policy.riders.instruments import Instruments
from bike_sim.schema import LOOK, SIGNALS, STATE
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.superbike import Superbike

CONFIG = SimulatorConfig("panigale_v4r", "compiled", 0.002, 0.02)
CALM, NOISY, GPS, LATE = range(4)
WORLDS = (
    Disturbances(),
    load_disturbances("sensors_double"),
    replace(load_disturbances("sensors_gps"), observation_delay_s=0.0),
    Disturbances(command_delay_s=0.04, observation_delay_s=0.02),
)
STEPS = 500


class Ridden(NamedTuple):
    """Of each control period: what is, what instruments show, what the observer shows; all shape (steps, rows, ...)."""

    true: Rows
    measured: Rows
    shown: Rows
    rates: np.ndarray
    fallen: np.ndarray
    law: AdaptiveLaw


@pytest.fixture(scope="module")
def ridden(panigale: Superbike, circuit: Path) -> Ridden:
    batch = Batch(len(WORLDS), CONFIG, disturbances=list(WORLDS))
    instruments = Instruments(WORLDS, batch.vehicles, CONFIG.control_period)
    law = AdaptiveLaw(panigale, CONFIG.control_period, CLASSICAL_SETTINGS, batch.count)
    for row in range(batch.count):
        batch.reset(row, batch.at_own_speed(row, ResetRequest(course=str(circuit))))
        law.begin(row, instruments.begin(row, batch), batch.course(row))
    kept: list[list[Rows]] = [[], [], []]
    rates = []
    for _ in range(STEPS):
        seen = instruments.shown(batch)
        shown = law.observer.observe(seen)
        for rows, each in zip(kept, (batch, seen, shown), strict=True):
            rows.append(Rows(*(np.array(getattr(each, name)) for name in Rows._fields)))
        commands = law.commands(seen)
        rates.append(law.observer.rates.copy())
        batch.step(np.where(batch.fallen[:, None], 0.0, instruments.acting(commands)))
    fallen = batch.fallen.copy()
    batch.close()
    stacked = (Rows(*map(np.array, zip(*rows, strict=True))) for rows in kept)
    return Ridden(*stacked, np.array(rates), fallen, law)


def test_nothing_found_is_nothing_changed(ridden: Ridden) -> None:
    assert not ridden.fallen.any()
    for shown, measured in zip(ridden.shown, ridden.measured, strict=True):
        np.testing.assert_array_equal(shown[:, CALM], measured[:, CALM])
    assert np.isnan(ridden.rates[:, [CALM, LATE]]).all()
    assert not ridden.law.observer.memory["lateral_found"][[CALM, LATE]].any()


def spread(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values[50:] ** 2)))


def test_noise_is_found_and_filtered(ridden: Ridden) -> None:
    memory = ridden.law.observer.memory
    assert memory["lateral_noise"][NOISY] == pytest.approx(0.04, rel=0.4)
    assert memory["roll_noise"][NOISY] == pytest.approx(0.0105, rel=0.4)
    lateral, roll = LOOK.index("lateral_error"), STATE.index("roll")
    for rows, column, limit in (("look", lateral, 0.7), ("state", roll, 0.4)):
        true, measured, shown = (
            getattr(each, rows)[:, NOISY, column] for each in (ridden.true, ridden.measured, ridden.shown)
        )
        assert spread(shown - true) < limit * spread(measured - true)
    rate = np.diff(ridden.true.look[:, NOISY, lateral]) / CONFIG.control_period
    differenced = np.diff(ridden.measured.look[:, NOISY, lateral]) / CONFIG.control_period
    assert spread(ridden.rates[1:, NOISY] - rate) < 0.2 * spread(differenced - rate)


def test_between_fixes_the_machine_is_followed(ridden: Ridden) -> None:
    for name, limit in (("progress", 0.3), ("heading_error", 0.01), ("lateral_error", 0.1)):
        column = LOOK.index(name)
        true, shown = ridden.true.look[50:, GPS, column], ridden.shown.look[50:, GPS, column]
        assert np.abs(shown - true).max() < limit
        assert np.abs(ridden.measured.look[50:, GPS, column] - true).max() > np.abs(shown - true).max()
    points = [each.points[50:, GPS, :, :10] for each in (ridden.true, ridden.measured, ridden.shown)]
    assert np.abs(points[2] - points[0]).max() < 0.5 * np.abs(points[1] - points[0]).max()


def test_a_delay_is_found(ridden: Ridden) -> None:
    np.testing.assert_allclose(ridden.law.observer.delays, [0.0, 0.0, 0.0, 0.06])


def test_hidden_tyres_are_estimated(ridden: Ridden) -> None:
    limits = {
        "rear_slip_angle": 0.01, "front_slip_angle": 0.012, "rear_slip": 0.01, "front_slip": 0.01, "rear_load": 300.0,
        "front_load": 300.0, "rear_force_lat": 200.0, "front_force_lat": 200.0, "front_force_long": 100.0,
    }  # fmt: skip
    for name, limit in limits.items():
        column = SIGNALS.index(name)
        assert np.isnan(ridden.measured.signals[:, NOISY, column]).all()
        error = ridden.shown.signals[:, NOISY, column] - ridden.true.signals[:, NOISY, column]
        assert spread(error) < limit, name
    assert np.isfinite(ridden.shown.signals[1:]).all()
    assert np.abs(ridden.law.memory.grip[[NOISY, GPS]] - 1.0).max() < 0.1


def test_rides_go_on_from_where_they_were_stored(ridden: Ridden, panigale: Superbike) -> None:
    observers = [RideObserver(panigale, CONFIG.control_period, len(WORLDS)) for _ in range(2)]
    line = next(iter(ridden.law._plans.values()))._line
    instants = [Rows(*(array[step] for array in ridden.measured)) for step in range(60)]
    for row in range(len(WORLDS)):
        for observer in observers:
            observer.begin(row, line)
    for rows in instants[:40]:
        observers[0].observe(rows)
        observers[0].answered(rows.state[:, :2])
    observers[1].restore(observers[0].state_dict())
    for rows in instants[40:]:
        shown = [observer.observe(rows) for observer in observers]
        for a, b in zip(*shown, strict=True):
            np.testing.assert_array_equal(a, b)
