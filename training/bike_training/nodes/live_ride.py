"""A ride that people watch and steer: a simulator node in lockstep at the pace of the clock, recorded as any other."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from bike_analysis.read.messages import Simulation
from bike_policy.riders.rider import Rider
from bike_policy.riders.stanley import HANDS, ManualRider
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.superbike_plant import SuperbikePlant
from bike_sim.vehicles.superbike import Superbike
from bike_training.envs.node_process import NodeProcess
from bike_training.envs.ros_client import RosClient
from bike_training.nodes.live_messages import event_message, places_of, state_values
from bike_training.nodes.live_thread import LiveThread
from bike_training.nodes.ride_monitor import START_TIMEOUT, RideMonitor

HELD: Final = 0.5
"""Wall-clock time for which a wish holds, s: who is cut off rides straight on with closed throttle."""
BEHIND: Final = 0.25
"""Delay beyond which the ride does not try to catch up with the clock, s."""
FRAME: Final = 1.0 / 75.0
"""Least wall-clock time between two states that are told, s: no screen shows more, and a fast ride is not held up."""
IDLE: Final = 0.02
"""Time between two looks at the requests while nothing moves, s."""


@dataclass(frozen=True)
class LiveSettings:
    """What is ridden.

    Attributes:
        config: of the simulator.
        request: with which each episode begins.
        rider: the computer's rider.
        recording: file to write, or None.
    """

    config: SimulatorConfig
    request: ResetRequest
    rider: Rider
    recording: Path | None = None


class LiveRide(LiveThread):
    """Rides until `end`."""

    thread_name = "live ride"

    def __init__(self, settings: LiveSettings, tell: Callable[[dict[str, Any]], None]) -> None:
        """Prepare a ride.

        Args:
            settings: what is ridden.
            tell: called from the ride's thread with each message for the page.
        """
        super().__init__(tell)
        config = settings.config
        self.settings = (config.control_period, Simulation(config.engine, config.time_step))
        self._settings = settings
        self._hands = ManualRider()
        self._by_hand = False
        self._paused = False
        self._steps_asked = 0
        self._pace = 1.0
        self._wished_at = self._told_at = 0.0

    # ------------------------------------------------------------------------------------------------ in its own thread

    def _live(self) -> None:
        with ExitStack() as opened:
            client = opened.enter_context(RosClient(self._settings.config))
            self.domain_id = client.domain_id
            self._begin(client)  # before it is recorded: a new node stands at the beginning of some other course
            recorder = self._record(opened, client)
            self._begun.set()
            self._ride(client)
            if recorder is not None:
                recorder.finish()

    def _record(self, opened: ExitStack, client: RosClient) -> NodeProcess | None:
        path = self._settings.recording
        if path is None:
            return None
        notes = [f"policy={HANDS} and {self._settings.rider.name}", f"circuit={self._settings.request.course}"]
        record = {"path": str(path.resolve()), "overwrite": True, "notes": notes}
        recorder = opened.enter_context(NodeProcess("bike_sim.ros.record", record, client.domain_id))
        with RideMonitor(client.domain_id) as monitor:
            monitor.wait_for_recorder(START_TIMEOUT, [recorder], ("state", "episode", "course"))
        return recorder

    def _begin(self, client: RosClient) -> None:
        self._snapshot = client.reset(self._settings.request)
        self.course = client.course
        assert self.course is not None
        self._places = places_of(SuperbikePlant.signal_names if isinstance(client.vehicle, Superbike) else ())
        for rider in (self._settings.rider, self._hands):
            self._prepare(client, rider)
        self._tell({"reset": True})
        self._show()

    def _prepare(self, client: RosClient, rider: Rider) -> None:
        assert self.course is not None
        rider.begin(client.vehicle, self.course, self._settings.config.control_period, client.preview)

    def _ride(self, client: RosClient) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            hands = self._by_hand
            reset = self._obey()
            if reset:
                self._begin(client)
            elif hands != self._by_hand:  # who takes over has seen none of what the other did
                self._prepare(client, self._hands if self._by_hand else self._settings.rider)
            if not self._moves():
                self._ended.wait(IDLE)
                due = time.monotonic()
                continue
            self._steps_asked = max(self._steps_asked - 1, 0)
            self._snapshot = client.step(*self._command())
            self._show()
            due += self._settings.config.control_period / self._pace
            left = due - time.monotonic()
            if left > 0.0:
                self._ended.wait(left)
            elif left < -BEHIND:
                due = time.monotonic()

    def _moves(self) -> bool:
        over = self._snapshot.fallen or (self._snapshot.finished and not getattr(self.course, "closed", False))
        return not over and (not self._paused or self._steps_asked > 0)

    def _obey(self) -> bool:
        """Do what was asked for; whether a new episode is."""
        reset = False
        for request in self._asked():
            kind = request["type"]
            if kind == "input":
                self._hands.steering, self._hands.throttle = request["steering"], request["throttle"]
                self._wished_at = time.monotonic()
                continue
            if kind == "pause":
                self._paused = request["on"]
            elif kind == "step":
                self._steps_asked += 1
            elif kind == "pace":
                self._pace = request["factor"]
            elif kind == "rider":
                self._by_hand, self._hands.balances = request["hands"], request["balance"]
            reset = reset or kind == "reset"
            self._tell(self.status())
        return reset

    def status(self) -> dict[str, Any]:
        """How the ride goes on, for the page."""
        return {
            "status": {
                "paused": self._paused,
                "pace": self._pace,
                "hands": self._by_hand,
                "balance": self._hands.balances,
            }
        }

    def _command(self) -> tuple[float, float]:
        if self._by_hand:
            if time.monotonic() - self._wished_at > HELD:
                self._hands.steering = self._hands.throttle = 0.0
            return self._hands.command(self._snapshot) or (0.0, 0.0)
        return self._settings.rider.command(self._snapshot) or (0.0, 0.0)

    def _show(self) -> None:
        snapshot = self._snapshot
        now = time.monotonic()
        if now - self._told_at >= FRAME or snapshot.events or not snapshot.step:
            self._told_at = now
            self._tell({"state": state_values(snapshot, self._places), "sent": round(1e3 * time.time(), 2)})
        for event in snapshot.events:
            self._tell(event_message(event.kind, event.text, event.value))
