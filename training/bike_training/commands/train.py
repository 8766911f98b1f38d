"""`bike train`: learn to ride."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from tqdm import tqdm

from bike_sim.physics.engine import ENGINE_KINDS
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.envs.clients import CLIENT_KINDS
from bike_training.learning import run as learning
from bike_training.learning.presets import PRESETS
from bike_training.learning.process import LearningProcess
from bike_training.learning.run_settings import RunSettings, machines_of
from bike_training.learning.simulators import DEFAULT_SIMULATORS, ENGINES, SUPERBIKE_ENGINES, with_simulator
from bike_training.learning.subjects import RACE_CURRICULA

SUPERBIKE: Final = "superbike"
"""What to train, in place of a bicycle's name."""
DEFAULT_PRESET: Final = "fast"
SUPERBIKE_PRESETS: Final = {"fast": "race", "paper": "race_paper"}
"""Presets of superbikes by the names of those of bicycles, so that the same word means the same kind."""
DEFAULT_MACHINE: Final = "panigale_v4r"
RECORD_EVERY: Final = 10
LOG_EVERY: Final = 10.0
"""Time between lines of progress in a log file, s: they must not fill it."""

EXAMPLES = """examples:
  bike train whipple --out runs/a                        the default preset on the compiled engine
  bike train whipple --out runs/b --client ros           through ROS, with PyBullet behind it
  bike train whipple --out runs/c --preset paper         as published
  bike train whipple --out runs/a --resume --steps 2000000
  bike train whipple --out runs/a --resume --steps 2050000 --client ros   the last steps through ROS
  bike train whipple --out runs/d --set layers=128,128 --set gamma=0.98
  bike train superbike --out runs/r --circuit cremona --seed 3              races; the default preset
  bike train superbike --out runs/s --preset paper --curriculum spdl        as published, on our circuits
  bike train superbike --out runs/x --vehicle r1 --circuit barcelona,cremona
  bike train superbike --out runs/m --vehicle r1,zx10rr --set observation=told   one actor for two machines
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "subject", help=f"what to train: a bicycle, shipped or as a file, or `{SUPERBIKE}` for races (see --vehicle)"
    )
    parser.add_argument(
        "--vehicle",
        help=f"with `{SUPERBIKE}`: machines or their files, with commas between them (default: {DEFAULT_MACHINE})",
    )
    parser.add_argument("--circuit", help="of races: circuits, YAML or CSV files, with commas between them")
    parser.add_argument("--curriculum", choices=RACE_CURRICULA, help="of races (default: that of the preset)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument(
        "--preset",
        choices=sorted(PRESETS),
        help=f"settings (default: {DEFAULT_PRESET}; of races "
        f"{SUPERBIKE_PRESETS[DEFAULT_PRESET]}, and `paper` means {SUPERBIKE_PRESETS['paper']} there)",
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of the preset"
    )
    parser.add_argument("--client", choices=CLIENT_KINDS, help="where the simulator is (default: local)")
    parser.add_argument(
        "--engine",
        choices=ENGINE_KINDS,
        help=f"default: {ENGINES['local']} locally, {ENGINES['ros']} through ROS; "
        f"of superbikes {SUPERBIKE_ENGINES['local']}",
    )
    parser.add_argument(
        "--time-step",
        type=float,
        help=f"integration step of simulators, s (default: {RunSettings.time_step}); not of the compiled engine",
    )
    parser.add_argument(
        "--simulators",
        type=int,
        help="simulators side by side where they are not compiled into this process (default: "
        f"{DEFAULT_SIMULATORS}, or fewer where the preset rides fewer bicycles); the updates for each step of learning "
        "stay the preset's",
    )
    parser.add_argument("--seed", type=int, help=f"seed of everything (default: {RunSettings.seed})")
    parser.add_argument("--steps", type=int, help="learning steps in all (default: those of the preset)")
    parser.add_argument(
        "--until-finished", action=argparse.BooleanOptionalAction, help="stop when the curriculum is finished"
    )
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")
    parser.add_argument(
        "--checkpoint-every",
        type=int,
        help=f"learning steps between checkpoints (default: {RunSettings.checkpoint_every})",
    )
    parser.add_argument(
        "--record-every",
        type=int,
        help=f"validations between recorded rides; 0 records none (default: {RECORD_EVERY})",
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Learn and return the outcome; not ok when interrupted."""
    settings = _with_simulator(_resumed_settings(args) if args.resume else _new_settings(args), args)
    every = 0.1 if sys.stderr.isatty() else LOG_EVERY
    with tqdm(total=settings.preset.steps, unit="step", smoothing=0.05, mininterval=every) as bar:
        summary = learning.run(settings, args.out, lambda process: _show(bar, process), args.resume)
    figures = summary | {"out": str(args.out)}
    if not args.json:
        _print(figures)
    return {"schema": "bike.train/1", "ok": not summary["interrupted"], "figures": figures}


