"""A node of this project as a child process in its own ROS domain."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO, Any, Final

from bike_sim.ros.isolation import DOMAIN_VARIABLE, end_with_this_process, prepare_discovery

STOP_TIMEOUT: Final = 3.0
"""Time that a node gets to end, s."""
FINISH_TIMEOUT: Final = 25.0
"""The same where its work must be finished, as that of a recorder, s."""


class NodeLost(RuntimeError):
    """A node ended that was needed, or did not answer in time."""


_running: Final[weakref.WeakSet[NodeProcess]] = weakref.WeakSet()


def tell_all_to_end() -> None:
    """Tell all nodes of this program to end, without waiting: one after the other they would take too long."""
    for node in list(_running):
        node.tell_to_end()


class NodeProcess(AbstractContextManager["NodeProcess"]):
    """A node started as ``python -m <module>``.

    It runs in its own session: a Ctrl-C at the terminal reaches its parent, which ends it in turn. If the parent
    is killed, the node notices and ends.
    """

    def __init__(
        self,
        module: str,
        parameters: Mapping[str, Any],
        domain_id: int,
        namespace: str = "bike",
        log_level: str = "warn",
    ) -> None:
        """Start the node.

        Args:
            module: its Python module.
            parameters: ROS parameters.
            domain_id: its ROS domain.
            namespace: namespace of its topics.
            log_level: least severity that it prints.
        """
        self.module = module
        command = [sys.executable, "-m", module, "--ros-args", "-r", f"__ns:=/{namespace.strip('/')}"]
        command += ["--log-level", log_level]
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

    def tell_to_end(self) -> None:
        """Tell the node to end, without waiting for it; one that has ended takes no notice."""
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
            self.tell_to_end()
            try:
                self.process.wait(timeout)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
