"""Every vehicle and every kind of course, in pairs: it rides sensibly and repeats; through ROS see tests/ros."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bike_sim.course.random_courses import PathRanges
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import EventKind
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import NO_FALL, Snapshot
from bike_sim.vehicles.files import load_vehicle, shipped_vehicles
from bike_sim.vehicles.superbike import Superbike
from tests.same import assert_same

WIDE = PathRanges(150.0, 200.0, 150.0, 200.0, 2.0, 4.0)
"""Random paths that a superbike can ride at the speed at which it begins."""
CIRCUITS = ("circuit", "circuit file")
KINDS = ("path", "closed path", "random path", *CIRCUITS, "CSV of a circuit", "CSV of a path")
ALL_KINDS = ("whipple", "panigale_v4r")
"""A bicycle and a superbike, which ride courses of every kind; the others ride paths."""
PAIRS = [
    (vehicle, kind)
    for vehicle in shipped_vehicles()
    for kind in (KINDS if vehicle in ALL_KINDS else ("path", "closed path"))
]
STEPS = 40


def config_of(vehicle: str) -> SimulatorConfig:
    if isinstance(load_vehicle(vehicle), Superbike):
        return superbike_config(vehicle)
    return SimulatorConfig(vehicle=vehicle, time_step=0.005)


@pytest.fixture(scope="module")
def client(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    client = Simulator(config_of(request.param))
    yield client
    client.close()


def request_for(client: Simulator, course: str) -> ResetRequest:
    machine = isinstance(client.vehicle, Superbike)
    speed = 8.0 if machine and course == "circle" else 20.0 if machine else 4.0
    paths = {"path_ranges": WIDE} if machine else {}
    return ResetRequest(seed=1, course=course, speed_range=(speed, speed), **paths)


def ride(client: Simulator, request: ResetRequest, throttle: float) -> list[Snapshot]:
    """Ride along the course by a plain law of steering: against the errors, and a bicycle into its fall."""
    seen = [client.reset(request)]
    machine = isinstance(client.vehicle, Superbike)
    for _ in range(STEPS):
        last = seen[-1]
        error, heading, bend = last.look[[lk.LATERAL_ERROR, lk.HEADING_ERROR, lk.CURVATURE]]
        if machine:
            lateral = last.speed**2 * (bend - 0.01 * error - 0.1 * heading)
            lean = math.atan(lateral / 9.81)
            steering = lean / math.radians(client.vehicle.virtual_rider.max_lean_deg)  # type: ignore[attr-defined]
        else:
            steering = -float(0.4 * last.state[st.ROLL] + 0.1 * last.state[st.ROLL_RATE])
        seen.append(client.step(float(np.clip(steering, -1.0, 1.0)), throttle))
    return seen


@pytest.mark.parametrize(("client", "kind"), PAIRS, indirect=["client"])
def test_it_rides_sensibly(client: Simulator, courses: dict[str, str], kind: str) -> None:
    request = request_for(client, courses[kind])
    machine = isinstance(client.vehicle, Superbike)
    driven, braked, again = (ride(client, request, throttle) for throttle in (1.0, -0.3, 1.0))
    for one, other in zip(driven, again, strict=True):
        assert_same(other, one, but=("episode", "events"))
        assert [replace(e, text="") for e in other.events] == [replace(e, text="") for e in one.events]
    (speed,) = set(request.speed_range)
    for seen in (driven, braked):
        first, last = seen[0], seen[-1]
        assert [snapshot.step for snapshot in seen] == list(range(STEPS + 1))
        assert first.speed == pytest.approx(speed, rel=0.02)
        assert {snapshot.fall for snapshot in seen} == {NO_FALL}
        assert not any(snapshot.fallen or snapshot.off_course or snapshot.finished for snapshot in seen)
        assert max(snapshot.distance for snapshot in seen) < 2.0
        assert [event.kind for event in first.events] == [EventKind.RESET]
        length = client.config.control_period * sum(snapshot.speed for snapshot in seen[1:])
        assert sum(math.dist(a.state[:2], b.state[:2]) for a, b in pairwise(seen)) == pytest.approx(length, rel=0.05)
        assert last.look[lk.PROGRESS] - first.look[lk.PROGRESS] == pytest.approx(length, rel=0.05)
        on_circuit = kind in CIRCUITS or (machine and kind == "CSV of a circuit")
        assert all((snapshot.circuit is not None) == on_circuit for snapshot in seen)
        assert len(last.preview_x) == client.preview.count
        assert np.all(np.diff(last.preview_x[:3]) > 0.0)
        assert all(np.isfinite(block).all() for block in (last.state, last.look, last.signals, last.preview_y))
    if machine:
        assert driven[-1].speed > speed + 1.0
        assert braked[-1].speed < speed - 1.0
    else:  # it has no drive
        assert np.array_equal(driven[-1].state, braked[-1].state)
        assert driven[-1].speed == pytest.approx(speed, rel=0.02)
