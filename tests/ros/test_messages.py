"""Core types through messages and back: nothing is lost, nothing changes."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pybullet
import pytest
from bike_msgs.msg import BikeCommand, BikeState
from hypothesis import given, settings
from hypothesis import strategies as st
from pybullet_utils.bullet_client import BulletClient
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker

from bike_sim.course.course import Course
from bike_sim.course.files import load_course
from bike_sim.course.random_courses import CURRICULUM_PATHS
from bike_sim.physics import kinematics
from bike_sim.physics import state as state_places
from bike_sim.ros import messages, standard_messages
from bike_sim.ros.command_gate import Command
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import EventKind
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike
from tests.same import assert_same
from tests.sim.conftest import STADIUM


def over_the_wire(message):
    return deserialize_message(serialize_message(message), type(message))


def assert_carried(snapshot: Snapshot, episode: messages.Episode, stamp: int = 3_000_000_017) -> None:
    """A state's bytes are those of rclpy, and the snapshot in them is the same bit for bit."""
    data = messages.encode_state(snapshot, episode, stamp)
    theirs = deserialize_message(data, BikeState)
    for found in (messages.decode_state(data), messages.decode_state(serialize_message(theirs))):
        assert_same(found.snapshot, snapshot)
        assert (found.stamp, found.episode) == (stamp, episode)
        assert found.snapshot.preview_y.flags.aligned
        assert found.snapshot.preview_y.flags.writeable
    assert_same(messages.snapshot_from_message(theirs), snapshot)
    assert messages.time_from_message(theirs.header.stamp) == stamp
    assert (theirs.vehicle, theirs.steering_limit) == (episode.vehicle, episode.steering_limit)


@pytest.fixture(scope="module")
def ridden() -> tuple[Simulator, list[Snapshot]]:
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.005))
    rides = [simulator.reset(ResetRequest(seed=4, course="benchmark", perturb=True, speed_range=(5.0, 5.0)))]
    rides += [simulator.step(0.02 * math.sin(0.3 * k)) for k in range(25)]
    return simulator, rides


def episode_of(simulator: Simulator) -> messages.Episode:
    assert simulator.course is not None
    return messages.Episode.of(simulator.vehicle, simulator.course, simulator.request.preview, 0.05)


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.floats(), st.floats(), st.integers(0, 2**50))
def test_commands_survive_bit_for_bit(episode: int, step: int, steering: float, throttle: float, stamp: int) -> None:
    command = Command(episode, step, steering, throttle)
    data = messages.encode_command(command, stamp)
    theirs = deserialize_message(data, BikeCommand)
    assert messages.time_from_message(theirs.header.stamp) == stamp
    for found in (data, serialize_message(theirs)):  # those of rclpy differ in what lies between numbers
        assert_same(messages.decode_command(found), command)


@given(data=st.data())
def test_bytes_of_a_stranger_are_a_message_or_one_error(
    ridden: tuple[Simulator, list[Snapshot]], data: st.DataObject
) -> None:
    simulator, rides = ridden
    state = messages.encode_state(rides[-1], episode_of(simulator), 5)
    command = messages.encode_command(Command(1, 2, 0.5), 5)
    for whole, decode in ((state, messages.decode_state), (command, messages.decode_command)):
        cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
        at, value = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(0, 255))
        changed = whole[:at] + bytes([value]) + whole[at + 1 :]
        for strange in (
            cut,
            changed,
            data.draw(st.binary(max_size=80)),
            whole[:4] + data.draw(st.binary(max_size=300)),
        ):
            with contextlib.suppress(ValueError):
                decode(strange)
        with pytest.raises(ValueError, match="bytes are not"):
            decode(cut)


@pytest.fixture(scope="module")
def simulators() -> Iterator[dict[str, Simulator]]:
    """Simulators of a bicycle on both engines, of a rigid superbike and of one with suspension."""
    configs = {name: superbike_config(name) for name in ("panigale_v4r", "zx10rr_suspended")}
    configs |= {"whipple": SimulatorConfig(engine="whipple"), "whipple on pybullet": SimulatorConfig(time_step=0.005)}
    made = {name: Simulator(config) for name, config in configs.items()}
    yield made
    for simulator in made.values():
        simulator.close()


