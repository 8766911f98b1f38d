"""The simulator as a ROS 2 node: commands in, physics, states out. Nothing here integrates or evaluates a ride.

In lockstep, time stands still until a command answers the last state; the next state follows. A state without an
answer is published again twice a second, so a policy may join late, be killed and restarted.

In free mode, time runs by itself at `real_time_factor` from the first command of an episode on, and the last command
is held. When commands stop for `command_timeout_s` of simulated time, the set points of steering and throttle go to 0.
For a bicycle that is not a state of rest: with its steering held straight it falls within seconds. Straight is merely
the set point that stays on the course longest without knowledge of the ride. After a fall the physics stops and waits
for a reset.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NoReturn

import numpy as np
import rclpy.node
from bike_msgs.msg import BikeCommand, BikeState, CoursePoints, EpisodeStart, LeanHistory, RideEvent, Telemetry
from bike_msgs.msg import Course as CourseMessage
from bike_msgs.srv import Pause, Reset
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from bike_sim.course.course import Course
from bike_sim.physics.engines import ENGINE_KINDS
from bike_sim.ros import node_tools, standard_messages
from bike_sim.ros.command_gate import Command, CommandCounts, CommandGate, Outcome
from bike_sim.ros.messages import (
    Episode,
    course_points_to_message,
    course_to_message,
    decode_command,
    encode_state,
    episode_start_to_message,
    event_to_message,
    lean_history_to_message,
    reset_from_message,
    telemetry_to_message,
)
from bike_sim.ros.node_tools import NANOSECONDS, ParameterSpec, time_to_message
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances, load_disturbances
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import DIVERGED, Snapshot
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # the wheels on PyPI have no tf2
    TFMessage = None

FIRST_STAMP: Final = NANOSECONDS
"""Simulated time of the first state, ns: nodes take a clock of 0 for one that has not begun."""

REPEAT_AFTER: Final = 0.4
"""Wall-clock time after which an unanswered state is published again, s. Looked at every HOUSEKEEPING_PERIOD."""

SCREEN_PERIOD: Final = 1.0 / 60.0
"""Least wall-clock time between two states for screens, s."""

HOUSEKEEPING_PERIOD: Final = 0.5
REPORT_PERIOD: Final = 1.0
"""Wall-clock time between two diagnostics, s."""

LARGEST_SEED: Final = 2**31


LOCKSTEP: Final = "lockstep"
FREE: Final = "free"
NEVER, FALL, END = "never", "fall", "end"

MAX_STEP: Final = 3600.0
"""Longest wall-clock time that free mode may take for a control period, s."""

_CONFIG = SimulatorConfig()
_PREVIEW = Preview()

SPECS: Final = (
    ParameterSpec("vehicle", _CONFIG.vehicle, "Shipped vehicle, or path of a YAML file.", fixed=True),
    ParameterSpec("engine", _CONFIG.engine, "Physics engine.", fixed=True, choices=ENGINE_KINDS),
    ParameterSpec("time_step", _CONFIG.time_step, "Integration step, s.", fixed=True),
    ParameterSpec("control_period", 0.0, "Time between two commands, s; 0 takes the vehicle's own.", fixed=True),
    ParameterSpec("history", _CONFIG.history, "Roll and steer angles kept in the lean history.", fixed=True),
    ParameterSpec(
        "mode",
        LOCKSTEP,
        "lockstep: one control period for each command that answers the last state. free: time runs by itself.",
        fixed=True,
        choices=(LOCKSTEP, FREE),
    ),
    ParameterSpec(
        "course", "benchmark", "Shipped course, path of a YAML or CSV file, or random. From the next episode."
    ),
    ParameterSpec(
        "speed",
        0.0,
        "Forward speed at the start of an episode, m/s; 0 takes the kind's own: 4 for a bicycle, at most 35 for a "
        "superbike. From the next episode.",
    ),
    ParameterSpec(
        "line", 1.0, "Circuit: line that is followed, 0 the median, 1 the ideal line. From the next episode."
    ),
    ParameterSpec(
        "progress", 0.0, "Circuit: where it begins, m along the centre line, below its length. From the next episode."
    ),
    ParameterSpec(
        "perturb", False, "Whether episodes start off the course, leaning and turning a little. From the next."
    ),
    ParameterSpec("seed", 0, "Seed of the first episode, counted up for each one the node begins; negative: drawn."),
    ParameterSpec(
        "preview_by_time", _PREVIEW.by_time, "Preview points by time, else by distance. From the next episode."
    ),
    ParameterSpec("preview_interval", _PREVIEW.interval, "Their interval, s or m. From the next episode."),
    ParameterSpec("preview_count", _PREVIEW.count, "Their number, the nearest included. From the next episode."),
    ParameterSpec(
        "real_time_factor",
        1.0,
        "Free mode: simulated over wall-clock time, at least a control period an hour; 0: a step for each command.",
    ),
    ParameterSpec(
        "command_timeout_s",
        0.5,
        "Free mode: simulated time without a command after which steering and throttle go to 0, s; 0: never.",
    ),
    ParameterSpec(
        "auto_reset",
        NEVER,
        "When a new episode begins by itself: never, after a fall, or at any end (fall, off course, course ridden).",
        choices=(NEVER, FALL, END),
    ),
    ParameterSpec(
        "disturbances",
        "",
        "Shipped disturbances or a YAML file; wind, pushes, drive and wrong parameters act here.",
        fixed=True,
    ),
    ParameterSpec(
        "frame_prefix", "", "Before the frames, map excepted; none: that of the namespace, none for /bike.", fixed=True
    ),
    ParameterSpec("publish_clock", True, "Publish /clock; false for all simulators of a domain but one.", fixed=True),
    ParameterSpec("publish_markers", True, "Publish markers for RViz and Foxglove where someone listens.", fixed=True),
)


@dataclass(frozen=True)
class NodeSettings:
    """Checked parameters of the simulator node.

    Attributes:
        simulator: settings of all episodes.
        episode: request of the node's own episodes, without the speed.
        speed: forward speed at their start, m/s; 0 for the vehicle's own.
        seed: seed of the first of them, or negative.
        mode: LOCKSTEP or FREE.
        real_time_factor: simulated over wall-clock time in free mode; 0 for a step a command.
        command_timeout: s of simulated time, 0 for never.
        auto_reset: NEVER, FALL or END.
        frame_prefix: before the frames, or empty for that of the namespace.
        publish_clock: whether /clock is published.
        publish_markers: whether markers are published.
        disturbances: of what is ridden, or None.
    """

    simulator: SimulatorConfig
    episode: ResetRequest
    speed: float
    seed: int
    mode: str
    real_time_factor: float
    command_timeout: float
    auto_reset: str
    frame_prefix: str
    publish_clock: bool
    publish_markers: bool
    disturbances: Disturbances | None

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> NodeSettings:
        """Check parameters, one by one and together.

        Raises:
            ValueError: a value that is wrong. FileNotFoundError: an unknown vehicle, or no such disturbances.
        """
        for name in ("real_time_factor", "command_timeout_s", "control_period", "speed"):
            if not math.isfinite(values[name]) or values[name] < 0.0:
                raise ValueError(f"parameter {name} must be finite and not negative, got {values[name]!r}")
        simulator = SimulatorConfig(
            vehicle=values["vehicle"],
            engine=values["engine"],
            time_step=values["time_step"],
            control_period=values["control_period"] or load_vehicle(values["vehicle"]).control_period,
            history=values["history"],
        )
        slowest = simulator.control_period / MAX_STEP
        if 0.0 < values["real_time_factor"] < slowest:
            raise ValueError(
                f"parameter real_time_factor must be 0 or at least {slowest:.3g}, a control period an hour, "
                f"got {values['real_time_factor']!r}"
            )
        episode = ResetRequest(
            seed=max(values["seed"], 0),
            course=values["course"],
            speed_range=(values["speed"],) * 2 if values["speed"] else ResetRequest().speed_range,
            perturb=values["perturb"],
            preview=Preview(values["preview_by_time"], values["preview_interval"], values["preview_count"]),
            line=values["line"],
            progress=values["progress"],
        )
        return cls(
            simulator=simulator,
            episode=episode,
            speed=values["speed"],
            seed=values["seed"],
            mode=values["mode"],
            real_time_factor=values["real_time_factor"],
            command_timeout=values["command_timeout_s"],
            auto_reset=values["auto_reset"],
            frame_prefix=values["frame_prefix"],
            publish_clock=values["publish_clock"],
            publish_markers=values["publish_markers"],
            disturbances=load_disturbances(values["disturbances"]) if values["disturbances"] else None,
        )

    def request(self, simulator: Simulator) -> ResetRequest:
        """Return the request of the node's own episodes; also fills in what a reset leaves open.

        Raises:
            ValueError: an episode that cannot begin. FileNotFoundError: an unknown course.
        """
        request = self.episode if self.speed else simulator.at_own_speed(self.episode)
        simulator.check(request)
        return request


class SimNode(rclpy.node.Node):
    """One vehicle on one course behind topics and services."""

    def __init__(self) -> None:
        """Read the parameters and begin the first episode.

        Raises:
            ValueError: an invalid parameter. FileNotFoundError: an unknown vehicle or course.
        """
        super().__init__("sim_node", namespace=node_tools.NAMESPACE)
        self._settings = NodeSettings.from_parameters(node_tools.declare(self, SPECS))
        self._simulator = Simulator(self._settings.simulator, self._settings.disturbances)
        self._request = self._settings.request(self._simulator)
        warm_up(self._simulator, self._request)
        self._period = round(self._settings.simulator.control_period * NANOSECONDS)
        self._gate = CommandGate(lockstep=self._settings.mode == LOCKSTEP)
        self._reported = CommandCounts()
        self._reported_at = time.monotonic()
        self._steps = self._reported_steps = 0
        self._own_episodes = 0
        self._begin_stamp = FIRST_STAMP
        self._stamp = FIRST_STAMP - self._period
        self._paused = False
        self._waiting: Command | None = None
        self._seeds = np.random.default_rng()
        self._open_topics()
        self._begin(self._own_request())
        commands = self.create_subscription(BikeCommand, "command", self._on_command, node_tools.COMMAND_QOS, raw=True)
        self.streams = (commands,)
        self.create_service(Reset, "reset", self._on_reset)
        self.create_service(Pause, "pause", self._on_pause)
        node_tools.on_change(self, SPECS, self._on_parameters)
        node_tools.wall_timer(self, HOUSEKEEPING_PERIOD, self._on_housekeeping_timer)
        self._pace()
        self.get_logger().info(self._describe())

    def finish(self) -> None:
        """Report a last time and release the engine."""
        self._report()
        self._simulator.close()

    # ------------------------------------------------------------------------------------------------------- topics

    def _open_topics(self) -> None:
        stream, latched = node_tools.SENDER_QOS, node_tools.LATCHED_QOS

        def open_topic(kind: type, name: str, qos: QoSProfile) -> Publisher:
            return self.create_publisher(kind, name, qos, event_callbacks=node_tools.QUIET)

        self._state_topic = open_topic(BikeState, "state", stream)
        self._screen_topic = open_topic(BikeState, node_tools.SCREEN_STATE, node_tools.SCREEN_QOS)
        self._screened_at = 0.0
        self._clock_topic = open_topic(Clock, "/clock", stream) if self._settings.publish_clock else None
        self._start_topic = open_topic(EpisodeStart, "episode", latched)
        self._course_topic = open_topic(CourseMessage, "course", latched)
        self._course_marker_topic = open_topic(Marker, "course_marker", latched)
        self._event_topic = open_topic(RideEvent, "events", node_tools.EVENT_QOS)
        self._diagnostics = node_tools.Diagnostics(self)
        if self._settings.disturbances is not None:
            topic = open_topic(String, "disturbances", latched)
            topic.publish(String(data=self._settings.disturbances.to_text()))
        # Topics that are only made where someone listens: they cost more than the state itself.
        self._extras: list[tuple[Publisher, Callable[[Snapshot], Any]]] = []

        def extra(kind: type, name: str, make: Callable[[Snapshot], Any]) -> None:
            self._extras.append((open_topic(kind, name, stream), make))

        extra(CoursePoints, "course_points", lambda s: course_points_to_message(s, self._course, self._stamp))
        extra(LeanHistory, "lean_history", lambda s: lean_history_to_message(s, self._stamp, self._period))
        vehicle = self._simulator.vehicle
        if isinstance(vehicle, Superbike):
            extra(Telemetry, "telemetry", lambda s: telemetry_to_message(s, vehicle, self._stamp))
        extra(Odometry, "odom", lambda s: standard_messages.odometry(s, vehicle, self._stamp))
        # The same as on /tf, for viewers of recordings made where tf2_msgs is missing.
        transforms = open_topic(TransformStamped, "transform", stream)
        self._extras += [(transforms, self._stamped(make)) for make in standard_messages.TRANSFORMS]
        extra(JointState, "joint_states", lambda s: standard_messages.joint_state(s, vehicle, self._stamp))
        if self._settings.publish_markers:
            extra(MarkerArray, "markers", lambda s: standard_messages.vehicle_markers(s, vehicle, self._stamp))
        if TFMessage is not None:
            made = standard_messages.TRANSFORMS
            extra(TFMessage, "/tf", lambda s: TFMessage(transforms=[make(s, self._stamp) for make in made]))
        description = open_topic(String, "robot_description", latched)
        description.publish(String(data=standard_messages.robot_description(vehicle)))
        name = self.get_namespace().strip("/")
        self._prefix = self._settings.frame_prefix or ("" if name in ("", node_tools.NAMESPACE) else f"{name}/")

    def _stamped(self, make: Callable[[Snapshot, int], Any]) -> Callable[[Snapshot], Any]:
        return lambda snapshot: make(snapshot, self._stamp)

    @property
    def _course(self) -> Course:
        course = self._simulator.course
        assert course is not None, "the first episode has begun"
        return course

    def _show(self, snapshot: Snapshot) -> None:
        """Publish a state and all that goes with it."""
        self._snapshot = snapshot
        self._stamp = self._begin_stamp + snapshot.step * self._period
        self._state = encode_state(snapshot, self._episode, self._stamp)
        # The state first: the partner computes its answer while the rest is made.
        self._publish_state()
        for topic, make in self._extras:
            if topic.get_subscription_count():
                topic.publish(self._prefixed(make(snapshot)))

    def _prefixed(self, message: Any) -> Any:
        return standard_messages.set_prefix(message, self._prefix) if self._prefix else message

    def _publish_state(self) -> None:
        if self._clock_topic is not None and self._clock_topic.get_subscription_count():
            self._clock_topic.publish(Clock(clock=time_to_message(self._stamp)))
        self._state_topic.publish(self._state)
        self._published_at = time.monotonic()
        if self._published_at - self._screened_at > SCREEN_PERIOD:
            self._screened_at = self._published_at
            if self._screen_topic.get_subscription_count():
                self._screen_topic.publish(self._state)

    # ------------------------------------------------------------------------------------------------------ episodes

    def _own_request(self) -> ResetRequest:
        """Return the request for an episode that the node begins on its own."""
        first = self._settings.seed
        seed = first + self._own_episodes if first >= 0 else self._draw_seed()
        self._own_episodes += 1
        return replace(self._request, seed=seed)

    def _draw_seed(self) -> int:
        return int(self._seeds.integers(LARGEST_SEED))

    def _begin(self, request: ResetRequest) -> Snapshot:
        """Begin an episode; simulated time advances by one period.

        Raises:
            ValueError: a request that cannot be met; the current episode continues. FileNotFoundError: no such course.
        """
        snapshot = self._simulator.reset(request)
        config, course = self._simulator.config, self._simulator.course
        assert course is not None
        self._episode = Episode.of(self._simulator.vehicle, course, self._simulator.preview, config.control_period)
        self._begin_stamp = self._stamp + self._period
        self._hold: Command | None = None
        self._held_since = 0
        self._waiting = None
        names = self._simulator.plant.signal_names
        start = episode_start_to_message(request, config, names, snapshot.episode, self._begin_stamp)
        self._start_topic.publish(start)
        self._course_topic.publish(course_to_message(course, snapshot.episode, self._begin_stamp))
        if self._settings.publish_markers:
            marker = standard_messages.course_marker(course, self._begin_stamp)
            self._course_marker_topic.publish(self._prefixed(marker))
        for event in snapshot.events:
            self._event_topic.publish(event_to_message(event, snapshot, self._begin_stamp))
        self._show(snapshot)
        return snapshot

    def _advance(self, steering: float, throttle: float) -> None:
        """Simulate one control period and publish the result."""
        snapshot = self._simulator.step(steering, throttle)
        if snapshot.fall == DIVERGED:
            self.get_logger().error(f"the physics diverged in step {snapshot.step}; the episode ends as a fall")
        self._steps += 1
        self._show(snapshot)
        for event in snapshot.events:
            self._event_topic.publish(event_to_message(event, snapshot, self._stamp))
            self.get_logger().info(f"episode {snapshot.episode}, {event.time:.3f} s: {event.text}")
        if self._wants_new_episode(snapshot):
            self._begin(self._own_request())

    def _wants_new_episode(self, snapshot: Snapshot) -> bool:
        if snapshot.fallen:
            return self._settings.auto_reset in (FALL, END)
        return self._settings.auto_reset == END and (snapshot.off_course or snapshot.finished)

    # ------------------------------------------------------------------------------------------------------ commands

    def _on_command(self, message: bytes) -> None:
        snapshot, timeout = self._snapshot, self._settings.command_timeout
        oldest = oldest_step(snapshot.step, timeout, self._simulator.config.control_period)
        try:
            command = decode_command(message)
        except ValueError as error:
            self._gate.counts.refused += 1
            self.get_logger().error(f"a command cannot be read: {error}", once=True)
            return
        outcome, command = self._gate.check(command, snapshot.episode, snapshot.step, oldest)
        if outcome is Outcome.REPEATED:
            self._publish_state()
        elif outcome is Outcome.TAKEN and not snapshot.fallen:
            self._take(command)

    def _take(self, command: Command) -> None:
        if self._runs_by_itself:
            self._hold = command
            self._held_since = self._snapshot.step
        elif self._paused:
            self._waiting = command
        else:
            self._advance(command.steering, command.throttle)

    @property
    def _runs_by_itself(self) -> bool:
        return self._settings.mode != LOCKSTEP and self._settings.real_time_factor > 0.0

    def _pace(self) -> None:
        """Start the timer of free mode at the present real-time factor."""
        self._timer = None
        if self._runs_by_itself:
            period = self._simulator.config.control_period / self._settings.real_time_factor
            self._timer = node_tools.wall_timer(self, period, self._tick)

    def _tick(self) -> None:
        """Ride one control period of free mode with the command that is held."""
        if self._paused or self._hold is None or self._snapshot.fallen:
            return
        if self._is_silent:
            self._advance(0.0, 0.0)
        else:
            self._advance(self._hold.steering, self._hold.throttle)

    @property
    def _is_silent(self) -> bool:
        """Whether commands have stopped in free mode."""
        timeout = self._settings.command_timeout
        if not self._runs_by_itself or self._hold is None or timeout == 0.0:
            return False
        return (self._snapshot.step - self._held_since) * self._simulator.config.control_period > timeout - 1e-9

    # ------------------------------------------------------------------------------------- services and parameters

    def _on_reset(self, request: Reset.Request, response: Reset.Response) -> Reset.Response:
        try:
            if request.seed < 0:
                request.seed = self._draw_seed()
            self._begin(reset_from_message(request, self._request))
        except (ValueError, OSError) as error:
            response.message = " ".join(str(error).split())
            response.state = deserialize_message(self._state, BikeState)
            self.get_logger().warning(f"reset refused: {response.message}")
            return response
        response.success = True
        response.seed = request.seed
        response.state = deserialize_message(self._state, BikeState)
        return response

    def _on_pause(self, request: Pause.Request, response: Pause.Response) -> Pause.Response:
        self._paused = request.paused
        response.success = True
        response.message = f"{'paused' if self._paused else 'running'} at step {self._snapshot.step}"
        if not self._paused and self._waiting is not None:
            command, self._waiting = self._waiting, None
            self._advance(command.steering, command.throttle)
        return response

    def _on_parameters(self, values: dict[str, Any]) -> None:
        """Take changed parameters over: pace and safety at once, what describes an episode from the next one on."""
        settings = NodeSettings.from_parameters(values)
        self._request = settings.request(self._simulator)
        before, self._settings = self._settings, settings
        if self._settings.seed != before.seed:
            self._own_episodes = 0
        if self._settings.real_time_factor != before.real_time_factor:
            if self._timer is not None:
                self.destroy_timer(self._timer)
            self._pace()

    # ------------------------------------------------------------------------------------------------- housekeeping

    def _on_housekeeping_timer(self) -> None:
        now = time.monotonic()
        if now - self._published_at > REPEAT_AFTER:
            self._publish_state()
        if now - self._reported_at > REPORT_PERIOD - 0.5 * HOUSEKEEPING_PERIOD:
            self._report()

    def _name_rivals(self) -> str:
        """Return what is wrong where another node publishes what only this one may, else nothing."""
        if self.count_publishers("state") > 1:
            topic = self._state_topic.topic_name
            return f"another simulator, or one that was killed just now, publishes {topic}: give each its own namespace"
        if self._clock_topic is not None and self.count_publishers("/clock") > 1:
            return "another node publishes /clock: set publish_clock to false in all simulators but one"
        return ""

    def _report(self) -> None:
        """Report the last second on diagnostics and in the log."""
        now = time.monotonic()
        elapsed = max(now - self._reported_at, 1e-9)
        new = self._gate.counts.since(self._reported)
        rate = (self._steps - self._reported_steps) / elapsed
        complaints = [f"{getattr(new, name)} {name}" for name in ("refused", "clipped", "stale") if getattr(new, name)]
        text = f"commands in the last second: {', '.join(complaints)}" if complaints else self._doing()
        if self._is_silent:
            text = f"commands have stopped, steering is set straight; {text}"
        rivals = self._name_rivals()
        text = rivals or text
        level = self._diagnostics.WARN if complaints or self._is_silent or rivals else self._diagnostics.OK
        if level == self._diagnostics.WARN:
            self.get_logger().warning(text)
        counts = {f"commands_{name}": value for name, value in vars(self._gate.counts).items()}
        figures = {
            "mode": self._settings.mode,
            "episode": self._snapshot.episode,
            "step": self._snapshot.step,
            "control_steps": self._steps,
            "processor_time_s": f"{time.process_time():.6f}",
            "control_steps_per_s": rate,
            "real_time_factor": rate * self._simulator.config.control_period,
            **counts,
        }
        self._diagnostics.report(level, text, figures, self._stamp)
        self._reported, self._reported_at = replace(self._gate.counts), now
        self._reported_steps = self._steps

    def _doing(self) -> str:
        if self._snapshot.fallen:
            return "fallen, waiting for a reset"
        if self._paused:
            return "paused"
        return "running"

    def _describe(self) -> str:
        config, disturbed = self._simulator.config, self._settings.disturbances
        return (
            f"{config.vehicle} on course {self._course.name!r} ({self._course.length:.0f} m) at "
            f"{self._request.speed_range[0]:g} m/s, {config.engine} at {config.time_step * 1e3:g} ms, "
            f"a command every {config.control_period * 1e3:g} ms, {self._settings.mode}"
            + (f", disturbed by {disturbed.name}" if disturbed is not None else "")
        )


def oldest_step(step: int, timeout: float, control_period: float) -> int:
    """Return the oldest step that a command of free mode may answer.

    Args:
        step: the present one.
        timeout: largest age, s; 0 for as old as the episode.
        control_period: s.
    """
    if timeout == 0.0:
        return 0
    return step - round(min(timeout / control_period, step))


def warm_up(simulator: Simulator, request: ResetRequest) -> None:
    """Simulate an unpublished step: the first on a machine compiles the physics, longer than a policy would wait."""
    simulator.reset(request)
    simulator.step(0.0)
    simulator.episode = 0


def main() -> NoReturn:
    """Run the node until a signal; the exit code is 2 after an invalid parameter."""
    node_tools.leave(node_tools.run_node("sim_node", SimNode))


if __name__ == "__main__":
    main()
