"""Vehicles side by side ride as one by one in the simulator, bit for bit, whatever rides beside them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import EventKind
from bike_sim.sim.observation import array_at
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot

BICYCLES = SimulatorConfig(engine="whipple", time_step=0.01)
CONFIG = replace(superbike_config("panigale_v4r"), engine="compiled")
MACHINES = ("panigale_v4r", "r1")
PREVIEW = Preview(True, 0.4, 5)
QUICK = settings(max_examples=8)

CIRCUITS = ("circuit file", "CSV of a circuit")
STARTS = some.fixed_dictionaries(
    {
        "seed": some.integers(0, 2**32),
        "course": some.sampled_from((*CIRCUITS, "closed path", "CSV of a path", "random path")),
        "line": some.sampled_from((0.0, 0.4, 1.0)),
        "progress": some.floats(0.0, 1000.0),
        "start_offset": some.floats(-7.0, 7.0),
        "start_heading": some.floats(-0.4, 0.4),
        "perturb": some.booleans(),
    }
)
ROWS = some.lists(some.tuples(some.sampled_from(MACHINES), STARTS, some.floats(6.0, 18.0)), min_size=1, max_size=4)
BLOCKS = ("state", "look", "signals", "place", "circuit", "points", "preview_xy")


class Fleet:
    """A batch and simulators of the same rows, kept over examples: a ride must not depend on those before it."""

    def __init__(self, count: int) -> None:
        self.batch = Batch(count, CONFIG)
        self.machines = {
            (row, name): Simulator(replace(CONFIG, vehicle=name)) for row in range(count) for name in MACHINES
        }
        for (row, name), machine in self.machines.items():
            if row:
                machine.batch._courses = self.machines[0, name].batch._courses


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    return Fleet(4)


def request_of(courses: dict[str, str], start: dict[str, Any], speed: float) -> ResetRequest:
    if start["course"] not in CIRCUITS:
        start, speed = {"seed": start["seed"], "perturb": start["perturb"], "course": start["course"]}, 4.0
    return ResetRequest(**{**start, "course": courses[start["course"]]}, speed_range=(speed, speed + 1.0))


def assert_row_shows(batch: Batch, row: int, snapshot: Snapshot) -> None:
    """Compare all that a batch shows of a row with a snapshot."""
    assert batch.state[row].tobytes() == snapshot.state.tobytes()
    assert batch.look[row].tobytes() == snapshot.look.tobytes()
    assert batch.signals[row].tobytes() == snapshot.signals.tobytes()
    assert batch.preview_xy[row].tobytes() == np.stack((snapshot.preview_x, snapshot.preview_y)).tobytes()
    assert batch.on_circuit[row] == (snapshot.circuit is not None)
    if snapshot.circuit is None:
        assert not any(block[row].any() for block in (batch.place, batch.circuit, batch.points))
    else:
        assert batch.place[row].tobytes() == snapshot.circuit.place.tobytes()
        assert batch.circuit[row].tobytes() == snapshot.circuit.limits.tobytes()
        assert batch.points[row].tobytes() == snapshot.circuit.points.tobytes()
        assert batch.wall(row) == snapshot.circuit.wall
    assert (bool(batch.fallen[row]), batch.fall(row)) == (snapshot.fallen, snapshot.fall)
    assert (bool(batch.off_course[row]), bool(batch.finished[row])) == (snapshot.off_course, snapshot.finished)
    ours, theirs = (
        [replace(event, text="") if event.kind is EventKind.RESET else event for event in events]
        for events in (batch.events(row), snapshot.events)
    )
    assert ours == theirs  # but for the number of the episode


@given(ROWS, some.integers(0, 2**32), some.floats(0.0, 1.0))
@QUICK
def test_superbikes_ride_as_simulators(
    courses: dict[str, str], fleet: Fleet, rows: list[Any], seed: int, calm: float
) -> None:
    """All that a row shows is that of `Simulator`, over falls, walls and resets amid the rides of the others."""
    batch, count = fleet.batch, fleet.batch.count
    machines, snapshots = [], []
    for row, (name, start, speed) in enumerate(rows):
        request = request_of(courses, start, speed)
        batch.reset(row, request, name)
        machines.append(fleet.machines[row, name])
        snapshots.append(machines[row].reset(request))
    rng = np.random.default_rng(seed)
    for step in range(100):
        for row, snapshot in enumerate(snapshots):
            assert_row_shows(batch, row, snapshot)
        if step == 60:
            again = request_of(courses, {**rows[-1][1], "progress": 5.0}, 10.0)
            batch.reset(0, again)
            snapshots[0] = machines[0].reset(again)
            continue
        commands = np.clip((1.0 - 0.9 * calm) * rng.uniform(-1.0, 1.0, (count, 2)) + [0.0, 0.4 * calm], -1.0, 1.0)
        batch.step(commands)
        snapshots = [machine.step(*pair) for machine, pair in zip(machines, commands.tolist(), strict=False)]
    for row, machine in enumerate(machines):
        assert batch.laps[row] == machine.batch.laps[0]


@pytest.mark.parametrize(
    ("config", "kinds", "steps"),
    [
        (BICYCLES, ("path", "closed path", "path", "random path", "closed path", "circuit file"), 60),
        (SimulatorConfig(time_step=0.005), ("path", "circuit file", "random path"), 20),
        (superbike_config("panigale_v4r"), ("circuit file", "closed path"), 15),
    ],
    ids=["bicycles, compiled", "bicycles, PyBullet", "superbikes, PyBullet"],
)
def test_vehicles_on_any_engine_ride_as_simulators(
    courses: dict[str, str], config: SimulatorConfig, kinds: tuple[str, ...], steps: int
) -> None:
    """Rows begin one after the other, one of them twice."""
    requests = [
        ResetRequest(seed=seed, course=courses[kind], speed_range=(5.0, 6.0), preview=PREVIEW)
        for seed, kind in enumerate(kinds)
    ]
    batch = Batch(len(requests), config, PREVIEW)
    simulators = [Simulator(config) for _ in requests]
    snapshots = [simulator.reset(request) for simulator, request in zip(simulators, requests, strict=True)]
    for index, request in enumerate(requests):
        batch.reset(index, request)
    commands = np.random.default_rng(0).uniform(-0.2, 0.2, (steps, len(requests), 2))
    for step in range(steps):
        for row, snapshot in enumerate(snapshots):
            assert_row_shows(batch, row, snapshot)
        batch.step(commands[step])
        snapshots = [s.step(*commands[step, index].tolist()) for index, s in enumerate(simulators)]
        if step == steps // 2:
            again = replace(requests[0], seed=99)
            batch.reset(0, again)
            snapshots[0] = simulators[0].reset(again)
    for simulator in simulators:
        simulator.close()
    batch.close()


def follow(batch: Batch, row: int) -> tuple[float, float]:
    """Return commands that keep a superbike near its line at about 20 m/s."""
    look = batch.look[row]
    bend, speed = look[8], look[2]
    lean = np.arctan(bend * speed**2 / 9.81) - 0.03 * look[6] - 0.6 * look[7]
    return float(np.clip(lean / np.radians(60.0), -1.0, 1.0)), float(np.clip(0.2 * (20.0 - speed), -0.3, 0.3))


def test_laps_and_events_are_those_of_the_simulator(courses: dict[str, str]) -> None:
    batch = Batch(2, CONFIG)
    machine = Simulator(CONFIG)
    request = ResetRequest(course=courses["circuit file"], speed_range=(20.0, 20.0), progress=900.0)
    batch.reset(0, request)
    batch.reset(1, replace(request, progress=400.0))
    machine.reset(request)
    events: list[Any] = []
    for _ in range(4000):
        commands = np.array([follow(batch, 0), follow(batch, 1)])
        batch.step(commands)
        snapshot = machine.step(*commands[0].tolist())
        assert batch.events(0) == snapshot.events
        events += snapshot.events
    assert_row_shows(batch, 0, snapshot)
    assert batch.laps[0] == machine.batch.laps[0]
    assert len(batch.laps[0]) == 1
    assert [event.kind for event in events].count(EventKind.LAP) == 1
    assert batch.log(0).laps == list(machine.batch.timing(0).laps)
    assert batch.laps[1] != batch.laps[0]
    batch.close()


@pytest.mark.parametrize(
    ("config", "vehicles", "kinds"),
    [
        (CONFIG, [*MACHINES, "r1"], ("circuit file", "closed path", "circuit file")),
        (BICYCLES, None, ("closed path", "circuit file", "random path")),
    ],
    ids=["superbikes", "bicycles"],
)
def test_a_batch_goes_on_from_a_checkpoint_as_if_nothing_had_been(
    courses: dict[str, str], config: SimulatorConfig, vehicles: list[str] | None, kinds: tuple[str, ...]
) -> None:
    batch, again = (Batch(3, config, vehicles=vehicles) for _ in range(2))
    for row, course in enumerate(kinds):
        batch.reset(row, ResetRequest(seed=row, course=courses[course], speed_range=(7.0, 7.0), perturb=True))
    if vehicles is not None:
        batch.reset(0, ResetRequest(course=courses["circuit file"], speed_range=(15.0, 15.0)), "r1")
    for _ in range(30):
        batch.step(np.full((3, 2), 0.05))
    stored = batch.state_dict()
    assert stored is not None
    again.restore(stored)
    assert [machine.name for machine in again.vehicles] == [machine.name for machine in batch.vehicles]
    for step in range(100):
        for rides in (batch, again):
            if step == 50:
                rides.reset(2, ResetRequest(seed=7, course=courses["closed path"], speed_range=(4.0, 4.0)))
            rides.step(np.array([[0.3, 0.5], [0.05, 0.1], [0.9, -0.3]]))
        for row in range(3):
            assert again.events(row) == batch.events(row)
    for name in BLOCKS:
        assert getattr(again, name).tobytes() == getattr(batch, name).tobytes()
    assert again.laps == batch.laps
    with pytest.raises(ValueError, match="a batch of 1 vehicles cannot go on with 3"):
        Batch(1, config).restore(stored)


@pytest.mark.parametrize("config", [CONFIG, BICYCLES, superbike_config("panigale_v4r")], ids=lambda it: it.engine)
def test_a_course_is_stored_once_however_many_ride_it(courses: dict[str, str], config: SimulatorConfig) -> None:
    batch = Batch(4, config, PREVIEW)
    for row in range(4):
        line = 1.0 if row < 3 else 0.5
        batch.reset(row, ResetRequest(course=courses["circuit file"], speed_range=(10.0, 10.0), line=line))
    around = batch.rows.around
    assert len(set(around["table"].tolist())) == len(set(around["line"][:3].tolist())) == 1
    assert around["line"][3] != around["line"][0]
    batch.reset(3, ResetRequest(course="circle", speed_range=(7.0, 7.0)))
    assert np.array_equal(array_at(int(around["line"][3]), 4, len(batch.course(3).s)), batch.course(3).table)
    batch.close()


def test_physics_that_diverge_end_a_row_at_its_last_finite_instant(courses: dict[str, str]) -> None:
    """It is reported once and the others ride on; so does the simulator."""
    batch, machine = Batch(2, CONFIG), Simulator(CONFIG)
    request = ResetRequest(course=courses["circuit file"], speed_range=(20.0, 20.0))
    for row in range(2):
        batch.reset(row, request)
    machine.reset(request)
    for rides in (batch, machine.batch):
        rides._slot.bodies.motion["velocity"][0] = np.nan  # type: ignore[attr-defined]
    before = batch.look[0].copy()
    for _ in range(3):
        batch.step(np.zeros((2, 2)))
        snapshot = machine.step(0.0, 0.0)
        assert_row_shows(batch, 0, snapshot)
    assert batch.fall(0) == "diverged"
    assert np.array_equal(batch.look[0], before)
    assert not batch.fallen[1]
    assert batch.look[1, 5] > 0.5


@pytest.mark.parametrize("config", [CONFIG, BICYCLES, SimulatorConfig(time_step=0.005)], ids=lambda it: it.engine)
def test_a_halted_row_stands_still_until_its_next_reset_and_the_others_ride_on(
    courses: dict[str, str], config: SimulatorConfig
) -> None:
    batch, alone = Batch(2, config), Simulator(config)
    request = ResetRequest(course=courses["circuit file"], speed_range=(6.0, 6.0))
    for row in range(2):
        batch.reset(row, request)
    snapshot = alone.reset(request)
    batch.halt(np.array([True, False]))
    before = batch.state[0].copy(), batch.look[0].copy()
    for _ in range(5):
        batch.step(np.full((2, 2), 0.05))
        snapshot = alone.step(0.05, 0.05)
    assert np.array_equal(batch.state[0], before[0])
    assert np.array_equal(batch.look[0], before[1])
    assert_row_shows(batch, 1, snapshot)
    batch.reset(0, request)
    batch.step(np.zeros((2, 2)))
    assert not np.array_equal(batch.state[0], before[0])
    alone.close()
    batch.close()


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="engine 'compiled' is for superbikes; for the bicycle 'whipple'"):
        Batch(1, SimulatorConfig(engine="compiled"))
    with pytest.raises(ValueError, match="a batch of 2 vehicles needs as many vehicles, got 1"):
        Batch(2, CONFIG, vehicles=["r1"])
    with pytest.raises(ValueError, match="bicycles and superbikes see different points ahead: whipple, r1"):
        Batch(2, SimulatorConfig(), vehicles=["whipple", "r1"])
    batch = Batch(2, BICYCLES)
    batch.reset(0, ResetRequest(course="line"))
    with pytest.raises(ValueError, match="all rows see 49 points ahead, not 5"):
        batch.reset(1, ResetRequest(course="line", preview=PREVIEW))
    for commands in (np.zeros((1, 2)), np.full((2, 2), 1.1), np.full((2, 2), np.nan)):
        with pytest.raises(ValueError, match=r"commands must be 2 pairs in \[-1, 1\]"):
            batch.step(commands)
