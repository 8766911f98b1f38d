"""A race as a ROS 2 node: machines on one circuit, each in a namespace of its own and driven by a node of its own.

A machine ``a`` has the topics of `bike_sim.ros.sim_node` below ``/a``, and ``/a/opponents`` besides: what it sees of
the others. ``bike_policy drive`` and ``joy`` drive it with ``-r __ns:=/a``. What happens between machines is published
as JSON in the node's own namespace, on ``events``, ``standings`` and ``result``.

In lockstep time stands still until the commands of all machines that ride answer their last states. A machine whose
commands stop, because its node died, is waited for only for a while; then it rolls out, straight on with closed
throttle, and the others race on. Its commands count again as soon as they come. Before its first command a machine is
waited for as long as it takes. In free mode time runs by itself from the moment on at which each has sent one.
"""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NoReturn

import numpy as np
import rclpy.node
from bike_msgs.msg import BikeCommand
from bike_msgs.srv import Pause
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from bike_sim.ros import node_tools
from bike_sim.ros.command_gate import Command, CommandGate, Outcome
from bike_sim.ros.messages import decode_command
from bike_sim.ros.node_tools import NANOSECONDS, ParameterSpec, time_to_message
from bike_sim.ros.ride_topics import RideTopics
from bike_sim.ros.sim_node import FIRST_STAMP, FREE, HOUSEKEEPING_PERIOD, LOCKSTEP, REPEAT_AFTER, REPORT_PERIOD
from bike_sim.ros.sim_node import SPECS as SIMULATOR_SPECS
from bike_sim.ros.topics import publisher
from bike_sim.sim.race import Race, RaceEvent, RaceSettings, check_names, entries_of
from bike_sim.sim.simulator import RowSnapshots
from bike_sim.sim.snapshot import Snapshot

NAMESPACE: Final = "race"
"""Namespace of what happens between machines, unless ``__ns`` is remapped."""

TIMEOUTS: Final = {LOCKSTEP: 10.0, FREE: 0.5}
"""Time without a command after which a machine rolls out, s; a busy machine answers late in lockstep."""

SPECS: Final = (
    ParameterSpec(
        "machines",
        (),
        "Machines in the order of the grid, each NAME=VEHICLE or VEHICLE; those without a name are bike_1 and so on.",
        fixed=True,
    ),
    ParameterSpec("laps", 2, "Laps of the race.", fixed=True),
    ParameterSpec("course", "barcelona", "Shipped circuit, or path of its file.", fixed=True),
    ParameterSpec("line", 1.0, "Line that is followed, 0 the median, 1 the ideal line.", fixed=True),
    next(spec for spec in SIMULATOR_SPECS if spec.name == "mode"),
    ParameterSpec("real_time_factor", 1.0, "Free mode: simulated over wall-clock time, above 0.", fixed=True),
    ParameterSpec(
        "command_timeout_s",
        0.0,
        "Time without a command after which a machine rolls out, s: of the clock in lockstep, simulated in free mode; "
        "0: 10 in lockstep, 0.5 in free mode.",
        fixed=True,
    ),
    ParameterSpec("publish_clock", True, "Publish /clock; false for all simulators of a domain but one.", fixed=True),
)


@dataclass
class Driver:
    """Who drives a machine.

    Attributes:
        gate: judges its commands.
        topics: of the machine.
        shown: its snapshots.
        command: that counts in the next step; None where it has not come.
        heard: wall-clock time of the last one, s; None before the first.
        heard_step: step that it answered.
        lost: whether the race goes on without it.
    """

    gate: CommandGate
    topics: RideTopics
    shown: RowSnapshots
    command: Command | None = None
    heard: float | None = None
    heard_step: int = 0
    lost: bool = False


