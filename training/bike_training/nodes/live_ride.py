"""A ride that people watch and steer: a node in lockstep at the pace of the clock, and its messages with the page."""

from __future__ import annotations

import queue
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol

from bike_analysis.read.messages import Simulation
from bike_policy.riders.base import Rider
from bike_policy.riders.stanley import HANDS, ManualRider
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import EventKind
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.snapshot import Snapshot
from bike_sim.sim.superbike_plant import SuperbikePlant
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.envs.node_process import NodeProcess
from bike_training.envs.ros_client import RosClient
from bike_training.nodes.node_rides import START_TIMEOUT, RideMonitor

STATE_NAMES: Final = (
    *("time", "distance", "x", "y", "yaw", "roll", "steer", "speed", "error", "command", "throttle", "brake"),
)
"""Values sent of each state, in order: s, m, rad and m/s; commands in [-1, 1]."""
WHEELS: Final = {
    **{"rear_slip": "rear_slip", "front_slip": "front_slip", "rear_load": "rear_load_n", "front_load": "front_load_n"}
}
"""Further values of a superbike, with the names of its signals: slip, and loads in N."""
PACES: Final = (0.1, 10.0)
"""Slowest and fastest ride, times the clock."""


def state_names(powered: bool) -> tuple[str, ...]:
    """Return the names of the values sent of a state, in order; more of vehicles with signals."""
    return (*STATE_NAMES, *WHEELS) if powered else STATE_NAMES


def places_of(signals: Sequence[str]) -> list[int]:
    """Return where the signals of `WHEELS` stand among a vehicle's; none where it has no signals."""
    return [list(signals).index(name) for name in WHEELS.values()] if len(signals) else []


def state_values(snapshot: Snapshot, places: Sequence[int]) -> list[float]:
    """Return the values sent of a state, in the order of `state_names`, with the signals at some places."""
    state, look = snapshot.state, snapshot.look
    values = (
        snapshot.time,
        look[lk.PROGRESS],
        *(state[place] for place in (st.X, st.Y, st.YAW, st.ROLL, st.STEER)),
        snapshot.speed,
        look[lk.LATERAL_ERROR],
        snapshot.steering,
        max(snapshot.throttle, 0.0),
        max(-snapshot.throttle, 0.0),
        *(snapshot.signals[place] for place in places),
    )
    return [round(float(value), 5) for value in values]


def event_message(kind: EventKind | int, text: str, value: float) -> dict[str, Any]:
    """Return the message of an event; that of a lap has its time, s."""
    return {"event": text, **({"lap": value} if kind == EventKind.LAP else {})}


def checked_request(message: Any) -> dict[str, Any] | None:
    """Return a request of the page with its values in bounds, or None if it is none.

    Args:
        message: what the page sent, decoded from JSON.
    """
    kind = message.get("type") if isinstance(message, dict) else None
    if not isinstance(kind, str) or kind not in _REQUESTS:
        return None
    values = {name: _checked(message.get(name), bounds) for name, bounds in _REQUESTS[kind].items()}
    return None if None in values.values() else {"type": kind, **values}


_REQUESTS: Final[dict[str, dict[str, tuple[float, float] | None]]] = {
    "input": {"steering": (-1.0, 1.0), "throttle": (-1.0, 1.0)},
    "pace": {"factor": PACES},
    "pause": {"on": None},
    "rider": {"hands": None, "balance": None},
    "step": {},
    "reset": {},
}
"""What a page may ask for, each with its numbers and their bounds; values without bounds are true or false."""


def _checked(value: Any, bounds: tuple[float, float] | None) -> float | bool | None:
    if bounds is None or isinstance(value, bool):
        return value if bounds is None and isinstance(value, bool) else None
    return float(min(max(value, bounds[0]), bounds[1])) if isinstance(value, int | float) and value == value else None


