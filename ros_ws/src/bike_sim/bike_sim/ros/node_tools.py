"""Start, end, parameters and diagnostics of all nodes."""

from __future__ import annotations

import difflib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NoReturn

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer

from bike_sim.ros.isolation import PARENT_PERIOD, parent_is_gone, prepare_discovery
from bike_sim.ros.subscriptions import StreamLoop

NANOSECONDS: Final = 1_000_000_000
"""Of a second."""

NAMESPACE: Final = "bike"
"""Namespace of the nodes unless ``__ns`` is remapped."""

STREAM_QOS: Final = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
COMMAND_QOS: Final = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
EVENT_QOS: Final = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
SENDER_QOS: Final = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""For topics sent every control period. A publisher keeps more than its subscribers request, so that a recorder that is
held up for a moment still gets each message."""
LATCHED_QOS: Final = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

SCREEN_QOS: Final = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For what a screen shows: only the newest counts, and none is acknowledged, which the simulator would have to hear."""
SCREEN_STATE: Final = "_screen_state"
"""Topic of the states that a screen can show; hidden, for it says nothing that ``state`` does not."""


def is_hidden(topic: str) -> bool:
    """Return whether ROS calls a topic hidden: a part of its name begins with an underscore."""
    return any(part.startswith("_") for part in topic.split("/"))


BAD_INPUT_EXIT: Final = 2
"""Exit code after an invalid parameter, file or partner."""

MAX_ARRIVAL: Final = 0.3
"""Wall-clock time that the last messages of a node get to arrive, s. One whose listener was killed never does."""

MAX_FAREWELL: Final = 4.0
"""Wall-clock time after a signal at which a process that is still busy is ended, s.

A busy machine holds up for more than a second what ends well; after 5 s `ros2 launch` sends a harder signal."""


QUIET: Final = PublisherEventCallbacks(use_default_callbacks=False)
"""For publishers: without it each brings two event handlers into every wait, which then takes three times as long. What
they would report, a partner with other QoS, its subscription reports as well."""


class CannotGoOn(Exception):
    """Ends a node with one line and exit code 2."""


# ------------------------------------------------------------------------------------------------------ start and end


def run_node(
    name: str,
    make_node: Callable[[], Node],
    arguments: Sequence[str] | None = None,
    linger: float = 0.0,
    farewell: float = MAX_FAREWELL,
) -> int:
    """Run a node until SIGINT or SIGTERM, until the program is gone that started it for itself, or until it raises.

    Args:
        name: name of the program for its messages.
        make_node: makes the node. A ValueError or OSError from it means bad input. Raw subscriptions in its attribute
            ``streams``, if it has one, are served by a `StreamLoop`.
        arguments: command line; None for this process's own.
        linger: wall-clock time that the node goes on after the signal, for messages that are under way, s.
        farewell: wall-clock time after the signal at which the process is ended if it is still busy, s.

    Returns:
        Exit code: 0 after a signal, 2 after bad input with one line on standard error.
    """
    prepare_discovery()
    stop, ended, bell = threading.Event(), threading.Event(), _Bell()
    _watch_signals(stop, ended, bell, farewell)
    node = executor = None
    code = 0
    try:
        _start_middleware(arguments)
        node = make_node()
        # A guard condition of the node itself, because waking an idle executor does not end its wait.
        bell.hang(node.create_guard_condition(lambda: None).trigger)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        streams = getattr(node, "streams", ())
        loop = StreamLoop(node, executor, streams) if streams else executor
        while not stop.is_set():
            # The time-out only matters where a signal comes between the test and the wait.
            loop.spin_once(timeout_sec=0.5)
        end = time.monotonic() + linger
        while (left := end - time.monotonic()) > 0.0:
            loop.spin_once(timeout_sec=left)
    except (CannotGoOn, ValueError, OSError, ParameterException) as error:
        code = _complain(name, error)
    finally:
        bell.take_down()
        if node is not None:
            try:
                getattr(node, "finish", lambda: None)()
            except (CannotGoOn, OSError) as error:
                code = _complain(name, error)
            _let_arrive(node)
            node.destroy_node()
        if executor is not None:
            executor.shutdown()
        rclpy.try_shutdown()
        rclpy.get_default_context().destroy()  # notifies the others at once that the node is gone
        ended.set()
    return code


