"""The stand-in for `ros2 run`: arguments, exit codes and signals are the executable's own."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

STANDIN = Path(__file__).parents[2] / "tools" / "ros2_standin.py"
PATIENCE = 90.0
"""Longest wait for a program, s: what a busy machine may need."""


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """An install prefix whose ament index knows the package `demo`."""
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "demo").touch()
    (tmp_path / "lib" / "demo").mkdir(parents=True)
    return tmp_path


def add(prefix: Path, name: str, text: str, mode: int = 0o755) -> Path:
    file = prefix / "lib" / "demo" / name
    file.write_text(text)
    file.chmod(mode)
    return file


def start(prefix: Path, *arguments: str) -> subprocess.Popen[str]:
    # A test run in the background of a script ignores SIGINT, and what it starts would inherit that.
    return subprocess.Popen(
        [sys.executable, str(STANDIN), *arguments],
        env=os.environ | {"AMENT_PREFIX_PATH": str(prefix)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def ros2(prefix: Path, *arguments: str) -> tuple[int, str, str]:
    """Exit code, standard output, and standard error without the line that says what this is."""
    process = start(prefix, *arguments)
    output, errors = process.communicate(timeout=PATIENCE)
    notice, _, rest = errors.partition("\n")
    assert "stand-in" in notice
    return process.returncode, output, rest.strip()


def test_arguments_and_exit_code_pass_through(prefix: Path) -> None:
    add(prefix, "show", "#!/bin/sh\nprintf '%s\\n' \"$@\"\nexit 7\n")
    arguments = ["--ros-args", "-p", "speed:=4.0", "--prefix", "x", "-h", "a b", "--", ""]
    code, output, _ = ros2(prefix, "run", "demo", "show", *arguments)
    assert (code, output.splitlines()) == (7, arguments)


def test_what_cannot_be_run_is_told_in_one_line(prefix: Path) -> None:
    add(prefix, "plain", "", mode=0o644)
    path = add(prefix, "broken", "#!/no/such/interpreter\n")
    assert ros2(prefix, "run", "nowhere", "show") == (1, "", "Package 'nowhere' not found")
    assert ros2(prefix, "run", "demo", "plain") == (1, "", "No executable found")
    assert ros2(prefix, "run", "demo", "broken") == (1, "", f"cannot run {path}: No such file or directory")
    code, output, errors = ros2(prefix, "topic", "list")
    assert (code, output) == (2, "")
    assert "error:" in errors


def test_a_signal_reaches_the_executable_itself(prefix: Path) -> None:
    add(prefix, "wait", "#!/bin/sh\necho $$\nexec sleep 600\n")
    process = start(prefix, "run", "demo", "wait")
    assert process.stdout is not None
    assert int(process.stdout.readline()) == process.pid
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE)
    assert process.returncode == -signal.SIGINT