@pytest.fixture(scope="module")
def circuit_file(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("circuits") / "stadium.yaml"
    path.write_text(STADIUM, encoding="utf-8")
    return str(path)


def assert_survives(simulator: Simulator, snapshot: Snapshot) -> None:
    assert simulator.course is not None
    period = simulator.config.control_period
    facts = messages.Episode.of(simulator.vehicle, simulator.course, simulator.preview, period)
    assert_carried(snapshot, facts)


@settings(max_examples=15)
@given(data=st.data())
def test_snapshots_of_all_vehicles_survive_wherever_they_ride(
    simulators: dict[str, Simulator], circuit_file: str, data: st.DataObject
) -> None:
    simulator = simulators[data.draw(st.sampled_from(sorted(simulators)))]
    circuit = data.draw(st.booleans())
    course = circuit_file if circuit else data.draw(st.sampled_from(("line", "circle", "benchmark", "random")))
    place = {}
    if circuit:
        place = {
            "line": data.draw(st.floats(0.0, 1.0)),
            "progress": data.draw(st.floats(0.0, 1000.0)),
            "start_offset": data.draw(st.floats(-8.0, 8.0)),
            "start_heading": data.draw(st.floats(-math.pi, math.pi)),
        }
    speed = data.draw(st.floats(4.0, 11.0) if isinstance(simulator.vehicle, Superbike) else st.floats(2.0, 7.0))
    request = ResetRequest(
        seed=data.draw(st.integers(0, 1000)),
        course=course,
        speed_range=(speed, speed),
        perturb=data.draw(st.booleans()),
        preview=Preview(data.draw(st.booleans()), data.draw(st.floats(0.1, 1.0)), data.draw(st.integers(1, 30))),
        **place,
    )
    assert_survives(simulator, simulator.reset(request))
    for _ in range(data.draw(st.integers(0, 20))):
        steering, throttle = data.draw(st.floats(-1.0, 1.0)), data.draw(st.floats(-1.0, 1.0))
        assert_survives(simulator, simulator.step(steering, throttle))


@pytest.mark.parametrize("vehicle", ["whipple", "panigale_v4r"])
def test_walls_falls_and_crossings_survive(simulators: dict[str, Simulator], circuit_file: str, vehicle: str) -> None:
    """Straight on over the start line and into a wall; then a fall."""
    simulator = simulators[vehicle]
    speed = 6.0 if vehicle == "whipple" else 30.0
    kinds, falls = set(), set()
    for course, progress, steered in ((circuit_file, 1000.0, False), ("line", 0.0, True)):
        snapshot = simulator.reset(ResetRequest(course=course, speed_range=(speed, speed), progress=progress))
        while True:
            assert_survives(simulator, snapshot)
            kinds |= {event.kind for event in snapshot.events}
            if snapshot.fallen:
                break
            roll, rate = snapshot.state[[state_places.ROLL, state_places.ROLL_RATE]]
            upright = -float(0.4 * roll + 0.1 * rate) if vehicle == "whipple" else 0.0
            snapshot = simulator.step(1.0 if steered else upright, 0.1)
            assert snapshot.time < 120.0
        falls.add(snapshot.fall)
        after = simulator.step(0.0)
        assert_survives(simulator, after)
    assert "wall" in falls
    assert len(falls) == 2
    assert {EventKind.RESET, EventKind.OFF_COURSE, EventKind.WALL, EventKind.FALL} <= kinds


@given(
    st.integers(0, 2**60),
    st.tuples(st.floats(0.1, 10.0), st.floats(0.0, 10.0)),
    st.sampled_from(CURRICULUM_PATHS),
    st.none() | st.lists(st.floats(-1e3, 1e3), min_size=10, max_size=10).map(tuple),
    st.none() | st.floats(1.0, 1e4),
    st.builds(Preview, st.booleans(), st.floats(0.01, 10.0), st.integers(1, 1000)),
    st.fixed_dictionaries(
        {
            "speed_share": st.floats(0.0, 1.2),
            "start_offset": st.floats(-1e3, 1e3),
            "start_heading": st.floats(-math.pi, math.pi),
        }
    ),
)
def test_reset_requests_survive(seed, speed, ranges, state, length, preview, start) -> None:
    asked = ResetRequest(
        seed=seed,
        course="somewhere.csv",
        speed_range=(speed[0], speed[0] + speed[1]),
        perturb=bool(seed % 2),
        initial_state=state,
        path_ranges=ranges,
        path_length=length,
        preview=preview,
        context=(1.0, 2.5),
        **start,
    )
    own = ResetRequest(course="line", path_length=17.0 if length else None)
    assert_same(ResetRequest.from_message(over_the_wire(messages.reset_to_message(asked)), own), asked)


def test_what_a_reset_leaves_open_is_the_simulators_own() -> None:
    own = ResetRequest(course="circle", speed_range=(3.0, 3.0), preview=Preview(False, 2.0, 7), path_length=50.0)
    empty = messages.Reset.Request(seed=5)
    assert_same(
        ResetRequest.from_message(empty, own),
        ResetRequest(5, "circle", (3.0, 3.0), preview=own.preview, path_length=50.0),
    )


@pytest.mark.parametrize("name", ["benchmark", "line"])
def test_courses_survive(name: str) -> None:
    course = load_course(name)
    assert_same(messages.course_from_message(over_the_wire(messages.course_to_message(course, 1, 0))), course)


def test_the_road_below_a_line_survives() -> None:
    plain = load_course("circle")
    grip = np.where(plain.s < 10.0, 0.6, 1.0)
    road = replace(plain, height=np.sin(plain.s / 9.0), bank=0.05 * np.cos(plain.s / 9.0), grip=grip)
    assert_same(messages.course_from_message(over_the_wire(messages.course_to_message(road, 1, 0))), road)


def test_limits_run_beside_the_line(ridden: tuple[Simulator, list[Snapshot]]) -> None:
    simulator, rides = ridden
    plain = simulator.course
    assert plain is not None
    left, right = 1.0 + 0.5 * np.sin(plain.s / 9.0), np.full_like(plain.s, 2.0)
    wide = Course(
        **{f.name: getattr(plain, f.name) for f in fields(plain)} | {"width_left": left, "width_right": right}
    )
    snapshot = rides[-1]
    message = over_the_wire(messages.course_points_to_message(snapshot, wide, 0))
    line, left_limit, right_limit = (
        np.array([[p.x, p.y] for p in points]) for points in (message.line, message.left, message.right)
    )
    np.testing.assert_array_equal(line[:, 0], snapshot.preview_x)
    stations = message.progress + np.arange(len(line)) * snapshot.look[lk.PREVIEW_SPACING]
    np.testing.assert_allclose(np.linalg.norm(left_limit - line, axis=1), np.interp(stations, wide.s, left), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(right_limit - line, axis=1), 2.0, atol=1e-9)
    ahead = np.gradient(line, axis=0)
    across = left_limit - right_limit
    turn = ahead[:, 0] * across[:, 1] - ahead[:, 1] * across[:, 0]
    assert np.all(turn > 0.0)  # the left limit lies to the left
    assert messages.course_points_to_message(snapshot, plain, 0).left == []


def test_lean_history_belongs_to_its_times(ridden: tuple[Simulator, list[Snapshot]]) -> None:
    _, rides = ridden
    for count, snapshot in ((1, rides[0]), (4, rides[3]), (10, rides[-1])):
        message = over_the_wire(messages.lean_history_to_message(snapshot, 9_000_000_000, 50_000_000))
        assert len(message.roll) == len(message.steer) == len(message.stamps) == count
        assert messages.time_from_message(message.stamps[-1]) == 9_000_000_000
        assert messages.time_from_message(message.stamps[0]) == 9_000_000_000 - (count - 1) * 50_000_000
        assert message.roll[-1] == snapshot.state[state_places.ROLL]
        assert message.roll_delta[0] == message.steer_delta[0] == 0.0
        np.testing.assert_array_equal(message.roll_delta[1:], np.diff(message.roll))


def test_kinds_of_events_are_those_of_the_message() -> None:
    for kind in EventKind:
        assert getattr(messages.RideEvent, kind.name) == kind.value


@pytest.fixture(scope="module")
def bicycle() -> Simulator:
    return Simulator(SimulatorConfig(engine="whipple"))


@given(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-4.0, 4.0))
def test_wheels_touch_the_ground_where_the_physics_says(
    bicycle: Simulator, roll: float, steer: float, yaw: float
) -> None:
    simulator = bicycle
    state = state_places.upright_state(4.0, simulator.vehicle.rF)
    state[[state_places.ROLL, state_places.STEER, state_places.YAW]] = roll, steer, yaw
    snapshot = simulator.reset(ResetRequest(course="line", initial_state=tuple(state)))
    vehicle = simulator.vehicle
    (rear, rear_turn), (front, front_turn) = wheel_poses(snapshot, vehicle)
    for centre, turn, radius in ((rear, rear_turn, vehicle.rR), (front, front_turn, vehicle.rF)):
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert centre[2] == pytest.approx(radius * math.sqrt(1.0 - turn[2, 1] ** 2), abs=1e-9)
    # The frame is rigid: the distance between the axles along the steering axis' normal does not depend on the pose.
    axis = front_turn @ np.array([-math.sin(vehicle.lam), 0.0, math.cos(vehicle.lam)])
    span = front - rear
    straight = simulator.reset(
        ResetRequest(course="line", initial_state=tuple(state_places.upright_state(4.0, vehicle.rF)))
    )
    (r0, _), (f0, t0) = wheel_poses(straight, vehicle)
    axis0 = t0 @ np.array([-math.sin(vehicle.lam), 0.0, math.cos(vehicle.lam)])
    assert span @ axis == pytest.approx((f0 - r0) @ axis0, abs=1e-6)
    assert kinematics.pitch(roll, steer, vehicle.parameters) == snapshot.look[lk.PITCH]