def _let_arrive(node: Node) -> None:
    """Wait until the subscribers have the last messages, which would be lost with the node."""
    end = time.monotonic() + MAX_ARRIVAL
    for publisher in node.publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))


def _complain(name: str, error: BaseException) -> int:
    print(f"{name}: {_one_line(error)}", file=sys.stderr, flush=True)
    return BAD_INPUT_EXIT


def leave(code: int) -> NoReturn:
    """End the process after `run_node`.

    Everything is closed by then. Python's own farewell would unload the compiler and the middleware, piece by piece,
    for up to a second.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def join(domain_id: int) -> Context:
    """Return a context of its own in a ROS domain, for nodes beside others in a process; see `leave_domain`."""
    prepare_discovery()
    context = Context()
    context.init(args=[], domain_id=domain_id)
    return context


def leave_domain(context: Context) -> None:
    """Shut down a context of `join`; its nodes must be destroyed before."""
    context.try_shutdown()
    context.destroy()


def _start_middleware(arguments: Sequence[str] | None) -> None:
    try:
        rclpy.init(args=list(arguments) if arguments else None, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # what rclpy makes of an argument that rcl cannot parse
        raise CannotGoOn(error) from error


class _Bell:
    """Wakes the main thread while its node exists.

    A signal may come at any time, also while the node is being destroyed for another reason. Ringing would then fail,
    and the traceback of the ringing thread would hide the reason of the end.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ring: Callable[[], None] | None = None

    def hang(self, ring: Callable[[], None]) -> None:
        """Begin to ring with a function."""
        with self._lock:
            self._ring = ring

    def take_down(self) -> None:
        """Stop ringing. Returns when no thread is ringing."""
        with self._lock:
            self._ring = None

    def ring(self) -> None:
        """Wake the main thread, if there is a node."""
        with self._lock:
            if self._ring is not None:
                self._ring()


def _watch_signals(stop: threading.Event, ended: threading.Event, bell: _Bell, farewell: float) -> None:
    """End the node on SIGINT and SIGTERM, and with its parent, also where the main thread is inside a library.

    Python runs its handlers only in the main thread, which may be waiting for messages; but the number of a signal is
    written to the wake-up file at once, whichever thread it hits. A thread reads it there. So the node ends between two
    callbacks with its middleware still up, and can say goodbye and close its files.
    """
    readable, writable = os.pipe()
    os.set_blocking(writable, False)
    signal.set_wakeup_fd(writable, warn_on_full_buffer=False)
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, lambda *_: None)

    def wait() -> None:
        number = 0
        while number not in (signal.SIGINT, signal.SIGTERM):
            if select.select([readable], [], [], PARENT_PERIOD)[0]:
                number = os.read(readable, 1)[0]
            elif parent_is_gone():
                number = signal.SIGTERM
        stop.set()
        bell.ring()
        if not ended.wait(farewell):
            os._exit(128 + number)

    threading.Thread(target=wait, name="signals", daemon=True).start()


