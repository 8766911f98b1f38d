"""Programs forked from a process that has loaded what they need: their starts take most of the time of these tests.

That they start from nothing is tested with `bike train`, `ros2 run`, and by the packages' own tests.
"""

from __future__ import annotations

import functools
import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

from bike_sim.ros.isolation import PARENT_VARIABLE

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["tests.ros.loaded"])


class Forked:
    """A module's `main` run as a program, with the part of `subprocess.Popen` that tests use."""

    def __init__(self, module: str, words: Sequence[str], environment: Mapping[str, str], output: Path) -> None:
        """Start it with the words of its command line; what it prints goes to a file."""
        command = (module, [module, *words], dict(environment), str(Path.cwd()), str(output))
        self._process = _CONTEXT.Process(target=_run, args=command, daemon=True)
        self._process.start()
        assert self._process.pid is not None
        self.pid = self._process.pid

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        code = self._process.exitcode
        if code is None:
            raise TimeoutError(f"process {self.pid} has not ended within {timeout} s")
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class Popen:
    """The part of `subprocess.Popen` that `NodeProcess` uses: ``python -m MODULE ...``, and a file for its words."""

    def __init__(self, command: Sequence[str], *, env: Mapping[str, str], stderr: IO[bytes], **_: Any) -> None:
        """Start the module."""
        _, _, module, *words = command
        # By its number, since the file has no name. The node's parent is the process that forks.
        output = Path(f"/proc/{os.getpid()}/fd/{stderr.fileno()}")
        self._forked = Forked(module, words, {**env, PARENT_VARIABLE: str(_forking())}, output)
        self.pid = self._forked.pid

    @property
    def returncode(self) -> int | None:
        return self._forked.poll()

    def poll(self) -> int | None:
        return self._forked.poll()

    def wait(self, timeout: float | None = None) -> int:
        try:
            return self._forked.wait(timeout)
        except TimeoutError as error:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0) from error

    def terminate(self) -> None:
        self._forked.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self._forked.kill()


def _run(module: str, words: list[str], environment: dict[str, str], folder: str, output: str) -> None:
    with Path(output).open("w") as file:
        for descriptor in (1, 2):
            os.dup2(file.fileno(), descriptor)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    sys.argv = words
    sys.path[:0] = filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))
    importlib.import_module(module).main()


def load() -> None:
    """Wait until programs can be forked."""
    _forking()


@functools.cache
def _forking() -> int:
    """Return the number of the process that forks, which has loaded all."""
    ours, theirs = _CONTEXT.Pipe()
    process = _CONTEXT.Process(target=_tell_parent, args=(theirs,))
    process.start()
    number: int = ours.recv()
    process.join()
    return number


def _tell_parent(pipe: Connection) -> None:
    pipe.send(os.getppid())
