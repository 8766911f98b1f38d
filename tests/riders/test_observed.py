"""The observer: silent where nothing disturbs, and otherwise it finds delay, noise and the roll's offset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_policy.riders.base import bundle_of
from bike_policy.riders.disturbed import DisturbedRider
from bike_policy.riders.observer import ObservedRider, Observer
from bike_policy.riders.rider import make_rider
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple import advance
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.files import load_vehicle
from bike_training.rollout.rollout import rollout

ENGINES = {
    "whipple": SimulatorConfig(engine="whipple", time_step=0.01),
    "pybullet": SimulatorConfig(engine="pybullet", time_step=0.005),
}


def ride(
    name: str, known: Disturbances, speed: float, engine: str = "whipple", steps: int = 300, plain: bool = False
) -> tuple[list[Snapshot], ObservedRider]:
    """Ride part of the benchmark path; plain without the observer."""
    observed = make_rider(name)
    assert isinstance(observed, ObservedRider)
    simulator = Simulator(ENGINES[engine], known)
    rider = DisturbedRider(observed.rider if plain else observed, known)
    snapshots = rollout(simulator, rider, ResetRequest(course="benchmark", speed_range=(speed, speed)))
    found = [snapshot for snapshot, _ in zip(snapshots, range(steps), strict=False)]
    simulator.close()
    return found, observed


def mean_error(snapshots: list[Snapshot]) -> float:
    return float(np.mean([abs(snapshot.look[lk.LATERAL_ERROR]) for snapshot in snapshots]))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", ["lqr", DEFAULT_POLICY])
def test_it_changes_no_bit_of_a_ride_that_nothing_disturbs(name: str, engine: str) -> None:
    for speed in (2.0, 7.0):
        observed, plain = (ride(name, Disturbances(), speed, engine, 150, plain)[0] for plain in (False, True))
        np.testing.assert_array_equal([s.state for s in observed], [s.state for s in plain])


@pytest.mark.parametrize("name", ["lqr", DEFAULT_POLICY])
@pytest.mark.parametrize(("late", "seen"), [(0.15, 0.0), (0.05, 0.05)])
def test_a_delay_is_found_and_costs_little(name: str, late: float, seen: float) -> None:
    known = Disturbances(command_delay_s=late, observation_delay_s=seen)
    for speed in (3.0, 7.0):
        late_ride, rider = ride(name, known, speed)
        assert len(late_ride) == 300
        assert rider.observer.delay == round((late + seen) / 0.05)
        assert mean_error(late_ride) < mean_error(ride(name, Disturbances(), speed)[0]) + 0.002


@pytest.mark.parametrize("askew", ["roll", "steer"])
def test_an_offset_is_found(askew: str) -> None:
    known = Disturbances(bias={askew: 0.0349})
    name = {"roll": "lqr", "steer": DEFAULT_POLICY}[askew]
    for speed in (3.0, 6.0):
        snapshots, rider = ride(name, known, speed)
        expected = [0.0349 if place == askew else 0.0 for place in ("roll", "steer")]
        assert rider.observer.offsets == pytest.approx(expected, abs=1e-3)
        assert mean_error(snapshots) < 0.3 * mean_error(ride(name, known, speed, plain=True)[0])
        assert mean_error(snapshots) < (0.03 if askew == "steer" else 0.05)


def test_noise_is_found_and_filtered() -> None:
    noise = load_disturbances("noise")
    snapshots, rider = ride("lqr", noise, 4.0)
    wanted = [noise.noise.get(name, 0.0) for name in ("lateral", "heading", "roll", "steer", "roll_rate", "steer_rate")]
    found = rider.observer.noise
    for wanted_one, found_one in zip(wanted, found, strict=True):
        assert found_one == pytest.approx(wanted_one, rel=0.6, abs=1e-3)
    plain = ride("lqr", noise, 4.0, plain=True)[0]
    rates = [np.std([snapshot.state[st.STEER_RATE] for snapshot in each]) for each in (snapshots, plain)]
    assert rates[0] < 0.6 * rates[1]


@pytest.mark.parametrize("name", [DEFAULT_POLICY, "lqr"])
@pytest.mark.parametrize(("speed", "seed"), [(2.0, 0), (7.0, 0), (2.0, 2), (3.0, 6), (3.0, 13), (4.0, 12), (5.0, 15)])
def test_a_start_on_six_times_the_noise_is_no_fall(name: str, speed: float, seed: int) -> None:
    """Whoever steers by the first measurements alone falls with most of these seeds."""
    usual = load_disturbances("noise")
    strong = replace(usual, seed=seed, noise={channel: 6.0 * size for channel, size in usual.noise.items()})
    snapshots, rider = ride(name, strong, speed, steps=200)
    assert len(snapshots) == 200
    assert not snapshots[-1].fallen
    assert rider.observer.noisy
    assert rider.observer.delay == 0
    assert mean_error(snapshots) < 0.3


def test_pushes_are_no_noise() -> None:
    _, rider = ride("lqr", load_disturbances("impulses"), 5.0)
    assert not rider.observer.noisy
    assert rider.observer.delay == 0
    assert (np.abs(rider.observer.offsets) < 0.008).all()


def test_a_policy_is_known_behind_what_lies_before_it() -> None:
    rider = make_rider(DEFAULT_POLICY)
    bundle = bundle_of(DisturbedRider(rider, Disturbances()))
    assert bundle is not None
    assert bundle.name == DEFAULT_POLICY
    assert bundle_of(make_rider("lqr")) is None
    assert bundle_of(make_rider("classical")) is None


def test_it_begins_anew_where_a_fall_leaves_nothing_to_filter() -> None:
    vehicle = load_vehicle("whipple")
    observer, draws = Observer(vehicle, vehicle.control_period), np.random.default_rng(5)
    for step in range(400):
        measured = np.zeros(st.STATE_SIZE)
        measured[st.FRONT_WHEEL_RATE] = 15.0
        # a fork that has turned over, again and again
        if step % 100 > 20:
            measured[[st.ROLL, st.STEER]] = draws.normal(0.0, 2.0, 2)
            measured[[st.ROLL_RATE, st.STEER_RATE]] = draws.normal(0.0, 40.0, 2)
        observer.measure(measured)
        observer.answered(draws.uniform(-1.2, 1.2))
        assert np.isfinite(observer.state).all()
        assert np.isfinite(observer.ahead()).all()


@pytest.mark.parametrize("rates", [0.0, 3.0])
def test_slopes_of_the_filter_are_those_of_the_motion(rates: float) -> None:
    """However quickly it moves: differences of rides with unlike steps would show their errors instead."""
    vehicle = load_vehicle("whipple")
    observer, before = Observer(vehicle, 0.05), np.zeros(st.STATE_SIZE)
    free = (st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE)
    before[list(free)], before[st.FRONT_WHEEL_RATE] = (-0.2, 0.5, rates, -rates), 6.0

    def moved(place: int, by: float) -> np.ndarray:
        state = before.copy()
        state[place] += by
        advance(state, 0.4, 0.01, 5, vehicle.parameters)
        return state

    slopes = observer._transition(before, moved(st.ROLL, 0.0), 0.4)
    for column, place in enumerate(free, start=2):
        wanted = (moved(place, 1e-4) - moved(place, -1e-4))[list(free)] / 2e-4
        np.testing.assert_allclose(slopes[2:6, column], wanted, rtol=0.02, atol=0.02)
