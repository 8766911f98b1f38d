"""A gamepad through ROS: ``sensor_msgs/Joy`` becomes commands."""

from __future__ import annotations

import pytest
from sensor_msgs.msg import Joy

from bike_policy.joy import wish_of


@pytest.mark.parametrize(
    ("value", "wish"), [(1.0, 1.0), (-1.0, -1.0), (0.04, 0.0), (-0.05, 0.0), (0.525, 0.5), (-0.525, -0.5)]
)
def test_the_dead_zone_takes_nothing_from_the_ends(value: float, wish: float) -> None:
    assert wish_of(value, 0.05) == pytest.approx(wish)


@pytest.mark.ros
def test_a_stick_steers_and_a_lost_gamepad_rides_straight_on(ros) -> None:
    """Without balance the stick is the set point itself; 0.525 is half of what lies beyond the dead zone."""
    ros.simulator(mode="free", real_time_factor=1.0, auto_reset="fall")
    ros.start("bike_policy.joy", balance=False, timeout_s=0.5)
    sender, probe = ros.sender(), ros.probe()
    joy = sender.open(Joy, "/joy")
    pad = Joy(axes=[0.525, 0.0, 1.0, 0.0, 0.0, 1.0])

    def steered() -> bool:
        joy.publish(pad)
        return any(abs(state.steering_command - 0.5) < 1e-6 for state in probe.states)

    probe.until(steered)
    count = len(probe.states)
    probe.until(lambda: any(state.steering_command == 0.0 and state.step > 0 for state in probe.states[count:]))
    for broken in (Joy(), Joy(axes=[float("nan")])):
        joy.publish(broken)
    count = len(probe.states)
    probe.until(lambda: len(probe.states) > count + 5)
    assert all(abs(state.steering_command) <= 0.5 for state in probe.states)
