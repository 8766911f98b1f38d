"""Watches a simulator that somebody else started and rides, for the same page as a live ride.

It takes only those states that a screen can show, from a topic of its own: the simulator is spared the sending of all
others. It never sends a command: pause and restart go through the simulator's services, which any node may call.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from bike_msgs.msg import BikeState, EpisodeStart, RideEvent
from bike_msgs.msg import Course as CourseMessage
from bike_msgs.srv import Pause, Reset

from bike_analysis.read.messages import Simulation
from bike_sim.course.course import Course
from bike_sim.ros import messages, node_tools
from bike_sim.ros.node_tools import GuestNode
from bike_sim.ros.subscriptions import RawSubscription, subscribe
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.files import load_vehicle
from bike_training.envs.node_process import NodeLost
from bike_training.nodes.live_ride import LiveThread, event_message, places_of, state_values

PERIOD: Final = 1.0 / 30.0
"""Wall-clock time between two visits to the states, s; each sends at most one."""
START_TIMEOUT: Final = 30.0
"""Longest wait for a simulator, s."""
GONE_AFTER: Final = 2.0
"""Wall-clock time without a state after which the simulator is looked for, s: one that waits repeats its last state."""
POSSIBLE: Final = ("pause", "reset")
"""Requests of the page that a watcher can pass on."""


class LiveWatch(LiveThread):
    """Tells about the rides of a simulator until `end`, which goes on; one that is started again is found again.

    Attributes:
        machine: name of the vehicle.
        powered: whether it has throttle and brake.
    """

    thread_name = "live watch"
    machine = ""
    powered = False

    def __init__(self, domain_id: int, namespace: str, report: Callable[[dict[str, Any]], None]) -> None:
        """Prepare to watch.

        Args:
            domain_id: ROS domain of the simulator.
            namespace: of its topics.
            report: called from the watcher's thread with each message for the page. ``{"course": True}`` says that the
                page was made for another course than that of the states that follow.
        """
        super().__init__(report)
        self.domain_id = domain_id
        self.namespace = f"/{namespace.strip('/')}"
        self._start: EpisodeStart | None = None
        self._course_message: CourseMessage | None = None
        self._events: list[RideEvent] = []
        self._latest: tuple[int, bytes] | None = None  # wall-clock time of its publication, ns
        self._shown: tuple[int, int] | None = None
        self._paused = self._gone = False
        self._heard_at = 0.0

    def ask(self, request: dict[str, Any]) -> None:
        """Put in a request, checked by `checked_request`; one that a watcher cannot pass on does nothing."""
        if request["type"] in POSSIBLE:
            super().ask(request)

    def status(self) -> dict[str, Any]:
        """Description of the ride for the page."""
        return {"status": {"paused": self._paused, "pace": 1.0, "hands": False, "balance": True}}

    # ------------------------------------------------------------------------------------------------ in its own thread

    def _live(self) -> None:
        node = GuestNode("live_watch", self.domain_id, self.namespace)
        # Before the subscriptions: a matched simulator knows where to send its answers; earlier ones are dropped.
        self._pause_service = node.create_client(Pause, "pause")
        self._reset_service = node.create_client(Reset, "reset")
        subscribe(node, EpisodeStart, "episode", partial(setattr, self, "_start"), node_tools.LATCHED_QOS)
        subscribe(node, CourseMessage, "course", partial(setattr, self, "_course_message"), node_tools.LATCHED_QOS)
        subscribe(node, RideEvent, "events", self._events.append, node_tools.EVENT_QOS)
        states = RawSubscription(node, BikeState, node_tools.SCREEN_STATE, node_tools.SCREEN_QOS)
        try:
            self._find(node, states)
            self._begun.set()
            while not self._ended.wait(PERIOD):
                node.spin_once(0.0)
                self._take(states)
                self._pass_on(node)
                self._obey()
        finally:
            states.close()
            node.close()

    def _find(self, node: GuestNode, states: RawSubscription) -> None:
        until = time.monotonic() + START_TIMEOUT
        while not self._ready():
            node.spin_once(PERIOD)
            self._take(states)
            if self._ended.is_set() or time.monotonic() > until:
                raise NodeLost(
                    f"no simulator at {self.namespace} in ROS domain {self.domain_id} within {START_TIMEOUT:g} s; "
                    "is it running, and is this its domain and namespace?"
                )
        self._enter()

    def _ready(self) -> bool:
        """Whether the present episode's start, course and a state of it are there."""
        if self._start is None or self._course_message is None or self._latest is None:
            return False
        return self._start.episode == self._course_message.episode

    def _enter(self) -> None:
        """Take over the course and the vehicle of the present episode."""
        assert self._start is not None
        self.course = messages.course_from_message(self._course_message)
        self.settings = (self._start.control_period, Simulation(self._start.engine, self._start.time_step))
        self.powered = bool(self._start.signal_names)
        self._places = places_of(self._start.signal_names)
        try:
            self.machine = load_vehicle(self._start.vehicle).name
        except (FileNotFoundError, ValueError):  # a file of the simulator's that is not readable from here
            self.machine = Path(self._start.vehicle).stem

    def _take(self, states: RawSubscription) -> None:
        taken: list[tuple[int, Any, bytes]] = []
        states.take(taken, None, 1)
        if taken:
            self._latest, self._heard_at = (taken[-1][0], taken[-1][2]), time.monotonic()

    def _pass_on(self, node: GuestNode) -> None:
        """Send the newest state and all events; a lockstep that waits repeats a state, which is sent once."""
        now = time.monotonic()
        self._look_for(node, now)
        if self._latest is not None and self._ready():
            sent, data = self._latest
            self._latest = None
            with suppress(ValueError):  # bytes of a stranger
                snapshot = messages.decode_state(data).snapshot
                if self._start is not None and snapshot.episode == self._start.episode:
                    self._show(snapshot, sent)
        for event in self._events:
            self._report(event_message(event.kind, event.text, event.value))
        self._events.clear()

    def _show(self, snapshot: Snapshot, sent: int) -> None:
        if self._shown is None or snapshot.episode != self._shown[0]:
            known = self.course
            self._enter()
            if self._shown is not None and not _same_line(known, self.course):
                self._report({"course": True})
            self._report({"reset": True})
        if (snapshot.episode, snapshot.step) != self._shown:
            self._shown = (snapshot.episode, snapshot.step)
            self._report({"state": state_values(snapshot, self._places), "sent": round(1e-6 * sent, 2)})

    def _look_for(self, node: GuestNode, now: float) -> None:
        gone = now - self._heard_at > GONE_AFTER and not node.count_publishers(f"{self.namespace}/state")
        if gone and not self._gone:
            self._report({"event": "the simulator is gone"})
            self._shown = self._start = self._course_message = None
            self._paused = False
        if self._gone and not gone:
            self._report({"event": "the simulator is back"})
        self._gone = gone

    def _obey(self) -> None:
        for request in self._asked():
            if request["type"] == "pause" and self._pause_service.service_is_ready():
                future = self._pause_service.call_async(Pause.Request(paused=request["on"]))
                future.add_done_callback(lambda _, on=request["on"]: self._on_paused(on))
            elif request["type"] == "reset" and self._start is not None and self._reset_service.service_is_ready():
                # As it began before: how an episode began has all fields of a request.
                again = {name: getattr(self._start, name) for name in Reset.Request.get_fields_and_field_types()}
                self._reset_service.call_async(Reset.Request(**again)).add_done_callback(self._on_reset)

    def _on_paused(self, on: bool) -> None:
        self._paused = on
        self._report(self.status())

    def _on_reset(self, future: Any) -> None:
        response = future.result()
        if response is not None and not response.success:
            self._report({"event": f"restart refused: {response.message}"})


def _same_line(one: Course | None, other: Course | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.name == other.name and len(one.x) == len(other.x) and bool((one.x == other.x).all())
