"""What the start of a node costs: processor time of a bicycle's simulator and policy nodes until they are at work.

Numba's cache is warm: a first start fills it. The fastest start of each counts.

    python -m bench.start_up
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from bike_sim.ros.isolation import DOMAIN_VARIABLE, DomainLease, prepare_discovery
from bike_sim.ros.parent import end_with_this_process

NODES: Final = {
    "sim_node": ("bike_sim.ros.sim_node", "on course"),
    "drive": ("bike_policy.drive", "driving episode"),
}
"""Module of each node, and what it says when it is at work; the policy says so after its first state."""


class Started:
    """A node in a process of its own, at work.

    Attributes:
        cpu_s: processor time until then, s.
    """

    def __init__(self, node: str, domain: int) -> None:
        """Start a node and wait until it is at work.

        Args:
            node: key of NODES.
            domain: its ROS domain.

        Raises:
            RuntimeError: it ended.
        """
        module, ready = NODES[node]
        environment = {**os.environ, DOMAIN_VARIABLE: str(domain)}
        prepare_discovery(environment)
        end_with_this_process(environment)
        self._process = subprocess.Popen(
            [sys.executable, "-m", module],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stderr is not None
        last = ""
        while ready not in last:
            last = self._process.stderr.readline()
            if not last:
                raise RuntimeError(f"{module} ended with exit code {self._process.wait()} before it was at work")
        self.cpu_s = _processor_time(self._process.pid)

    def close(self) -> None:
        """End the node."""
        self._process.terminate()
        self._process.communicate()


def _processor_time(process: int) -> float:
    """Return the processor time of a process so far, s. One that replaced itself counts from its first program on."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def start_both() -> dict[str, float]:
    """Start both nodes, end them, and return the processor time of each until it was at work, s."""
    with DomainLease() as lease, ExitStack() as nodes:
        times = {}
        for name in NODES:
            started = Started(name, lease.domain_id)
            nodes.callback(started.close)
            times[name] = started.cpu_s
    return times


def measure(rounds: int = 5) -> dict[str, Any]:
    """Return processor times until the nodes are at work, s.

    Args:
        rounds: starts of each; the fastest counts.

    Raises:
        RuntimeError: a node ended.
    """
    times = [start_both() for _ in range(1 + rounds)]
    return {f"{name}_start_cpu_s": min(time[name] for time in times[1:]) for name in NODES}


if __name__ == "__main__":
    for key, value in measure().items():
        print(f"{key:36} {value:.3f}")
