"""Programs forked from a process that has loaded what they need: their starts take most of the time of these tests.

That they start from nothing is tested with `bike ride`, `ros2 run` and the launch files.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

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
    process = _CONTEXT.Process(target=int)
    process.start()
    process.join()
