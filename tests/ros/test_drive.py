"""The policy node against the simulator node, also where one of them is killed."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest
from bike_msgs.msg import BikeCommand, BikeState, Course
from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from bike_policy.drive import REANSWER_AFTER
from bike_policy.riders.rider import make_rider
from bike_sim.course.files import load_course
from bike_sim.ros import node_tools
from bike_sim.ros.messages import course_to_message
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator

pytestmark = pytest.mark.ros

STEPS = 80


@pytest.mark.slow
def test_a_ride_with_both_nodes_killed_and_restarted(ros, policy) -> None:
    simulator = ros.simulator(course="circle")
    driver = ros.start("bike_policy.drive", policy=policy)
    probe = ros.probe()
    probe.until(lambda: probe.states[-1].step > 25)
    driver.end(signal.SIGKILL)
    left_at = probe.still().step
    driver = ros.start("bike_policy.drive", policy=policy)
    probe.until(lambda: probe.states[-1].step > left_at + 25)
    steps = [s.step for s in probe.states]
    assert steps == sorted(steps)
    assert {s.episode for s in probe.states} == {1}
    assert not probe.states[-1].fallen
    simulator.end(signal.SIGKILL)
    probe.until(lambda: "no state for" in driver.words)
    before = len(probe.states)
    assert "from step 0" not in driver.words
    ros.simulator(course="circle")
    probe.until(lambda: "driving episode 1 from step 0" in driver.words)
    # These probe may find the new simulator later than the driver does, and miss its first states.
    probe.until(lambda: len(probe.states) > before and probe.states[-1].step > 25)
    assert driver.process.poll() is None
    assert driver.end(signal.SIGTERM)[0] == 0


def test_the_nodes_ride_as_the_policy_rides_in_process(ros, policy) -> None:
    """That of the vehicle's kind, where none is chosen."""
    ros.simulator(course="benchmark", seed=3, perturb=True)
    probe = ros.probe()
    driver = ros.start("bike_policy.drive")
    probe.until(lambda: probe.states[-1].step >= STEPS)
    rider, simulator = make_rider(policy), Simulator(SimulatorConfig(time_step=0.005))
    snapshot = simulator.reset(ResetRequest(seed=3, course="benchmark", perturb=True))
    assert simulator.course is not None
    rider.begin(simulator.vehicle, simulator.course, simulator.config.control_period, simulator.preview)
    heard = {s.step: s for s in probe.states}
    while snapshot.step < STEPS:
        command = rider.command(snapshot)
        assert command is not None
        snapshot = simulator.step(*command)
        if snapshot.step in heard:
            same = heard[snapshot.step]
            assert (same.x, same.y, same.roll, same.steer) == tuple(snapshot.state[[0, 1, 3, 4]])
    assert len(heard) > 0.8 * STEPS
    probe.until(lambda: probe.count("drive", "states_answered") >= STEPS)
    latest = probe.reported("drive")
    assert 0.0 < float(latest["latency_median_ms"]) <= float(latest["latency_p99_ms"])
    driver.end()
    assert f"'{policy}' is driving episode 1" in driver.words
    assert "latency median" in driver.words


