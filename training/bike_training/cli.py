"""The `bike` command."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Sequence
from typing import Final

from bike_training.node_process import NodeLost

COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "ride": ("bike_training.commands.ride", "ride a course through the nodes, record it and report"),
    "train": ("bike_training.commands.train", "learn to ride"),
    "evaluate": ("bike_training.commands.evaluate", "ride a policy at 21 speeds and write down how well"),
    "export": ("bike_training.commands.export", "make a policy bundle of a run"),
    "analyze": ("bike_analysis.commands.analyze", "figures, plots and a report page from a recording"),
    "replay": ("bike_training.commands.replay", "ride a recorded ride again and tell whether it is the same"),
    "explain": ("bike_training.commands.explain", "which parts of its observation make a policy steer as it does"),
    "validate": ("bike_training.commands.validate", "hold the physics against its publications"),
    "lap": ("bike_training.commands.lap", "lap circuits on superbikes with the classical rider"),
    "course": ("bike_training.commands.course", "check a circuit's file, or draw a circuit"),
    "bench": ("bike_training.commands.bench", "measure speeds and compare them"),
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

    Returns:
        0 when it did what was asked and its figures hold, 1 when its figures do not hold, 2 for bad input, 130 when
        interrupted.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    chosen = next((word for word in words if not word.startswith("-")), None)
    args = build_parser(chosen).parse_args(words)
    module = importlib.import_module(COMMANDS[args.command][0])
    try:
        result = module.run(args)
    except (ValueError, OSError, NodeLost) as error:
        print(f"bike {args.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"bike {args.command}: interrupted", file=sys.stderr)
        return 130
    if args.json:
        print(json.dumps(result))
    return 0 if result["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
