"""`bike train`: learn to ride."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bike_analysis.figures.numbers import lap_text
from bike_policy.riders.optimum import OPTIMUM, BestLap, shipped_lap
from bike_training.arguments import check_whole, make_folder
from bike_training.commands.declarations import SUPERBIKE
from bike_training.commands.evaluate import CIRCUIT
from bike_training.learning.presets import GradientSettings
from bike_training.learning.run_settings import (
    DEFAULT_PRESET,
    GRADIENT_POLICY,
    RunSettings,
    settings_of,
    with_simulator,
)
from bike_training.progress import progress_bar

if TYPE_CHECKING:
    from bike_training.learning.gradients import Comparison
    from bike_training.learning.imitation import Imitation
    from bike_training.learning.process import LearningProcess

# PyTorch and JAX are loaded late, after bad settings are refused: they take seconds.

SUPERBIKE_PRESETS: Final = {"fast": "race", "paper": "race_paper"}
"""Presets of superbikes by the names of those of bicycles, so that the same word means the same kind."""
RECORD_EVERY: Final = 10


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Learn and return the outcome; not ok when interrupted."""
    settings = _resumed_settings(args) if args.resume else _new_settings(args)
    from bike_training.learning.process import run as learn

    if not (settings.superbike or settings.until_finished or args.json):
        print(
            f"learns for {settings.preset.sac.steps:,} steps; --until-finished ends with the curriculum, after minutes"
        )
    with progress_bar("learning", "step", settings.expected_steps()) as bar:
        rounds = settings.preset.sac.rounds

        def show_round(imitation: Imitation) -> None:
            bar.set_postfix_str(f"imitation {imitation.done} of {rounds}, {imitation.lost} rides lost", refresh=True)

        summary = learn(settings, args.out, lambda process: _show(bar, process), args.resume, show_round)
    figures = summary | {"out": str(args.out)}
    if not args.json:
        _print(figures)
    return {"schema": "bike.train/1", "ok": not summary["interrupted"], "figures": figures}


def _new_settings(args: argparse.Namespace) -> RunSettings:
    races = args.subject == SUPERBIKE
    name = args.preset or DEFAULT_PRESET
    name = SUPERBIKE_PRESETS.get(name, name) if races else name
    changes: dict[str, Any] = {}
    for pair in args.set or ():
        setting, equals, changes[setting] = pair.partition("=")
        if not equals:
            raise ValueError(f"--set takes PATH=VALUE, got {pair!r}")
    asked = {"curriculum.circuits": args.course, "curriculum": args.curriculum}
    changes |= {setting: value for setting, value in asked.items() if value is not None}
    return settings_of({**vars(args), "preset": name, "set": changes}, RECORD_EVERY)


def _resumed_settings(args: argparse.Namespace) -> RunSettings:
    """Return the settings of a resumed run, with those that may change."""
    from bike_training.learning.process import stored_settings

    settings = stored_settings(args.out)
    if args.vehicle not in (None, settings.vehicle):
        raise ValueError(f"{args.out} holds a run of vehicle {settings.vehicle!r}, not of {args.vehicle!r}")
    if args.steps is not None:
        settings = replace(settings, preset=settings.preset.changed({"learner.steps": args.steps}))
    names = ("checkpoint_every", "record_every", "until_finished")
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    return with_simulator(replace(settings, **given), args.client, args.engine, args.time_step, args.simulators)


def _show(bar: Any, process: LearningProcess) -> None:
    if not bar.n:  # steps of earlier sessions were not made in this one's time
        bar.initial = bar.n = bar.last_print_n = process.model.num_timesteps
    bar.set_postfix_str(process.words(), refresh=False)
    bar.total = process.settings.expected_steps(process.model.num_timesteps)
    bar.update(process.model.num_timesteps - bar.n)


def _print(figures: dict[str, Any]) -> None:
    where = "finished" if figures["finished_at_step"] else f"in part {figures['part']}"
    print(
        f"{figures['steps']} steps, {figures['updates']} updates, {figures['seconds']:.0f} s; curriculum {where}"
        + (f" at step {figures['finished_at_step']}" if figures["finished_at_step"] else "")
    )
    if figures["interrupted"]:
        print(f"interrupted; go on with: bike train --out {figures['out']} --resume")
    if figures["updates"]:
        print(f"run in {figures['out']}; make a policy of it with: bike export {figures['out']}")


