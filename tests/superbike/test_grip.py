"""The inferred grip: exact where the tyres are known, found within a bend where the road has less, and ridden by."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bike_policy.contract.observation import Rows
from bike_policy.planning.grip import BIN, LEVEL, RESERVE, AdaptiveLaw, GripPlans
from bike_policy.planning.lap_plan import CAREFUL_SETTINGS, CLASSICAL_SETTINGS, P_SPEED, plan_line
from bike_policy.planning.plan_verification import PlanFollower, verified_plan
from bike_policy.riders.classical import ClassicalRider
from bike_sim.schema import STATE
from bike_sim.sim import look as lk
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances, RoadChanges
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike
from bike_training.rollout.rollout import rollout

CONFIG = SimulatorConfig("panigale_v4r", "compiled", 0.002, 0.02)
ROADS = [Disturbances(), *(Disturbances(road=RoadChanges(grip)) for grip in (0.9, 0.85))]
PATCH = Disturbances(road=RoadChanges(patches=((500.0, 650.0, 0.95),)))


@pytest.fixture(scope="module")
def ridden(panigale: Superbike, circuit: Path) -> tuple[Batch, AdaptiveLaw, list[np.ndarray], list[np.ndarray]]:
    """A lap and a half on the known road, on two with less grip, and with a patch; states, and inferred grips."""
    worlds = [*ROADS, PATCH]
    batch = Batch(len(worlds), CONFIG, disturbances=worlds)
    law = AdaptiveLaw(panigale, CONFIG.control_period, CLASSICAL_SETTINGS, batch.count)
    for row in range(batch.count):
        batch.reset(row, batch.at_own_speed(row, ResetRequest(course=str(circuit))))
        law.begin(row, batch, batch.course(row))
    states, grips = [], []
    while batch.look[~batch.fallen, lk.PROGRESS].min(initial=1e9) < 1500.0:
        batch.step(np.where(batch.fallen[:, None], 0.0, law.commands(batch)))
        states.append(batch.state.copy())
        grips.append(np.stack((batch.look[:, lk.PROGRESS], law.memory.grip), axis=1))
    return batch, law, states, grips


def test_the_known_road_changes_no_bit(ridden, panigale: Superbike, circuit: Path) -> None:
    _, _, states, grips = ridden
    assert max(abs(step[0, 1] - 1.0) for step in grips) < 1e-6
    alone = Batch(1, CONFIG)
    alone.reset(0, alone.at_own_speed(0, ResetRequest(course=str(circuit))))
    plan = verified_plan(panigale, alone.course(0), CLASSICAL_SETTINGS, CONFIG.control_period)
    follower = PlanFollower(panigale, CONFIG.control_period, CLASSICAL_SETTINGS, plan, [0.0])
    follower.begin(0, alone, alone.course(0))
    for step, expected in enumerate(states[:800]):
        alone.step(follower.commands(alone, step))
        np.testing.assert_array_equal(alone.state[0], expected[0])


def test_less_grip_is_found_and_ridden(ridden) -> None:
    batch, _, _, grips = ridden
    assert not batch.fallen.any()
    late = np.array(grips[500:])
    for row, road in enumerate(ROADS):
        np.testing.assert_allclose(late[:, row, 1], road.road.grip, atol=2e-3)
    progress, grip = late[:, 3].T
    assert grip.min() == pytest.approx(0.95, abs=0.01)
    place = progress[np.argmin(grip)] % 1300.0
    assert 450.0 < place < 750.0


def test_a_rider_goes_slower_where_the_lap_before_had_less_grip(ridden) -> None:
    """Of the lap before, the smallest grip of each part is remembered; it counts from a little ahead on."""
    _, law, _, _ = ridden
    lap = law.memory._lap[3]
    lowest = int(np.argmin(lap))
    assert lap[lowest] < 0.97
    here = np.full(4, (lowest - 2) * BIN + 1.0)
    law.memory.grip[:] = 1.0
    assert law.memory.ahead(here)[3] == lap[lowest]
    assert law.memory.ahead(here)[0] == pytest.approx(1.0, abs=1e-6)


def test_plans_fall_with_the_grip(panigale: Superbike, circuit: Path) -> None:
    batch = Batch(1, CONFIG)
    batch.reset(0, batch.at_own_speed(0, ResetRequest(course=str(circuit))))
    line = batch.course(0)
    known = verified_plan(panigale, line, CLASSICAL_SETTINGS, CONFIG.control_period)
    plans = GripPlans(panigale, line, CLASSICAL_SETTINGS, known)
    assert plans.on(1.0) is known
    speeds = np.array([plans.on(grip).table[:, P_SPEED] for grip in (1.0, 0.95, 0.9, 0.86, 0.7)])
    assert (np.diff(speeds, axis=0) <= 1e-9).all()
    np.testing.assert_allclose(speeds[1], 0.5 * (speeds[0] + speeds[2]))
    assert plans.on(0.3) is plans.on(0.7)
    # a bend is ridden as fast as friction holds: speed by the root of the grip, nearly, for part of it is air
    tight = int(np.argmin(speeds[0]))
    assert speeds[2, tight] / speeds[0, tight] == pytest.approx(np.sqrt(0.9), rel=0.01)
    assert LEVEL <= RESERVE


def test_a_ride_goes_on_from_what_is_kept(panigale: Superbike, circuit: Path) -> None:
    batch = Batch(1, CONFIG, disturbances=ROADS[1])
    batch.reset(0, batch.at_own_speed(0, ResetRequest(course=str(circuit))))
    laws = [AdaptiveLaw(panigale, CONFIG.control_period, CAREFUL_SETTINGS) for _ in range(2)]
    for law in laws:
        law.begin(0, batch, batch.course(0))
    for _ in range(300):
        batch.step(laws[0].commands(batch))
    assert laws[0].memory.grip[0] < 0.95
    assert laws[0].state_dict()["shaking"][0] > 0.0
    laws[1].restore(laws[0].state_dict())
    for _ in range(100):
        commands = laws[0].commands(batch)
        np.testing.assert_array_equal(laws[1].commands(batch), commands)
        np.testing.assert_array_equal(laws[0].commands(batch), commands)
        batch.step(commands)


def test_a_careful_rider_does_not_drive_while_the_handlebars_shake(panigale: Superbike, circuit: Path) -> None:
    batch = Batch(1, CONFIG)
    batch.reset(0, ResetRequest(course=str(circuit), speed_share=0.5))
    laws = [
        AdaptiveLaw(panigale, CONFIG.control_period, settings) for settings in (CAREFUL_SETTINGS, CLASSICAL_SETTINGS)
    ]
    for law in laws:
        law.begin(0, batch, batch.course(0))
    drives = []
    for step in range(40):
        state = batch.state.copy()
        state[0, STATE.index("steer_rate")] = (-1.0) ** step
        rows = Rows(state, batch.look, batch.preview_xy, batch.signals, batch.circuit, batch.points, batch.fallen)
        drives.append([law.follow(rows, np.ones(1), np.ones(1))[0, 1] for law in laws])
        assert [law.follow(rows, np.ones(1), np.ones(1))[0, 1] for law in laws] == drives[-1]
    careful, classical = np.array(drives).T
    assert careful[0] == classical[0] > 0.5
    assert careful[-1] <= 0.0 < classical[-1]


def test_the_rider_of_a_node_rides_the_same(ridden, circuit: Path) -> None:
    _, _, states, _ = ridden
    simulator = Simulator(CONFIG, ROADS[1])
    request = simulator.at_own_speed(ResetRequest(course=str(circuit)))
    rides = rollout(simulator, ClassicalRider(), request)
    next(rides)
    for expected, snapshot in zip(states[:400], rides, strict=False):
        np.testing.assert_array_equal(snapshot.state, expected[1])
    simulator.close()


@pytest.mark.parametrize("vehicle", ["gsxr1000", "r1_suspended"])
def test_any_tyre_law_tells_the_known_road(vehicle: str, circuit: Path) -> None:
    config = SimulatorConfig(vehicle, "compiled", 0.002, 0.02)
    batch, machine = Batch(1, config), load_superbike(vehicle)
    law = AdaptiveLaw(machine, 0.02, CLASSICAL_SETTINGS, 1, lambda line: plan_line(machine, line, CLASSICAL_SETTINGS))
    batch.reset(0, batch.at_own_speed(0, ResetRequest(course=str(circuit), line=0.0)))
    law.begin(0, batch, batch.course(0))
    for _ in range(250):
        batch.step(law.commands(batch))
        assert law.memory.grip[0] == pytest.approx(1.0, abs=1e-6)
