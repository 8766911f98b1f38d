"""Signals end a command as they should: with its exit code, at a moment that suits, and without a traceback."""

import gc
import importlib
import os
import signal
import subprocess
import sys
import time
import types
import weakref
from pathlib import Path

import pytest

from bike_training import cli
from bike_training.commands.declarations import COMMANDS, Command
from bike_training.interruption import interrupt, signals_handled, signals_noted

CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.fixture
def command(monkeypatch):
    """A command `bike wait` whose work the test gives."""
    module = types.SimpleNamespace()
    monkeypatch.setitem(sys.modules, "bike_training.commands.waits", module)
    waits = Command("waits", "no time", "", {"it": "waits:run"}, lambda args: "it", {})
    monkeypatch.setitem(COMMANDS, "wait", waits)
    return module


@pytest.mark.parametrize("number", CODES)
def test_the_exit_code_of_a_command_tells_the_signal(command, number, capsys):
    closed = []

    def run(args):
        try:
            signal.raise_signal(number)
            time.sleep(60.0)
        finally:
            closed.append(True)

    command.run = run
    before = [signal.getsignal(each) for each in CODES]
    assert cli.main(["wait"]) == CODES[number]
    assert capsys.readouterr().err == "bike wait: interrupted\n"
    assert closed
    assert [signal.getsignal(each) for each in CODES] == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_handles_a_signal_itself_and_stops_early_has_its_exit_code(command, number, capsys):
    """As learning does, which writes a checkpoint and tells what it learned."""

    def run(args):
        came = []
        with signals_handled(lambda *_: came.append(True)):
            signal.raise_signal(number)
        assert came
        return {"ok": False}

    command.run = run
    assert cli.main(["wait", "--json"]) == CODES[number]
    assert capsys.readouterr().out == '{"ok": false}\n'


@pytest.mark.parametrize(("ok", "code"), [(True, 0), (False, 1)])
def test_without_a_signal_figures_decide(command, ok, code):
    command.run = lambda args: {"ok": ok}
    assert cli.main(["wait"]) == code


def test_a_signal_that_is_ignored_stays_so(command):
    """As nohup has it."""

    def run(args):
        signal.raise_signal(signal.SIGHUP)
        return {"ok": True}

    command.run = run
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert cli.main(["wait"]) == 0
    finally:
        signal.signal(signal.SIGHUP, before)


def test_an_interruption_waits_until_a_module_is_loaded(tmp_path, monkeypatch):
    """An exception there would be lost, or become an error of the module."""
    text = "import signal, time\nsignal.raise_signal(signal.SIGTERM)\ntime.sleep(0.2)\nWHOLE = True\n"
    (tmp_path / "bike_loads_slowly.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with signals_noted() as code, signals_handled(interrupt):
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012 - it comes some time after the module is whole
            assert importlib.import_module("bike_loads_slowly").WHOLE
            time.sleep(60.0)
        assert code() == 143


def test_an_interruption_is_not_lost_where_exceptions_are_ignored():
    """Python ignores exceptions of destructors and of callbacks of weak references and of garbage collection (JAX)."""

    class Ends:
        def __del__(self):
            signal.raise_signal(signal.SIGTERM)

    class Forgotten:
        pass

    called = []

    def collect(phase, info):
        if not called:
            called.append(phase)
            signal.raise_signal(signal.SIGTERM)

    def ends_while_collecting():
        gc.callbacks.append(collect)
        try:
            while not called:
                gc.collect(0)  # does nothing while another thread collects
        finally:
            gc.callbacks.remove(collect)

    def forgets():
        weakref.finalize(Forgotten(), signal.raise_signal, signal.SIGTERM)

    for ends in (ends_while_collecting, lambda: Ends() and None, forgets):
        with signals_handled(interrupt), pytest.raises(KeyboardInterrupt):  # noqa: PT012 - it comes some time later
            ends()
            time.sleep(60.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_can_be_interrupted_while_it_is_loaded(number, tmp_path):
    command = [sys.executable, "-m", "bike_training.cli", "train", "whipple", "--out", str(tmp_path / "run")]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
    ) as bike:
        maps = Path(f"/proc/{bike.pid}/maps")
        latest = time.monotonic() + 60.0
        while "numpy" not in maps.read_text():  # the command's own modules are being loaded
            assert time.monotonic() < latest
        bike.send_signal(number)
        words = bike.communicate(timeout=60.0)[1]
    assert bike.returncode == CODES[number], words
    assert "Traceback" not in words
    assert words.strip().endswith("interrupted")
