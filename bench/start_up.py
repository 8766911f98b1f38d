"""What the start of a node costs: processor time of a bicycle's simulator and policy nodes until they are at work.

The nodes are started with the kernels that the set-up has compiled ahead of time and, in turn, with Numba's, so that
the ratio is of one run. The fastest start of each counts.

    python -m bench.start_up
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from bike_sim import kernels
from bike_sim.ros.isolation import DOMAIN_VARIABLE, DomainLease, prepare_discovery
from bike_sim.ros.parent import end_with_this_process

NODES: Final = {
    "sim_node": ("bike_sim.ros.sim_node", "on course"),
    "drive": ("bike_policy.drive", "driving episode"),
}
"""Module of each node, and what it says when it is at work; the policy says so after its first state."""
CHOICES: Final = {"prepared": "", "numba": "numba"}
"""Values of the variable that chooses kernels."""


class Started:
    """A node in a process of its own, at work.

    Attributes:
        cpu_s: processor time until then, s.
        libraries: names of the files that it has mapped.
    """

    def __init__(self, node: str, choice: str, domain: int) -> None:
        """Start a node and wait until it is at work.

        Args:
            node: key of NODES.
            choice: key of CHOICES.
            domain: its ROS domain.

        Raises:
            RuntimeError: it ended.
        """
        module, ready = NODES[node]
        environment = {**os.environ, DOMAIN_VARIABLE: str(domain), kernels.CHOICE_VARIABLE: CHOICES[choice]}
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
        maps = Path(f"/proc/{self._process.pid}/maps").read_text().splitlines()
        self.libraries = {Path(line.split(maxsplit=5)[5]).name for line in maps if "/" in line}

    def close(self) -> None:
        """End the node."""
        self._process.terminate()
        self._process.communicate()


def _processor_time(process: int) -> float:
    """Return the processor time of a process so far, s. One that replaced itself counts from its first program on."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def start_both(choice: str) -> dict[str, Started]:
    """Start both nodes, end them, and return what was seen.

    Args:
        choice: key of CHOICES.
    """
    with DomainLease() as lease, ExitStack() as nodes:
        started = {}
        for name in NODES:
            started[name] = Started(name, choice, lease.domain_id)
            nodes.callback(started[name].close)
    return started


def measure(rounds: int = 5) -> dict[str, Any]:
    """Return processor times until the nodes are at work, s, and their ratios.

    Args:
        rounds: starts of each; the fastest counts.

    Raises:
        RuntimeError: a node ended, or the library is missing.
    """
    if kernels.load_library() is None:
        raise RuntimeError("the prepared kernels are missing or out of date; run `make setup`")
    least: dict[tuple[str, str], float] = {}
    for _ in range(rounds):
        for choice in CHOICES:
            for name, started in start_both(choice).items():
                least[name, choice] = min(started.cpu_s, least.get((name, choice), started.cpu_s))
    figures: dict[str, Any] = {}
    for name in NODES:
        figures[f"{name}_start_cpu_s"] = least[name, "prepared"]
        figures[f"{name}_start_with_numba_cpu_s"] = least[name, "numba"]
        figures[f"{name}_start_ratio"] = least[name, "prepared"] / least[name, "numba"]
    return figures


if __name__ == "__main__":
    for key, value in measure().items():
        print(f"{key:36} {value:.3f}")
