"""Nodes as processes: how one ended is told to whoever started it, and none is left behind."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bike_sim.ros.isolation import PARENT_PERIOD, DomainLease
from bike_training.envs.node_process import NodeLost, NodeProcess, tell_all_to_end

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
