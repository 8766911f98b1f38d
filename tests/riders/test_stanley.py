"""The Stanley law with its balance loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_policy.riders.lqr import LqrRider
from bike_policy.riders.mpc import MpcRider
from bike_policy.riders.rider import make_rider
from bike_policy.riders.stanley import StanleyRider
from bike_sim.course.files import load_course
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import load_vehicle
from bike_training.rollout.rollout import rollout

COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)


def test_a_steady_turn_is_ridden_without_an_offset_of_the_front() -> None:
    simulator = Simulator(COMPILED)
    snapshots = rollout(simulator, make_rider("stanley"), ResetRequest(course="circle", speed_range=(4.0, 4.0)))
    last = [next(snapshots) for _ in range(600)][-1]
    simulator.close()
    assert abs(last.look[lk.FRONT_LATERAL_ERROR]) < 0.02  # steered, the front contact moves sideways by the trail


@pytest.mark.parametrize("kind", [LqrRider, MpcRider, StanleyRider])
def test_mirrored_snapshots_get_mirrored_answers_and_superbikes_are_refused(kind: type) -> None:
    """Of every rider with a law of steering."""
    answers = []
    for sign in (1.0, -1.0):
        simulator, rider = Simulator(COMPILED), kind()
        first = simulator.reset(ResetRequest(course="line", speed_range=(4.0, 4.0)))
        state, look = first.state.copy(), first.look.copy()
        state[[2, 3, 4, 7, 8]] = sign * np.array([0.1, 0.05, -0.02, 0.1, -0.3])
        look[[6, 7, 10]] = sign * np.array([0.2, -0.05, 0.2])
        assert simulator.course is not None
        rider.begin(simulator.vehicle, simulator.course, 0.05, simulator.preview)
        answers.append(rider.command(replace(first, state=state, look=look)))
        simulator.close()
    assert answers[0][0] == pytest.approx(-answers[1][0], abs=1e-6 if kind is MpcRider else 1e-12)
    assert answers[0][0] != 0.0
    with pytest.raises(ValueError, match="'r1' is a superbike"):
        kind().begin(load_vehicle("r1"), load_course("circle"), 0.02, None)  # type: ignore[arg-type]
