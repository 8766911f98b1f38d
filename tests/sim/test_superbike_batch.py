"""Superbikes in one compiled loop ride as one by one in the simulator, bit for bit, whatever rides beside them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some

from bike_sim.sim.batch import make_circuit_batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import EventKind
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.sim.superbike_batch import CompiledSuperbikeBatch
from bike_sim.sim.superbike_plant import superbike_config

CONFIG = replace(superbike_config("panigale_v4r"), engine="compiled")
MACHINES = ("panigale_v4r", "r1")
QUICK = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

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


class Fleet:
    """A batch and simulators of the same rows, kept over examples: a ride must not depend on those before it."""

    def __init__(self, count: int) -> None:
        self.batch = CompiledSuperbikeBatch(count, CONFIG)
        self.machines = {
            (row, name): Simulator(replace(CONFIG, vehicle=name)) for row in range(count) for name in MACHINES
        }
        for (row, name), machine in self.machines.items():
            if row:
                machine.share_courses(self.machines[0, name])


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    return Fleet(4)


def request_of(courses: dict[str, str], start: dict[str, Any], speed: float) -> ResetRequest:
    if start["course"] not in CIRCUITS:
        start, speed = {"seed": start["seed"], "perturb": start["perturb"], "course": start["course"]}, 4.0
    return ResetRequest(**{**start, "course": courses[start["course"]]}, speed_range=(speed, speed + 1.0))


def assert_row_shows(batch: CompiledSuperbikeBatch, row: int, snapshot: Snapshot) -> None:
    """Compare all that a batch shows of a row with a snapshot."""
    assert batch.state[row].tobytes() == snapshot.state.tobytes()
    assert batch.look[row].tobytes() == snapshot.look.tobytes()
    assert batch.signals[row].tobytes() == snapshot.signals.tobytes()
    assert batch.preview_y[row].tobytes() == snapshot.preview_y.tobytes()
    if snapshot.circuit is None:
        assert all(np.isnan(block[row]).all() for block in (batch.place, batch.circuit, batch.points))
    else:
        assert batch.place[row].tobytes() == snapshot.circuit.place.tobytes()
        assert batch.circuit[row].tobytes() == snapshot.circuit.limits.tobytes()
        assert batch.points[row].tobytes() == snapshot.circuit.points.tobytes()
    assert (bool(batch.fallen[row]), batch.fall(row)) == (snapshot.fallen, snapshot.fall)
    assert (bool(batch.off_course[row]), bool(batch.finished[row])) == (snapshot.off_course, snapshot.finished)
    told = [replace(event, text="") if event.kind is EventKind.RESET else event for event in snapshot.events]
    seen = [replace(event, text="") if event.kind is EventKind.RESET else event for event in batch.events(row)]
    assert seen == told  # but for the number of the episode


@given(ROWS, some.integers(0, 2**32), some.floats(0.0, 1.0))
@QUICK
def test_rows_ride_as_simulators(
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
        assert machine.scene is not None
        assert batch.laps[row] == machine.scene.valid_laps()


def follow(batch: CompiledSuperbikeBatch, row: int) -> tuple[float, float]:
    """Return commands that keep a superbike near its line at about 20 m/s."""
    look = batch.look[row]
    bend, speed = look[8], look[2]
    lean = np.arctan(bend * speed**2 / 9.81) - 0.03 * look[6] - 0.6 * look[7]
    return float(np.clip(lean / np.radians(60.0), -1.0, 1.0)), float(np.clip(0.2 * (20.0 - speed), -0.3, 0.3))


def test_laps_and_events_are_those_of_the_simulator(courses: dict[str, str]) -> None:
    batch = CompiledSuperbikeBatch(2, CONFIG)
    machine = Simulator(CONFIG)
    request = ResetRequest(course=courses["circuit file"], speed_range=(20.0, 20.0), progress=900.0)
    batch.reset(0, request)
    batch.reset(1, replace(request, progress=400.0))
    machine.reset(request)
    told: list[Any] = []
    for _ in range(4000):
        commands = np.array([follow(batch, 0), follow(batch, 1)])
        batch.step(commands)
        snapshot = machine.step(*commands[0].tolist())
        assert batch.events(0) == snapshot.events
        told += snapshot.events
    assert_row_shows(batch, 0, snapshot)
    assert machine.scene is not None
    assert batch.laps[0] == machine.scene.valid_laps()
    assert len(batch.laps[0]) == 1
    assert [event.kind for event in told].count(EventKind.LAP) == 1
    assert batch.log(0).laps == list(machine.scene.timing().laps)  # type: ignore[union-attr]
    assert batch.laps[1] != batch.laps[0]
    batch.close()


def test_a_batch_goes_on_from_a_checkpoint_as_if_nothing_had_been(courses: dict[str, str]) -> None:
    batch, again = (CompiledSuperbikeBatch(3, CONFIG, [*MACHINES, "r1"]) for _ in range(2))
    for row, course in enumerate(("circuit file", "closed path", "circuit file")):
        batch.reset(row, ResetRequest(seed=row, course=courses[course], speed_range=(7.0, 7.0), perturb=True))
    batch.reset(0, ResetRequest(course=courses["circuit file"], speed_range=(15.0, 15.0)), "r1")
    for _ in range(30):
        batch.step(np.full((3, 2), 0.05))
    again.restore(batch.state_dict())
    assert [machine.name for machine in again.vehicles] == [machine.name for machine in batch.vehicles]
    for _ in range(100):
        for rides in (batch, again):
            rides.step(np.array([[0.3, 0.5], [0.05, 0.1], [0.9, -0.3]]))
        for row in range(3):
            assert again.events(row) == batch.events(row)
    for name in ("state", "look", "signals", "place", "circuit", "points", "preview_y"):
        assert getattr(again, name).tobytes() == getattr(batch, name).tobytes()
    assert again.laps == batch.laps
    with pytest.raises(ValueError, match="a batch of 1 superbikes cannot go on with 3"):
        CompiledSuperbikeBatch(1, CONFIG).restore(batch.state_dict())


def test_a_circuit_is_stored_once_however_many_ride_it(courses: dict[str, str]) -> None:
    batch = CompiledSuperbikeBatch(4, CONFIG)
    for row in range(4):
        line = 1.0 if row < 3 else 0.5
        batch.reset(row, ResetRequest(course=courses["circuit file"], speed_range=(10.0, 10.0), line=line))
    rows = batch._rows
    assert len(set(rows.track.tolist())) == 1
    assert len(set(rows.line[:3].tolist())) == 1
    assert rows.line[3] != rows.line[0]
    batch.reset(3, ResetRequest(course=courses["CSV of a circuit"], speed_range=(10.0, 10.0)))
    assert rows.track[3] != rows.track[0]


def test_physics_that_diverge_end_a_row_at_its_last_finite_instant(courses: dict[str, str]) -> None:
    """The row tells it once and the others ride on; so does the simulator."""
    batch, machine = CompiledSuperbikeBatch(2, CONFIG), Simulator(CONFIG)
    request = ResetRequest(course=courses["circuit file"], speed_range=(20.0, 20.0))
    for row in range(2):
        batch.reset(row, request)
    machine.reset(request)
    batch._rows.motion["velocity"][0] = np.nan
    machine.plant.engine.motion["velocity"] = np.nan  # type: ignore[attr-defined]
    before = batch.look[0].copy()
    for _ in range(3):
        batch.step(np.zeros((2, 2)))
        snapshot = machine.step(0.0, 0.0)
        assert_row_shows(batch, 0, snapshot)
    assert batch.fall(0) == "diverged"
    assert np.array_equal(batch.look[0], before)
    assert not batch.fallen[1]
    assert batch.look[1, 5] > 0.5


def test_what_cannot_be_is_refused(courses: dict[str, str]) -> None:
    for config in (SimulatorConfig(engine="whipple"), superbike_config("r1")):
        with pytest.raises(ValueError, match="needs a superbike and engine 'compiled', got vehicle"):
            CompiledSuperbikeBatch(1, config)
    with pytest.raises(ValueError, match="a batch of 2 superbikes needs as many vehicles, got 1"):
        CompiledSuperbikeBatch(2, CONFIG, ["r1"])
    batch = make_circuit_batch(2, CONFIG, Preview())
    assert isinstance(batch, CompiledSuperbikeBatch)
    for commands in (np.zeros((1, 2)), np.full((2, 2), 1.1), np.full((2, 2), np.nan)):
        with pytest.raises(ValueError, match=r"commands must be 2 pairs in \[-1, 1\]"):
            batch.step(commands)
