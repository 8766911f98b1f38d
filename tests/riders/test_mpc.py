"""The predictive rider: the LQR where no limit is met, and within its limits elsewhere."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bike_policy.riders.lqr import LqrRider, LqrSettings
from bike_policy.riders.mpc import MpcRider, MpcSettings
from bike_sim.physics import state as st
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.rollout.rollout import rollout

COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)


def ridden(rider: LqrRider, speed: float, steps: int, course: str = "benchmark") -> list:
    simulator = Simulator(COMPILED)
    snapshots = rollout(simulator, rider, ResetRequest(course=course, speed_range=(speed, speed)))
    ride = [next(snapshots) for _ in range(steps)]
    simulator.close()
    return ride


@pytest.mark.parametrize("delay", [0, 2])
def test_without_a_limit_in_reach_it_answers_as_the_lqr(delay: int) -> None:
    free = MpcSettings(lean=math.radians(80.0), accuracy=1e-8, iterations=20000)
    weights = LqrSettings(delay=delay)
    rider, model = MpcRider(weights, free), LqrRider(weights)
    simulator = Simulator(COMPILED)
    first = simulator.reset(ResetRequest(course="benchmark", speed_range=(4.0, 4.0)))
    assert simulator.course is not None
    for step, (offset, roll) in enumerate([(0.0, 0.0), (0.02, 0.005), (-0.03, 0.01)]):
        state, look = first.state.copy(), first.look.copy()
        look[[5, 6]], state[st.ROLL] = (6.0, offset), roll  # the full circle begins in the preview
        shown = replace(first, step=step, state=state, look=look)
        for each in (rider, model):
            each.begin(simulator.vehicle, simulator.course, 0.05, simulator.preview)
        answer = model.turn(shown.look, shown.state)
        assert 0.003 < abs(answer) < 1.0
        assert rider.turn(shown.look, shown.state) == pytest.approx(answer, abs=1e-3)
    simulator.close()


def test_it_keeps_to_its_lean_where_the_lqr_does_not() -> None:
    """The full circle of 10 m asks for 26 deg at 7 m/s."""
    limit = math.radians(20.0)
    steps = round(25.0 / 7.0 / 0.05)
    leans = [
        max(abs(snapshot.state[st.ROLL]) for snapshot in ridden(rider, 7.0, steps))
        for rider in (LqrRider(), MpcRider(settings=MpcSettings(lean=limit)))
    ]
    assert leans[0] > limit + math.radians(5.0)
    assert leans[1] < limit + math.radians(3.5)  # the limit is soft


def test_the_same_ride_again_is_the_same_bit_for_bit() -> None:
    rider = MpcRider()
    first, second = (ridden(rider, 6.0, 80) for _ in range(2))
    assert [snapshot.steering for snapshot in first] == [snapshot.steering for snapshot in second]
    assert np.isfinite(first[-1].state).all()
