"""The wind that is inferred from the drag, in rides of it, and what a careful rider makes of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from bike_policy.planning.grip import AdaptiveLaw
from bike_policy.planning.lap_plan import CAREFUL_SETTINGS, CLASSICAL_SETTINGS, plan_line
from bike_policy.planning.wind_observer import CALM, LOST, MOST, WindObserver
from bike_sim.course.course import Course
from bike_sim.schema import LOOK, STATE
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances, RoadChanges
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.superbike import Superbike

CONFIG = SimulatorConfig("panigale_v4r", "compiled", 0.002, 0.02)
WIND, TOWARDS = 12.0, (0.0, 90.0, 225.0)
WORLDS = (Disturbances(), *(Disturbances(road=RoadChanges(wind_m_s=WIND, wind_towards_deg=to)) for to in TOWARDS))
STEPS = 4000


class Ridden(NamedTuple):
    """Wind that is found in the map (m/s), push, yaw and reserve at the end, lateral errors by rider, and the line."""

    found: np.ndarray
    push: np.ndarray
    yaw: np.ndarray
    lost: np.ndarray
    observer: WindObserver
    errors: dict[str, np.ndarray]
    line: Course


@pytest.fixture(scope="module")
def ridden(panigale: Superbike) -> Ridden:
    errors = {}
    for name, settings in (("careful", CAREFUL_SETTINGS), ("classical", CLASSICAL_SETTINGS)):
        batch = Batch(len(WORLDS), CONFIG, disturbances=list(WORLDS))
        law = AdaptiveLaw(
            panigale, 0.02, settings, batch.count, lambda line: plan_line(panigale, line, CLASSICAL_SETTINGS)
        )
        observer = WindObserver(panigale, 0.02, batch.count)
        for row in range(batch.count):
            batch.reset(row, batch.at_own_speed(row, ResetRequest(course="phillip_island")))
            law.begin(row, batch, batch.course(row))
            observer.begin(row, batch.course(row))
        lateral = []
        for _ in range(STEPS):
            observer.update(batch)
            batch.step(np.where(batch.fallen[:, None], 0.0, law.commands(batch)))
            lateral.append(np.where(batch.fallen, np.nan, batch.look[:, LOOK.index("lateral_error")]))
        errors[name] = np.array(lateral)
        if name == "careful":
            yaw, found = batch.state[:, STATE.index("yaw")].copy(), observer.state_dict()["_found"][:, :2]
            kept = observer
        line = batch.course(0)
        batch.close()
    return Ridden(found, kept.push.copy(), yaw, kept.lost.copy(), kept, errors, line)


def test_the_mean_wind_is_found(ridden: Ridden) -> None:
    for found, towards in zip(ridden.found[1:], TOWARDS, strict=True):
        true = WIND * np.array([np.cos(np.radians(towards)), np.sin(np.radians(towards))])
        assert np.linalg.norm(found - true) < CALM + 0.1 * WIND
    assert np.linalg.norm(ridden.found[0]) < CALM


def test_a_calm_day_changes_nothing(ridden: Ridden) -> None:
    assert ridden.push[0] == ridden.lost[0] == 0.0


def test_wind_asks_for_reserve_and_pushes_to_its_side(ridden: Ridden) -> None:
    size = np.linalg.norm(ridden.found, axis=1)
    np.testing.assert_allclose(ridden.lost, LOST * np.clip(size - CALM, 0.0, MOST - CALM))
    aside = ridden.found[:, 1] * np.cos(ridden.yaw) - ridden.found[:, 0] * np.sin(ridden.yaw)
    assert np.all(ridden.push[1:] * aside[1:] > 0.0)
    assert np.all(np.abs(ridden.push) < 1.0)


def test_who_knows_the_wind_stays_nearer_to_the_line(ridden: Ridden) -> None:
    rms = {name: np.sqrt(np.nanmean(errors[STEPS // 2 :, 1:] ** 2)) for name, errors in ridden.errors.items()}
    assert rms["careful"] < 0.8 * rms["classical"]


def test_the_same_rows_again_change_nothing(ridden: Ridden, panigale: Superbike) -> None:
    batch = Batch(1, CONFIG)
    batch.reset(0, batch.at_own_speed(0, ResetRequest(course="phillip_island")))
    observer = WindObserver(panigale, 0.02)
    observer.begin(0, batch.course(0))
    observer.update(batch)
    before = observer.state_dict()
    observer.update(batch)
    for name, values in observer.state_dict().items():
        np.testing.assert_array_equal(values, before[name])
    batch.close()


def test_what_is_known_is_stored_and_forgotten_with_a_ride(ridden: Ridden, panigale: Superbike) -> None:
    other = WindObserver(panigale, 0.02, len(WORLDS))
    other.restore(ridden.observer.state_dict())
    for name, values in ridden.observer.state_dict().items():
        np.testing.assert_array_equal(other.state_dict()[name], values)
    other.begin(1, ridden.line)
    assert other.push[1] == other.lost[1] == 0.0
    assert not other.state_dict()["_found"][1].any()
