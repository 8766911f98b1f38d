"""The ride in standard messages, for RViz, Foxglove and everyone who does not know ``bike_msgs``."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from geometry_msgs.msg import Point, Quaternion, TransformStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.ros.messages import BASE_FRAME, MAP_FRAME
from bike_sim.ros.node_tools import time_to_message
from bike_sim.sim import look as lk
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

JOINTS: Final = ("steer", "rear_wheel", "front_wheel")

_COURSE_COLOUR: Final = ColorRGBA(r=0.1, g=0.5, b=0.9, a=1.0)
_PREVIEW_COLOUR: Final = ColorRGBA(r=0.95, g=0.6, b=0.1, a=1.0)
_BODY_COLOUR: Final = ColorRGBA(r=0.2, g=0.2, b=0.2, a=1.0)
_FALLEN_COLOUR: Final = ColorRGBA(r=0.8, g=0.1, b=0.1, a=1.0)
_PREVIEW_HEIGHT: Final = 0.1
"""Height of the preview points above the ground, m, so that the line does not hide them."""
_COURSE_MARKER_STEP: Final = 5
"""Every fifth sample of the course is drawn: half a metre."""


def odometry(snapshot: Snapshot, stamp: int) -> Odometry:
    """Return pose and velocity of base_link (rear contact point, yaw only) in map; velocities in base_link."""
    message = Odometry()
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = MAP_FRAME
    message.child_frame_id = BASE_FRAME
    message.pose.pose.position = _point(snapshot.state[st.X], snapshot.state[st.Y], 0.0)
    message.pose.pose.orientation = _quaternion(_rotation_z(snapshot.state[st.YAW]))
    message.twist.twist.linear.x = float(snapshot.look[lk.SPEED])
    message.twist.twist.angular.x = float(snapshot.state[st.ROLL_RATE])
    message.twist.twist.angular.z = float(snapshot.look[lk.YAW_RATE])
    return message


def joint_state(snapshot: Snapshot, stamp: int) -> JointState:
    """Return steering and wheel angles; the rate of the rear wheel is left to the speed."""
    message = JointState()
    message.header.stamp = time_to_message(stamp)
    message.name = list(JOINTS)
    message.position = [float(snapshot.state[i]) for i in (st.STEER, st.REAR_WHEEL, st.FRONT_WHEEL)]
    return message


def base_transform(snapshot: Snapshot, stamp: int) -> TransformStamped:
    """Return the transform from map to base_link."""
    message = TransformStamped()
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = MAP_FRAME
    message.child_frame_id = BASE_FRAME
    message.transform.translation.x = float(snapshot.state[st.X])
    message.transform.translation.y = float(snapshot.state[st.Y])
    message.transform.rotation = _quaternion(_rotation_z(snapshot.state[st.YAW]))
    return message


def vehicle_markers(snapshot: Snapshot, vehicle: Vehicle, stamp: int) -> MarkerArray:
    """Return wheels, frame and preview points."""
    rear, front = wheel_poses(snapshot, vehicle)
    colour = _FALLEN_COLOUR if snapshot.fallen else _BODY_COLOUR
    wheels = []
    for number, ((centre, turn), radius) in enumerate(((rear, vehicle.rR), (front, vehicle.rF)), start=1):
        wheel = _marker(number, Marker.CYLINDER, MAP_FRAME, stamp, colour)
        wheel.pose.position = _point(*centre)
        # A cylinder's axis is z, a wheel's is y.
        wheel.pose.orientation = _quaternion(turn @ _rotation_x(math.pi / 2.0))
        wheel.scale.x = wheel.scale.y = 2.0 * radius
        wheel.scale.z = 0.04
        wheels.append(wheel)
    frame = _marker(3, Marker.LINE_STRIP, MAP_FRAME, stamp, colour)
    frame.scale.x = 0.05
    saddle = rear[0] + rear[1] @ np.array([0.25 * vehicle.w, 0.0, 1.8 * vehicle.rR])
    handlebar = front[0] + front[1] @ np.array([-0.35 * vehicle.rF, 0.0, 1.7 * vehicle.rF])
    frame.points = [_point(*p) for p in (rear[0], saddle, handlebar, front[0])]
    preview = _marker(4, Marker.SPHERE_LIST, BASE_FRAME, stamp, _PREVIEW_COLOUR)
    preview.scale.x = preview.scale.y = preview.scale.z = 0.15
    preview.points = [
        _point(x, y, _PREVIEW_HEIGHT) for x, y in zip(snapshot.preview_x, snapshot.preview_y, strict=True)
    ]
    return MarkerArray(markers=[*wheels, frame, preview])


def course_marker(course: Course, stamp: int) -> Marker:
    """Return the followed line."""
    marker = _marker(0, Marker.LINE_STRIP, MAP_FRAME, stamp, _COURSE_COLOUR)
    marker.scale.x = 0.1
    index = np.append(np.arange(0, len(course.s) - 1, _COURSE_MARKER_STEP), len(course.s) - 1)
    marker.points = [_point(x, y, 0.0) for x, y in zip(course.x[index], course.y[index], strict=True)]
    return marker


def wheel_poses(snapshot: Snapshot, vehicle: Vehicle) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return centre (m, map) and orientation (3 by 3, axle along y) of the rear and of the front wheel."""
    state, look = snapshot.state, snapshot.look
    lean = _rotation_z(state[st.YAW]) @ _rotation_x(state[st.ROLL])
    rear = np.array([state[st.X], state[st.Y], 0.0]) + lean @ np.array([0.0, 0.0, vehicle.rR])
    frame = lean @ _rotation_y(look[lk.PITCH])
    tilt = _rotation_y(-vehicle.lam)
    front = frame @ tilt @ _rotation_z(state[st.STEER]) @ tilt.T
    # From the contact point the centre lies upwards within the plane of the wheel.
    axle = front[:, 1]
    upwards = np.array([0.0, 0.0, 1.0]) - axle[2] * axle
    centre = np.array([look[lk.FRONT_X], look[lk.FRONT_Y], 0.0]) + vehicle.rF * upwards / np.linalg.norm(upwards)
    return (rear, frame), (centre, front)


