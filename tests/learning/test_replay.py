"""A recorded ride is ridden again: the same bit for bit, or the step from which it is another one."""

import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_analysis.read.columns import MessageSchema
from bike_analysis.read.container import Container
from bike_policy.contract.bundle import Actor
from bike_sim.course.random_courses import PathRanges
from bike_sim.recording.definitions import message_type
from bike_sim.recording.recorder import RideRecorder
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview, ResetRequest
from bike_training.cli import main
from bike_training.curricula.parts import PartsCurriculum
from bike_training.replay import COMMANDS, EXACT, FLAGS, Replay, RideSource, Start, read_rides, ride_again
from bike_training.tasks.path import SHARP, TASKS

rclpy_serialization = pytest.importorskip("rclpy.serialization")

TASK = replace(TASKS["lean"], weights=SHARP)
RANGES = PartsCurriculum().episodes(0)
COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)
PYBULLET = SimulatorConfig(engine="pybullet", time_step=0.005)


def balancing_actor() -> Actor:
    """Steer into the fall and towards the path."""
    weights = dict(zip(TASK.layout.names, np.zeros(TASK.layout.size), strict=True))
    weights |= {"roll": -0.6, "roll_rate": -0.35, "t_p1": 0.05}
    return Actor([np.array([list(weights.values())], dtype="f4")], [np.zeros(1, dtype="f4")])


def record(path: Path, config: SimulatorConfig) -> Path:
    from bike_training.learning.episode_recording import Standing, record_ride

    request = ResetRequest(
        seed=5, speed_range=(4.0, 5.0), path_ranges=RANGES.paths, path_length=150.0, perturb=True, preview=TASK.preview
    )
    record_ride(path, balancing_actor(), TASK, config, request, Standing(100, 1, RANGES))
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("recording") / "ride.mcap", COMPILED)


@pytest.fixture(scope="module")
def recorded(recording) -> RideSource:
    (ride,) = read_rides(recording)[1]
    assert len(ride.ride.states) > 60
    return ride


def rewrite(source: Path, target: Path, change: Callable[[str, Any], Any]) -> Path:
    """Copy a recording; each message goes through a function, which may change it or return None to leave it out."""
    box = Container(source)
    found = list(box.messages())
    with RideRecorder(target, notes=box.metadata["ride_notes"], metadata_file=False) as recorder:
        for message in found:
            channel = box.channels[message.channel]
            name = box.schemas[channel.schema_id].name
            package, _, kind = name.split("/")
            decoded = rclpy_serialization.deserialize_message(
                message.data, getattr(importlib.import_module(f"{package}.msg"), kind)
            )
            changed = change(channel.topic, decoded)
            recorder.add_topic(channel.topic, name)
            if changed is not None:
                schema = MessageSchema(name, message_type(name).definition)
                data = schema.trim(rclpy_serialization.serialize_message(changed))
                recorder.write(channel.topic, data, message.log_time_ns)
    return target


def replay_file(path: Path) -> Replay:
    (ride,) = read_rides(path)[1]
    return ride_again(ride)


@pytest.mark.parametrize("config", [COMPILED, PYBULLET], ids=lambda config: config.engine)
def test_a_recorded_ride_comes_out_the_same(config, tmp_path):
    (ride,) = read_rides(record(tmp_path / "ride.mcap", config))[1]
    replay = ride_again(ride)
    assert replay.same
    assert replay.states == replay.recorded_states == len(ride.ride.states) > 60
    assert replay.learned == replay.states - 1
    assert (replay.missing, replay.stopped, replay.apart, replay.config) == (0, "", (), config)


@given(data=st.data(), by=st.floats(1e-6, 0.1) | st.floats(-0.1, -1e-6))
def test_a_changed_command_is_found_at_the_step_that_it_led_to(recorded, data, by):
    row = data.draw(st.integers(1, len(recorded.ride.states) - 1))
    steering = recorded.columns["steering_command"].copy()
    steering[row] = np.clip(steering[row] + by, -1.0, 1.0)
    replay = ride_again(replace(recorded, columns={**recorded.columns, "steering_command": steering}))
    assert not replay.same
    assert replay.difference is not None
    assert replay.difference.step == row
    assert replay.apart[-1].time_s == pytest.approx((len(steering) - 1) * 0.05)


