"""What several bicycles publish, at any rate, from a process of its own: a load for the recorder.

    python -m bench.traffic 10 8000 5        # ten bicycles, 8000 messages a second together, for 5 s

The messages are those of a ride, as bytes: state, command, clock, preview points, lean history, odometry, joint states
and markers of each bicycle in turn, with a new stamp for each control period. Standard output gets a line when all
topics have a listener, and the number of messages once all are sent. The process ends when all have arrived.
"""

from __future__ import annotations

import argparse
import struct
import sys
import time
from contextlib import ExitStack
from typing import Any, Final

import rclpy
import rclpy.node
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from bike_sim.ros import messages, node_tools, standard_messages
from bike_sim.ros.command_gate import Command
from bike_sim.ros.isolation import prepare_discovery
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator

LONGEST_START: Final = 30.0
"""Wall-clock time in which every topic must have found a listener, s."""
SETTLING: Final = 1.0
"""Wall-clock time between that and the first message, s."""
PACE: Final = 0.002
"""Wall-clock time between two bursts, s."""
UNSTAMPED: Final = "markers"


def messages_of_a_period() -> dict[str, tuple[type, bytes]]:
    """Return name, type and CDR of all messages that belong to one control period of one bicycle."""
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.005, control_period=0.01))
    request = ResetRequest(course="benchmark", speed_range=(4.0, 4.0))
    snapshot = simulator.reset(request)
    for _ in range(10):
        snapshot = simulator.step(0.0)
    assert simulator.course is not None
    period = round(simulator.config.control_period * messages.NANOSECONDS)
    stamp = messages.NANOSECONDS
    episode = messages.Episode.of(simulator.vehicle, simulator.course, request.preview, simulator.config.control_period)
    made = {
        "state": messages.state_to_message(snapshot, episode, stamp),
        "command": messages.command_to_message(Command(1, snapshot.step, 0.1)),
        "clock": Clock(clock=messages.time_to_message(stamp)),
        "course_points": messages.course_points_to_message(snapshot, simulator.course, stamp),
        "lean_history": messages.lean_history_to_message(snapshot, stamp, period),
        "odom": standard_messages.odometry(snapshot, stamp),
        "joint_states": standard_messages.joint_state(snapshot, stamp),
        "markers": standard_messages.vehicle_markers(snapshot, simulator.vehicle, stamp),
    }
    return {name: (type(message), bytes(serialize_message(message))) for name, message in made.items()}


class Traffic(rclpy.node.Node):
    """Publishes the messages of several bicycles."""

    def __init__(self, bikes: int, context: Context, name: str = "traffic") -> None:
        super().__init__(name, context=context, namespace=node_tools.NAMESPACE, start_parameter_services=False)
        period = messages_of_a_period()
        self._load: list[tuple[Publisher, bytes, bool]] = []
        for bike in range(bikes):
            for topic, (kind, data) in period.items():
                publisher = self.create_publisher(
                    kind, f"{name}/b{bike}/{topic}", node_tools.SENDER_QOS, event_callbacks=node_tools.QUIET
                )
                self._load.append((publisher, data, topic != UNSTAMPED))

    def wait_for_listeners(self) -> None:
        """Wait until each topic is heard.

        Raises:
            TimeoutError: one is not.
        """
        end = time.monotonic() + LONGEST_START
        while not all(publisher.get_subscription_count() for publisher, *_ in self._load):
            if time.monotonic() > end:
                raise TimeoutError(f"nobody listens to all topics after {LONGEST_START:g} s; does a recorder run?")
            time.sleep(0.05)
        time.sleep(SETTLING)

    def send(self, rate: float, duration: float) -> int:
        """Send messages, topic by topic, until the time is over; return how many.

        Args:
            rate: messages a second of wall-clock time.
            duration: of the sending, s of wall-clock time.
        """
        with ExitStack() as stack:
            # The handles themselves, which `Publisher.publish` would take and give back for each message.
            for publisher, *_ in self._load:
                stack.enter_context(publisher.handle)
            load = [(publisher.handle.publish_raw, data, stamped) for publisher, data, stamped in self._load]
            sent, begun = 0, time.monotonic()
            while (elapsed := time.monotonic() - begun) < duration:
                for number in range(sent, int(elapsed * rate)):
                    period, topic = divmod(number, len(load))
                    publish, data, stamped = load[topic]
                    publish(_stamped(data, period) if stamped else data)
                    sent = number + 1
                time.sleep(PACE)
        return sent

    def wait_for_arrival(self, longest: float = 20.0) -> None:
        """Wait until the listeners have all messages, at most so many seconds of wall-clock time."""
        end = time.monotonic() + longest
        for publisher, *_ in self._load:
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))


def _stamped(data: bytes, period: int) -> bytes:
    """Return a message that begins with a header, at another time: 1 s and so many control periods of 10 ms."""
    seconds, hundredths = divmod(100 + period, 100)
    return data[:4] + struct.pack("<iI", seconds, hundredths * 10_000_000) + data[12:]


def main(arguments: Any = None) -> None:
    """Read the command line and send."""
    parser = argparse.ArgumentParser(description="Publishes what several bicycles publish.")
    parser.add_argument("bikes", type=int, help="number of bicycles")
    parser.add_argument("rate", type=float, help="messages a second of all together")
    parser.add_argument("duration", type=float, help="s of wall-clock time")
    parser.add_argument("--name", default="traffic", help="name of the node and of its topics (default: traffic)")
    args = parser.parse_args(arguments)
    prepare_discovery()
    with Context() as context:
        traffic = Traffic(args.bikes, context, args.name)
        try:
            traffic.wait_for_listeners()
        except TimeoutError as error:
            sys.exit(str(error))
        print("heard on all topics", flush=True)
        print(traffic.send(args.rate, args.duration), flush=True)
        traffic.wait_for_arrival()
        traffic.destroy_node()


if __name__ == "__main__":
    main()
