"""Processes, domains and probes for the tests that start ROS 2 nodes."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from bike_msgs.msg import BikeCommand, BikeState
from bike_msgs.srv import Pause, Reset
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_sim.ros import node_tools
from bike_sim.ros.command_gate import Command
from bike_sim.ros.isolation import DISCOVERY_VARIABLE, PROFILES_VARIABLE, DomainLease
from bike_sim.ros.messages import encode_command, reset_to_message
from bike_sim.sim.request import ResetRequest
from bike_training.envs import node_process
from tests.circuits import write_oval
from tests.ros.forked import Forked, Popen, load

PATIENCE = 90.0
"""Longest wait for anything, s. Nothing takes that long; it is what a busy machine may need."""


def arguments_of(namespace: str, parameters: dict[str, Any]) -> list[str]:
    """Return the words of a command line that give a node its namespace and parameters."""
    words = ["--ros-args", "-r", f"__ns:=/{namespace}"]
    return [*words, *(word for name, value in parameters.items() for word in ("-p", f"{name}:={json.dumps(value)}"))]


class Program:
    """A node in a process of its own."""

    def __init__(
        self, module: str, domain: int, words: Path, namespace: str = "bike", remap: str = "", **parameters: Any
    ) -> None:
        command = [*arguments_of(namespace, parameters), *(["-r", remap] if remap else [])]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        for variable in (DISCOVERY_VARIABLE, PROFILES_VARIABLE):
            environment.pop(variable, None)  # the defaults are what is tested
        self._words = words
        words.touch()
        self.process = Forked(module, command, environment, words)

    @property
    def words(self) -> str:
        return self._words.read_text()

    def end(self, number: int = signal.SIGINT) -> tuple[int, float]:
        """Send a signal; return the exit code and the seconds until the end."""
        began = time.monotonic()
        self.process.send_signal(number)
        return self.process.wait(PATIENCE), time.monotonic() - began

    def wait(self) -> int:
        return self.process.wait(PATIENCE)


class Witness(node_tools.GuestNode):
    """A node of the test's own, and what it hears of the recorder."""

    def __init__(self, name: str, domain: int, namespace: str = "bike") -> None:
        super().__init__(name, domain, namespace)
        self.reports: list[DiagnosticStatus] = []
        self.statuses: dict[str, list[DiagnosticStatus]] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, node_tools.EVENT_QOS)

    def _on_report(self, message: DiagnosticArray) -> None:
        self.reports += [status for status in message.status if status.name == "bike/record"]
        for status in message.status:
            self.statuses.setdefault(status.name.removeprefix("bike/"), []).append(status)

    def figures(self, file: Path | str = "") -> dict[str, str]:
        """Return what a recorder last reported: the one that writes a file, or any."""
        found = ({entry.key: entry.value for entry in status.values} for status in reversed(self.reports))
        return next((figures for figures in found if str(file) in figures["file"]), {})

    def reported(self, node: str) -> dict[str, str]:
        """Return a node's last report, empty where it has not reported yet."""
        latest = self.statuses.get(node, [DiagnosticStatus()])[-1]
        return {entry.key: entry.value for entry in latest.values}

    def count(self, node: str, name: str) -> int:
        """Return what a node last reported to have counted, 0 where it has not reported yet."""
        return int(self.reported(node).get(name, "0"))

    def records(self, *topics: str, file: Path | str = "") -> bool:
        """Whether a recorder has written messages of topics; what is sent from now on reaches it, too."""
        return {f"/bike/{topic}" for topic in topics} <= set(self.figures(file).get("topics_heard", "").split())

    def open(self, kind: type, topic: str, qos: QoSProfile = node_tools.SENDER_QOS) -> Any:
        """Return a publisher that the recorder hears."""
        publisher = self.create_publisher(kind, topic, qos)
        self.until(publisher.get_subscription_count)
        return publisher

    def listen(self, kind: type, topic: str, qos: Any = None) -> list[Any]:
        """Return a list that grows with each message."""
        heard: list[Any] = []
        self.create_subscription(kind, topic, heard.append, qos or node_tools.EVENT_QOS)
        return heard

    def until(self, condition: Callable[[], Any], patience: float = PATIENCE) -> None:
        """Listen until a condition holds."""
        end = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < end, f"waited {patience} s in vain; {self.describe()}"
            self.spin_once(0.05)

    def until_equal(self, find: Callable[[], Any], wanted: Any) -> None:
        """Listen until something is as it should be; what it was instead is told."""
        end = time.monotonic() + PATIENCE
        while (found := find()) != wanted and time.monotonic() < end:
            self.spin_once(0.05)
        assert found == wanted

    def describe(self) -> str:
        return f"the recorder reported {self.figures()}"

    def during(self, seconds: float) -> None:
        """Listen for some time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.spin_once(max(end - time.monotonic(), 0.0))


class StateProbe(Witness):
    """Listens to a simulator, commands and calls."""

    def __init__(self, domain: int, namespace: str = "bike") -> None:
        super().__init__("probe", domain, namespace)
        self.commands = self.create_publisher(BikeCommand, "command", node_tools.COMMAND_QOS)
        self._reset = self.create_client(Reset, "reset")
        self._pause = self.create_client(Pause, "pause")
        self._parameters: Client | None = None
        self._sent: Counter[str] = Counter()
        # After the clients: a simulator whose states come knows where its answers go to, and sooner it drops them.
        # As deep as the simulator's queue, so that none is lost where this process is held up.
        self.states: list[BikeState] = self.listen(BikeState, "state", node_tools.SENDER_QOS)

    def describe(self) -> str:
        return f"last episode and step: {[(s.episode, s.step) for s in self.states[-1:]]}; {super().describe()}"

    def connected(self) -> bool:
        # Each service: one that is not there yet drops a call without a word, and the simulator opens them in turn.
        services = self._reset.service_is_ready() and self._pause.service_is_ready()
        return bool(self.states) and self.commands.get_subscription_count() > 0 and services

    def command(self, state: BikeState, steering: float = 0.0, **changes: Any) -> None:
        """Answer a state, or something near it."""
        values = {"episode": state.episode, "step": state.step, "steering": steering, **changes}
        self.commands.publish(encode_command(Command(**values)))

    def sent(self, outcome: str, state: BikeState, steering: float = 0.0, **changes: Any) -> None:
        """Send a command and wait until the simulator has counted it: its queue holds one, a further takes its place.

        Commands with this outcome must all have been sent by this method, or by `answer`.
        """
        self.command(state, steering, **changes)
        self._sent[outcome] += 1
        self.until_equal(lambda: self.count("sim_node", f"commands_{outcome}"), self._sent[outcome])

    def answer(self, state: BikeState, steering: float = 0.0, **changes: Any) -> BikeState:
        """Answer a state and return the next one."""
        self.command(state, steering, **changes)
        self._sent["taken"] += 1
        self.until(lambda: (self.states[-1].episode, self.states[-1].step) == (state.episode, state.step + 1))
        return self.states[-1]

    def attend(self, kind: type, topic: str) -> list[Any]:
        """Return a list that grows with each message from now on: the simulator knows of it.

        Nodes learn of subscriptions in the order in which these were made, so a later one that hears a state tells.
        """
        heard = self.listen(kind, topic)
        states: list[BikeState] = []
        later = self.create_subscription(BikeState, "state", states.append, node_tools.STREAM_QOS)
        self.until(lambda: states)
        self.destroy_subscription(later)
        return heard

    def still(self) -> BikeState:
        """Wait until time stands still, and return the state that comes again.

        Twice: one that is published again may have had its answer in the simulator's queue already.
        """
        begin = len(self.states)
        self.until(lambda: len(self.states) >= begin + 3 and self.states[-1] == self.states[-2] == self.states[-3])
        return self.states[-1]

    def reset(self, request: ResetRequest | Reset.Request) -> Reset.Response:
        message = request if isinstance(request, Reset.Request) else reset_to_message(request)
        future = self._reset.call_async(message)
        self.until(future.done)
        return future.result()

    def set_parameter(self, name: str, value: float | str) -> SetParametersResult:
        """Set a parameter of the simulator."""
        if self._parameters is None:
            self._parameters = self.create_client(SetParameters, "sim_node/set_parameters")
            self.until(self._parameters.service_is_ready)
        parameter = Parameter(name, value=value).to_parameter_msg()
        future = self._parameters.call_async(SetParameters.Request(parameters=[parameter]))
        self.until(future.done)
        return future.result().results[0]

    def pause(self, paused: bool) -> Pause.Response:
        future = self._pause.call_async(Pause.Request(paused=paused))
        self.until(future.done)
        return future.result()


@pytest.fixture
def run_here(ros: RosFixture, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Any:
    """Runs a node in this process, which must end by itself; returns its exit code and its words."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros.domain))
    monkeypatch.setattr(node_tools, "_watch_signals", lambda *_: None)

    def run(module: str, **parameters: Any) -> tuple[int, str]:
        command = ["node", *arguments_of("bike", parameters)]
        monkeypatch.setattr(sys, "argv", command)
        codes: list[int] = []
        monkeypatch.setattr(node_tools, "leave", codes.append)
        importlib.import_module(module).main()
        return codes[0], capfd.readouterr().err

    return run


