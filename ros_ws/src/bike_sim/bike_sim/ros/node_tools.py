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


SIGNAL_PERIOD: Final = 0.1
"""Longest wall-clock time in which an idle node takes no notice of a signal, s."""
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
    stop, ended = threading.Event(), threading.Event()
    _watch_signals(stop, ended, farewell)
    node = executor = None
    code = 0
    try:
        try:
            rclpy.init(args=list(arguments or []) or None, signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:  # what rclpy makes of an argument that rcl cannot parse
            raise CannotGoOn(error) from error
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        streams = getattr(node, "streams", ())
        loop = StreamLoop(node, executor, streams) if streams else executor
        while not stop.is_set():
            loop.spin_once(timeout_sec=SIGNAL_PERIOD)
        end = time.monotonic() + linger
        while (left := end - time.monotonic()) > 0.0:
            loop.spin_once(timeout_sec=left)
    except (CannotGoOn, ValueError, OSError, ParameterException) as error:
        code = _complain(name, error)
    finally:
        if node is not None:
            try:
                getattr(node, "finish", lambda: None)()
            except (CannotGoOn, OSError) as error:
                code = _complain(name, error)
            end = time.monotonic() + MAX_ARRIVAL
            for publisher in node.publishers:
                publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))
            node.destroy_node()
        if executor is not None:
            executor.shutdown()
        rclpy.try_shutdown()
        rclpy.get_default_context().destroy()  # notifies the others at once that the node is gone
        ended.set()
    return code


def _complain(name: str, error: BaseException) -> int:
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, OSError) and error.strerror and error.filename is None:
        text = error.strerror  # our own words, which need no number
    print(f"{name}: {text}", file=sys.stderr, flush=True)
    return BAD_INPUT_EXIT


def leave(code: int) -> NoReturn:
    """End the process after `run_node`.

    Everything is closed by then. Python's own farewell would unload the compiler and the middleware, piece by piece,
    for up to a second.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


class GuestNode(Node):
    """A node in a context of its own in a ROS domain, for a program that is none itself; it has no parameters."""

    def __init__(self, name: str, domain_id: int, namespace: str = NAMESPACE) -> None:
        """Join the domain."""
        prepare_discovery()
        self._guest_context = Context()
        self._guest_context.init(args=[], domain_id=domain_id)
        super().__init__(
            name,
            context=self._guest_context,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._spinner = SingleThreadedExecutor(context=self._guest_context)
        self._spinner.add_node(self)

    def spin_once(self, timeout: float) -> None:
        """Handle one thing that has come, or wait for it at most for a time, s."""
        self._spinner.spin_once(timeout_sec=timeout)

    def close(self) -> None:
        """Leave the domain."""
        self._spinner.shutdown()
        self.destroy_node()
        self._guest_context.try_shutdown()
        self._guest_context.destroy()


def _watch_signals(stop: threading.Event, ended: threading.Event, farewell: float) -> None:
    """End the node on SIGINT and SIGTERM, and with its parent, also where the main thread is inside a library.

    Python runs its handlers only in the main thread, which may be busy; but the number of a signal is written to the
    wake-up file at once, whichever thread it hits. A thread reads it there. So the node ends between two callbacks
    with its middleware still up, and can say goodbye and close its files.
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
        if not ended.wait(farewell):
            os._exit(128 + number)

    threading.Thread(target=wait, name="signals", daemon=True).start()


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
        values = [
            KeyValue(key=key, value=f"{value:.6g}" if isinstance(value, float) else str(value))
            for key, value in figures.items()
        ]
        status = DiagnosticStatus(level=level, name=self._name, message=text, values=values)
        message = DiagnosticArray(status=[status])
        message.header.stamp = time_to_message(stamp)
        self._publisher.publish(message)


def wall_timer(node: Node, period: float, callback: Callable[[], object]) -> Timer:
    """Call back every so many seconds of wall-clock time, whatever the simulated time does."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def time_to_message(nanoseconds: int) -> Time:
    """Return a time stamp."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)
