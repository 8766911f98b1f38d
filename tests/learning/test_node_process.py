"""Nodes as processes: how they are waited for, how one ended is told, and none is left behind."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bike_sim.ros.isolation import PARENT_PERIOD, DomainLease
from bike_training.envs.node_process import InactivityTimeout, NodeLost, NodeProcess, tell_all_to_end

PATIENCE = 90.0
"""Longest wait for anything, s."""

WAITS = """
import os, pathlib, signal, sys
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
pathlib.Path(__file__).with_name("ready").touch()
signal.sigwait({signal.SIGTERM})
"""


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], NodeProcess]]:
    """Starts a module that waits for its end, as a node does, and then does something."""
    started: list[NodeProcess] = []

    def start_node(end: str) -> NodeProcess:
        (tmp_path / "ending_node.py").write_text(f"{WAITS}{end}\n", encoding="utf-8")
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        started.append(NodeProcess("ending_node", {}, 1))
        latest = time.monotonic() + 30.0
        while not (tmp_path / "ready").exists():
            assert time.monotonic() < latest
            time.sleep(0.01)
        return started[-1]

    yield start_node
    for node in started:
        node.close()


def test_a_node_that_cannot_finish_its_work_says_why(start) -> None:
    """As a recorder that is told to end on a full disk."""
    node = start("print('noise\\nrecord: no space', file=sys.stderr); sys.exit(2)")
    node.check()
    with pytest.raises(NodeLost, match=r"^ending_node ended with exit code 2: record: no space$"):
        node.finish()
    with pytest.raises(NodeLost, match="exit code 2"):
        node.check()


def test_a_node_that_finished_its_work_is_no_error(start) -> None:
    start("sys.exit(0)").finish()


@pytest.mark.parametrize(("end", "code"), [("os._exit(128 + signal.SIGTERM)", 143), ("os.kill(os.getpid(), 9)", -9)])
def test_a_node_that_had_to_be_ended_did_not_finish(start, end, code) -> None:
    """As a recorder on a disk that is too slow to close the file in time."""
    with pytest.raises(NodeLost, match=rf"exit code {code}$"):
        start(end).finish()


def test_all_nodes_are_told_to_end_at_once(start) -> None:
    node = start("sys.exit(0)")
    tell_all_to_end()
    assert node.process.wait(PATIENCE) == 0
    tell_all_to_end()  # those that have ended take no notice
    node.finish()


@pytest.fixture
def node(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[NodeProcess]:
    """A process that does something, as a node."""
    popen = subprocess.Popen

    def start(_: list[str], **options: object) -> subprocess.Popen:
        return popen([sys.executable, "-I", "-S", "-c", f"print(flush=True); {request.param}"], **options)

    monkeypatch.setattr(subprocess, "Popen", start)
    node = NodeProcess("node", {}, 1)
    yield node
    node.process.kill()
    node.close()


def silence(patience: InactivityTimeout, longest: float) -> float:
    """Return the time until patience runs out, s; `longest` where it does not."""
    began = time.monotonic()
    while time.monotonic() - began < longest and not patience.is_out():
        time.sleep(0.02)
    return time.monotonic() - began


@pytest.mark.parametrize("node", ["import time; time.sleep(60)"], indirect=True)
def test_a_node_that_does_nothing_is_given_up(node: NodeProcess) -> None:
    time.sleep(1.0)  # its start is work
    assert 0.5 <= silence(InactivityTimeout(0.5, [node]), 20.0) < 10.0
    node.process.kill()
    node.process.wait()
    assert silence(InactivityTimeout(0.2, [node]), 20.0) < 10.0


@pytest.mark.parametrize("node", ["[1 for _ in iter(int, 1)]"], indirect=True)
def test_a_node_that_works_is_waited_for(node: NodeProcess) -> None:
    """As one that compiles, also where it is one of several."""
    assert silence(InactivityTimeout(0.5, [node]), 2.5) >= 2.5


def test_what_is_heard_begins_anew_and_a_pause_of_ones_own_is_no_silence_of_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    patience = InactivityTimeout(3.0, [])
    for now in (1.0, 2.0, 3.0):  # noqa: B007 - the clock
        assert not patience.is_out()
    patience.heard()
    for now in (4.0, 5.0, 3600.0):  # noqa: B007 - suspended with Ctrl-Z for an hour
        assert not patience.is_out()
    now += 1.0
    assert patience.is_out()


STARTS_A_RECORDER = """
import sys, threading, time
from bike_training.envs.node_process import NodeProcess

started = []
start = lambda: started.append(NodeProcess("bike_sim.ros.record", {"path": sys.argv[1]}, int(sys.argv[2])))
thread = threading.Thread(target=start)
thread.start()
thread.join()
print(started[0].process.pid, flush=True)
time.sleep(600)
"""


def until(condition: Callable[[], bool]) -> None:
    latest = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < latest
        time.sleep(0.02)


@pytest.mark.ros
def test_a_node_outlives_the_thread_that_started_it_but_not_the_program(tmp_path: Path) -> None:
    """Also a program that is killed, and with the file of the recorder closed."""
    pytest.importorskip("rclpy")
    recording = tmp_path / "ride.mcap"
    with DomainLease() as lease:
        command = [sys.executable, "-c", STARTS_A_RECORDER, str(recording), str(lease.domain_id)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as starter:
            assert starter.stdout is not None
            words = Path("/proc") / starter.stdout.readline().strip() / "cmdline"  # empty once the process has ended
            until(recording.exists)
            time.sleep(4 * PARENT_PERIOD)
            assert b"bike_sim.ros.record" in words.read_bytes()
            starter.kill()
        until(lambda: not words.exists() or not words.read_bytes())
    assert recording.read_bytes().endswith(b"\x89MCAP0\r\n")
