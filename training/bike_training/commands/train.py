"""`bike train`: learn to ride."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from bike_training.clients import CLIENT_KINDS
from bike_training.presets import PRESETS
from bike_training.process import LearningProcess, RunSettings

SETTINGS_FILE = "settings.json"

EXAMPLES = """examples:
  bike train whipple --out runs/a                        the default preset on the compiled engine
  bike train whipple --out runs/b --client ros           through ROS, with PyBullet behind it
  bike train whipple --out runs/c --preset paper         as published
  bike train whipple --out runs/a --resume --steps 2000000
  bike train whipple --out runs/a --resume --steps 2050000 --client ros   the last steps through ROS
  bike train whipple --out runs/d --set layers=128,128 --set gamma=0.98
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("vehicle", choices=["whipple"], help="what to train")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="fast", help="settings (default: %(default)s)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of the preset"
    )
    parser.add_argument("--client", choices=CLIENT_KINDS, help="where the simulator is (default: local)")
    parser.add_argument(
        "--engine", choices=["whipple", "pybullet"], help="default: whipple locally, pybullet through ROS"
    )
    parser.add_argument("--time-step", type=float, default=0.005, help="simulator's integration step, s")
    parser.add_argument(
        "--simulators",
        type=int,
        default=2,
        help="simulators side by side where they are not compiled into this process (default: %(default)s); "
        "the updates for each step of learning stay the preset's",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=1_000_000, help="learning steps in all (default: %(default)s)")
    parser.add_argument("--until-finished", action="store_true", help="stop when the curriculum is finished")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")
    parser.add_argument("--checkpoint-every", type=int, default=50_000, help="learning steps between checkpoints")
    parser.add_argument(
        "--record-every", type=int, default=10, help="validations between recorded rides; 0 records none"
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Learn and return what came of it; not ok when interrupted."""
    settings = _resumed_settings(args) if args.resume else _new_settings(args)
    process = LearningProcess(settings, args.out, args.steps, resume=args.resume)
    interrupted = False
    with tqdm(total=args.steps, initial=process.model.num_timesteps, unit="step", smoothing=0.05) as bar:
        try:
            process.run(lambda p: _show(bar, p))
        except KeyboardInterrupt:
            interrupted = True
    figures = process.summary() | {"interrupted": interrupted, "out": str(args.out)}
    if not args.json:
        _print(figures)
    return {"schema": "bike.train/1", "ok": not interrupted, "figures": figures}


def _new_settings(args: argparse.Namespace) -> RunSettings:
    overrides = dict(_split(pair) for pair in args.set)
    settings = RunSettings(
        preset=PRESETS[args.preset].override(overrides),
        seed=args.seed,
        time_step=args.time_step,
        checkpoint_every=args.checkpoint_every,
        record_every=args.record_every,
        until_finished=args.until_finished,
    )
    settings = _with_simulator(settings, args)
    args.out.mkdir(parents=True, exist_ok=True)
    if not (args.out / SETTINGS_FILE).exists():
        _store(settings, args.out)
    return settings


def _resumed_settings(args: argparse.Namespace) -> RunSettings:
    """Return the settings of a run that goes on, with another simulator if one is asked for."""
    path = args.out / SETTINGS_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{args.out} holds no run to resume ({path.name} is missing)")
    settings = RunSettings.from_json(json.loads(path.read_text(encoding="utf-8")))
    if args.client or args.engine:
        settings = _with_simulator(settings, args)
        _store(settings, args.out)
    return settings


def _store(settings: RunSettings, out: Path) -> None:
    (out / SETTINGS_FILE).write_text(json.dumps(settings.to_json(), indent=1), encoding="utf-8")


def _with_simulator(settings: RunSettings, args: argparse.Namespace) -> RunSettings:
    """Return settings with the simulator that the arguments ask for.

    Fewer bicycles at once learn as much from each of their steps.
    """
    if args.simulators < 1:
        raise ValueError(f"--simulators must be at least 1, got {args.simulators}")
    client = args.client or "local"
    engine = args.engine or ("pybullet" if client == "ros" else "whipple")
    settings = replace(settings, client=client, engine=engine)
    if settings.compiled:
        return settings
    preset = settings.preset
    count = min(args.simulators, preset.environments)
    updates = max(1, round(preset.updates * count / preset.environments))
    return replace(settings, preset=replace(preset, environments=count, updates=updates))


def _split(pair: str) -> tuple[str, str]:
    name, equals, value = pair.partition("=")
    if not equals:
        raise ValueError(f"--set takes NAME=VALUE, got {pair!r}")
    return name, value


def _show(bar: tqdm[Any], process: LearningProcess) -> None:
    progress = process.progress
    bar.set_postfix_str(
        f"part {min(progress.curriculum.part, 4)}{' done' if progress.curriculum.finished else ''}, "
        f"validation {progress.recent_error_m:.3f} m",
        refresh=False,
    )
    bar.update(process.model.num_timesteps - bar.n)


def _print(figures: dict[str, Any]) -> None:
    where = "finished" if figures["finished_at_step"] else f"in part {figures['part']}"
    print(
        f"{figures['steps']} steps, {figures['updates']} updates, {figures['seconds']:.0f} s; curriculum {where}"
        + (f" at step {figures['finished_at_step']}" if figures["finished_at_step"] else "")
    )
    print(f"run in {figures['out']}; make a policy of it with: bike export {figures['out']}")