@given(data=st.data(), name=st.sampled_from([name for name in EXACT if name not in (*COMMANDS, *FLAGS)]))
def test_a_single_bit_of_a_state_is_found(recorded, data, name):
    row = data.draw(st.integers(0, len(recorded.ride.states) - 1))
    values = recorded.columns[name].copy()
    values[row] = np.nextafter(values[row], np.inf)
    found = ride_again(replace(recorded, columns={**recorded.columns, name: values})).difference
    assert found is not None
    assert (found.step, found.field) == (row, name)
    assert found.ridden == recorded.columns[name][row]


def test_what_was_learned_from_is_held_against_the_ride(recorded):
    learned = recorded.learned
    assert learned is not None
    observation, reward = learned.observation.copy(), learned.reward.copy()
    observation[7, 2] += 1e-3
    reward[3] += 1e-9
    seen = ride_again(replace(recorded, learned=replace(learned, observation=observation)))
    paid = ride_again(replace(recorded, learned=replace(learned, reward=reward)))
    for replay, step, name in ((seen, 7, "observation[2]"), (paid, 3, "reward")):
        assert replay.difference is None
        assert not replay.same
        assert replay.learned_difference is not None
        assert (replay.learned_difference.step, replay.learned_difference.field) == (step, name)


def test_lost_states_are_bridged_by_commands_and_end_the_ride_without_them(recording, recorded, tmp_path):
    lost = {0, 7, 8, 9}

    def without_states(topic: str, message: Any) -> Any:
        return None if topic == "/bike/state" and message.step in lost else message

    def without_commands(topic: str, message: Any) -> Any:
        gone = topic == "/bike/command" and message.step == 7
        return None if gone else without_states(topic, message)

    whole = len(recorded.ride.states)
    bridged = replay_file(rewrite(recording, tmp_path / "bridged.mcap", without_states))
    assert bridged.same
    assert (bridged.states, bridged.missing) == (whole - 4, 4)
    torn = replay_file(rewrite(recording, tmp_path / "torn.mcap", without_commands))
    assert not torn.same
    assert torn.difference is None
    assert torn.states == 6  # those of steps 1 to 6
    assert "states of steps 8 to 9 are missing" in torn.stopped


def test_a_simulator_that_was_started_anew_has_its_own_rides(recording, tmp_path):
    """Two rides of the same number, one after the other; each is ridden from its own start."""
    other = tmp_path / "other.mcap"
    both = tmp_path / "both.mcap"
    record(other, PYBULLET)
    with RideRecorder(both, metadata_file=False) as recorder:
        for path in (recording, other):
            box = Container(path)
            for message in box.messages():
                channel = box.channels[message.channel]
                recorder.add_topic(channel.topic, box.schemas[channel.schema_id].name)
                recorder.write(channel.topic, message.data, message.log_time_ns)
    one, two = read_rides(both)[1]
    assert (one.ride.episode, two.ride.episode) == (1, 1)
    assert (one.start.config.engine, two.start.config.engine) == ("whipple", "pybullet")
    assert ride_again(one).same
    assert ride_again(two).same