class RosFixture:
    """A ROS domain with the programs and probes of one test."""

    def __init__(self, folder: Path) -> None:
        self._lease = DomainLease()
        self._folder = folder
        self._programs: list[Program] = []
        self._witnesses: list[Witness] = []
        self.domain = self._lease.domain_id

    def start(self, module: str, **parameters: Any) -> Program:
        words = self._folder / f"{module}_{self.domain}_{len(self._programs)}.txt"
        self._programs.append(Program(module, self.domain, words, **parameters))
        return self._programs[-1]

    def simulator(self, **parameters: Any) -> Program:
        return self.start("bike_sim.ros.sim_node", **{"time_step": 0.005, "course": "line", **parameters})

    def probe(self, namespace: str = "bike") -> StateProbe:
        """Return a probe that the simulator of a namespace knows."""
        probe = StateProbe(self.domain, namespace)
        self._witnesses.append(probe)
        probe.until(probe.connected)
        return probe

    def sender(self) -> Witness:
        """Return a node that publishes what it likes."""
        sender = Witness("sender", self.domain)
        self._witnesses.append(sender)
        return sender

    def close(self) -> None:
        for witness in self._witnesses:
            witness.close()
        for program in self._programs:
            if program.process.poll() is None:
                program.process.kill()
            program.process.wait()
            print(program.words)  # shown where a test fails
        self._lease.close()