def wheel_poses(snapshot: Snapshot, vehicle: Vehicle) -> list[tuple[np.ndarray, np.ndarray]]:
    """Centres of the wheels, and their axes in columns."""
    poses = standard_messages.wheel_poses(snapshot, vehicle)
    return [(centre, np.reshape(pybullet.getMatrixFromQuaternion(turn), (3, 3))) for centre, turn in poses]


def leaned_axes(yaw: float, roll: float) -> np.ndarray:
    """Axes of base_link in map, in columns."""
    (sy, cy), (sr, cr) = ((math.sin(angle), math.cos(angle)) for angle in (yaw, roll))
    return np.array([[cy, -sy * cr, sy * sr], [sy, cy * cr, -cy * sr], [0.0, sr, cr]])


@pytest.mark.parametrize(("name", "tolerance"), [("whipple", 1e-3), ("panigale_v4r", 0.02)])
def test_twist_and_joint_rates_fit_poses_and_angles(name: str, tolerance: float) -> None:
    """What is said of a moment is the mean of what changes around it, m/s and rad/s."""
    kind = superbike_config(name) if name != "whipple" else SimulatorConfig(name, "whipple", control_period=0.01)
    simulator = Simulator(kind)
    snapshots = [simulator.reset(ResetRequest(course="line", speed_range=(30.0 if "v4r" in name else 5.0,) * 2))]
    snapshots += [simulator.step(0.4 * math.sin(0.05 * k) if "v4r" in name else 0.03, 0.2) for k in range(150)]
    vehicle, period = simulator.vehicle, simulator.config.control_period
    simulator.close()
    assert max(abs(s.state[state_places.ROLL]) for s in snapshots) > 0.2
    for before, now, after in zip(snapshots[20:], snapshots[21:], snapshots[22:], strict=False):
        odometry = standard_messages.odometry(now, vehicle, 0)
        joints = [standard_messages.joint_state(s, vehicle, 0) for s in (before, now, after)]
        change = (after.state - before.state) / (2.0 * period)
        roll = now.state[state_places.ROLL]
        axes = leaned_axes(now.state[state_places.YAW], roll)
        linear = [getattr(odometry.twist.twist.linear, axis) for axis in "xyz"]
        assert axes @ linear == pytest.approx([*change[:2], 0.0], abs=tolerance)
        angular = [getattr(odometry.twist.twist.angular, axis) for axis in "xyz"]
        yaw_rate, roll_rate = change[state_places.YAW], change[state_places.ROLL]
        rates = [roll_rate, yaw_rate * math.sin(roll), yaw_rate * math.cos(roll)]
        assert angular == pytest.approx(rates, abs=tolerance)
        means = (np.array(joints[2].position) - joints[0].position) / (2.0 * period)
        assert joints[1].velocity == pytest.approx(list(means), abs=tolerance)


