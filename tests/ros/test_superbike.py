"""A superbike through simulator node and classical pilot: what travels, and that it is ridden."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from bike_msgs.msg import Telemetry
from bike_msgs.srv import Reset

from bike_analysis.figures.circuit import Theory
from bike_analysis.report import analyze_laps
from bike_sim.physics.state import upright_state
from bike_sim.planning.envelope import envelope
from bike_sim.planning.lap_limit import lap_limit
from bike_sim.planning.line_cache import track_with_line
from bike_sim.ros.messages import Episode as MessageEpisode
from bike_sim.ros.messages import (
    course_points_to_message,
    decode_state,
    encode_state,
    snapshot_from_message,
    telemetry_to_message,
)
from bike_sim.schema import SIGNALS
from bike_sim.sim import look as lk
from bike_sim.sim.config import superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import load_superbike
from bike_training.nodes.node_rides import ride_through_nodes
from bike_training.replay import read_rides
from tests.circuits import write_oval
from tests.ros.conftest import RosFixture, StateProbe
from tests.same import assert_same

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("compiled")]


def test_messages_carry_what_the_rider_sees(circuit: Path) -> None:
    machine = Simulator(superbike_config())
    snapshot = machine.reset(ResetRequest(course=str(circuit), speed_range=(25.0, 25.0)))
    for _ in range(20):
        snapshot = machine.step(0.4, 0.2)
    assert machine.course is not None
    episode = MessageEpisode.of(machine.vehicle, machine.course, machine.preview, machine.config.control_period)
    again = decode_state(encode_state(snapshot, episode, 10**9)).snapshot
    assert_same(again, snapshot)
    points = course_points_to_message(snapshot, machine.course, 10**9)
    assert [len(points.line), len(points.left), len(points.right)] == [20, 20, 20]
    assert [(p.x, p.y, p.z) for p in points.right] == [tuple(row) for row in snapshot.circuit.points[2]]
    machine.close()


def straight_on(vehicle: str, throttles: list[float]) -> Iterator[tuple[Simulator, Telemetry, str]]:
    """Ride upright on the open plane; yield ride, telemetry and fall after each control period."""
    ride = Simulator(superbike_config(vehicle))
    seen = ride.reset(ResetRequest(course="line", speed_range=(20.0, 20.0)))
    ride.plant.engine.reset(upright_state(25.0, ride.vehicle.rF))
    for throttle in throttles:
        ride.plant.engine.advance(0.0, throttle, ride.config.substeps)
        seen = replace(seen, signals=ride.plant.engine.telemetry())
        yield ride, telemetry_to_message(seen, ride.vehicle, 10**9), ride.plant.engine.fall
    ride.close()


def test_telemetry_balances_what_moves_the_machine() -> None:
    throttles = [0.3] * 40 + [1.0] * 60 + [-1.0] * 60
    aids: list[set[str]] = [set(), set()]
    for throttle, (machine, message, fall) in zip(throttles, straight_on("m1000rr", throttles), strict=True):
        assert fall == "none"
        along = message.rear_force_longitudinal + message.front_force_longitudinal - message.drag_force
        assert message.acceleration_longitudinal * machine.vehicle.mass == pytest.approx(along, abs=1.0)
        assert message.front_contact_lost == (message.front_load == 0.0)
        at_tyre = message.engine_power * machine.vehicle.motor.efficiency
        # The tread is faster than the machine by the slip.
        speed = machine.plant.engine.telemetry()[SIGNALS.index("speed")] * (1.0 + message.rear_slip)
        assert at_tyre == pytest.approx(message.engine_force * speed, rel=0.03, abs=1.0)
        for name in ("traction_control", "anti_wheelie", "brake_control", "anti_stoppie"):
            if getattr(message, name):
                aids[throttle < 0.0].add(name)
    # The brakes take a while after the throttle, whose aid may then still hold something back.
    assert "anti_wheelie" in aids[0]
    assert "anti_stoppie" in aids[1]
    assert not aids[0] & {"brake_control", "anti_stoppie"}


def test_aids_that_are_off_are_never_active(tmp_path: Path) -> None:
    text = (files("bike_sim") / "config/vehicles/r1.yaml").read_text()
    for aid in ("traction_control", "wheelie_control", "brake_control", "stoppie_control"):
        text, count = re.subn(rf"{aid}: 1\.0", f"{aid}: 0.0", text)
        assert count == 1, aid
    path = tmp_path / "bare.yaml"
    path.write_text(text)
    seen = list(straight_on(str(path), [1.0] * 100))
    for _, message, _ in seen:
        assert not any((message.traction_control, message.anti_wheelie, message.brake_control, message.anti_stoppie))
    assert any(message.front_contact_lost for _, message, _ in seen)
    assert seen[-1][2] == "wheelie"


@pytest.fixture(scope="module")
def superbike(shared_ros: RosFixture, tmp_path_factory: pytest.TempPathFactory) -> tuple[StateProbe, Path]:
    """A simulator of a superbike on a circuit of its own."""
    circuit = write_oval(tmp_path_factory.mktemp("superbike"))
    shared_ros.simulator(vehicle="panigale_v4r", course=str(circuit), time_step=0.002, speed=20.0)
    return shared_ros.probe(), circuit


def test_reset_chooses_line_and_place_alike_in_process_and_through_ros(superbike: tuple[StateProbe, Path]) -> None:
    probe, circuit = superbike
    name = str(circuit)
    told = probe.attend(Telemetry, "telemetry")
    local = Simulator(superbike_config())
    for line, progress in ((0.0, 150.0), (1.0, 0.0), (0.4, 333.3)):
        request = ResetRequest(course=name, speed_range=(20.0, 20.0), line=line, progress=progress)
        ours, response = local.reset(request), probe.reset(request)
        assert response.success, response.message
        theirs = snapshot_from_message(response.state)
        assert_same(theirs, replace(ours, episode=theirs.episode), but=("events",))
        assert_same(theirs.events, tuple(replace(event, text=theirs.events[0].text) for event in ours.events))
        probe.until(lambda number=response.state.episode: probe.states[-1].episode == number)
        state = probe.states[-1]
        for _ in range(5):
            state, ours = probe.answer(state, 0.1), local.step(0.1)
        assert_same(snapshot_from_message(state), ours, but=("episode",))
        number = response.state.episode
        probe.until(lambda number=number: told and (told[-1].episode, told[-1].step) == (number, 5))
        expected = telemetry_to_message(ours, local.vehicle, 0)
        expected.header, expected.episode = told[-1].header, number
        assert told[-1] == expected
    assert ours.look[lk.PROGRESS] > 300.0
    # What is left open is the node's own: the ideal line from the start.
    response = probe.reset(Reset.Request(seed=0, course=name))
    assert response.success, response.message
    first = local.reset(ResetRequest(course=name, speed_range=(20.0, 20.0)))
    np.testing.assert_array_equal(snapshot_from_message(response.state).state, first.state)
    refused = {"line": (1.5, -0.5, float("nan")), "progress": (5000.0, -3.0, float("inf"))}
    for field, values in refused.items():
        for value in values:
            response = probe.reset(Reset.Request(seed=0, course=name, **{field: value}))
            assert not response.success
            assert response.message.startswith(field)
            assert str(value) in response.message
    local.close()


def test_a_changed_parameter_does_not_load_the_circuit_again(superbike: tuple[StateProbe, Path]) -> None:
    """Loading it takes most of a second, in which nobody is answered. Here there is nothing to load any more."""
    probe, circuit = superbike
    assert probe.set_parameter("speed", 0.0).successful
    speed = probe.reset(Reset.Request(seed=1)).state.speed
    circuit.unlink()
    for name, value in (("command_timeout_s", 1.0), ("seed", 3), ("auto_reset", "end")):
        result = probe.set_parameter(name, value)
        assert result.successful, result.reason
    assert probe.reset(Reset.Request(seed=1)).state.speed == speed > 0.0
    for name, value in (("line", 0.5), ("progress", 20.0), ("speed", 20.0)):
        result = probe.set_parameter(name, value)
        assert result.successful, result.reason
    begun = snapshot_from_message(probe.reset(Reset.Request(seed=1)).state)
    assert begun.speed == pytest.approx(20.0, rel=0.02)
    assert begun.progress == pytest.approx(20.0, abs=0.5)
    gone = str(circuit.with_name("gone.csv"))
    for name, value, reason in (("progress", 5000.0, "progress 5000.0 m lies beyond"), ("course", gone, gone)):
        result = probe.set_parameter(name, value)
        assert not result.successful
        assert reason in result.reason


@pytest.mark.slow
def test_laps_through_the_nodes_are_recorded_and_timed_alike(tmp_path: Path) -> None:
    circuit = write_oval(tmp_path, 0.45)
    machine = load_superbike("panigale_v4r")
    limits = envelope(machine)
    track = track_with_line(circuit, limits)
    limit = lap_limit(limits, track.line(1.0))
    recording = tmp_path / "lap.mcap"
    ride_through_nodes("panigale_v4r", str(circuit), float(limit.s[-1]), 1, recording, limit.lap_time)
    theory = Theory(track, limit.s, limit.speed, limit.lateral, limit.longitudinal, limit.lap_time, limit.sector_times)
    figures = analyze_laps(recording, theory, tmp_path)
    assert figures["falls"] == figures["walls"] == figures["lost_steps"] == 0
    assert len(figures["laps_s"]) == 1
    # Its first state and command are there, however late the nodes find each other, which is different each time.
    (recorded,) = read_rides(recording)[1]
    steps = range(len(recorded.ride.states))
    assert recorded.ride.states.step.tolist() == [*steps]
    assert {*recorded.ride.commands.step.tolist()} >= {*steps[:-1]}
    assert figures["valid_laps"] == 1
    page = Path(figures["page"]).read_text()
    shown = set(re.findall(r'data-plot="([^"]+)"', page))
    assert {"follow", "map", "delta", "speed", "lean", "throttle", "brake", "slip", "load", "grip", "cloud"} <= shown
    assert "<canvas" in page
    assert "default-src 'none'" in page
