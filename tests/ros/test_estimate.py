"""The estimator node between simulator and policy, and answers at a fixed rate."""

from __future__ import annotations

import math
import signal

import pytest
from bike_msgs.msg import BikeCommand, BikeState

pytestmark = pytest.mark.ros


def test_the_policy_rides_on_estimates_as_on_states(ros, policy) -> None:
    ros.simulator(course="benchmark", engine="whipple", time_step=0.01, disturbances="raw_sensors")
    estimate = ros.start("bike_policy.estimate")
    driver = ros.start("bike_policy.drive", policy=policy, remap="state:=estimated_state")
    probe = ros.probe()
    estimated = probe.listen(BikeState, "estimated_state")
    probe.until(lambda: probe.states[-1].step >= 120)
    true = {state.step: state for state in probe.states}
    pairs = [(state, true[state.step]) for state in estimated if state.step in true and state.step > 40]
    assert len(pairs) > 40
    assert max(math.hypot(a.x - b.x, a.y - b.y) for a, b in pairs) < 0.05
    assert max(abs(a.roll - b.roll) for a, b in pairs) < 0.01
    assert any(a.roll != b.roll for a, b in pairs)
    assert abs(probe.states[-1].lateral_error) < 0.1

    def bias() -> float:
        return float(probe.reported("estimate").get("gyro_bias_z_rad_s", "nan"))

    probe.until(lambda: bias() == pytest.approx(0.005, abs=1e-3))  # reports are by the wall clock, rides are not
    for node in (driver, estimate):
        assert node.end(signal.SIGTERM)[0] == 0


def test_a_fixed_rate_answers_on_and_says_when_states_are_late(ros, policy) -> None:
    simulator = ros.simulator(course="circle")  # in lockstep: a busy machine is no fall
    driver = ros.start("bike_policy.drive", policy=policy, rate_hz=20)
    probe = ros.probe()
    commands = probe.listen(BikeCommand, "command")
    probe.until(lambda: probe.states[-1].step > 40)
    simulator.end(signal.SIGKILL)
    probe.until(lambda: "the watchdog steers straight" in driver.words)
    probe.until(lambda: (commands[-1].episode, commands[-1].steering) == (0, 0.0))
    probe.until(lambda: probe.count("drive", "states_late") > 5)


def test_a_rate_that_is_not_the_policys_is_refused(ros, policy) -> None:
    ros.simulator(course="circle")
    driver = ros.start("bike_policy.drive", policy=policy, rate_hz=50.0)
    assert driver.wait() == 2
    assert "rate_hz of 50.0 is not that of its control period of 0.05 s, 20" in driver.words
