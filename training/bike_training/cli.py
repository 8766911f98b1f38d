"""The `bike` command."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from bike_training import learning_packages
from bike_training.envs.node_process import NodeLost
from bike_training.interruption import SHELL_BASE, interrupt, leave_at_once, signals_handled, signals_noted

COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "ride": ("bike_training.commands.ride", "ride a course through the nodes, record it and report"),
    "live": ("bike_training.commands.live", "ride in a browser: watch, steer, and compare with other riders"),
    "train": ("bike_training.commands.train", "learn to ride"),
    "refine": ("bike_training.commands.refine", "learn to ride exactly, through the derivatives of the bicycle"),
    "evaluate": ("bike_training.commands.evaluate", "ride a policy at 21 speeds and write down how well"),
    "export": ("bike_training.commands.export", "make a policy bundle of a run"),
    "analyze": ("bike_analysis.commands.analyze", "figures, plots and a report page from a recording"),
    "replay": ("bike_training.commands.replay", "ride a recorded ride again and tell whether it is the same"),
    "explain": ("bike_training.commands.explain", "which parts of its observation make a policy steer as it does"),
    "validate": ("bike_training.commands.validate", "hold the physics against its publications"),
    "lap": ("bike_training.commands.lap", "lap circuits on superbikes, with the classical or a learned rider"),
    "course": ("bike_training.commands.course", "check a circuit's file, or draw a circuit"),
    "bench": ("bike_training.commands.bench", "measure speeds and compare them"),
    "sweep": ("bike_training.commands.sweep", "do many runs from one file, and go on where they stopped"),
    "report": ("bike_analysis.commands.report", "tables with intervals, curves and a page of a sweep"),
    "reproduce": ("bike_training.commands.reproduce", "do the experiments of a publication again"),
    "curves": ("bike_training.commands.curves", "learning curves of several runs"),
}
"""Name, module and one line of each command. Modules are loaded when they are called."""


def build_parser(chosen: str | None) -> argparse.ArgumentParser:
    """Return the parser; only the chosen command declares its arguments, so that others need not be loaded."""
    parser = argparse.ArgumentParser(prog="bike", description="An open two-wheeler lab for ROS 2.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (module, summary) in COMMANDS.items():
        sub = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        sub.add_argument("--json", action="store_true", help="print one JSON object on standard output, nothing else")
        if name == chosen:
            importlib.import_module(module).configure(sub)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: words of the command; None for those of this process, which then ends here where it is interrupted.

    Returns:
        0 when it did what was asked and its figures hold, 1 when its figures do not hold, 2 for bad input, 130 when
        interrupted by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP.
    """
    code = _run(list(sys.argv[1:] if arguments is None else arguments))
    if arguments is None and code > SHELL_BASE:
        # All is closed by now. Python's own farewell would unload compilers and middleware for another second.
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)
    return code


def _run(words: Sequence[str]) -> int:
    chosen = next((word for word in words if not word.startswith("-")), None)
    with signals_noted() as interrupted_code:
        try:
            with signals_handled(leave_at_once):
                args = build_parser(chosen).parse_args(words)
                command = importlib.import_module(COMMANDS[args.command][0])
            with signals_handled(interrupt):
                result = command.run(args)
        except ModuleNotFoundError as error:
            package = learning_packages.missing_package(error)
            if package is None:
                raise
            return learning_packages.offer(str(chosen), package)
        except (KeyboardInterrupt, ValueError, OSError, NodeLost) as error:
            interrupted = isinstance(error, KeyboardInterrupt) and SHELL_BASE + signal.SIGINT
            # Nodes that a signal ended may be missed before the interruption comes.
            code = interrupted_code() or interrupted or 2
            print(f"bike {chosen}: {error if code == 2 else 'interrupted'}", file=sys.stderr)
            return code
        if args.json:
            print(json.dumps(result))
        # Learning ends by itself after a signal, with a checkpoint, and tells what it learned.
        return 0 if result["ok"] else interrupted_code() or 1


if __name__ == "__main__":
    sys.exit(main())