def test_another_engine_parts_from_the_recorded_ride(recorded):
    replay = ride_again(recorded, engine="pybullet", time_step=0.001)
    assert not replay.same
    assert replay.config == replace(COMPILED, engine="pybullet", time_step=0.001)
    apart = [apart.position_m for apart in replay.apart if apart.time_s <= 2.0]
    assert apart == sorted(apart)
    assert 0.0 < apart[0] < 1e-3  # half a second


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"vehicle": "nothing"}, "no vehicle 'nothing'"),
        ({"vehicle": "panigale_v4r", "engine": "pybullet"}, "is 'panigale_v4r' now"),
        ({"course": "nowhere.yaml"}, "nowhere.yaml"),
        ({"time_step": 0.003}, "whole number of time steps"),
        ({"speed_max": 0.0}, "speed range"),
        ({"engine": "steam"}, "unknown engine 'steam'"),
    ],
)
def test_a_start_that_cannot_be_met_is_one_line(recording, tmp_path, capsys, change, words):
    def changed(topic: str, message: Any) -> Any:
        for name, value in change.items() if topic == "/bike/episode" else ():
            setattr(message, name, value)
        return message

    assert main(["analyze", "--replay", str(rewrite(recording, tmp_path / "ride.mcap", changed))]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("bike analyze: ")
    assert words in line


def test_recordings_that_cannot_be_ridden_again_say_why(recording, tmp_path, capsys):
    def without_start(topic: str, message: Any) -> Any:
        return None if topic == "/bike/episode" else message

    def only_commands(topic: str, message: Any) -> Any:
        return message if topic == "/bike/command" else None

    startless = rewrite(recording, tmp_path / "startless.mcap", without_start)
    stateless = rewrite(recording, tmp_path / "stateless.mcap", only_commands)
    (tmp_path / "text.mcap").write_text("no recording")
    for path, words in (
        (startless, "does not say how the ride began"),
        (stateless, "holds no state"),
        (tmp_path / "text.mcap", "is not an MCAP recording"),
        (tmp_path / "none.mcap", "does not exist"),
    ):
        assert main(["analyze", "--replay", str(path)]) == 2
        assert words in capsys.readouterr().err
    assert main(["analyze", "--replay", str(recording), "--episode", "7"]) == 2
    assert "has no ride of episode 7; it has 1" in capsys.readouterr().err


def test_the_command_tells_what_came_out(recording, tmp_path, capsys):
    assert main(["analyze", "--replay", str(recording)]) == 0
    assert "the same ride, bit for bit" in capsys.readouterr().out

    def softer(topic: str, message: Any) -> Any:
        if topic == "/bike/state" and message.step == 20:
            message.steering_command *= 0.5
        return message

    path = rewrite(recording, tmp_path / "changed.mcap", softer)
    assert main(["analyze", "--replay", str(path)]) == 1
    assert "the first that differs: step 20 (1.00 s)" in capsys.readouterr().out
    assert main(["analyze", "--replay", str(path), "--json"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert result["schema"] == "bike.analyze_replay/1"
    (ride,) = result["figures"]["rides"]
    assert ride["first_difference"]["step"] == 20
    assert ride["as_recorded"]
    assert main(["analyze", "--replay", str(recording), "--engine", "pybullet", "--episode", "1"]) == 1
    assert "recorded with whipple at 10 ms" in capsys.readouterr().out


def test_no_ros_is_needed(recording):
    script = (
        "import sys; from bike_training.cli import main; code = main(sys.argv[1:]); "
        "sys.exit(code or any(m.split('.')[0] in ('rclpy', 'bike_msgs', 'std_msgs') for m in sys.modules))"
    )
    words = [sys.executable, "-c", script, "analyze", "--replay", str(recording)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "the same ride, bit for bit" in done.stdout


@given(share=st.floats(0.0, 1.0))
def test_a_torn_recording_is_ridden_as_far_as_it_goes(recording, tmp_path, capsys, share):
    whole = recording.read_bytes()
    path = tmp_path / "torn.mcap"
    path.write_bytes(whole[: round(share * len(whole))])
    code = main(["analyze", "--replay", str(path)])
    said = capsys.readouterr()
    assert code in (0, 2)
    if code == 0:
        assert "the same ride, bit for bit" in said.out
    else:
        assert len(said.err.strip().splitlines()) == 1


def test_a_start_survives_as_a_message_whatever_is_in_it():
    """Every field differs from its default, so that one that is left out shows."""
    from bike_sim.ros.messages import episode_start_to_message

    config = SimulatorConfig("some.yaml", "whipple", 0.002, 0.1, 3)
    request = ResetRequest(
        seed=9,
        course="circle",
        speed_range=(3.0, 5.0),
        perturb=True,
        initial_state=tuple(0.1 * k for k in range(10)),
        path_ranges=PathRanges(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        path_length=77.0,
        preview=Preview(False, 0.7, 4),
        context=(1.5, 2.5),
        line=0.25,
        progress=12.5,
        speed_share=0.5,
        start_offset=0.2,
        start_heading=0.05,
    )
    for value in (config, request):
        for spec in fields(value):
            default = spec.default_factory() if spec.default_factory is not MISSING else spec.default
            assert getattr(value, spec.name) != default, f"{spec.name} has its default here"
    message = episode_start_to_message(request, config, ("wheel_load_n",), 3, 10**9)
    name = "bike_msgs/msg/EpisodeStart"
    schema = MessageSchema(name, message_type(name).definition)
    decoded = schema.decode(schema.trim(rclpy_serialization.serialize_message(message)))
    assert Start.from_message(decoded) == Start(config, request)
