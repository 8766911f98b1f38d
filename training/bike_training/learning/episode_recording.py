"""Records rides of training as the recorder node would, with what was learned from at each step.

Two kinds of rides are recorded: those of a validation, and rides that the learner itself makes, with its exploration.
A recording that the disk refuses ends with a warning; learning goes on.
"""

from __future__ import annotations

import json
import warnings
from array import array
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from bike_msgs.msg import LearningStep
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from stable_baselines3.common.vec_env import VecEnv

from bike_analysis.read.columns import MessageSchema
from bike_policy.contract.bundle import Actor
from bike_policy.contract.observation import rows_of
from bike_sim.course.random_courses import PathRanges
from bike_sim.recording.definitions import message_type
from bike_sim.recording.metadata import LATCHED, Qos
from bike_sim.recording.recorder import RideRecorder
from bike_sim.ros import messages, node_tools
from bike_sim.ros.command_gate import Command
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.superbike import Superbike
from bike_training.curricula.parts import RideRanges
from bike_training.tasks.base import Task, sum_of

TOPICS: Final = {
    "episode": ("bike_msgs/msg/EpisodeStart", LATCHED),
    "course": ("bike_msgs/msg/Course", LATCHED),
    "state": ("bike_msgs/msg/BikeState", Qos()),
    "course_points": ("bike_msgs/msg/CoursePoints", Qos()),
    "lean_history": ("bike_msgs/msg/LeanHistory", Qos()),
    "telemetry": ("bike_msgs/msg/Telemetry", Qos()),
    "command": ("bike_msgs/msg/BikeCommand", Qos()),
    "events": ("bike_msgs/msg/RideEvent", Qos()),
    "learning/step": ("bike_msgs/msg/LearningStep", Qos()),
}
"""Topics of a recorded ride in the namespace of the nodes, with their types and QoS; telemetry is of superbikes."""


@dataclass(frozen=True)
class Standing:
    """Progress of learning at an episode.

    Attributes:
        step: learning steps made so far.
        part: part of the curriculum, 5 once it is finished.
        ranges: intervals that new rides are drawn from; None where a curriculum has no such intervals.
    """

    step: int
    part: int
    ranges: RideRanges | None