class LiveThread(ABC):
    """Goes on until `end`; requests come through `ask`.

    Attributes:
        course: the followed line, once the ride has begun.
        domain_id: ROS domain of its nodes, likewise.
        settings: control period, s, and how the motion is computed, likewise.
    """

    thread_name: ClassVar[str]
    course: Course | None = None
    domain_id = 0
    settings: tuple[float, Simulation | None] = (0.0, None)

    def __init__(self, report: Callable[[dict[str, Any]], None]) -> None:
        """Prepare.

        Args:
            report: called from the ride's thread with each message for the page; the last one is ``{"ended": True}``.
        """
        self._report = report
        self._requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._begun = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=self.thread_name, daemon=True)

    def start(self) -> None:
        """Begin, and return when course and first state are there.

        Raises:
            NodeLost: no simulator appeared. ValueError: a rider that cannot ride this.
        """
        self._thread.start()
        self._begun.wait()
        self.check()

    def check(self) -> None:
        """Raise what ended the ride, if anything did."""
        if self._failure is not None:
            raise self._failure

    def end(self) -> None:
        """End, and wait until all that was opened is closed."""
        self._ended.set()
        self._thread.join()

    def ask(self, request: dict[str, Any]) -> None:
        """Put in a request, checked by `checked_request`."""
        self._requests.put(request)

    @abstractmethod
    def status(self) -> dict[str, Any]:
        """Return how the ride goes on, for the page; from any thread."""

    # ------------------------------------------------------------------------------------------------ in its own thread

    @abstractmethod
    def _live(self) -> None:
        """Set `_begun` once course and first state are there, and return when `_ended` is set."""

    def _run(self) -> None:
        try:
            self._live()
        except BaseException as error:
            self._failure = error
        finally:
            self._begun.set()
            self._report({"ended": True})

    def _asked(self) -> Iterator[dict[str, Any]]:
        """Take the requests that wait."""
        while not self._requests.empty():
            yield self._requests.get()


HELD: Final = 0.5
"""Wall-clock time for which a manual command holds, s: who is cut off rides straight on with closed throttle."""
BEHIND: Final = 0.25
"""Delay beyond which the ride does not try to catch up with the clock, s."""
FRAME: Final = 1.0 / 75.0
"""Least wall-clock time between two states that are sent, s: no screen shows more, and a fast ride is not held up."""
IDLE: Final = 0.02
"""Time between two looks at the requests while nothing moves, s."""


@dataclass(frozen=True)
class LiveSettings:
    """Settings of a live ride.

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


class RideClient(Protocol):
    """The simulator of the machine that is ridden, as `RosClient`."""

    vehicle: Vehicle
    preview: Preview

    @property
    def course(self) -> Course | None: ...  # noqa: D102
    def reset(self, request: ResetRequest) -> Snapshot: ...  # noqa: D102
    def step(self, steering: float, throttle: float = 0.0) -> Snapshot: ...  # noqa: D102


class LiveRide(LiveThread):
    """Rides until `end`."""

    thread_name = "live ride"

    def __init__(self, settings: LiveSettings, report: Callable[[dict[str, Any]], None]) -> None:
        """Prepare a ride.

        Args:
            settings: what is ridden.
            report: called from the ride's thread with each message for the page.
        """
        super().__init__(report)
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

    def _begin(self, client: RideClient) -> None:
        self._snapshot = client.reset(self._settings.request)
        self.course = client.course
        assert self.course is not None
        self._places = places_of(SuperbikePlant.signal_names if isinstance(client.vehicle, Superbike) else ())
        for rider in (self._settings.rider, self._hands):
            self._prepare(client, rider)
        self._report({"reset": True})
        self._show()

    def _prepare(self, client: RideClient, rider: Rider) -> None:
        assert self.course is not None
        rider.begin(client.vehicle, self.course, self._settings.config.control_period, client.preview)

    def _ride(self, client: RideClient) -> None:
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
            self._report(self.status())
        return reset

    def status(self) -> dict[str, Any]:
        """Progress of the ride for the page."""
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

    def _more(self) -> dict[str, Any]:
        """Return what is sent with a state besides."""
        return {}

    def _show(self) -> None:
        snapshot = self._snapshot
        now = time.monotonic()
        if now - self._told_at >= FRAME or snapshot.events or not snapshot.step:
            self._told_at = now
            told = {"state": state_values(snapshot, self._places), "sent": round(1e3 * time.time(), 2)}
            self._report(told | self._more())
        for event in snapshot.events:
            self._report(event_message(event.kind, event.text, event.value))
