"""Instruments of superbikes: late, in fixes and with errors, the same bits side by side and alone."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_policy.contract.observation import Rows, VehicleRows, rows_of
from bike_policy.riders.disturbed import DisturbedRider
from bike_policy.riders.instruments import CommandQueue, Instruments
from bike_sim.schema import LIMITS, LOOK, STATE
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import load_superbike, load_vehicle

CONFIG = SimulatorConfig("panigale_v4r", "compiled", 0.002, 0.02)
NOISE = {"roll": 0.005, "roll_rate": 0.02, "lateral": 0.02, "heading": 0.002, "speed": 0.1, "acceleration_lat": 0.2}
WORLDS = (
    Disturbances(),
    Disturbances(seed=3, noise=NOISE, bias={"roll": 0.01}),
    Disturbances(seed=3, noise=NOISE, position_hz=10.0, observation_delay_s=0.06, command_delay_s=0.04),
    Disturbances(command_delay_s=0.02, command_rate=2.0),
)
STEPS = 40


def answers(rows: VehicleRows) -> np.ndarray:
    """Return a command that every number that a rider sees changes."""
    seen = rows.state[:, 3:5] + 0.02 * rows.look[:, [LOOK.index("lateral_error"), LOOK.index("speed")]]
    return np.clip(0.1 * np.sin(seen + rows.points[:, 1, 3, :2] + 0.01 * rows.signals[:, 2:4]), -1.0, 1.0)


def start(row: int) -> ResetRequest:
    return ResetRequest(course="barcelona", speed_range=(40.0, 40.0), progress=200.0 + row, perturb=True, seed=row)


@pytest.fixture(scope="module")
def side_by_side() -> tuple[list[np.ndarray], list[Rows], list[np.ndarray]]:
    """True states, what was shown, and the commands that acted, of a ride in each world."""
    batch = Batch(len(WORLDS), CONFIG, disturbances=list(WORLDS))
    instruments = Instruments(WORLDS, batch.vehicles, CONFIG.control_period)
    for row in range(batch.count):
        batch.reset(row, start(row))
        instruments.begin(row, batch)
    states, shown, acted = [], [], []
    for _ in range(STEPS):
        seen = instruments.shown(batch)
        assert all(np.array_equal(a, b) for a, b in zip(seen, instruments.shown(batch), strict=True))
        acting = instruments.acting(answers(seen))
        states.append(np.concatenate((batch.state, batch.look, batch.circuit), axis=1))
        shown.append(Rows(*(np.array(array) for array in seen)))
        acted.append(acting)
        batch.step(acting)
    batch.close()
    return states, shown, acted


class Stub:
    name, preview = "stub", None

    def begin(self, *_: object) -> None:
        self.seen: list[Rows] = []

    def command(self, snapshot):
        self.seen.append(rows_of(snapshot))
        return tuple(answers(self.seen[-1])[0].tolist())


@pytest.mark.parametrize("row", range(len(WORLDS)))
def test_a_rider_alone_is_shown_the_same_bits(row: int, side_by_side) -> None:
    states, shown, acted = side_by_side
    stub, simulator = Stub(), Simulator(CONFIG, WORLDS[row])
    rider = DisturbedRider(stub, WORLDS[row])
    snapshot = simulator.reset(start(row))
    rider.begin(simulator.vehicle, simulator.course, CONFIG.control_period, simulator.preview)
    for step in range(STEPS):
        command = rider.command(snapshot)
        np.testing.assert_array_equal(snapshot.state, states[step][row, :10])
        for name in Rows._fields:
            np.testing.assert_array_equal(getattr(stub.seen[-1], name)[0], getattr(shown[step], name)[row], name)
        np.testing.assert_array_equal(command, acted[step][row])
        snapshot = simulator.step(*command)
    simulator.close()


def test_errors_are_those_of_the_file_and_limits_move_with_the_position(side_by_side) -> None:
    states, shown, _ = side_by_side
    true = np.array(states)
    roll, lateral = STATE.index("roll"), LOOK.index("lateral_error")
    rolls = np.array([rows.state[1, roll] for rows in shown]) - true[:, 1, roll]
    errors = np.array([rows.look[1, lateral] for rows in shown]) - true[:, 1, 10 + lateral]
    assert rolls.mean() == pytest.approx(0.01, abs=0.003)
    assert rolls.std() == pytest.approx(0.005, rel=0.35)
    assert errors.std() == pytest.approx(0.02, rel=0.35)
    for name, sign in (("rear_left_margin", -1.0), ("rear_right_margin", 1.0)):
        margins = np.array([rows.circuit[1, LIMITS.index(name)] for rows in shown])
        np.testing.assert_allclose(margins - true[:, 1, 22 + LIMITS.index(name)], sign * errors, atol=1e-12)
    np.testing.assert_array_equal([rows.state[0] for rows in shown], true[:, 0, :10])


def test_fixes_are_rare_and_all_is_late(side_by_side) -> None:
    _, shown, _ = side_by_side
    progress = np.array([rows.look[2, LOOK.index("progress")] for rows in shown])
    rolls = np.array([rows.state[2, STATE.index("roll")] for rows in shown])
    changed = np.flatnonzero(np.diff(progress) != 0.0) + 1
    np.testing.assert_array_equal(changed, np.arange(8, STEPS, 5))  # three periods late, then every fifth
    assert (np.diff(rolls)[:3] == 0.0).all()
    assert (np.diff(rolls)[3:] != 0.0).all()


def test_commands_come_late_and_no_faster_than_they_may() -> None:
    queue = CommandQueue([0, 2], [math.inf, 0.1])
    acted = np.array([queue.send(np.full((2, 2), 0.3)) for _ in range(7)])
    np.testing.assert_array_equal(acted[:, 0], 0.3)
    np.testing.assert_allclose(acted[:, 1, 0], [0.0, 0.0, 0.1, 0.2, 0.3, 0.3, 0.3])
    stored = queue.state_dict()
    ahead = [queue.send(np.zeros((2, 2))) for _ in range(4)]
    again = CommandQueue([0, 2], [math.inf, 0.1])
    again.restore(stored)
    np.testing.assert_array_equal(ahead, [again.send(np.zeros((2, 2))) for _ in range(4)])


def test_rides_go_on_from_where_they_were_stored() -> None:
    rng = np.random.default_rng(0)
    instants = [
        Rows(
            *(rng.standard_normal(shape) for shape in SHAPES),
            np.zeros(len(WORLDS), dtype=bool),
            rng.standard_normal((len(WORLDS), 5, 5)),
        )
        for _ in range(20)
    ]
    vehicles = [load_superbike("panigale_v4r")] * len(WORLDS)
    first, other = (Instruments(WORLDS, vehicles, 0.02) for _ in range(2))
    for instruments in (first, other):
        for row in range(len(WORLDS)):
            instruments.begin(row, instants[0])
    for rows in instants[:9]:
        first.acting(first.shown(rows).state[:, :2])
    other.restore(first.state_dict())
    for rows in instants[9:]:
        for a, b in zip(first.shown(rows), other.shown(rows), strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(*(each.acting(each.shown(rows).state[:, :2]) for each in (first, other)))


SHAPES = [(len(WORLDS), *shape) for shape in ((10,), (12,), (2, 20), (49,), (8,), (3, 20, 3))]


def test_a_snapshot_that_was_missed_shifts_nothing() -> None:
    simulator = Simulator(CONFIG, WORLDS[2])
    snapshots = [simulator.reset(start(2))]
    for _ in range(16):
        snapshots.append(simulator.step(0.01, 0.2))
    riders = [DisturbedRider(Stub(), WORLDS[2]) for _ in range(2)]
    for rider in riders:
        rider.begin(simulator.vehicle, simulator.course, 0.02, simulator.preview)
    simulator.close()
    whole, gappy = riders
    for step, snapshot in enumerate(snapshots):
        expected = whole.command(snapshot)
        if step != 6:
            got = gappy.command(snapshot)
            if step not in (8, 9, 11):  # what was sent and seen in the period that was missed would have come then
                assert got == expected


def test_what_a_bicycle_does_not_measure_is_refused(tmp_path: Path) -> None:
    for known in (Disturbances(noise={"yaw_rate": 0.1}), Disturbances(position_hz=10.0)):
        rider = DisturbedRider(Stub(), replace(known, name="odd"))
        with pytest.raises(ValueError, match=r"'odd' have (yaw_rate|position_hz), which are a superbike's"):
            rider.begin(load_vehicle("whipple"), None, 0.05, Preview())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="only superbikes have instruments"):
        Instruments([Disturbances(noise={"roll": 0.1})], [load_vehicle("whipple")], 0.05)
    with pytest.raises(ValueError, match=r"position_hz of 7\.0 is not once in a whole number of control periods"):
        Instruments([Disturbances(position_hz=7.0)], [load_superbike("r1")], 0.02)