@contextmanager
def _warning_of_disk(path: Path, end: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Turn a refusal of the disk into a warning, for no recording is worth the training.

    Args:
        path: recording.
        end: is called then.
    """
    try:
        yield
    except OSError as error:
        warnings.warn(f"{path} is not recorded further, learning goes on: {error.strerror or error}", stacklevel=3)
        end()


class EpisodeWriter:
    """Rides one ride in a simulator, step by step, and writes it down.

    Attributes:
        snapshot: what is seen now.
        failed: whether the ride has failed.
    """

    def __init__(
        self, path: Path, task: Task, config: SimulatorConfig, request: ResetRequest, full_episode: int, rider: str
    ) -> None:
        """Begin the ride and its recording.

        Args:
            path: recording, ``.mcap``.
            task: task to learn.
            config: of the simulator that it is ridden in.
            request: of the ride.
            full_episode: steps after which an episode of learning is truncated.
            rider: the rider, for the notes.

        Raises:
            OSError: the disk refuses the recording; it is closed then. `step` and `close` raise it too.
        """
        self._task, self._full_episode = task, full_episode
        self._episode, self._episode_step = 1, 0
        self.failed = False
        with ExitStack() as opened:
            self._simulator = opened.enter_context(closing(Simulator(config)))
            self._begin(path, request, rider)
            self._opened = opened.pop_all()

    def _begin(self, path: Path, request: ResetRequest, rider: str) -> None:
        task, simulator, config = self._task, self._simulator, self._simulator.config
        self.snapshot = simulator.reset(request)
        assert simulator.course is not None
        self._rides = task.make_state(1, simulator.vehicle)
        self._rides.begin(0, rows_of(self.snapshot), request, simulator.course)
        self._facts = messages.Episode.of(simulator.vehicle, simulator.course, request.preview, config.control_period)
        self._open(path, {"rider": rider, "layout": task.layout.name, "task": json.dumps(task.to_card())})
        number, stamp = self.snapshot.episode, self._stamp_of(self.snapshot)
        names = simulator.plant.signal_names
        self._write("episode", messages.episode_start_to_message(request, config, names, number, stamp), stamp)
        self._write("course", messages.course_to_message(simulator.course, number, stamp), stamp)
        self._write_events(self.snapshot)
        self._write_state(self.snapshot, stamp)

    def _write_state(self, snapshot: Snapshot, stamp: int) -> None:
        """Write what `sim_node` publishes of a state."""
        course, vehicle = self._simulator.course, self._simulator.vehicle
        assert course is not None, "an episode has begun"
        period = round(self._facts.control_period * node_tools.NANOSECONDS)
        self._write_bytes("state", messages.encode_state(snapshot, self._facts, stamp), stamp)
        self._write("course_points", messages.course_points_to_message(snapshot, course, stamp), stamp)
        self._write("lean_history", messages.lean_history_to_message(snapshot, stamp, period), stamp)
        if isinstance(vehicle, Superbike):
            self._write("telemetry", messages.telemetry_to_message(snapshot, vehicle, stamp), stamp)

    def _open(self, path: Path, notes: dict[str, str]) -> None:
        self._recorder = RideRecorder(path, overwrite=True, notes=notes, metadata_file=False)
        self._schemas: dict[str, MessageSchema] = {}
        for name, (kind, qos) in TOPICS.items():
            if name == "telemetry" and not isinstance(self._simulator.vehicle, Superbike):
                continue
            described = message_type(kind)
            self._recorder.add_topic(f"/bike/{name}", described, qos)
            self._schemas[name] = MessageSchema(described.name, described.definition)

    def step(
        self,
        observation: NDArray[np.float32],
        action: NDArray[np.floating],
        standing: Standing,
        deterministic: bool,
    ) -> list[Snapshot]:
        """Hold an action for one decision; write down its commands, the step of learning, and what comes of it.

        Args:
            observation: of the policy.
            action: of the policy, in [-1, 1].
            standing: progress of learning then.
            deterministic: whether the action is the mean of the policy.
        """
        before = self.snapshot
        self._rides.act(rows_of(before), action[None])
        held: list[tuple[Snapshot, Command]] = []
        while len(held) < self._task.repeat and not self.snapshot.fallen:
            command = self._rides.commands(rows_of(self.snapshot))[0].tolist()
            given = Command(self.snapshot.episode, self.snapshot.step, *command)
            self.snapshot = self._simulator.step(*command)
            self._rides.advance(rows_of(self.snapshot))
            held.append((self.snapshot, given))
        learned = self._learned(before, observation, action, standing)
        learned.deterministic = deterministic
        learned.steering = held[0][1].steering if held else 0.0
        # In the order of time; what was learned stands before its states.
        for place, (snapshot, given) in enumerate(held):
            stamp = self._stamp_of(before)
            self._write_bytes("command", messages.encode_command(given, stamp), stamp)
            if place == 0:
                self._write("learning/step", learned, stamp)
            self._write_state(snapshot, self._stamp_of(snapshot))
            self._write_events(snapshot)
            before = snapshot
        return [snapshot for snapshot, _ in held]

    def observe(self) -> NDArray[np.float32]:
        """Return what a policy sees now."""
        return self._rides.observe(rows_of(self.snapshot))[0]

    def _write_events(self, snapshot: Snapshot) -> None:
        stamp = self._stamp_of(snapshot)
        for event in snapshot.events:
            self._write("events", messages.event_to_message(event, snapshot, stamp), stamp)

    def close(self) -> None:
        """Finish the file and release the simulator."""
        self._opened.close()
        self._recorder.close()

    def _learned(
        self, before: Snapshot, observation: NDArray[np.float32], action: NDArray[np.floating], standing: Standing
    ) -> LearningStep:
        """Return what the step was worth and whether an episode of learning ended with it."""
        terms, failed = self._rides.evaluate(rows_of(self.snapshot))
        self.failed = bool(failed[0])
        message = LearningStep(episode=before.episode, step=before.step)
        message.header.stamp = node_tools.time_to_message(self._stamp_of(before))
        message.feature_names = list(self._task.layout.names)
        message.observation, message.action = array("f", observation.tobytes()), array("f", action.tolist())
        message.steer_set = float(action[0]) * self._task.action.columns[0].scale
        message.reward_names = list(terms)
        message.reward_terms = array("d", (float(term[0]) for term in terms.values()))
        message.reward = float(sum_of(terms)[0])
        message.learning_step, message.part = standing.step, standing.part
        if standing.ranges is not None:
            sets = (standing.ranges, *standing.ranges.also)
            message.speed_min = array("d", (ranges.speed[0] for ranges in sets))
            message.speed_max = array("d", (ranges.speed[1] for ranges in sets))
            for spec in fields(PathRanges):
                setattr(message, spec.name, array("d", (getattr(ranges.paths, spec.name) for ranges in sets)))
        message.learning_episode, message.learning_episode_step = self._episode, self._episode_step
        self._episode_step += 1
        message.terminated = self.failed
        message.truncated = not self.failed and self._episode_step == self._full_episode
        if message.truncated:
            self._episode, self._episode_step = self._episode + 1, 0
        return message

    def _stamp_of(self, snapshot: Snapshot) -> int:
        """Simulated time of a state, ns. Rides begin after one period, as those of the node do."""
        return round((snapshot.step + 1) * self._facts.control_period * node_tools.NANOSECONDS)

    def _write(self, name: str, message: Any, stamp: int) -> None:
        # rclpy leaves excess bytes behind messages with empty arrays, which strict readers refuse.
        data = self._schemas[name].trim(serialize_message(message))
        self._write_bytes(name, data, stamp)

    def _write_bytes(self, name: str, data: bytes, stamp: int) -> None:
        self._recorder.write(f"/bike/{name}", data, stamp)


def record_ride(
    path: Path, actor: Actor, task: Task, config: SimulatorConfig, request: ResetRequest, standing: Standing
) -> None:
    """Ride a validation ride once more and record it; a disk that refuses it ends the ride with a warning.

    Args:
        path: recording, ``.mcap``.
        actor: policy.
        task: what it sees and answers.
        config: of the simulator that it is ridden in.
        request: of the ride.
        standing: progress of learning.
    """
    steps = round(task.validation_duration / config.control_period)
    with _warning_of_disk(path):
        writer = EpisodeWriter(path, task, config, request, steps, "deterministic actor, in validation")
        with closing(writer):
            for _ in range(steps // task.repeat):
                observation = writer.observe()
                action = actor.act(observation)
                writer.step(observation, action, standing, True)
                if writer.failed:
                    break


class TrainingRecorder:
    """Records rides of the learner itself when it is asked to.

    It follows the first bicycle with a simulator of its own, command by command, and holds each observation against
    that of the training: what is recorded is the ride that was learned from.
    """

    def __init__(self, env: VecEnv, task: Task, config: SimulatorConfig) -> None:
        """Prepare to record rides of a task in the environments of a training with a simulator that rides alike."""
        self._env, self._task, self._config = env, task, config
        self._path: Path | None = None
        self._ridden: ResetRequest | None = None
        self._writer: EpisodeWriter | None = None

    @property
    def recording(self) -> bool:
        """Whether a ride is being recorded."""
        return self._writer is not None

    def record_next(self, path: Path) -> None:
        """Record the next ride that begins, unless one is being recorded or waited for."""
        if self._path is None:
            self._path, self._ridden = path, self._request()

    def stepped(
        self, observation: NDArray[np.float32], action: NDArray[np.floating], standing: Callable[[], Standing]
    ) -> None:
        """Take in a decision that the first vehicle has made; the recording ends where it has left that ride.

        Args:
            observation: of the policy before it.
            action: of the policy, in [-1, 1].
            standing: returns the progress of learning before it.
        """
        if self._path is None:
            return
        with _warning_of_disk(self._path, self.close):
            if self._writer is not None:
                if not np.array_equal(self._writer.observe(), observation):
                    warnings.warn(f"recording {self._path} ends: its ride has left that of the training", stacklevel=2)
                    self.close()
                    return
                self._writer.step(observation, action.astype(np.float64), standing(), False)
            request = self._request()
            if request is self._ridden:
                return
            if self._writer is not None:
                self.close()
                return
            self._ridden, rider = request, "learner, in training"
            steps = self._task.max_steps
            self._writer = EpisodeWriter(self._path, self._task, self._config, request, steps, rider)

    def _request(self) -> ResetRequest:
        """Return the request of the ride of the first vehicle, always the same object."""
        request: ResetRequest = self._env.env_method("request", indices=0)[0]
        return request

    def close(self) -> None:
        """Finish a recording that is open, and wait for none."""
        path, writer = self._path, self._writer
        self._path = self._writer = None
        if path is not None and writer is not None:
            with _warning_of_disk(path):
                writer.close()