def run_refinement(args: argparse.Namespace) -> dict[str, Any]:
    """Learn through the derivatives of the bicycle.

    It is not ok where no actor rides all rides of a comparison with a stable loop.
    """
    settings = _new_settings(args)
    learner = settings.preset.learner
    if not isinstance(learner, GradientSettings):
        raise ValueError(f"preset {settings.preset.name!r} does not learn by gradients")
    from bike_training.learning.gradients import GradientLearning

    with progress_bar("learning", "segment", learner.segments) as bar:

        def report(process: GradientLearning, found: Comparison | None) -> None:
            if found is not None:
                bar.set_postfix_str(f"{found.ridden} ridden, mean {found.mean_m:.4f} m", refresh=False)
            bar.update()

        summary = GradientLearning(settings).run(args.out, report)
    best = summary["best_selection"]
    if not args.json:
        print(
            f"{summary['segments']} segments, {summary['updates']} updates, {summary['steps']} control periods, "
            f"{summary['seconds']:.0f} s; best at segment {summary['best_segment']}: {best['ridden']} rides ridden, "
            f"mean {best['mean_m']:.4f} m, spectral radius {best['spectral_radius']:.3f}"
        )
        print(f"policy in {args.out / GRADIENT_POLICY}; evaluate it with: bike evaluate {args.out / GRADIENT_POLICY}")
    ok = best["swing_deg"] < 1.0 and best["spectral_radius"] < 1.0
    return {"schema": "bike.train_exact/1", "ok": ok, "figures": {**summary, "out": str(args.out)}}


LAP_ROUNDS: Final = 40
"""Rounds of a search of a best lap."""


def run_lap_search(args: argparse.Namespace) -> dict[str, Any]:
    """Search the best lap of a superbike on a circuit, or go on with a search; not ok where it could not be improved.

    Raises:
        ValueError: a wrong argument, or a folder with another search. FileNotFoundError: an unknown name.
    """
    from bike_training.rollout.optimum import LAP_FILE, LapSearch, Progress  # late: its kernels take seconds

    rounds = LAP_ROUNDS if args.steps is None else args.steps
    check_whole("--steps", rounds, 1)
    seed = 0 if args.seed is None else args.seed
    check_whole("--seed", seed, 0)
    start = None
    if args.start is not None:
        shipped = shipped_lap(args.vehicle, args.course or CIRCUIT)
        start = BestLap.read(shipped if args.start == OPTIMUM else Path(args.start))
    make_folder("--out", args.out)
    search = LapSearch(args.vehicle, args.course or CIRCUIT, seed)
    try:
        progress = search.stored(args.out) or search.first(start)
        with progress_bar(f"{args.vehicle}, {args.course or CIRCUIT}", "round", rounds, quiet=args.json) as bar:
            bar.update(len(progress.curve) - 1)

            def report(found: Progress) -> None:
                search.store(found, args.out)
                bar.set_postfix_str(
                    f"{lap_text(found.lap.lap_time)}, best {lap_text(found.best.lap_time)}", refresh=False
                )
                bar.update(len(found.curve) - 1 - bar.n)

            search.store(progress, args.out)
            search.improve(progress, rounds, report)
    finally:
        search.close()
    first, best = progress.curve[0], progress.best.lap_time
    figures = {
        "vehicle": progress.best.vehicle, "circuit": progress.best.circuit, "seed": seed, "lap_s": best,
        "theory_s": search.theory_s, "excess": best / search.theory_s - 1.0, "first_s": first.lap_time,
        "curve": [point._asdict() for point in progress.curve], "out": str(args.out),
    }  # fmt: skip
    if not args.json:
        print(f"best lap: {lap_text(best)}, {best / search.theory_s - 1.0:+.2%} over the theoretical one")
        print(f"ride it with: bike ride --rider {args.out / LAP_FILE} --vehicle {args.vehicle} --course ...")
    return {"schema": "bike.train_lap/1", "ok": best < first.lap_time, "figures": figures}
