"""The simulator node where time runs by itself."""

from __future__ import annotations

import time
from typing import Any

import pytest
from bike_msgs.msg import BikeState, RideEvent
from bike_msgs.srv import Reset

from bike_sim.ros.sim_node import oldest_step
from tests.ros.conftest import StateProbe

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("step", "timeout", "oldest"), [(10, 0.25, 5), (3, 0.25, 0), (10, 0.01, 10), (10, 0.0, 0), (10, 1e308, 0)]
)
def test_commands_may_be_as_old_as_the_timeout(step: int, timeout: float, oldest: int) -> None:
    assert oldest_step(step, timeout, 0.05) == oldest


@pytest.fixture(scope="module")
def free(shared_ros) -> StateProbe:
    """A simulator whose time runs by itself; each test has its own parameters and begins an episode."""
    shared_ros.simulator(mode="free", seed=5)
    return shared_ros.probe()


def begin(probe: StateProbe, **parameters: Any) -> BikeState:
    """Begin an episode under changed parameters; return its first state."""
    for name, value in parameters.items():
        assert probe.set_parameter(name, value).successful
    episode = probe.reset(Reset.Request(seed=5)).state.episode
    probe.until(lambda: probe.states[-1].episode == episode)
    return probe.states[-1]


def of(probe: StateProbe, first: BikeState) -> list[BikeState]:
    """States of an episode."""
    return [state for state in probe.states if state.episode == first.episode]


def test_time_runs_at_the_wanted_pace_and_commands_are_held(free: StateProbe) -> None:
    first = begin(free, real_time_factor=2.0, command_timeout_s=0.0)
    free.during(0.3)
    assert free.states[-1].step == 0  # an episode's time begins with its first command
    began = time.monotonic()
    free.command(first, 0.01)
    free.until(lambda: free.states[-1].step >= 30)
    elapsed = time.monotonic() - began
    assert {s.steering_command for s in of(free, first) if s.step} == {0.01}
    assert elapsed > 0.8 * 30 * 0.05 / 2.0  # never faster; how much slower is up to the machine
    assert free.pause(True).success
    step = free.still().step
    free.pause(False)
    free.until(lambda: free.states[-1].step > step)


def test_silence_sets_steering_straight_and_a_command_ends_it(free: StateProbe) -> None:
    first = begin(free, real_time_factor=1.0, command_timeout_s=0.25)
    free.command(first, 0.02)
    free.until(lambda: free.states[-1].step >= 12)
    applied = {s.step: s.steering_command for s in of(free, first)}
    assert {applied[step] for step in range(1, 6)} == {0.02}
    assert {applied[step] for step in range(7, 12)} == {0.0}
    # A command of the far past is stale, one that names no episode is not, however late it comes.
    free.sent("stale", free.states[-1], 0.03, step=1)
    free.command(free.states[-1], 0.04, episode=0, step=0)
    free.until(lambda: free.states[-1].steering_command == 0.04)
    assert 0.03 not in {s.steering_command for s in of(free, first)}


def test_without_a_pace_each_command_is_a_step_and_falls_begin_anew(free: StateProbe) -> None:
    events = free.attend(RideEvent, "events")
    first = begin(free, real_time_factor=0.0, auto_reset="fall")
    for _ in range(200):
        state = free.states[-1]
        if state.episode > first.episode:
            break
        free.command(state, 0.4, episode=0)
        free.until(
            lambda before=state: (free.states[-1].episode, free.states[-1].step) != (before.episode, before.step)
        )
    free.until(lambda: any(e.kind == RideEvent.RESET and e.episode == first.episode + 1 for e in events))
    ridden = of(free, first)
    assert [s.fallen for s in ridden] == [False] * (len(ridden) - 1) + [True]
    assert [s.step for s in ridden] == sorted(s.step for s in ridden)
    assert free.states[-1].episode == first.episode + 1
