"""How a node ends when a signal comes at a bad moment."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from bike_sim.ros.isolation import DOMAIN_VARIABLE, SHARED_MEMORY, DomainLease

ENDS_TWICE = """
import os, signal, sys, time
import rclpy.node
from bike_sim.ros import node_tools

class Full(rclpy.node.Node):
    def __init__(self):
        super().__init__("full")
        node_tools.wall_timer(self, 0.01, self.give_up)

    def give_up(self):
        raise node_tools.CannotGoOn("no space left")

    def destroy_node(self):
        super().destroy_node()
        os.kill(os.getpid(), int(sys.argv[1]))
        time.sleep(0.5)  # as on a busy machine

node_tools.leave(node_tools.run_node("full", Full, arguments=["--ros-args"]))
"""


@pytest.mark.ros
@pytest.mark.parametrize("number", [2, 15])
def test_a_signal_while_a_node_is_ending_does_not_bury_the_reason(number: int) -> None:
    """Its last line is what `bike` shows, so a traceback of another thread must not come after it."""
    with DomainLease() as lease:
        environment: dict[str, Any] = {**os.environ, DOMAIN_VARIABLE: str(lease.domain_id)}
        command = [sys.executable, "-c", ENDS_TWICE, str(number)]
        result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=60.0)
    assert result.stderr == "full: no space left\n"
    assert result.returncode == 2


def mapped_by(process: int) -> set[str]:
    """Return the files of Fast DDS that a process has in its memory."""
    return set(re.findall(rf"{SHARED_MEMORY}/(\S*fastrtps\S*)", (Path("/proc") / str(process) / "maps").read_text()))


@pytest.mark.ros
def test_a_clean_end_leaves_nothing_in_shared_memory(ros: Any, policy: str, tmp_path: Path) -> None:
    programs = {
        "recording to": ros.start("bike_sim.ros.record", path=str(tmp_path / "ride.mcap")),
        "every 50 ms": ros.simulator(),
        "driving episode": ros.start("bike_policy.drive", policy=policy),
    }
    end = time.monotonic() + 90.0
    while not all(words in program.words for words, program in programs.items()):
        assert time.monotonic() < end
        time.sleep(0.1)
    files = set().union(*(mapped_by(program.process.pid) for program in programs.values()))
    assert len(files) >= 6  # a segment and a port of each
    for program in programs.values():
        assert program.end(signal.SIGTERM)[0] == 0
    assert not files & {path.name for path in SHARED_MEMORY.iterdir()}
