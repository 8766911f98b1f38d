"""`bike sweep` as a program that tests start, watch and end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import psutil

from bike_training.sweeps.runs import execute
from bike_training.sweeps.spec import load_sweep

from .conftest import assert_same, learned

PATIENCE = 900.0
"""Longest wait for anything, s. Nothing takes that long; it is what a busy machine may need."""


class Driver:
    """`bike sweep` as a program of its own."""

    def __init__(
        self, spec: Path, out: Path, *more: str, background: bool = False, environment: Mapping[str, str] | None = None
    ) -> None:
        """Start it in a process group of its own, as a shell does; `background` with SIGINT ignored."""
        self.out = out
        self.words = out.parent / f"{out.name}_{time.monotonic_ns()}.txt"
        command = [sys.executable, "-m", "bike_training.cli", "sweep", str(spec), "--out", str(out), *more]
        with self.words.open("w") as file:
            ignore = signal.SIG_IGN if background else signal.default_int_handler
            before = signal.signal(signal.SIGINT, ignore)
            try:
                self.process = subprocess.Popen(
                    command, stdout=file, stderr=subprocess.STDOUT, process_group=0, env=environment
                )
            finally:
                signal.signal(signal.SIGINT, before)

    def until(self, condition: Callable[[], Any]) -> Any:
        """Wait until something holds, and return it."""
        end = time.monotonic() + PATIENCE
        while not (found := condition()):
            assert time.monotonic() < end, self.words.read_text()
            assert self.process.poll() is None, self.words.read_text()
            time.sleep(0.05)
        return found

    def type_control_c(self) -> None:
        """Do what a terminal does: its whole process group gets the signal."""
        os.killpg(self.process.pid, signal.SIGINT)

    def family(self) -> list[psutil.Process]:
        """Return the driver and all processes below it."""
        me = psutil.Process(self.process.pid)
        return [me, *me.children(recursive=True)]

    def workers(self) -> list[psutil.Process]:
        """Return the processes that do runs now."""
        found = []
        for folder in (self.out / "runs").glob("*"):
            attempts = folder / "attempts.jsonl"
            if attempts.exists() and not (folder / "result.json").exists():
                pid = json.loads(attempts.read_text().splitlines()[-1])["pid"]
                if psutil.pid_exists(pid):
                    found.append(psutil.Process(pid))
        return found

    def checkpoints(self) -> list[Path]:
        """Return the checkpoints of runs that have not finished."""
        states = (self.out / "runs").glob("*/checkpoint/state.json")
        return [path for path in states if not (path.parents[1] / "result.json").exists()]

    def end(self) -> int:
        """Wait for its end and return its exit code."""
        return self.process.wait(PATIENCE)


def undisturbed(spec: Path, folder: Path) -> dict[str, dict[str, Any]]:
    """Return what the runs of a sweep learn, one after the other in this process, in reverse order."""
    sweep = load_sweep(spec)
    for run in reversed(sweep.runs):
        assert execute(run, folder / run.name)["status"] == "finished"
    return {run.name: learned(folder / run.name) for run in sweep.runs}


def assert_as_undisturbed(spec: Path, out: Path, folder: Path) -> None:
    for name, wanted in undisturbed(spec, folder).items():
        assert_same(learned(out / "runs" / name), wanted)
