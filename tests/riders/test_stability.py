"""Closed loops of all riders: stable about steady rides, and calm on a straight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_policy.contract.bundle import Actor, load_bundle, shipped_policies
from bike_policy.riders.base import LearnedRider
from bike_policy.riders.rider import make_rider
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.simulator import Simulator
from bike_training.rollout.stability import _slopes_at_rest, deviations, is_stable, settle, stability

CLASSICAL = ("lqr", "mpc", "stanley")
LEARNED = [name for name in shipped_policies() if not load_bundle(name).layout.races]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*CLASSICAL, *LEARNED])
def test_steady_rides_are_stable_and_a_push_is_forgotten(name: str) -> None:
    figures = stability(make_rider(name), (4.5,) if name == "mpc" else (2.0, 4.5, 7.0))
    for row in figures["stability"]:
        assert row["spectral_radius_upright"] is not None, row
        assert row["spectral_radius_upright"] < 0.99, row
        assert row["spectral_radius_turn"] is not None, row
        assert row["spectral_radius_turn"] < 0.99, row
        assert row["swing_deg"] < 0.5, row
        assert abs(row["offset_m"]) < 1e-3, row


def test_a_rider_that_answers_too_strongly_is_not_stable() -> None:
    """It may ride on, swinging about the path."""
    bundle, config = load_bundle(LEARNED[0]), SimulatorConfig(engine="whipple", time_step=0.01)
    kernels, biases = [w.T for w in bundle.actor.weights], bundle.actor.biases
    for gain, stable in ((1.0, True), (4.0, False)):
        actor = Actor([*kernels[:-1], gain * kernels[-1]], biases)
        assert is_stable(LearnedRider(replace(bundle, actor=actor)), config, (7.0,)) is stable


def test_the_derivative_is_that_at_the_fixed_point() -> None:
    """Also where the fixed point repels, so that no ride would come to it."""
    rng = np.random.default_rng(3)
    slopes = rng.normal(size=(6, 6))
    rest = 0.05 * rng.normal(size=6)

    def following(point: np.ndarray) -> np.ndarray:
        away = point - rest
        return rest + slopes @ away + 0.3 * away**2

    assert np.abs(np.linalg.eigvals(slopes)).max() > 1.0
    found = _slopes_at_rest(following, np.zeros(6))
    np.testing.assert_allclose(found, slopes, atol=1e-5)


def test_a_ride_that_fails_does_not_settle() -> None:
    class Asleep:
        name, preview = "asleep", None

        def begin(self, *_: object) -> None: ...

        def command(self, _: object) -> tuple[float, float]:
            return 0.0, 0.0

    client = Simulator(SimulatorConfig(engine="whipple", time_step=0.01))
    assert settle(client, Asleep(), "line", 2.0, roll=0.1) is None
    assert stability(Asleep(), (2.0,))["worst_spectral_radius_turn"] is None
    rode = settle(client, make_rider("lqr"), "circle", 7.0)
    assert rode is not None
    # The lean of the turn is that of the nonlinear bicycle, so it is ridden without an offset.
    assert abs(deviations(rode[-1])[0]) < 5e-3
    client.close()
