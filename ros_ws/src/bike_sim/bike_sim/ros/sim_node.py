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
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NoReturn

import numpy as np
import rclpy.node
from bike_msgs.msg import BikeCommand, BikeState
from bike_msgs.srv import Pause, Reset
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from bike_sim.physics.engines import ENGINE_KINDS
from bike_sim.ros import node_tools
from bike_sim.ros.command_gate import Command, CommandGate, Outcome
from bike_sim.ros.messages import decode_command
from bike_sim.ros.node_tools import NANOSECONDS, ParameterSpec, time_to_message
from bike_sim.ros.ride_topics import RideTopics
from bike_sim.ros.sensor_topics import SensorTopics
from bike_sim.ros.topics import publisher
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.sensors import DATUM
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import DIVERGED, Snapshot
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

FIRST_STAMP: Final = NANOSECONDS
"""Simulated time of the first state, ns: nodes take a clock of 0 for one that has not begun."""

REPEAT_AFTER: Final = 0.4
"""Wall-clock time after which an unanswered state is published again, s. Looked at every HOUSEKEEPING_PERIOD."""

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
    ParameterSpec("latitude", DATUM[0], "Of the map's origin, for fix, deg.", fixed=True),
    ParameterSpec("longitude", DATUM[1], "Of the map's origin, for fix, deg.", fixed=True),
    ParameterSpec("publish_clock", True, "Publish /clock; false for all simulators of a domain but one.", fixed=True),
)