class RaceNode(rclpy.node.Node):
    """A race behind topics.

    Attributes:
        episode: number of the race, that of the episodes of all machines.
        streams: subscriptions to commands.
    """

    def __init__(self) -> None:
        """Read the parameters and place the machines on the grid.

        Raises:
            ValueError: what is no race, or an invalid parameter. FileNotFoundError: an unknown vehicle or circuit.
        """
        super().__init__("race_node", namespace=NAMESPACE)
        values = self._values = node_tools.declare(self, SPECS)
        settings = settings_of(values)
        self._names = [entry.name for entry in settings.entries]
        self._race = Race(settings, lambda part: self.get_logger().info(part))
        self._warm_up()
        batch = self._race.batch
        self._lockstep = values["mode"] == LOCKSTEP
        self._timeout = values["command_timeout_s"] or TIMEOUTS[values["mode"]]
        self._period = round(batch.config.control_period * NANOSECONDS)
        self._stamp = FIRST_STAMP - self._period
        self._clock_topic = publisher(self, "/clock") if values["publish_clock"] else None
        self._events, self._result, self._standings, self._settings_topic = (
            self.create_publisher(String, name, qos, event_callbacks=node_tools.QUIET)
            for name, qos in (
                ("events", node_tools.EVENT_QOS), ("result", node_tools.LATCHED_QOS),
                ("standings", node_tools.LATCHED_QOS), ("settings", node_tools.LATCHED_QOS),
            )
        )  # fmt: skip
        self._settings_topic.publish(String(data=json.dumps(settings.to_card())))
        self._drivers = [
            Driver(
                CommandGate(self._lockstep),
                RideTopics(self, batch.plant(row), self._period, f"/{name}", f"{name}/", races=True),
                RowSnapshots(batch, row),
            )
            for row, name in enumerate(self._names)
        ]
        self._diagnostics = node_tools.Diagnostics(self)
        self._reported_at, self._steps, self._reported_steps = time.monotonic(), 0, 0
        self.episode, self._paused = 1, False
        self._begin()
        self.streams = tuple(
            self.create_subscription(
                BikeCommand, f"/{name}/command", self._taker(row), node_tools.COMMAND_QOS, raw=True
            )
            for row, name in enumerate(self._names)
        )
        self.create_service(Pause, "pause", self._on_pause)
        node_tools.on_change(self, SPECS, lambda values: None)
        node_tools.wall_timer(self, HOUSEKEEPING_PERIOD, self._on_housekeeping_timer)
        if not self._lockstep:
            node_tools.wall_timer(self, batch.config.control_period / values["real_time_factor"], self._tick)
        self.get_logger().info(
            f"{len(self._names)} machines on {settings.course}, {settings.laps} laps, {values['mode']}: "
            + ", ".join(self._names)
        )

    def finish(self) -> None:
        """Report a last time and release the engines."""
        self._report()
        self._race.close()

    def _warm_up(self) -> None:
        """Take an unpublished step: the first on a machine compiles the physics, longer than a rider would wait."""
        self._race.step(np.zeros((self._race.count, 2)))
        self._race.begin()

    # ---------------------------------------------------------------------------------------------------------- race

    def _begin(self) -> None:
        """Begin the race; simulated time advances by one period."""
        race, batch = self._race, self._race.batch
        race.begin()
        self._begin_stamp = self._stamp + self._period
        self._told_standings: list[int] = []
        snapshots: list[Snapshot] = []
        for row, driver in enumerate(self._drivers):
            batch.episodes[row] = self.episode
            driver.command, driver.heard, driver.lost = None, None, False
            config, request = replace(batch.config, vehicle=batch.vehicles[row].name), batch.request(row)
            assert request is not None, "the machine is on the grid"
            snapshots.append(driver.shown.begin())
            driver.topics.begin(snapshots[-1], request, config, batch.course(row), batch.preview, self._begin_stamp)
        self._show(snapshots)

    def _show(self, snapshots: list[Snapshot]) -> None:
        """Publish the states of all machines."""
        self._stamp = self._begin_stamp + self._race.step_number * self._period
        self._published_at = time.monotonic()
        for driver, snapshot in zip(self._drivers, snapshots, strict=True):
            driver.topics.take(snapshot, self._stamp)
        self._publish()
        for driver, snapshot in zip(self._drivers, snapshots, strict=True):
            driver.topics.publish_extras()
            driver.topics.publish_events(snapshot, self._stamp)

    def _publish(self) -> None:
        if self._clock_topic is not None and self._clock_topic.get_subscription_count():
            self._clock_topic.publish(Clock(clock=time_to_message(self._stamp)))
        for driver in self._drivers:
            driver.topics.publish_state()

    def _advance(self) -> None:
        """Ride one control period with the commands that have come."""
        race = self._race
        pairs = [(d.command.steering, d.command.throttle) if d.command else (0.0, 0.0) for d in self._drivers]
        events = race.step(np.array(pairs))
        self._steps += 1
        if self._lockstep:
            for driver in self._drivers:
                driver.command = None
        step = race.step_number
        self._show([driver.shown.take(step, *pair) for driver, pair in zip(self._drivers, pairs, strict=True)])
        self._tell(events)

    def _tell(self, events: list[RaceEvent]) -> None:
        """Publish what happened between the machines, who is where, and at the end the result."""
        for event in events:
            self._events.publish(String(data=json.dumps(event._asdict())))
            self.get_logger().info(f"{event.time:.2f} s: {event.text}")
        order = self._race.positions()
        if order != self._told_standings:
            self._told_standings = order
            places = {"time": self._race.time, "order": [self._names[row] for row in order]}
            self._standings.publish(String(data=json.dumps(places)))
        if self._race.over and (events or self._race.time >= self._race.limit):
            lines = [line._asdict() for line in self._race.classification()]
            result = {"classification": lines, "gaps": self._race.gaps(), "contact_energy_j": self._race.energy}
            self._result.publish(String(data=json.dumps(result)))

    # ------------------------------------------------------------------------------------------------------ commands

    def _taker(self, row: int) -> Any:
        return lambda message: self._on_command(row, message)

    def _on_command(self, row: int, message: bytes) -> None:
        driver, race = self._drivers[row], self._race
        try:
            command = decode_command(message)
        except ValueError as error:
            driver.gate.counts[Outcome.REFUSED] += 1
            self.get_logger().error(f"a command of {self._names[row]} cannot be read: {error}", once=True)
            return
        oldest = max(race.step_number - round(self._timeout / self._control_period), 0)
        outcome, command = driver.gate.check(command, self.episode, race.step_number, oldest)
        if outcome is Outcome.REPEATED and not driver.command:
            driver.topics.publish_state()
        if outcome in (Outcome.TAKEN, Outcome.REPEATED, Outcome.STALE) and command.episode == self.episode:
            driver.heard = time.monotonic()
            if driver.lost:
                driver.lost = False
                self.get_logger().info(f"{self._names[row]} is driven again")
        if outcome is Outcome.TAKEN:
            driver.command, driver.heard_step = command, race.step_number
            if self._lockstep:
                self._go_on()

    @property
    def _control_period(self) -> float:
        return self._race.batch.config.control_period

    def _waited_for(self) -> list[int]:
        """Return the machines that ride, whose commands are missing and that are not lost."""
        up = ~self._race.batch.fallen  # who has finished rides on until the race is over
        return [row for row, d in enumerate(self._drivers) if up[row] and not d.lost and d.command is None]

    def _go_on(self) -> None:
        """Advance in lockstep where nobody is waited for."""
        if not self._race.over and not self._paused and not self._waited_for():
            self._advance()

    def _tick(self) -> None:
        """Ride one control period of free mode."""
        race = self._race
        if race.over or self._paused or any(driver.heard is None for driver in self._drivers):
            return
        for row, driver in enumerate(self._drivers):
            silent = (race.step_number - driver.heard_step) * self._control_period
            if silent > self._timeout + 1e-9 and not driver.lost:
                self._lose(row)
        self._advance()

    def _lose(self, row: int) -> None:
        driver = self._drivers[row]
        driver.lost, driver.command = True, None
        if self._race.riding[row]:
            self.get_logger().warning(f"commands of {self._names[row]} have stopped: it rolls out")

    # ------------------------------------------------------------------------------------------------- housekeeping

    def _on_pause(self, request: Pause.Request, response: Pause.Response) -> Pause.Response:
        self._paused = request.paused
        response.success = True
        response.message = f"{'paused' if self._paused else 'running'} at step {self._race.step_number}"
        self._published_at = time.monotonic()
        if self._lockstep:
            self._go_on()
        return response

    def _on_housekeeping_timer(self) -> None:
        now = time.monotonic()
        if self._lockstep and not self._race.over and not self._paused:
            for row in self._waited_for():
                heard = self._drivers[row].heard
                if heard is not None and now - max(heard, self._published_at) > self._timeout:
                    self._lose(row)
            self._go_on()
        if now - max(driver.topics.published_at for driver in self._drivers) > REPEAT_AFTER:
            self._publish()
        if now - self._reported_at > REPORT_PERIOD - 0.5 * HOUSEKEEPING_PERIOD:
            self._report()

    def _report(self) -> None:
        """Report the last second on diagnostics."""
        now, race = time.monotonic(), self._race
        rate = (self._steps - self._reported_steps) / max(now - self._reported_at, 1e-9)
        riding = race.riding
        rivals = [
            f"another node publishes {driver.topics.state_topic}: give each machine its own name"
            for name, driver in zip(self._names, self._drivers, strict=True)
            if self.count_publishers(f"/{name}/state") > 1
        ]
        absent = [name for row, name in enumerate(self._names) if riding[row] and self._drivers[row].heard is None]
        lost = [name for row, name in enumerate(self._names) if riding[row] and self._drivers[row].lost]
        text = "the race is over" if race.over else "racing"
        if absent:
            text = f"waiting for the first commands of {', '.join(absent)}"
        if lost:
            text = f"rolling out, for commands have stopped: {', '.join(lost)}"
        text = rivals[0] if rivals else text
        counts = Counter({outcome: sum(d.gate.counts[outcome] for d in self._drivers) for outcome in Outcome})
        figures = {
            "mode": self._values["mode"],
            "episode": self.episode,
            "step": race.step_number,
            "control_steps": self._steps,
            "processor_time_s": f"{time.process_time():.6f}",
            "control_steps_per_s": rate,
            "real_time_factor": rate * self._control_period,
            **{f"commands_{name}": value for name, value in counts.items()},
        }
        level = self._diagnostics.WARN if lost or rivals else self._diagnostics.OK
        if rivals:
            self.get_logger().warning(text)
        self._diagnostics.report(level, text, figures, self._stamp)
        self._reported_at, self._reported_steps = now, self._steps


def settings_of(values: Mapping[str, Any]) -> RaceSettings:
    """Return the race of checked parameters.

    Raises:
        ValueError: what is no race, or a value that is wrong.
    """
    if not 0.0 < values["real_time_factor"] < math.inf:
        raise ValueError(f"parameter real_time_factor must be positive, got {values['real_time_factor']!r}")
    if not 0.0 <= values["command_timeout_s"] < math.inf:
        raise ValueError(f"parameter command_timeout_s must not be negative, got {values['command_timeout_s']!r}")
    if not values["machines"]:
        raise ValueError("parameter machines names the machines of the race, as in machines:=\"['a=r1', 'b=zx10rr']\"")
    entries = entries_of(values["machines"])
    check_names([entry.name for entry in entries])
    return RaceSettings(values["course"], values["laps"], entries, values["line"])


def main() -> NoReturn:
    """Run the node until a signal; the exit code is 2 after an invalid parameter."""
    node_tools.leave(node_tools.run_node("race_node", RaceNode))


if __name__ == "__main__":
    main()
