"""The `bike` command."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import signal
import sys
import threading
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import bike_sim
from bike_sim.documents import alternatives, shorten
from bike_training import learning_packages
from bike_training.commands.declarations import COMMANDS, NEED_ROS, CommandParser
from bike_training.envs.node_process import NodeLost
from bike_training.interruption import SHELL_BASE, interrupt, leave_at_once, signals_handled, signals_noted

LOADS_LONG: Final = 1.0
"""Time after which a line tells that a command is being loaded, s."""
LINEAR_ALGEBRA_THREADS: Final = "OPENBLAS_NUM_THREADS"
"""Variable of the environment with the number of threads of NumPy's matrix products."""
MAX_ERROR: Final = 300
"""Characters of an error's line."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: words of the command; None for those of this process, which then ends here where it is interrupted.

    Returns:
        0 when it did what was asked and its figures hold, 1 when its figures do not hold, 2 for bad input, 130 when
        interrupted by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP.
    """
    if arguments is None:
        # Before NumPy is loaded: its products here are small. Threads wait for each other, ten times as long beside
        # another program, and how many there are changes the last bits of a batch.
        os.environ.setdefault(LINEAR_ALGEBRA_THREADS, "1")
    code = _run(list(sys.argv[1:] if arguments is None else arguments), alone=arguments is None)
    if arguments is None and code > SHELL_BASE:
        # All is closed by now. Python's own farewell would unload compilers and middleware for another second.
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)
    return code


def _run(words: Sequence[str], alone: bool = False) -> int:
    name, *rest = words or [""]
    if name in ("", "-h", "--help"):
        print(_overview())
        return 0 if name else 2
    if name == "--version":
        print(f"bike {version(learning_packages.DISTRIBUTION)}")
        return 0
    prefix = f"bike {name}" if name in COMMANDS else "bike"
    note = _noted(f"{prefix}: loading what it needs{_first_start()}") if alone else nullcontext()
    with signals_noted() as interrupted_code:
        try:
            with signals_handled(leave_at_once), note:
                args = parse(name, rest)
                if (name, args.subject) in NEED_ROS:
                    for needed in ("rclpy", "bike_msgs"):
                        if importlib.util.find_spec(needed) is None:
                            raise ModuleNotFoundError(needed, name=needed)
                run = _load(COMMANDS[name].functions[args.subject])
            with signals_handled(interrupt):
                result = run(args)
        except ModuleNotFoundError as error:
            package = learning_packages.missing_package(error)
            if package is None:
                raise
            learning_packages.advise(name, package)
            return 2
        except (KeyboardInterrupt, ValueError, OSError, NodeLost) as error:
            interrupted = isinstance(error, KeyboardInterrupt) and SHELL_BASE + signal.SIGINT
            # Nodes that a signal ended may be missed before the interruption comes.
            code = interrupted_code() or interrupted or 2
            message = shorten(str(error), MAX_ERROR) if code == 2 else "interrupted"
            print(f"{prefix}: {message}", file=sys.stderr)
            return code
        if args.json:
            print(json.dumps(result))
        # Learning ends by itself after a signal, with a checkpoint, and reports what it learned.
        return 0 if result["ok"] else interrupted_code() or 1


def _first_start() -> str:
    """Return what to expect where no compiled kernel lies beside the simulator's sources."""
    compiled = Path(bike_sim.__path__[0]).glob("physics/*/__pycache__/*.nbi")
    if "NUMBA_CACHE_DIR" in os.environ or any(compiled):
        return ""
    return "; the first ride on a machine compiles it, which takes minutes"


@contextmanager
def _noted(text: str) -> Iterator[None]:
    """Print a line on standard error where the block takes long."""
    timer = threading.Timer(LOADS_LONG, print, [text], {"file": sys.stderr, "flush": True})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def parse(name: str, words: Sequence[str]) -> Namespace:
    """Return the arguments of a command, with its subject, and with the defaults for it.

    Args:
        name: of the command.
        words: after the name.

    Raises:
        ValueError: an unknown command, option or value, or an option that does not apply to the subject.
        FileNotFoundError: an unknown vehicle, rider or course.
    """
    if name not in COMMANDS:
        raise ValueError(f"unknown command {name!r}; {alternatives(name, COMMANDS)}")
    command = COMMANDS[name]
    parser = CommandParser(name)
    args = parser.parse_args(words)
    args.subject = command.subject(args)
    parser.resolve(args, args.subject)
    return args


def _overview() -> str:
    """Return the help of the command without a subcommand."""
    lines = [f"  {name:10} {command.summary}" for name, command in COMMANDS.items()]
    head = "usage: bike COMMAND ... | --help | --version\n\nAn open two-wheeler lab for ROS 2.\n\ncommands:"
    return "\n".join([head, *lines, "\nbike COMMAND --help shows options and examples."])


def _load(function: str) -> Callable[[Any], dict[str, Any]]:
    module, name = function.split(":")
    loaded: Callable[[Any], dict[str, Any]] = getattr(importlib.import_module(f"bike_training.commands.{module}"), name)
    return loaded


if __name__ == "__main__":
    sys.exit(main())