def _one_line(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror and error.filename is None:
        return error.strerror  # our own words, which need no number
    return " ".join(str(error).split()) or type(error).__name__


# --------------------------------------------------------------------------------------------------------- parameters


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter of a node.

    Attributes:
        name: its name.
        default: its default, which also gives its type.
        text: what it means, with unit.
        fixed: whether it can only be set at start.
        choices: allowed values, or empty.
    """

    name: str
    default: bool | int | float | str | tuple[str, ...]
    text: str
    fixed: bool = False
    choices: tuple[str, ...] = ()

    def read(self, value: Any) -> Any:
        """Return a value in the parameter's own type.

        Raises:
            ValueError: a wrong type or a value that is not one of the choices.
        """
        kind = type(self.default)
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)  # `speed:=4` is as good as `speed:=4.0`
        if kind is tuple and isinstance(value, list | tuple) and all(isinstance(entry, str) for entry in value):
            value = tuple(value)
        if type(value) is not kind:
            raise ValueError(f"parameter {self.name} must be {_KINDS[kind]}, got {value!r}")
        if self.choices and value not in self.choices:
            raise ValueError(f"parameter {self.name} must be one of {', '.join(self.choices)}, got {value!r}")
        return value


_KINDS: Final[Mapping[type, str]] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    tuple: "a list of texts",
}


def declare(node: Node, specs: Sequence[ParameterSpec]) -> dict[str, Any]:
    """Declare parameters and return their values.

    Raises:
        ValueError: a value of the wrong type, or a parameter that the node does not have.
    """
    values = {}
    for spec in specs:
        descriptor = ParameterDescriptor(
            description=spec.text,
            additional_constraints=", ".join(spec.choices),
            read_only=spec.fixed,
            dynamic_typing=True,  # the types are checked by `read`, which names the fault and accepts 4 for 4.0
        )
        default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
        node.declare_parameter(spec.name, default, descriptor)
        values[spec.name] = spec.read(node.get_parameter(spec.name).value)
    for name in node._parameter_overrides:  # the only place where rclpy keeps what is set but not declared
        if not node.has_parameter(name) and name.partition(".")[0] not in _RCLPY_PARAMETERS:
            near = difflib.get_close_matches(name, values, 1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(values)}"
            raise ValueError(f"unknown parameter {name!r}; {hint}")
    return values


_RCLPY_PARAMETERS: Final = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters that rclpy gives to any node, some later than at its start."""


def on_change(node: Node, specs: Sequence[ParameterSpec], accept: Callable[[dict[str, Any]], None]) -> None:
    """Check parameters that are set while the node runs.

    Args:
        node: the node.
        specs: its parameters.
        accept: gets all values after the change; a ValueError or OSError from it refuses the change.
    """
    known = {spec.name: spec for spec in specs}

    def check(changed: list[Parameter]) -> SetParametersResult:
        try:
            values = {name: known[name].read(node.get_parameter(name).value) for name in known}
            mine = {p.name: known[p.name].read(p.value) for p in changed if p.name in known}
            if mine:
                accept(values | mine)
        except (ValueError, OSError) as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


# -------------------------------------------------------------------------------------------------------- diagnostics


class Diagnostics:
    """Publishes a node's report on ``/diagnostics``."""

    OK: Final = DiagnosticStatus.OK
    WARN: Final = DiagnosticStatus.WARN
    ERROR: Final = DiagnosticStatus.ERROR

    def __init__(self, node: Node) -> None:
        self._name = node.get_fully_qualified_name().lstrip("/")
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", STREAM_QOS, event_callbacks=QUIET)

    def report(self, level: bytes, text: str, figures: Mapping[str, object], stamp: int) -> None:
        """Publish one report.

        Args:
            level: OK, WARN or ERROR.
            text: one line for people.
            figures: named values; names end in their unit.
            stamp: simulated time, ns.
        """
        values = [KeyValue(key=key, value=_figure(value)) for key, value in figures.items()]
        status = DiagnosticStatus(level=level, name=self._name, message=text, values=values)
        message = DiagnosticArray(status=[status])
        message.header.stamp = time_to_message(stamp)
        self._publisher.publish(message)


def _figure(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def wall_timer(node: Node, period: float, callback: Callable[[], object]) -> Timer:
    """Call back every so many seconds of wall-clock time, whatever the simulated time does."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def time_to_message(nanoseconds: int) -> Time:
    """Return a time stamp."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)