class Asker:
    """Publishes states of its own, and hears what the policy answers."""

    def __init__(self, probe: Any) -> None:
        self._ears = probe
        self._answers: list[tuple[float, BikeCommand]] = []
        probe.create_subscription(
            BikeCommand,
            "command",
            lambda command: self._answers.append((time.monotonic(), command)),
            node_tools.SENDER_QOS,
        )
        self._publisher = probe.create_publisher(BikeState, "state", node_tools.SENDER_QOS)
        self._courses = probe.create_publisher(Course, "course", node_tools.LATCHED_QOS)

    def show_course(self, state: BikeState) -> None:
        """Publish the course of a state's episode, without which no rider begins."""
        self._courses.publish(course_to_message(load_course("line"), state.episode, 0))

    def ask(self, state: BikeState, **changes: Any) -> None:
        """Publish a state with changes."""
        values = {name: getattr(state, name) for name in state.get_fields_and_field_types()}
        self._publisher.publish(BikeState(**values | changes))

    def answers(self, step: int) -> list[tuple[float, BikeCommand]]:
        """Answers to a step, each with the wall-clock time at which it came, s."""
        return [answer for answer in self._answers if answer[1].step == step]

    def until(self, condition: Callable[[], bool]) -> None:
        self._ears.until(condition)

    def until_answered(self, step: int, count: int = 1) -> None:
        self._ears.until(lambda: len(self.answers(step)) >= count)

    def repeat_until_answered(self, state: BikeState, count: int = 1, **changes: Any) -> None:
        """Publish a state again and again until so many answers to it have come."""

        def answered() -> bool:
            self.ask(state, **changes)
            self._ears.during(0.3)
            return len(self.answers(changes.get("step", state.step))) >= count

        self._ears.until(answered)

    def until_reported(self, **states: int) -> None:
        """Wait until the policy node has reported so many states of these kinds."""
        self._ears.until_equal(lambda: {kind: self._ears.count("drive", f"states_{kind}") for kind in states}, states)


@pytest.fixture(scope="module")
def asked(shared_ros, policy) -> tuple[Asker, BikeState, Any]:
    """A policy node that has answered a state and takes no silence for a new simulator; each test has its own steps."""
    ros = shared_ros
    simulator = ros.simulator(course="line")
    probe = ros.probe()
    asker, state = Asker(probe), probe.states[-1]
    simulator.end()
    driver = ros.start("bike_policy.drive", policy=policy, stale_after_s=1e6)
    asker.show_course(state)
    asker.repeat_until_answered(state)  # it answers nothing before all who listen have found it
    return asker, state, driver


def test_copies_of_a_state_are_answered_once_and_later_again(asked) -> None:
    asker, state, _ = asked
    began = time.monotonic()
    for _ in range(6):
        asker.ask(state, step=7)
    asker.ask(state, step=8)
    asker.until_answered(8)  # so all copies have been looked at
    answers = asker.answers(7)
    # One, or as many as a machine that held the nodes up in between gave time for.
    assert 1 <= len(answers) <= 1 + (answers[-1][0] - began) / REANSWER_AFTER
    asker.repeat_until_answered(state, 2, step=8)
    assert len({command.steering for _, command in asker.answers(8)}) == 1


def test_states_that_are_old_or_not_finite_are_told_and_not_answered(asked) -> None:
    asker, state, driver = asked
    later = Header(stamp=Time(sec=state.header.stamp.sec + 1), frame_id=state.header.frame_id)
    asker.ask(state, step=17, header=later)
    asker.until_answered(17)
    asker.ask(state, step=15)
    asker.until_reported(stale=1, refused=0)
    asker.ask(state, step=18, header=later, roll=math.nan)
    asker.until_reported(stale=1, refused=1)
    asker.ask(state, step=19, header=later)
    asker.until_answered(19)
    assert not asker.answers(15)
    assert not asker.answers(18)
    assert "1 stale, 0 not finite" in driver.words
    assert "0 stale, 1 not finite" in driver.words


def test_a_policy_that_does_not_fit_is_refused(asked) -> None:
    """Here for its preview; `tests/contract/test_bundle.py` has the other differences. It ends the node: last."""
    asker, state, driver = asked
    other = BikeState(**{name: getattr(state, name) for name in state.get_fields_and_field_types()})
    other.episode += 1
    asker.show_course(other)

    def ended() -> bool:
        asker.ask(other, preview_by_time=False, preview_interval=1.0)
        return driver.process.poll() is not None

    asker.until(ended)
    assert driver.wait() == 2
    assert "needs a preview by time" in driver.words


def test_a_policy_that_does_not_exist_is_one_line(run_here) -> None:
    code, words = run_here("bike_policy.drive", policy="nobody")
    assert code == 2
    assert words.count("\n") == 1
    assert "no policy 'nobody'" in words
