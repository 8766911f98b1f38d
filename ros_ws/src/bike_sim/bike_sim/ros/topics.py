"""Topics of a ride, each with its type and the QoS that its publishers offer."""

from __future__ import annotations

from typing import Final, NamedTuple

from bike_msgs import msg as ours
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, NavSatFix
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from bike_sim.ros import node_tools as tools

try:
    from tf2_msgs.msg import TFMessage as TFMessage
except ImportError:  # the wheels on PyPI have no tf2
    TFMessage = None


class Topic(NamedTuple):
    """Type of the messages, and QoS that their publishers offer."""

    kind: type
    qos: QoSProfile = tools.SENDER_QOS


TOPICS: Final = {
    "state": Topic(ours.BikeState),
    tools.SCREEN_STATE: Topic(ours.BikeState, tools.SCREEN_QOS),
    "estimated_state": Topic(ours.BikeState),
    "command": Topic(ours.BikeCommand),
    "episode": Topic(ours.EpisodeStart, tools.LATCHED_QOS),
    "course": Topic(ours.Course, tools.LATCHED_QOS),
    "disturbances": Topic(String, tools.LATCHED_QOS),
    "events": Topic(ours.RideEvent, tools.EVENT_QOS),
    "grip": Topic(ours.GripEstimate),
    "opponents": Topic(ours.Opponents),
    "course_points": Topic(ours.CoursePoints),
    "lean_history": Topic(ours.LeanHistory),
    "telemetry": Topic(ours.Telemetry),
    "odom": Topic(Odometry),
    "transform": Topic(TransformStamped),
    "joint_states": Topic(JointState),
    "imu": Topic(Imu),
    "encoders": Topic(JointState),
    "fix": Topic(NavSatFix),
    "robot_description": Topic(String, tools.LATCHED_QOS),
    "markers": Topic(MarkerArray),
    "course_marker": Topic(Marker, tools.LATCHED_QOS),
    "/clock": Topic(Clock),
    "/diagnostics": Topic(DiagnosticArray, tools.STREAM_QOS),
    **({"/tf": Topic(TFMessage)} if TFMessage is not None else {}),
}
"""By their names relative to the namespace; absolute ones are shared."""


def publisher(node: Node, name: str, namespace: str = "") -> Publisher:
    """Return a node's publisher of one of the topics.

    Args:
        node: that publishes.
        name: of the topic, as in `TOPICS`.
        namespace: of the topic, absolute; none for the node's own.
    """
    kind, qos = TOPICS[name]
    full = f"{namespace}/{name}" if namespace and not name.startswith("/") else name
    return node.create_publisher(kind, full, qos, event_callbacks=tools.QUIET)


def type_name(kind: type) -> str:
    """Return the full name of a message class, ``package/msg/Type``."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
