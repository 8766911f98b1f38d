"""The simulator node where time runs by itself."""

from __future__ import annotations

import time

import pytest
from bike_msgs.msg import RideEvent

from bike_sim.ros.sim_node import oldest_step

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("step", "timeout", "oldest"), [(10, 0.25, 5), (3, 0.25, 0), (10, 0.01, 10), (10, 0.0, 0), (10, 1e308, 0)]
)
def test_commands_may_be_as_old_as_the_timeout(step: int, timeout: float, oldest: int) -> None:
    assert oldest_step(step, timeout, 0.05) == oldest


def test_time_runs_at_the_wanted_pace_and_commands_are_held(ros) -> None:
    ros.simulator(mode="free", real_time_factor=2.0, command_timeout_s=0.0)
    probe = ros.probe()
    probe.during(0.7)
    assert probe.states[-1].step == 0  # an episode's time begins with its first command
    began = time.monotonic()
    probe.command(probe.states[-1], 0.01)
    probe.until(lambda: probe.states[-1].step >= 40)
    elapsed = time.monotonic() - began
    ridden = [s for s in probe.states if s.step > 0]
    assert {s.steering_command for s in ridden} == {0.01}
    assert elapsed > 0.8 * 40 * 0.05 / 2.0  # never faster; how much slower is up to the machine
    assert probe.pause(True).success
    step = probe.still().step
    probe.pause(False)
    probe.until(lambda: probe.states[-1].step > step)


def test_silence_sets_steering_straight_and_a_command_ends_it(ros) -> None:
    ros.simulator(mode="free", command_timeout_s=0.25, real_time_factor=1.0)
    probe = ros.probe()
    probe.command(probe.states[-1], 0.02)
    probe.until(lambda: probe.states[-1].step >= 12)
    applied = {s.step: s.steering_command for s in probe.states}
    assert {applied[step] for step in range(1, 6)} == {0.02}
    assert {applied[step] for step in range(7, 12)} == {0.0}
    # A command of the far past is stale, one that names no episode is not, however late it comes.
    probe.sent("stale", probe.states[-1], 0.03, step=1)
    probe.command(probe.states[-1], 0.04, episode=0, step=0)
    probe.until(lambda: probe.states[-1].steering_command == 0.04)
    probe.sent("stale", probe.states[-1], 0.03, step=1)
    probe.command(probe.states[-1], 0.05, episode=0, step=0)
    probe.until(lambda: probe.states[-1].steering_command == 0.05)
    assert 0.03 not in {s.steering_command for s in probe.states}


def test_without_a_pace_each_command_is_a_step_and_falls_begin_anew(ros) -> None:
    ros.simulator(mode="free", real_time_factor=0.0, auto_reset="fall", seed=5)
    probe = ros.probe()
    events = probe.attend(RideEvent, "events")
    for _ in range(200):
        state = probe.states[-1]
        if state.episode == 2:
            break
        probe.command(state, 0.4, episode=0)
        probe.until(
            lambda before=state: (probe.states[-1].episode, probe.states[-1].step) != (before.episode, before.step)
        )
    probe.until(lambda: any(e.kind == RideEvent.RESET and e.episode == 2 for e in events))
    fallen = [s for s in probe.states if s.fallen]
    assert [s.episode for s in fallen] == [1]
    assert [s.step for s in probe.states if s.episode == 1] == sorted(s.step for s in probe.states if s.episode == 1)
    assert probe.states[-1].episode == 2