@dataclass(frozen=True)
class NodeSettings:
    """Checked parameters of the simulator node.

    Attributes:
        values: all of them, by name.
        simulator: settings of all episodes.
        episode: request of the node's own episodes, without the speed.
        disturbances: of what is ridden, or None.
    """

    values: Mapping[str, Any]
    simulator: SimulatorConfig
    episode: ResetRequest
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
        period = values["control_period"] or load_vehicle(values["vehicle"]).control_period
        own = {name: values[name] for name in ("vehicle", "engine", "time_step", "history")}
        simulator = SimulatorConfig(control_period=period, **own)
        slowest = simulator.control_period / MAX_STEP
        if 0.0 < values["real_time_factor"] < slowest:
            raise ValueError(
                f"parameter real_time_factor must be 0 or at least {slowest:.3g}, a control period an hour, "
                f"got {values['real_time_factor']!r}"
            )
        own = {name: values[name] for name in ("course", "perturb", "line", "progress")}
        episode = ResetRequest(
            seed=max(values["seed"], 0),
            speed_range=(values["speed"],) * 2 if values["speed"] else ResetRequest().speed_range,
            preview=Preview(values["preview_by_time"], values["preview_interval"], values["preview_count"]),
            **own,
        )
        disturbed = load_disturbances(values["disturbances"]) if values["disturbances"] else None
        return cls(values, simulator, episode, disturbed)

    def request(self, simulator: Simulator) -> ResetRequest:
        """Return the request of the node's own episodes; also fills in what a reset leaves open.

        Raises:
            ValueError: an episode that cannot begin. FileNotFoundError: an unknown course.
        """
        request = self.episode if self.values["speed"] else simulator.at_own_speed(self.episode)
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
        # An unpublished step: the first on a machine compiles the physics, longer than a policy would wait.
        self._simulator.reset(self._request)
        self._simulator.step(0.0)
        self._simulator.episode = 0
        self._period = round(self._settings.simulator.control_period * NANOSECONDS)
        self._gate = CommandGate(lockstep=self._settings.values["mode"] == LOCKSTEP)
        self._reported = self._gate.counts.copy()
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
        values = self._settings.values
        name = self.get_namespace().strip("/")
        prefix = values["frame_prefix"] or ("" if name in ("", node_tools.NAMESPACE) else f"{name}/")
        disturbances = self._settings.disturbances
        self._topics = RideTopics(self, self._simulator.plant, self._period, prefix=prefix, disturbances=disturbances)
        vehicle, datum = self._simulator.vehicle, (values["latitude"], values["longitude"])
        self._sensors = None
        if not isinstance(vehicle, Superbike):
            self._sensors = SensorTopics(self, vehicle, disturbances or Disturbances(), self._period, datum, prefix)
        self._clock_topic = publisher(self, "/clock") if values["publish_clock"] else None
        self._diagnostics = node_tools.Diagnostics(self)

    def _show(self, snapshot: Snapshot) -> None:
        """Publish a state and all that goes with it."""
        self._snapshot = snapshot
        self._stamp = self._begin_stamp + snapshot.step * self._period
        self._topics.take(snapshot, self._stamp)
        # The state first: the partner computes its answer while the rest is made.
        if self._sensors is not None:
            self._sensors.take(snapshot, self._stamp)
        self._publish_state()
        self._topics.publish_extras()

    def _publish_state(self) -> None:
        if self._clock_topic is not None and self._clock_topic.get_subscription_count():
            self._clock_topic.publish(Clock(clock=time_to_message(self._stamp)))
        self._topics.publish_state()
        if self._sensors is not None:
            self._sensors.publish()

    # ------------------------------------------------------------------------------------------------------ episodes

    def _own_request(self) -> ResetRequest:
        """Return the request for an episode that the node begins on its own."""
        first = self._settings.values["seed"]
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
        self._begin_stamp = self._stamp + self._period
        self._hold: Command | None = None
        self._held_since = 0
        self._waiting = None
        self._topics.begin(snapshot, request, config, course, self._simulator.preview, self._begin_stamp)
        if self._sensors is not None:
            self._sensors.begin(snapshot, self._begin_stamp)
        self._show(snapshot)
        return snapshot

    def _advance(self, steering: float, throttle: float) -> None:
        """Simulate one control period and publish the result."""
        snapshot = self._simulator.step(steering, throttle)
        if snapshot.fall == DIVERGED:
            self.get_logger().error(f"the physics diverged in step {snapshot.step}; the episode ends as a fall")
        self._steps += 1
        self._show(snapshot)
        self._topics.publish_events(snapshot, self._stamp)
        for event in snapshot.events:
            self.get_logger().info(f"episode {snapshot.episode}, {event.time:.3f} s: {event.text}")
        if self._wants_new_episode(snapshot):
            self._begin(self._own_request())

    def _wants_new_episode(self, snapshot: Snapshot) -> bool:
        when = self._settings.values["auto_reset"]
        return when != NEVER and (snapshot.fallen or (when == END and (snapshot.off_course or snapshot.finished)))

    # ------------------------------------------------------------------------------------------------------ commands

    def _on_command(self, message: bytes) -> None:
        snapshot, timeout = self._snapshot, self._settings.values["command_timeout_s"]
        oldest = oldest_step(snapshot.step, timeout, self._simulator.config.control_period)
        try:
            command = decode_command(message)
        except ValueError as error:
            self._gate.counts[Outcome.REFUSED] += 1
            self.get_logger().error(f"a command cannot be read: {error}", once=True)
            return
        outcome, command = self._gate.check(command, snapshot.episode, snapshot.step, oldest)
        if outcome is Outcome.REPEATED:
            self._publish_state()
        elif outcome is Outcome.TAKEN and not snapshot.fallen:
            if self._runs_by_itself:
                self._hold, self._held_since = command, snapshot.step
            elif self._paused:
                self._waiting = command
            else:
                self._advance(command.steering, command.throttle)

    @property
    def _runs_by_itself(self) -> bool:
        return self._settings.values["mode"] != LOCKSTEP and self._settings.values["real_time_factor"] > 0.0

    def _pace(self) -> None:
        """Start the timer of free mode at the present real-time factor."""
        self._timer = None
        if self._runs_by_itself:
            period = self._simulator.config.control_period / self._settings.values["real_time_factor"]
            self._timer = node_tools.wall_timer(self, period, self._tick)

    def _tick(self) -> None:
        """Ride one control period of free mode with the command that is held."""
        if self._paused or self._hold is None or self._snapshot.fallen:
            return
        self._advance(*((0.0, 0.0) if self._is_silent else (self._hold.steering, self._hold.throttle)))

    @property
    def _is_silent(self) -> bool:
        """Whether commands have stopped in free mode."""
        timeout = self._settings.values["command_timeout_s"]
        if not self._runs_by_itself or self._hold is None or timeout == 0.0:
            return False
        return (self._snapshot.step - self._held_since) * self._simulator.config.control_period > timeout - 1e-9

    # ------------------------------------------------------------------------------------- services and parameters

    def _on_reset(self, request: Reset.Request, response: Reset.Response) -> Reset.Response:
        try:
            if request.seed < 0:
                request.seed = self._draw_seed()
            self._begin(ResetRequest.from_message(request, self._request))
            response.success, response.seed = True, request.seed
        except (ValueError, OSError) as error:
            response.message = " ".join(str(error).split())
            self.get_logger().warning(f"reset refused: {response.message}")
        response.state = deserialize_message(self._topics.state, BikeState)
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
        changed = {name for name, value in settings.values.items() if value != before.values[name]}
        if "seed" in changed:
            self._own_episodes = 0
        if "real_time_factor" in changed:
            if self._timer is not None:
                self.destroy_timer(self._timer)
            self._pace()

    # ------------------------------------------------------------------------------------------------- housekeeping

    def _on_housekeeping_timer(self) -> None:
        now = time.monotonic()
        if now - self._topics.published_at > REPEAT_AFTER:
            self._publish_state()
        if now - self._reported_at > REPORT_PERIOD - 0.5 * HOUSEKEEPING_PERIOD:
            self._report()

    def _name_rivals(self) -> str:
        """Return what is wrong where another node publishes what only this one may, else nothing."""
        if self.count_publishers("state") > 1:
            topic = self._topics.state_topic
            return f"another simulator, or one that was killed just now, publishes {topic}: give each its own namespace"
        if self._clock_topic is not None and self.count_publishers("/clock") > 1:
            return "another node publishes /clock: set publish_clock to false in all simulators but one"
        return ""

    def _report(self) -> None:
        """Report the last second on diagnostics and in the log."""
        now = time.monotonic()
        elapsed = max(now - self._reported_at, 1e-9)
        new = self._gate.counts - self._reported
        rate = (self._steps - self._reported_steps) / elapsed
        complaints = [f"{new[name]} {name}" for name in (Outcome.REFUSED, Outcome.CLIPPED, Outcome.STALE) if new[name]]
        doing = "fallen, waiting for a reset" if self._snapshot.fallen else "paused" if self._paused else "running"
        text = f"commands in the last second: {', '.join(complaints)}" if complaints else doing
        if self._is_silent:
            text = f"commands have stopped, steering is set straight; {text}"
        rivals = self._name_rivals()
        text = rivals or text
        level = self._diagnostics.WARN if complaints or self._is_silent or rivals else self._diagnostics.OK
        if level == self._diagnostics.WARN:
            self.get_logger().warning(text)
        counts = {f"commands_{name}": value for name, value in self._gate.counts.items()}
        figures = {
            "mode": self._settings.values["mode"],
            "episode": self._snapshot.episode,
            "step": self._snapshot.step,
            "control_steps": self._steps,
            "processor_time_s": f"{time.process_time():.6f}",
            "control_steps_per_s": rate,
            "real_time_factor": rate * self._simulator.config.control_period,
            **counts,
        }
        self._diagnostics.report(level, text, figures, self._stamp)
        self._reported, self._reported_at = self._gate.counts.copy(), now
        self._reported_steps = self._steps

    def _describe(self) -> str:
        config, disturbed, course = self._simulator.config, self._settings.disturbances, self._simulator.course
        assert course is not None, "the first episode has begun"
        return (
            f"{config.vehicle} on course {course.name!r} ({course.length:.0f} m) at "
            f"{self._request.speed_range[0]:g} m/s, {config.engine} at {config.time_step * 1e3:g} ms, "
            f"a command every {config.control_period * 1e3:g} ms, {self._settings.values['mode']}"
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


def main() -> NoReturn:
    """Run the node until a signal; the exit code is 2 after an invalid parameter."""
    node_tools.leave(node_tools.run_node("sim_node", SimNode))


if __name__ == "__main__":
    main()