@pytest.mark.parametrize("name", ["whipple", "panigale_v4r"])
def test_robot_description_moves_as_the_vehicle_does(name: str, tmp_path: Path) -> None:
    """Bullet reads it: at the joint states its wheels are where the markers are; its mass is the vehicle's."""
    simulator = Simulator(superbike_config(name) if name != "whipple" else SimulatorConfig(name, "whipple"))
    vehicle = simulator.vehicle
    file = tmp_path / "vehicle.urdf"
    file.write_text(standard_messages.robot_description(vehicle))
    state = state_places.upright_state(10.0, vehicle.rF)
    state[[state_places.ROLL, state_places.STEER, state_places.YAW]] = 0.3, 0.1, 2.0
    snapshot = simulator.reset(ResetRequest(course="line", initial_state=tuple(state)))
    world = BulletClient(pybullet.DIRECT)
    body = world.loadURDF(str(file))
    yaw, roll = (world.getQuaternionFromEuler(angles) for angles in ((0.0, 0.0, 2.0), (0.3, 0.0, 0.0)))
    _, leaned = world.multiplyTransforms([0.0] * 3, yaw, [0.0] * 3, roll)
    contact = [*snapshot.state[[state_places.X, state_places.Y]], 0.0]
    world.resetBasePositionAndOrientation(body, contact, leaned)
    joints = {world.getJointInfo(body, i)[1].decode(): i for i in range(world.getNumJoints(body))}
    angles = standard_messages.joint_state(snapshot, vehicle, 0)
    assert set(joints) == set(angles.name)
    for joint, angle in zip(angles.name, angles.position, strict=True):
        world.resetJointState(body, joints[joint], angle)
    poses = standard_messages.wheel_poses(snapshot, vehicle)
    for wheel, (centre, _) in zip(("rear_wheel", "front_wheel"), poses, strict=True):
        at = world.getLinkState(body, joints[wheel], computeForwardKinematics=True)[4]
        assert at == pytest.approx(list(centre), abs=1e-6 if name == "whipple" else 0.05)
    assert sum(world.getDynamicsInfo(body, i)[0] for i in joints.values()) == pytest.approx(vehicle.mass)
    world.disconnect()
    simulator.close()


