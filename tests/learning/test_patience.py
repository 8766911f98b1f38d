"""Waiting for nodes, and what a terminal shows meanwhile."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from bike_training.envs.node_process import InactivityTimeout, NodeProcess


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


def test_what_is_heard_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    patience = InactivityTimeout(3.0, [])
    for now in (1.0, 2.0, 3.0):  # noqa: B007 - the clock
        assert not patience.is_out()
    patience.heard()
    for now in (4.0, 5.0, 6.0):  # noqa: B007
        assert not patience.is_out()
    now = 7.0
    assert patience.is_out()


def test_a_pause_of_ones_own_is_no_silence_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    patience = InactivityTimeout(3.0, [])
    now = 3600.0  # suspended with Ctrl-Z for an hour
    assert not patience.is_out()