def _vehicle(args: argparse.Namespace) -> str:
    """Return the vehicle that is asked for.

    Raises:
        ValueError: options that do not go together.
    """
    if args.subject == SUPERBIKE:
        return args.vehicle or DEFAULT_MACHINE
    if args.vehicle is not None:
        raise ValueError(f"--vehicle {args.vehicle} goes with `bike train {SUPERBIKE}`, not with {args.subject!r}")
    return str(args.subject)


def _new_settings(args: argparse.Namespace) -> RunSettings:
    vehicle = _vehicle(args)
    races = isinstance(load_vehicle(machines_of(vehicle)[0]), Superbike)
    name = args.preset or DEFAULT_PRESET
    preset = PRESETS[SUPERBIKE_PRESETS.get(name, name) if races else name]
    changes = dict(_split(pair) for pair in args.set)
    options = (("--circuit", "circuits", args.circuit), ("--curriculum", "curriculum", args.curriculum))
    for option, setting, value in options:
        if value is None:
            continue
        if not races:
            raise ValueError(f"{option} {value} is for races, and {vehicle!r} is a bicycle")
        changes[setting] = value
    engine = (SUPERBIKE_ENGINES if races else ENGINES)["local"]
    settings = RunSettings(preset.override(changes), vehicle, args.seed or 0, engine=engine, record_every=RECORD_EVERY)
    return _with_choices(settings, args)


def _resumed_settings(args: argparse.Namespace) -> RunSettings:
    """Return the settings of a resumed run, with those that may change."""
    fixed = {
        "--preset": args.preset,
        "--set": args.set or None,
        "--seed": args.seed,
        "--circuit": args.circuit,
        "--curriculum": args.curriculum,
    }
    given = [option for option, value in fixed.items() if value is not None]
    if given:
        raise ValueError(f"a resumed run keeps what it began with: leave out {', '.join(given)}, or begin another run")
    settings = learning.stored_settings(args.out)
    vehicle = settings.vehicle if args.subject == SUPERBIKE and args.vehicle is None else _vehicle(args)
    if vehicle != settings.vehicle:
        raise ValueError(f"{args.out} holds a run of vehicle {settings.vehicle!r}, not of {vehicle!r}")
    return _with_choices(settings, args)


def _with_choices(settings: RunSettings, args: argparse.Namespace) -> RunSettings:
    """Return settings with those arguments that may change at each start."""
    if args.steps is not None:
        settings = replace(settings, preset=replace(settings.preset, steps=args.steps))
    names = ("checkpoint_every", "record_every", "until_finished")
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    return replace(settings, **given)


def _with_simulator(settings: RunSettings, args: argparse.Namespace) -> RunSettings:
    """Return settings with the simulator of the arguments."""
    return with_simulator(settings, args.client, args.engine, args.time_step, args.simulators)


def _split(pair: str) -> tuple[str, str]:
    name, equals, value = pair.partition("=")
    if not equals:
        raise ValueError(f"--set takes NAME=VALUE, got {pair!r}")
    return name, value


def _show(bar: tqdm[Any], process: LearningProcess) -> None:
    if not bar.n:  # steps of earlier sessions were not made in this one's time
        bar.initial = bar.n = bar.last_print_n = process.model.num_timesteps
    bar.set_postfix_str(process.words(), refresh=False)
    bar.update(process.model.num_timesteps - bar.n)


def _print(figures: dict[str, Any]) -> None:
    where = "finished" if figures["finished_at_step"] else f"in part {figures['part']}"
    print(
        f"{figures['steps']} steps, {figures['updates']} updates, {figures['seconds']:.0f} s; curriculum {where}"
        + (f" at step {figures['finished_at_step']}" if figures["finished_at_step"] else "")
    )
    print(f"run in {figures['out']}; make a policy of it with: bike export {figures['out']}")