@given(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-3.1, 3.1), st.floats(-30.0, 30.0))
def test_markers_of_the_wheels_turn_as_the_wheels_do(
    bicycle: Simulator, roll: float, steer: float, yaw: float, angle: float
) -> None:
    """A cylinder's axis is its z axis, so each marker is the wheel's rotation after a quarter turn about x."""
    simulator = bicycle
    state = state_places.upright_state(4.0, simulator.vehicle.rF)
    state[[state_places.ROLL, state_places.STEER, state_places.YAW]] = roll, steer, yaw
    state[[state_places.REAR_WHEEL, state_places.FRONT_WHEEL]] = angle, -angle
    snapshot = simulator.reset(ResetRequest(course="line", initial_state=tuple(state)))
    markers = standard_messages.vehicle_markers(snapshot, simulator.vehicle, 0).markers
    wheels = [marker for marker in markers if marker.type == Marker.CYLINDER]
    quarter = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    assert len(wheels) == 2
    for marker, (centre, turn) in zip(wheels, wheel_poses(snapshot, simulator.vehicle), strict=True):
        q = marker.pose.orientation
        vector, w = np.array([q.x, q.y, q.z]), q.w
        place = marker.pose.position
        np.testing.assert_allclose([place.x, place.y, place.z], centre, atol=1e-12)
        for point in np.eye(3):
            turned = point + 2.0 * np.cross(vector, np.cross(vector, point) + w * point)
            np.testing.assert_allclose(turned, turn @ quarter @ point, atol=1e-12)