def _marker(number: int, kind: int, frame: str, stamp: int, colour: ColorRGBA) -> Marker:
    marker = Marker(ns="bike", id=number, type=kind, action=Marker.ADD, color=colour)
    marker.header.stamp = time_to_message(stamp)
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    return marker


def _point(x: Any, y: Any, z: Any) -> Point:
    return Point(x=float(x), y=float(y), z=float(z))


def _rotation_x(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rotation_y(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _rotation_z(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _quaternion(r: FloatArray) -> Quaternion:
    """Return a rotation as quaternion; the largest component is found first, so that nothing is divided by zero."""
    squares = np.array([1.0 + r[0, 0] - r[1, 1] - r[2, 2], 1.0 - r[0, 0] + r[1, 1] - r[2, 2]])
    squares = np.append(squares, [1.0 - r[0, 0] - r[1, 1] + r[2, 2], 1.0 + np.trace(r)])
    largest = int(np.argmax(squares))
    double = math.sqrt(squares[largest])
    q = np.empty(4)
    q[largest] = 0.5 * double
    if largest == 3:
        q[:3] = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (2.0 * double)
    else:
        j, k = (largest + 1) % 3, (largest + 2) % 3
        q[j] = (r[j, largest] + r[largest, j]) / (2.0 * double)
        q[k] = (r[k, largest] + r[largest, k]) / (2.0 * double)
        q[3] = (r[k, j] - r[j, k]) / (2.0 * double)
    return Quaternion(x=float(q[0]), y=float(q[1]), z=float(q[2]), w=float(q[3]))
