"""How a node ends when a signal comes at a bad moment."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import pytest

from bike_sim.ros.isolation import DOMAIN_VARIABLE, DomainLease

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
