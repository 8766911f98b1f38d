"""Nodes as processes: how one ended is told to whoever started it."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bike_training.node_process import NodeLost, NodeProcess

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
