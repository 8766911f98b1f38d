"""The policy node against the simulator node, also where one of them is killed."""

from __future__ import annotations

import math
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from bike_msgs.msg import BikeCommand, BikeState
from diagnostic_msgs.msg import DiagnosticArray

from bike_policy.bundle import load_bundle
from bike_sim import node_tools
from bike_sim.reset import ResetRequest
from bike_sim.simulator import Simulator, SimulatorConfig

pytestmark = pytest.mark.ros


def figures(reports: list[DiagnosticArray], node: str) -> dict[str, str]:
    """Latest diagnostics of a node."""
    statuses = [status for report in reports for status in report.status if status.name == node]
    return {entry.key: entry.value for entry in statuses[-1].values} if statuses else {}


def test_a_ride_with_both_nodes_killed_and_restarted(stage, policy) -> None:
    simulator = stage.simulator(course="circle")
    driver = stage.start("bike_policy.drive", policy=policy)
    ears = stage.ears()
    ears.until(lambda: ears.states[-1].step > 50)
    driver.end(signal.SIGKILL)
    ears.during(0.3)
    left_at = ears.states[-1].step
    ears.during(0.6)
    assert ears.states[-1].step == left_at
    driver = stage.start("bike_policy.drive", policy=policy)
    ears.until(lambda: ears.states[-1].step > left_at + 50)
    steps = [s.step for s in ears.states]
    assert steps == sorted(steps)
    assert {s.episode for s in ears.states} == {1}
    assert not ears.states[-1].fallen
    simulator.end(signal.SIGKILL)
    ears.during(1.6)
    before = len(ears.states)
    assert "from step 0" not in driver.words
    stage.simulator(course="circle")
    ears.until(lambda: "driving episode 1 from step 0" in driver.words)
    ears.until(lambda: len(ears.states) > before and ears.states[-1].step > 50)
    assert driver.process.poll() is None
    assert driver.end(signal.SIGTERM)[0] == 0
    assert "no state for" in driver.words


def test_the_nodes_ride_as_the_policy_rides_in_process(stage, policy) -> None:
    stage.simulator(course="benchmark", seed=3, perturb=True)
    ears = stage.ears()
    reports = ears.listen(DiagnosticArray, "/diagnostics")
    driver = stage.start("bike_policy.drive", policy=policy)
    ears.until(lambda: ears.states[-1].step >= 300)
    bundle, simulator = load_bundle(policy), Simulator(SimulatorConfig(time_step=0.005))
    snapshot = simulator.reset(ResetRequest(seed=3, course="benchmark", perturb=True))
    index = bundle.layout.pick_preview(True, 0.1, 25)
    heard = {s.step: s for s in ears.states}
    while snapshot.step < 300:
        action = bundle.actor.act(bundle.layout.observe(snapshot.state, snapshot.preview_y[index]))
        snapshot = simulator.step(bundle.action.to_command(action, simulator.vehicle.max_steer))
        if snapshot.step in heard:
            same = heard[snapshot.step]
            assert (same.x, same.y, same.roll, same.steer) == tuple(snapshot.state[[0, 1, 3, 4]])
    assert len(heard) > 250
    ears.until(lambda: int(figures(reports, "bike/drive").get("states_answered", "0")) >= 300)
    latest = figures(reports, "bike/drive")
    assert 0.0 < float(latest["latency_median_ms"]) <= float(latest["latency_p99_ms"])
    driver.end()
    assert "latency median" in driver.words


def test_copies_of_a_state_are_answered_once_and_later_again(stage, policy) -> None:
    simulator = stage.simulator(course="line")
    source = stage.ears()
    state = source.states[-1]
    commands: list[BikeCommand] = source.listen(BikeCommand, "command", node_tools.COMMAND_QOS)
    publisher = source.create_publisher(BikeState, "state", node_tools.STREAM_QOS)
    simulator.end()
    driver = stage.start("bike_policy.drive", policy=policy)
    while not commands:  # it answers nothing before all who listen have found it
        publisher.publish(state)
        source.during(0.3)
    source.during(0.3)
    commands.clear()
    for _ in range(5):
        publisher.publish(state)
    source.until(lambda: commands)
    source.during(0.1)
    assert len(commands) == 1
    source.during(0.3)
    publisher.publish(state)
    source.until(lambda: len(commands) == 2)
    assert commands[0].steering == commands[1].steering
    # A later state, then an older one, then one that is not finite.
    later = BikeState(**{name: getattr(state, name) for name in state.get_fields_and_field_types()})
    later.step, later.header.stamp.sec = 7, state.header.stamp.sec + 1
    publisher.publish(later)
    source.until(lambda: len(commands) == 3)
    assert commands[2].step == 7
    later.step = 5
    later.header.stamp.sec -= 1
    publisher.publish(later)
    later.step, later.roll = 8, math.nan
    later.header.stamp.sec += 1
    publisher.publish(later)
    source.during(1.3)
    assert len(commands) == 3
    assert driver.process.poll() is None
    assert "1 stale, 1 not finite" in driver.words


@pytest.mark.parametrize(
    ("changes", "parameters", "words"),
    [
        ({"vehicle": "tricycle"}, {}, "trained for vehicle 'tricycle'"),
        ({"control_period": 0.02}, {}, "control period of 0.02 s"),
        ({}, {"preview_by_time": False, "preview_interval": 1.0}, "needs a preview by time"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused(stage, policy, tmp_path: Path, changes, parameters, words) -> None:
    replace(load_bundle(policy), **changes).save(tmp_path / "misfit")
    stage.simulator(**parameters)
    driver = stage.start("bike_policy.drive", policy=str(tmp_path / "misfit"))
    ears = stage.ears()
    assert driver.wait() == 2
    assert words in driver.words
    assert ears.states[-1].step == 0


def test_a_policy_that_does_not_exist_is_one_line(stage) -> None:
    driver = stage.start("bike_policy.drive", policy="nobody")
    began = time.monotonic()
    assert driver.wait() == 2
    assert driver.words.count("\n") == 1
    assert "no policy 'nobody'" in driver.words
    assert time.monotonic() - began < 20.0
