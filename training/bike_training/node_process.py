"""A node of this project as a process of one's own, in its own ROS domain."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from types import TracebackType
from typing import IO, Any, Final, Self

from bike_sim.isolation import DOMAIN_VARIABLE, prepare_discovery

STOP_TIMEOUT: Final = 3.0
"""Time that a node gets to end, s."""


class NodeLost(RuntimeError):
    """A node ended that was needed, or did not answer in time."""


class NodeProcess:
    """A node started as ``python -m <module>``.

    It runs in a session of its own: a Ctrl-C at the terminal is for whoever started it, who ends it in turn.
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
        self._words: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed by close()
        self.process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=self._words, start_new_session=True
        )

    def __enter__(self) -> Self:
        """Return the running node."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the node."""
        self.close()

    def check(self) -> None:
        """Check that the node runs.

        Raises:
            NodeLost: it has ended; with its last words.
        """
        if self.process.poll() is not None:
            raise self._lost()

    def finish(self) -> None:
        """End the process and check that it could finish its work, as a recorder cannot on a full or very slow disk.

        Raises:
            NodeLost: it ended with an error of its own, with its last words, or had to be ended by force.
        """
        self._end()
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

    def _end(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