@pytest.fixture(scope="session")
def compiled() -> None:
    """Compiles the physics where nobody waits."""
    load()


@pytest.fixture(scope="module", autouse=True)
def forked_nodes() -> Iterator[None]:
    """Forks the nodes that programs start."""
    with pytest.MonkeyPatch.context() as patch:
        own = SimpleNamespace(Popen=Popen, DEVNULL=subprocess.DEVNULL, TimeoutExpired=subprocess.TimeoutExpired)
        patch.setattr(node_process, "subprocess", own)
        yield


@pytest.fixture
def circuit(tmp_path: Path) -> Path:
    """A small circuit."""
    return write_oval(tmp_path)


@pytest.fixture
def ros(tmp_path: Path, compiled: None) -> Iterator[RosFixture]:
    ros = RosFixture(tmp_path)
    yield ros
    ros.close()


@pytest.fixture
def other_ros(tmp_path: Path) -> Iterator[RosFixture]:
    ros = RosFixture(tmp_path)
    yield ros
    ros.close()


@pytest.fixture(scope="module")
def shared_ros(tmp_path_factory: pytest.TempPathFactory, compiled: None) -> Iterator[RosFixture]:
    """A ROS domain that the tests of a module share."""
    ros = RosFixture(tmp_path_factory.mktemp("shared"))
    yield ros
    ros.close()


@pytest.fixture(scope="module")
def lockstep(shared_ros: RosFixture) -> StateProbe:
    """StateProbe on a simulator in lockstep that the tests of a module share; each begins with a reset of its own."""
    shared_ros.simulator()
    return shared_ros.probe()


@pytest.fixture(scope="session")
def policy() -> str:
    """A policy that rides."""
    return DEFAULT_POLICY
