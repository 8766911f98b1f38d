"""The ride in standard messages, for RViz, Foxglove and everyone who does not know ``bike_msgs``."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from geometry_msgs.msg import Point, Quaternion, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import Imu, JointState, NavSatFix, NavSatStatus
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from bike_sim.course.course import Course
from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.multibody.vectors import axis_angle, conjugate, multiply, rotate
from bike_sim.ros.messages import FOOTPRINT_FRAME, MAP_FRAME
from bike_sim.ros.node_tools import time_to_message
from bike_sim.schema import SIGNALS
from bike_sim.sim import look as lk
from bike_sim.sim.disturbances import RawSensors
from bike_sim.sim.sensors import Measurement, to_geodetic
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

ODOM_FRAME: Final = "odom"
BASE_FRAME: Final = "base_link"
REAR_FRAME: Final = "rear_frame"
"""Link of `robot_description` that carries the inertial unit; the estimator knows where."""

_X, _Y, _Z = np.eye(3)

JOINTS: Final = ("steer", "rear_wheel", "front_wheel", "pitch")
_PITCH, _PITCH_RATE, _REAR_SLIP, _LATERAL, _VERTICAL = (
    SIGNALS.index(name) for name in ("pitch", "pitch_rate", "rear_slip", "lateral_velocity", "vertical_velocity")
)

_COVARIANCE: Final = (1e-5 * np.eye(6)).ravel()
"""Of pose and twist, SI units squared: 3 mm, 3 mrad, and so in a second. The simulator knows both; zeros would mean
that nothing is known."""

_COURSE_COLOUR: Final = ColorRGBA(r=0.1, g=0.5, b=0.9, a=1.0)
_PREVIEW_COLOUR: Final = ColorRGBA(r=0.95, g=0.6, b=0.1, a=1.0)
_BODY_COLOUR: Final = ColorRGBA(r=0.2, g=0.2, b=0.2, a=1.0)
_FALLEN_COLOUR: Final = ColorRGBA(r=0.8, g=0.1, b=0.1, a=1.0)
_PREVIEW_HEIGHT: Final = 0.1
"""Height of the preview points above the ground, m, so that the line does not hide them."""
_COURSE_MARKER_STEP: Final = 5
"""Every fifth sample of the course is drawn: half a metre."""


class BaseMotion(NamedTuple):
    """Motion of a vehicle at one instant.

    Attributes:
        linear: velocity of the origin of base_link, in its axes, m/s.
        angular: angular velocity of base_link, in its axes, rad/s.
        pitch: of the rear frame in base_link, about the rear axle, positive nose down, rad.
        pitch_rate: rad/s.
        rear_wheel_rate: of the rear wheel to the rear frame, rad/s.
    """

    linear: tuple[float, float, float]
    angular: tuple[float, float, float]
    pitch: float
    pitch_rate: float
    rear_wheel_rate: float


def base_motion(snapshot: Snapshot, vehicle: Vehicle) -> BaseMotion:
    """Return the motion of base_link and of the rear frame in it; roads count as level."""
    state, (yaw_rate, speed) = snapshot.state, snapshot.look[[lk.YAW_RATE, lk.SPEED]].tolist()
    roll, roll_rate = float(state[st.ROLL]), float(state[st.ROLL_RATE])
    sr, cr = math.sin(roll), math.cos(roll)
    if not isinstance(vehicle, Superbike):  # rolls without slip along its heading
        pitch, pitch_rate = float(snapshot.look[lk.PITCH]), kinematics.pitch_rate(state, vehicle.parameters)
        angular = (roll_rate, yaw_rate * sr, yaw_rate * cr)
        return BaseMotion((speed, 0.0, 0.0), angular, pitch, pitch_rate, speed / vehicle.rR - pitch_rate)
    # The signals are of the frame's centre of mass, and of the angle between the frame and the horizontal.
    sink, sink_rate, slip, lateral, vertical = (
        float(snapshot.signals[i]) for i in (_PITCH, _PITCH_RATE, _REAR_SLIP, _LATERAL, _VERTICAL)
    )
    sp = min(max(math.sin(sink) / cr, -1.0), 1.0)
    cp = math.sqrt(max(1.0 - sp * sp, 1e-12))
    pitch_rate = (math.cos(sink) * sink_rate + sr * roll_rate * sp) / (cr * cp)
    yaw_rate -= pitch_rate * sr
    angular = (roll_rate, yaw_rate * sr, yaw_rate * cr)
    ahead, above = vehicle.frame.x, vehicle.frame.height - vehicle.rR
    ahead, above = cp * ahead + sp * above, cp * above - sp * ahead
    crown = vehicle.rear_tyre.crown
    arm = above + vehicle.rR - crown  # the contact point follows the lean around the tyre's crown
    linear = (
        speed - angular[1] * arm - pitch_rate * above,
        lateral * cr + vertical * sr - angular[2] * ahead + roll_rate * arm,
        vertical * cr - lateral * sr + angular[1] * ahead + pitch_rate * ahead,
    )
    radius = vehicle.rR - crown * (1.0 - cr)
    return BaseMotion(linear, angular, math.asin(sp), pitch_rate, linear[0] * (1.0 + slip) / radius - pitch_rate)


def odometry(snapshot: Snapshot, vehicle: Vehicle, stamp: int) -> Odometry:
    """Return pose of base_link in odom and its velocity in its own axes."""
    motion = base_motion(snapshot, vehicle)
    message = Odometry()
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = ODOM_FRAME
    message.child_frame_id = BASE_FRAME
    message.pose.pose.position = _point(snapshot.state[st.X], snapshot.state[st.Y], 0.0)
    message.pose.pose.orientation = _quaternion(_lean(snapshot.state))
    message.twist.twist.linear = _vector(*motion.linear)
    message.twist.twist.angular = _vector(*motion.angular)
    message.pose.covariance = message.twist.covariance = _COVARIANCE
    return message


def joint_state(snapshot: Snapshot, vehicle: Vehicle, stamp: int) -> JointState:
    """Return angles and rates of the joints of `robot_description`."""
    state, motion = snapshot.state, base_motion(snapshot, vehicle)
    message = JointState()
    message.header.stamp = time_to_message(stamp)
    message.name = list(JOINTS)
    message.position = [*state[[st.STEER, st.REAR_WHEEL, st.FRONT_WHEEL]].tolist(), motion.pitch]
    steer_rate, front_rate = state[[st.STEER_RATE, st.FRONT_WHEEL_RATE]].tolist()
    message.velocity = [steer_rate, motion.rear_wheel_rate, front_rate, motion.pitch_rate]
    return message


ENCODERS: Final = ("steer", "front_wheel")
"""Joints of the encoders; of the wheel only the rate is measured."""


def imu(measured: Measurement, sensors: RawSensors, stamp: int) -> Imu:
    """Return angular velocity and specific force of the rear frame in its own axes; it measures no orientation."""
    message = Imu()
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = REAR_FRAME
    message.orientation_covariance[0] = -1.0
    message.angular_velocity = _vector(*measured.gyro)
    message.linear_acceleration = _vector(*measured.force)
    message.angular_velocity_covariance = (sensors.gyro**2 * np.eye(3)).ravel()
    message.linear_acceleration_covariance = (sensors.accelerometer**2 * np.eye(3)).ravel()
    return message


def encoders(measured: Measurement, stamp: int) -> JointState:
    """Return what the encoders of steering and front wheel measure."""
    message = JointState()
    message.header.stamp = time_to_message(stamp)
    message.name = list(ENCODERS)
    message.position = [measured.steer, math.nan]
    message.velocity = [measured.steer_rate, measured.wheel_rate]
    return message


def nav_sat_fix(measured: Measurement, sensors: RawSensors, stamp: int, datum: tuple[float, float]) -> NavSatFix:
    """Return the position that has arrived, with the stamp (ns) of its measurement."""
    fix = measured.fix
    assert fix is not None, "asked for"
    message = NavSatFix()
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = "antenna"
    message.status.status, message.status.service = NavSatStatus.STATUS_GBAS_FIX, NavSatStatus.SERVICE_GPS
    message.latitude, message.longitude = to_geodetic(fix.x, fix.y, datum)
    message.position_covariance = (sensors.position**2 * np.diag([1.0, 1.0, 4.0])).ravel()
    message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    return message


def map_to_odom(snapshot: Snapshot, stamp: int) -> TransformStamped:
    """Return the transform from map to odom: none, for this odometry does not drift."""
    return _transform(MAP_FRAME, ODOM_FRAME, stamp)


def odom_to_footprint(snapshot: Snapshot, stamp: int) -> TransformStamped:
    """Return the transform from odom to base_footprint: the rear contact point, yaw only (REP-120)."""
    message = _transform(ODOM_FRAME, FOOTPRINT_FRAME, stamp)
    message.transform.translation = _vector(snapshot.state[st.X], snapshot.state[st.Y], 0.0)
    message.transform.rotation = _quaternion(axis_angle(_Z, snapshot.state[st.YAW]))
    return message


def footprint_to_base(snapshot: Snapshot, stamp: int) -> TransformStamped:
    """Return the transform from base_footprint to base_link: the lean."""
    message = _transform(FOOTPRINT_FRAME, BASE_FRAME, stamp)
    message.transform.rotation = _quaternion(axis_angle(_X, snapshot.state[st.ROLL]))
    return message


TRANSFORMS: Final = (map_to_odom, odom_to_footprint, footprint_to_base)
"""From the world to the vehicle."""


def set_prefix(message: Any, prefix: str) -> Any:
    """Put a prefix before the frames of a message, except the map that all share, and before marker namespaces."""
    for part in getattr(message, "markers", None) or getattr(message, "transforms", None) or (message,):
        if part.header.frame_id not in ("", MAP_FRAME):
            part.header.frame_id = prefix + part.header.frame_id
        for name in ("child_frame_id", "ns"):
            if hasattr(part, name):
                setattr(part, name, prefix + getattr(part, name))
    return message


def robot_description(vehicle: Vehicle) -> str:
    """Return a vehicle's four bodies as URDF; the root is base_link, the joints are `JOINTS`.

    Links have the axes of base_link in the upright pose. The rider belongs to the rear frame.
    """
    v = vehicle
    wheel_r, wheel_f = ((i, 0.0, j, i) for i, j in ((v.IRxx, v.IRyy), (v.IFxx, v.IFyy)))
    links = [
        '<link name="base_link"/>',
        _link("rear_frame", v.mB, (v.xB, -v.zB - v.rR), (v.IBxx, -v.IBxz, v.IByy, v.IBzz)),
        _link("front_frame", v.mH, (v.xH - v.w - v.c, -v.zH), (v.IHxx, -v.IHxz, v.IHyy, v.IHzz)),
        _link("rear_wheel_link", v.mR, (0.0, 0.0), wheel_r, v.rR),
        _link("front_wheel_link", v.mF, (0.0, 0.0), wheel_f, v.rF),
    ]
    joints = [
        _joint("pitch", "base_link", "rear_frame", (0.0, v.rR)),
        _joint("rear_wheel", "rear_frame", "rear_wheel_link", (0.0, 0.0)),
        # at the foot of the steering axis on the ground
        _joint("steer", "rear_frame", "front_frame", (v.w + v.c, -v.rR), (-math.sin(v.lam), 0.0, math.cos(v.lam))),
        _joint("front_wheel", "front_frame", "front_wheel_link", (-v.c, v.rF)),
    ]
    return "\n".join(['<?xml version="1.0"?>', f'<robot name="{v.name}">', *links, *joints, "</robot>", ""])


def _link(
    name: str, mass: float, centre: tuple[float, float], inertia: tuple[float, float, float, float], radius: float = 0.0
) -> str:
    """Return a body, drawn as a wheel of a radius or as a ball at its centre of mass (x and z, m)."""
    x, z = centre
    xx, xz, yy, zz = inertia
    shape = f'<cylinder radius="{radius}" length="0.04"/>' if radius else '<sphere radius="0.1"/>'
    turn = 0.5 * math.pi if radius else 0.0
    return (
        f'<link name="{name}"><inertial><origin xyz="{x} 0 {z}"/><mass value="{mass}"/><inertia ixx="{xx}" ixy="0" '
        f'ixz="{xz}" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>'
        f'<visual><origin xyz="{x} 0 {z}" rpy="{turn} 0 0"/><geometry>{shape}</geometry></visual></link>'
    )


def _joint(
    name: str,
    parent: str,
    child: str,
    origin: tuple[float, float],
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> str:
    """Return a joint at x and z in its parent, m."""
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin[0]} 0 {origin[1]}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/></joint>'
    )


def vehicle_markers(snapshot: Snapshot, vehicle: Vehicle, stamp: int) -> MarkerArray:
    """Return wheels, frame and preview points."""
    rear, front = wheel_poses(snapshot, vehicle)
    colour = _FALLEN_COLOUR if snapshot.fallen else _BODY_COLOUR
    wheels = []
    for number, ((centre, turn), radius) in enumerate(((rear, vehicle.rR), (front, vehicle.rF)), start=1):
        wheel = _marker(number, Marker.CYLINDER, MAP_FRAME, stamp, colour)
        wheel.pose.position = _point(*centre)
        # A cylinder's axis is z, a wheel's is y.
        wheel.pose.orientation = _quaternion(multiply(turn, axis_angle(_X, math.pi / 2.0)))
        wheel.scale.x = wheel.scale.y = 2.0 * radius
        wheel.scale.z = 0.04
        wheels.append(wheel)
    frame = _marker(3, Marker.LINE_STRIP, MAP_FRAME, stamp, colour)
    frame.scale.x = 0.05
    saddle = rear[0] + rotate(rear[1], np.array([0.25 * vehicle.w, 0.0, 1.8 * vehicle.rR]))
    handlebar = front[0] + rotate(front[1], np.array([-0.35 * vehicle.rF, 0.0, 1.7 * vehicle.rF]))
    frame.points = [_point(*p) for p in (rear[0], saddle, handlebar, front[0])]
    preview = _marker(4, Marker.SPHERE_LIST, FOOTPRINT_FRAME, stamp, _PREVIEW_COLOUR)
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
    """Return centre (m, map) and orientation (quaternion, axle along y) of the rear and of the front wheel."""
    state, look = snapshot.state, snapshot.look
    lean, tilt = _lean(state), axis_angle(_Y, -vehicle.lam)
    rear = np.array([state[st.X], state[st.Y], 0.0]) + rotate(lean, vehicle.rR * _Z)
    frame = multiply(lean, axis_angle(_Y, base_motion(snapshot, vehicle).pitch))
    steered = multiply(tilt, multiply(axis_angle(_Z, state[st.STEER]), conjugate(tilt)))
    front = multiply(frame, steered)
    # From the contact point the centre lies upwards within the plane of the wheel.
    axle = rotate(front, _Y)
    upwards = _Z - axle[2] * axle
    centre = np.array([look[lk.FRONT_X], look[lk.FRONT_Y], 0.0]) + vehicle.rF * upwards / np.linalg.norm(upwards)
    return (rear, frame), (centre, front)


def _lean(state: FloatArray) -> FloatArray:
    """Return the orientation of base_link, a quaternion."""
    return multiply(axis_angle(_Z, state[st.YAW]), axis_angle(_X, state[st.ROLL]))


def _marker(number: int, kind: int, frame: str, stamp: int, colour: ColorRGBA) -> Marker:
    marker = Marker(ns="bike", id=number, type=kind, action=Marker.ADD, color=colour)
    marker.header.stamp = time_to_message(stamp)
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    return marker


def _transform(parent: str, child: str, stamp: int) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = parent
    return message


def _quaternion(turn: FloatArray) -> Quaternion:
    x, y, z, w = turn.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _vector(x: Any, y: Any, z: Any) -> Vector3:
    return Vector3(x=float(x), y=float(y), z=float(z))


def _point(x: Any, y: Any, z: Any) -> Point:
    return Point(x=float(x), y=float(y), z=float(z))
