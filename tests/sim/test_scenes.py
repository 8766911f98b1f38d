"""A superbike on a path and a bicycle on a circuit: what both scenes show to the vehicle that is not usual there."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import EventKind
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot

BICYCLE = SimulatorConfig(engine="whipple", time_step=0.005)


def superbike_on_a_path(courses: dict[str, str]) -> tuple[Simulator, ResetRequest, Callable[[Snapshot], float]]:
    machine = Simulator(replace(superbike_config("panigale_v4r"), engine="compiled"))
    request = ResetRequest(seed=3, course=courses["closed path"], speed_range=(13.0, 13.0), perturb=True)
    lean = math.radians(machine.vehicle.virtual_rider.max_lean_deg)

    def steer(seen: Snapshot) -> float:
        error, heading, bend = seen.look[[lk.LATERAL_ERROR, lk.HEADING_ERROR, lk.CURVATURE]]
        return math.atan(seen.speed**2 * (bend - 0.008 * error - 0.12 * heading) / 9.81) / lean

    return machine, request, steer


def bicycle_on_a_circuit(courses: dict[str, str]) -> tuple[Simulator, ResetRequest, Callable[[Snapshot], float]]:
    request = ResetRequest(
        seed=3,
        course=courses["circuit file"],
        speed_range=(5.0, 5.0),
        perturb=True,
        line=0.5,
        progress=120.0,
        preview=Preview(True, 0.2, 11),
    )
    return Simulator(BICYCLE), request, lambda seen: -float(0.4 * seen.state[st.ROLL] + 0.1 * seen.state[st.ROLL_RATE])


def ride(simulator: Simulator, request: ResetRequest, steer: Callable[[Snapshot], float]) -> list[Snapshot]:
    seen = [simulator.reset(request)]
    for _ in range(100):
        seen.append(simulator.step(min(max(steer(seen[-1]), -1.0), 1.0)))
    return seen


def test_a_circle_leans_a_superbike_as_its_speed_asks_and_is_told_as_laps(courses: dict[str, str]) -> None:
    simulator, request, steer = superbike_on_a_path(courses)
    seen = ride(simulator, request, steer)
    asked = seen[-1].speed

    def on() -> None:
        # A constant throttle would speed the machine up until the bend asks for more than its tyres hold.
        seen.append(simulator.step(steer(seen[-1]), min(max(0.2 * (asked - seen[-1].speed), -1.0), 1.0)))

    for _ in range(300):  # the rider swings in from a start beside the steady turn
        on()
    bend = seen[-1].look[lk.CURVATURE]
    assert seen[-1].state[st.ROLL] == pytest.approx(-math.atan(seen[-1].speed ** 2 * bend / 9.81), rel=0.25)
    assert seen[-1].look[lk.YAW_RATE] == pytest.approx(seen[-1].speed * bend, rel=0.15)
    assert simulator.course is not None
    events: list = []
    while not events:
        on()
        assert not seen[-1].fallen
        events = [event for event in seen[-1].events if event.kind is EventKind.LAP]
    assert events[0].progress == simulator.course.length
    assert seen[-1].finished == (seen[-1].progress >= simulator.course.length)
    assert seen[-2].time <= events[0].time <= seen[-1].time
    simulator.close()


def test_a_bicycle_sees_limits_and_place_of_its_circuit(courses: dict[str, str]) -> None:
    simulator, request, steer = bicycle_on_a_circuit(courses)
    seen = ride(simulator, request, steer)
    assert seen[0].progress == pytest.approx(120.0, abs=0.5)
    track = simulator.track
    assert track is not None
    for snapshot in seen:
        view = snapshot.circuit
        assert view is not None
        assert view.points.shape == (3, lk.STATIONS, 3)
        across = np.linalg.norm(view.points[lk.LEFT, :, :2] - view.points[lk.RIGHT, :, :2], axis=1)
        assert across == pytest.approx(np.full(lk.STATIONS, 12.0), abs=1e-6)
        # The front wheel runs ahead of the rear one, and both lie within the limits.
        ahead = view.place[lk.FRONT_CENTRE_PROGRESS] - view.place[lk.CENTRE_PROGRESS]
        assert ahead == pytest.approx(simulator.vehicle.w, rel=0.02)
        assert -6.0 < view.outside == pytest.approx(min(abs(view.place[[1, 3]])) - 6.0, abs=1e-6)
        assert len(snapshot.preview_y) == 11
        assert snapshot.look[lk.PREVIEW_SPACING] == pytest.approx(0.2 * snapshot.speed, rel=0.01)
    simulator.close()
