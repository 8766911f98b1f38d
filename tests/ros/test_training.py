"""Learning through ROS: a short run, its resume, and what is left when it is stopped."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path

import pytest

from bike_training.cli import main

pytestmark = pytest.mark.ros

PATIENCE = 120.0
"""Longest wait for anything, s. Nothing takes that long; it is what a busy machine may need."""

MARK = "BIKE_TEST_MARK"

SMALL = ("layers=8,8", "environments=2", "updates=1", "batch_size=16", "learning_starts=20")


def train(out: Path, steps: int, *more: str) -> list[str]:
    """Return the words of a run with a network that learns in no time."""
    words = ["train", "whipple", "--client", "ros", "--out", str(out), "--steps", str(steps), "--json", *more]
    if "--resume" not in more:
        words += ["--record-every", "0", "--set", "learner=sb3"]
        words += [word for setting in SMALL for word in ("--set", f"learner.{setting}")]
    return words


def nodes(mark: str) -> list[str]:
    """Return the nodes that run with a mark in their environment."""
    found = []
    for process in Path("/proc").iterdir():
        if process.name.isdigit():
            try:
                words = (process / "cmdline").read_bytes()
                if b"--ros-args" in words and f"{MARK}={mark}".encode() in (process / "environ").read_bytes():
                    found.append(words.replace(b"\0", b" ").decode())
            except OSError:
                continue  # it has ended, or is not ours
    return found


def until(condition: Callable[[], object], told: Callable[[], str] = str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"waited {PATIENCE} s in vain; {told()}"
        time.sleep(0.02)


@pytest.fixture
def mark(monkeypatch: pytest.MonkeyPatch) -> str:
    name = uuid.uuid4().hex
    monkeypatch.setenv(MARK, name)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    return name


@pytest.mark.slow
def test_a_short_run_and_its_resume(tmp_path: Path, mark: str, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    learned = []
    for words in (train(run, 80), train(run, 120, "--resume")):
        assert main(words) == 0
        assert nodes(mark) == []
        learned.append(json.loads(capsys.readouterr().out)["figures"])
    first, second = learned
    assert (first["steps"], second["steps"]) == (80, 120)
    assert 0 < first["updates"] < second["updates"]
    (ros,) = first["stages"]
    assert [ros] == second["stages"]
    assert (ros["client"], ros["engine"], ros["from_step"]) == ("ros", "pybullet", 0)
    assert not second["interrupted"]


@pytest.mark.parametrize("learning", [False, True], ids=["in its start", "while it learns"])
def test_a_run_that_is_stopped_leaves_no_node(tmp_path: Path, mark: str, learning: bool) -> None:
    run, words = tmp_path / "run", tmp_path / "words.txt"
    command = [sys.executable, "-m", "bike_training.cli", *train(run, 1_000_000, "--simulators", "1")]
    with words.open("w") as file, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=file, text=True) as bike:
        learns = "part 1"  # in the progress bar
        until(lambda: learns in words.read_text() if learning else nodes(mark), words.read_text)
        assert bike.poll() is None, words.read_text()
        bike.send_signal(signal.SIGTERM)
        printed = bike.communicate(timeout=PATIENCE)[0]
    assert bike.returncode == 143, words.read_text()
    until(lambda: not nodes(mark), lambda: f"left: {nodes(mark)}")
    assert "Traceback" not in words.read_text()
    if learning:
        figures = json.loads(printed)["figures"]
        assert figures["interrupted"]
        assert figures["steps"] > 0
        assert (run / "checkpoint" / "state.json").exists()
    else:
        assert printed == ""
