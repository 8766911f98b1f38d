"""The stand-in for `ros2 run` against the documented behaviour of ros2run: search, messages, exit codes, signals."""

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st

STANDIN = Path(__file__).parents[2] / "tools" / "ros2_standin.py"
PATIENCE = 90.0
"""Longest wait for a program, s: what a busy machine may need."""
SHOW_ARGUMENTS = "#!/bin/sh\nprintf '%s\\n' \"$@\"\n"


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """An install prefix whose ament index knows the package `demo`, which has no executables yet."""
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "demo").touch()
    (tmp_path / "lib" / "demo").mkdir(parents=True)
    return tmp_path


def add(prefix: Path, path: str, text: str = SHOW_ARGUMENTS, mode: int = 0o755) -> Path:
    """Puts a file below lib/demo."""
    file = prefix / "lib" / "demo" / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    file.chmod(mode)
    return file


def start(prefix: Path, *arguments: str) -> subprocess.Popen[str]:
    environment = os.environ | {"AMENT_PREFIX_PATH": str(prefix)}
    command = [sys.executable, str(STANDIN), *arguments]
    # A test run in the background of a script ignores SIGINT, and what it starts would inherit that.
    return subprocess.Popen(
        command,
        env=environment,
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
    add(prefix, "show", SHOW_ARGUMENTS + "exit 7\n")
    arguments = ["--ros-args", "-p", "speed:=4.0", "--prefix", "x", "-h", "a b"]
    code, output, _ = ros2(prefix, "run", "demo", "show", *arguments)
    assert code == 7
    assert output.splitlines() == arguments


def test_prefix_is_split_by_shell_rules_and_comes_first(prefix: Path) -> None:
    path = add(prefix, "show")
    code, output, _ = ros2(prefix, "run", "--prefix", "echo -n 'two words'", "demo", "show", "last")
    assert code == 0
    assert output == f"two words {path} last"


def test_what_counts_as_an_executable(prefix: Path) -> None:
    """Files below the package's folder that may be run, hidden folders and Python modules left out."""
    add(prefix, "plain", mode=0o644)
    add(prefix, ".hidden/show")
    add(prefix, "show.py")
    add(prefix, "below/further/deep")
    assert ros2(prefix, "run", "nowhere", "show") == (1, "", "Package 'nowhere' not found")
    for name in ("plain", "show", "dee"):
        assert ros2(prefix, "run", "demo", name) == (1, "", "No executable found")
    assert ros2(prefix, "run", "demo", "deep", "here")[:2] == (0, "here\n")


def test_several_executables_are_listed_in_order(prefix: Path) -> None:
    paths = [add(prefix, name) for name in ("b/show", "a/show", "show")]
    code, output, errors = ros2(prefix, "run", "demo", "show")
    assert (code, output) == (1, "")
    assert errors.splitlines() == ["Multiple executables found:", *(f"- {paths[index]}" for index in (2, 1, 0))]


@pytest.mark.parametrize("arguments", [["run"], ["run", "demo"], ["topic", "list"], ["run", "--wrong", "demo", "show"]])
def test_wrong_usage(prefix: Path, arguments: list[str]) -> None:
    code, output, errors = ros2(prefix, *arguments)
    assert (code, output) == (2, "")
    assert "error:" in errors


def test_file_that_cannot_be_run_gets_one_line(prefix: Path) -> None:
    path = add(prefix, "show", "#!/no/such/interpreter\n")
    code, _, errors = ros2(prefix, "run", "demo", "show")
    assert code == 1
    assert errors.splitlines() == [f"cannot run {path}: No such file or directory"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_signal_reaches_the_executable_itself(prefix: Path, number: signal.Signals) -> None:
    script = "#!/usr/bin/env python3\nimport os, time\nprint(os.getpid(), flush=True)\ntime.sleep(600)\n"
    add(prefix, "wait", script)
    process = start(prefix, "run", "demo", "wait")
    assert process.stdout is not None
    assert int(process.stdout.readline()) == process.pid
    process.send_signal(number)
    process.communicate(timeout=PATIENCE)
    assert process.returncode == -number


@pytest.fixture(scope="module")
def standin() -> ModuleType:
    spec = importlib.util.spec_from_file_location("ros2_standin", STANDIN)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@given(arguments=st.lists(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))))
def test_any_arguments_reach_the_executable_unchanged(standin: ModuleType, arguments: list[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        commands: list[list[str]] = []
        patch.setattr(standin, "find_executable", lambda package, name: f"/lib/{package}/{name}")
        patch.setattr(standin.os, "execvp", lambda file, command: commands.append([file, *command]))
        standin.main(["run", "demo", "show", *arguments])
    assert commands == [["/lib/demo/show", "/lib/demo/show", *arguments]]
