"""A node of this project as a child process in its own ROS domain, and how long nodes are waited for.

A limit counts their silence, not their work: the first start on a machine compiles the physics, for minutes where
others keep its processors busy. That is no reason to give up, and neither is a machine on which all takes its time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO, Any, Final

from bike_sim.ros.isolation import DOMAIN_VARIABLE, end_with_this_process, prepare_discovery

MAX_LOOK: Final = 1.0
"""Longest time between two looks that counts as silence, s: beyond it, this process itself was held up."""


class InactivityTimeout:
    """Counts the time without messages in which no process works, and reports when it is too long."""

    def __init__(self, limit: float, workers: Sequence[NodeProcess]) -> None:
        """Begin to count.

        Args:
            limit: longest silence, s.
            workers: processes whose work is no silence.
        """
        self._limit = limit
        self._workers = workers
        self.heard()

    def heard(self) -> None:
        """Start again: a message has arrived."""
        self._silence = 0.0
        self._looked = time.monotonic()

    def is_out(self) -> bool:
        """Check the processes, and return whether the silence is too long. To be called about ten times a second."""
        now = time.monotonic()
        if not any(worker.is_working() for worker in self._workers):
            self._silence += min(now - self._looked, MAX_LOOK)
        self._looked = now
        return self._silence > self._limit


STOP_TIMEOUT: Final = 3.0
"""Time that a node gets to end, s."""
FINISH_TIMEOUT: Final = 25.0
"""The same where its work must be finished, as that of a recorder, s."""


class NodeLost(RuntimeError):
    """A node ended that was needed, or did not answer in time."""


_running: Final[weakref.WeakSet[NodeProcess]] = weakref.WeakSet()


def tell_all_to_end() -> None:
    """Request all nodes of this program to end, without waiting: one after the other they would take too long."""
    for node in list(_running):
        node.request_end()


class NodeProcess(AbstractContextManager["NodeProcess"]):
    """A node started as ``python -m <module>``.

    It runs in its own session: a Ctrl-C at the terminal reaches its parent, which ends it in turn. If the parent
    is killed, the node notices and ends.
    """

    def __init__(self, module: str, parameters: Mapping[str, Any], domain_id: int, namespace: str = "bike") -> None:
        """Start the node.

        Args:
            module: its Python module.
            parameters: ROS parameters.
            domain_id: its ROS domain.
            namespace: of its topics.
        """
        self.module = module
        command = [sys.executable, "-m", module, "--ros-args", "-r", f"__ns:=/{namespace}"]
        command += ["--log-level", "warn"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={json.dumps(value)}"]
        environment = {**os.environ, DOMAIN_VARIABLE: str(domain_id)}
        prepare_discovery(environment)
        end_with_this_process(environment)
        self._words: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed by close()
        self.process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=self._words, start_new_session=True
        )
        _running.add(self)

    def __exit__(self, *_: object) -> None:
        """End the node."""
        self.close()

    def request_end(self) -> None:
        """Request the node to end, without waiting for it; one that has ended takes no notice."""
        self.process.terminate()

    def check(self) -> None:
        """Check that the node runs.

        Raises:
            NodeLost: it has ended; with its last words.
        """
        if self.process.poll() is not None:
            raise self._lost()

    def is_working(self) -> bool:
        """Return whether its main thread runs, waits for a processor or waits for a disk."""
        try:
            status = Path(f"/proc/{self.process.pid}/stat").read_text()
        except OSError:  # it has ended, which `check` reports
            return False
        return status.rpartition(")")[2].split()[0] in ("R", "D")

    def finish(self) -> None:
        """End the process and check that it could finish its work, as a recorder cannot on a full or very slow disk.

        Raises:
            NodeLost: it ended with its own error, with its last words, or had to be ended by force.
        """
        self._end(FINISH_TIMEOUT)
        if self.process.returncode:
            raise self._lost()

    def close(self) -> None:
        """End the process, if need be by force; a second call does nothing."""
        self._end()
        self._words.close()

    def _lost(self) -> NodeLost:
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").strip().splitlines()
        words = f": {lines[-1]}" if lines else ""
        return NodeLost(f"{self.module} ended with exit code {self.process.returncode}{words}")

    def _end(self, timeout: float = STOP_TIMEOUT) -> None:
        if self.process.poll() is None:
            self.request_end()
            try:
                self.process.wait(timeout)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
