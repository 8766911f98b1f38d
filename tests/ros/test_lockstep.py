"""The simulator node in lockstep: one command, one period, the same ride as in process."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bike_msgs.msg import Course as CourseMessage
from bike_msgs.msg import CoursePoints, LeanHistory, RideEvent
from bike_msgs.srv import Reset
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from bike_sim.course.files import load_course
from bike_sim.ros import messages, node_tools, standard_messages
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.files import load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("compiled")]


def begin(probe, **values):
    response = probe.reset(ResetRequest(**{"seed": 1, "course": "line", **values}))
    assert response.success, response.message
    probe.until(lambda: probe.states[-1].episode == response.state.episode)
    return probe.states[-1]


def test_a_repeated_command_gets_the_same_state_again(lockstep) -> None:
    first = begin(lockstep)
    second = lockstep.answer(first, 0.05)
    count = len(lockstep.states)
    lockstep.sent("repeated", first, 0.9)
    lockstep.until(lambda: len(lockstep.states) > count)
    assert lockstep.states[-1] == second
    third = lockstep.answer(second, 0.05)
    assert third.step == 2


def test_stale_and_foreign_commands_do_nothing(lockstep) -> None:
    first = begin(lockstep)
    second = lockstep.answer(first)
    third = lockstep.answer(second)
    for changes in ({"step": 0}, {"step": 3}, {"episode": third.episode - 1}, {"episode": third.episode + 1}):
        lockstep.sent("stale", third, 0.5, **changes)
    assert lockstep.states[-1] == third
    assert lockstep.answer(third).steering_command == 0.0


def test_commands_that_cannot_be_never_reach_the_physics_and_are_reported(lockstep) -> None:
    state = begin(lockstep)
    for value in (math.nan, math.inf, -math.inf):
        lockstep.sent("refused", state, value)
        lockstep.sent("refused", state, 0.0, throttle=value)
    assert lockstep.states[-1] == state
    clipped = lockstep.answer(state, 3.0)
    assert clipped.steering_command == 1.0
    lockstep.until(lambda: lockstep.count("sim_node", "commands_clipped") == 1)
    reports = lockstep.statuses["sim_node"]
    warnings = [status.message for status in reports if status.level == DiagnosticStatus.WARN]
    assert any("refused" in text for text in warnings)
    assert any("clipped" in text for text in warnings)


def test_an_unanswered_state_comes_again(lockstep) -> None:
    state = begin(lockstep)
    count = len(lockstep.states)
    lockstep.until(lambda: len(lockstep.states) >= count + 2)
    assert all(again == state for again in lockstep.states[count:])


def test_time_never_runs_backwards_also_over_resets(lockstep) -> None:
    ticks = lockstep.listen(Clock, "/clock")
    lockstep.until(lambda: ticks)
    for _ in range(3):
        state = begin(lockstep)
        for _ in range(4):
            state = lockstep.answer(state)
    lockstep.until(
        lambda: messages.time_from_message(ticks[-1].clock) == messages.time_from_message(state.header.stamp)
    )
    times = [messages.time_from_message(tick.clock) for tick in ticks]
    stamps = [messages.time_from_message(s.header.stamp) for s in lockstep.states]
    assert times[0] > 0
    assert times == sorted(times)
    assert stamps == sorted(stamps)
    steps = np.diff(sorted(set(times)))
    assert np.all(steps == 50_000_000)


def test_a_refused_reset_says_why_and_leaves_the_ride_alone(lockstep) -> None:
    state = lockstep.answer(begin(lockstep))
    for request, words in [
        (Reset.Request(seed=1, course="nowhere"), "'nowhere'"),
        (Reset.Request(seed=1, speed_min=5.0, speed_max=2.0), "speed range"),
        (Reset.Request(seed=1, initial_state=[1.0, 2.0]), "10 finite numbers"),
        (Reset.Request(seed=1, initial_state=[math.nan] * 10), "finite"),
        (Reset.Request(seed=1, radius_min=9.0), "radius_max"),
        (Reset.Request(seed=1, preview_count=3), "preview interval"),
    ]:
        response = lockstep.reset(request)
        assert not response.success
        assert words in response.message
        assert "\n" not in response.message
    assert lockstep.answer(state).step == 2


def test_a_seed_is_drawn_where_none_is_given(lockstep) -> None:
    drawn = [lockstep.reset(Reset.Request(seed=-1, course="random", perturb=True)) for _ in range(2)]
    assert drawn[0].seed != drawn[1].seed
    again = lockstep.reset(Reset.Request(seed=drawn[0].seed, course="random", perturb=True))
    assert again.state.roll == drawn[0].state.roll != drawn[1].state.roll


def test_a_pause_keeps_the_command_for_later(lockstep) -> None:
    state = begin(lockstep)
    assert lockstep.pause(True).success
    lockstep.sent("taken", state, 0.25)
    assert lockstep.still() == state
    lockstep.pause(False)
    lockstep.until(lambda: lockstep.states[-1].step == 1)
    assert lockstep.states[-1].steering_command == 0.25


def test_all_topics_tell_of_the_same_ride(lockstep) -> None:
    kinds = {
        "course_points": CoursePoints,
        "lean_history": LeanHistory,
        "odom": Odometry,
        "joint_states": JointState,
        "markers": MarkerArray,
        "transform": TransformStamped,
    }
    heard = {topic: lockstep.attend(kind, topic) for topic, kind in kinds.items()}
    state = begin(lockstep, course="benchmark")
    for _ in range(5):
        state = lockstep.answer(state, 0.01)
    counts = dict.fromkeys(kinds, 6) | {"transform": 18}
    lockstep.until_equal(lambda: {topic: len(heard[topic]) for topic in kinds}, counts)
    points, history, odom, joints = (heard[topic][-1] for topic in list(kinds)[:4])
    assert {m.header.stamp.nanosec for m in (points, history, odom, joints)} == {state.header.stamp.nanosec}
    assert [p.x for p in points.line] == list(state.preview_x)
    assert [p.y for p in points.line] == list(state.preview_y)
    assert list(history.roll) == list(state.roll_history)
    assert (odom.pose.pose.position.x, odom.pose.pose.position.y) == (state.x, state.y)
    assert list(joints.position) == [state.steer, state.rear_wheel_angle, state.front_wheel_angle, state.pitch]
    assert joints.velocity[0] == state.steer_rate
    assert len(heard["markers"][-1].markers) == 4
    frames = heard["transform"][-3:]
    links = [("map", "odom"), ("odom", "base_footprint"), ("base_footprint", "base_link")]
    assert [(frame.header.frame_id, frame.child_frame_id) for frame in frames] == links
    assert (frames[1].transform.translation.x, frames[1].transform.translation.y) == (state.x, state.y)
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")


def test_who_comes_late_still_gets_the_course_and_the_description(lockstep) -> None:
    state = begin(lockstep, course="circle")
    courses = lockstep.listen(CourseMessage, "course", node_tools.LATCHED_QOS)
    lockstep.until(lambda: courses)
    assert courses[-1].episode == state.episode
    np.testing.assert_array_equal(messages.course_from_message(courses[-1]).x, load_course("circle").x)
    descriptions = lockstep.listen(String, "robot_description", node_tools.LATCHED_QOS)
    lockstep.until(lambda: descriptions)
    assert descriptions == [String(data=standard_messages.robot_description(load_vehicle("whipple")))]


def test_a_fall_is_told_and_ends_the_episode(lockstep) -> None:
    events = lockstep.attend(RideEvent, "events")
    state = begin(lockstep)
    while not state.fallen:
        state = lockstep.answer(state, 0.3)
    lockstep.until(lambda: events and events[-1].kind == RideEvent.FALL)
    assert events[-1].value == state.roll
    assert [e.kind for e in events if e.episode == state.episode] == [RideEvent.RESET, RideEvent.FALL]
    lockstep.sent("taken", state)
    assert lockstep.still() == state
    assert not begin(lockstep).fallen


def test_parameters_are_checked_when_they_change(lockstep) -> None:
    for name, value, reason in (
        ("speed", -3.0, "parameter speed must be finite and not negative, got -3.0"),
        (
            "real_time_factor",
            1e-12,
            "parameter real_time_factor must be 0 or at least 1.39e-05, a control period an hour",
        ),
        ("course", "nowhere", "no shipped course is called 'nowhere'"),
        ("vehicle", "whipple", "read-only"),
    ):
        result = lockstep.set_parameter(name, value)
        assert not result.successful
        assert reason in result.reason
    assert lockstep.set_parameter("speed", 5).successful
    request = ResetRequest(course="line", seed=1)
    lockstep.reset(request)
    lockstep.until(lambda: abs(lockstep.states[-1].speed - 4.0) < 0.01)
    assert lockstep.reset(Reset.Request(seed=1)).state.speed == pytest.approx(5.0, abs=1e-6)
