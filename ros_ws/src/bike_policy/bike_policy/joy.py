"""A gamepad as a rider: ``sensor_msgs/Joy`` on ``/joy`` becomes commands, as ROS's own joystick drivers publish it.

Each state is answered as `bike_policy.drive` answers it, with the manual command of the last message in place of a
policy. The simulator should run in free mode, so that time passes at the clock's pace.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Final, NoReturn

from sensor_msgs.msg import Joy

from bike_policy.drive import VEHICLE, Drive
from bike_policy.riders.stanley import ManualRider
from bike_sim.ros import node_tools
from bike_sim.ros.node_tools import ParameterSpec
from bike_sim.ros.subscriptions import subscribe

SPECS: Final = (
    VEHICLE,
    ParameterSpec("stale_after_s", 1.0, "Wall-clock time without a state after which a warning is given, s."),
    ParameterSpec("lean_axis", 0, "Axis of the lean, 1 to the left."),
    ParameterSpec("throttle_axis", 5, "Axis of the throttle's trigger, 1 released and -1 pulled; -1 for none."),
    ParameterSpec("brake_axis", 2, "Axis of the brake's trigger, 1 released and -1 pulled; -1 for none."),
    ParameterSpec("dead_zone", 0.05, "Part of the lean's axis about its middle that counts as nothing."),
    ParameterSpec("balance", True, "Whether a bicycle's command is a lean; else it is the steering angle's set point."),
    ParameterSpec("timeout_s", 0.5, "Wall-clock time for which a message holds, s; then straight on, throttle closed."),
)
"""Defaults are those of `joy_node` with an Xbox pad: left stick, right trigger, left trigger."""


class Joystick(Drive):
    """Answers states with what a gamepad asks for."""

    def __init__(self) -> None:
        """Wait for a gamepad.

        Raises:
            ValueError: an invalid parameter.
        """
        self._hands = ManualRider()
        self._heard_joy = -1e9
        super().__init__("joystick", SPECS)
        subscribe(self, Joy, "/joy", self._on_joy, node_tools.STREAM_QOS)
        node_tools.wall_timer(self, 0.1, self._forget)

    def _rider_of(self, values: dict[str, Any]) -> ManualRider:
        return self._hands

    def _accept(self, values: dict[str, Any]) -> None:
        super()._accept(values)
        if not 0.0 <= values["dead_zone"] < 1.0:
            raise ValueError(f"parameter dead_zone must be from 0 to below 1, got {values['dead_zone']!r}")
        if not values["timeout_s"] > 0.0:
            raise ValueError(f"parameter timeout_s must be positive, got {values['timeout_s']!r}")
        self._settings = values
        self._hands.balances = values["balance"]

    def _on_joy(self, message: Joy) -> None:
        self._heard_joy = time.monotonic()
        settings, axes = self._settings, message.axes
        self._hands.steering = wish_of(_axis(axes, settings["lean_axis"]), settings["dead_zone"])
        pulls = [_axis(axes, settings[name], released=1.0) for name in ("throttle_axis", "brake_axis")]
        self._hands.throttle = 0.5 * (1.0 - pulls[0]) - 0.5 * (1.0 - pulls[1])

    def _forget(self) -> None:
        if time.monotonic() - self._heard_joy > self._settings["timeout_s"]:
            self._hands.steering = self._hands.throttle = 0.0


def wish_of(value: float, dead_zone: float) -> float:
    """Return an axis without its dead zone, still reaching from -1 to 1."""
    size = max(abs(value) - dead_zone, 0.0) / (1.0 - dead_zone)
    return size if value > 0.0 else -size


def _axis(axes: Sequence[float], index: int, released: float = 0.0) -> float:
    """Return an axis within [-1, 1]; where it is missing or not a number, its value when released."""
    value = float(axes[index]) if 0 <= index < len(axes) else released
    return min(max(value, -1.0), 1.0) if value == value else released


def main() -> NoReturn:
    """Run the node until a signal."""
    node_tools.leave(node_tools.run_node("joystick", Joystick))


if __name__ == "__main__":
    main()
