"""`bike refine`: learn to ride exactly, through the derivatives of the bicycle."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

from tqdm import tqdm

from bike_policy.contract.bundle import load_bundle
from bike_training.arguments import make_folder
from bike_training.learning.refinement import Refinement, refine
from bike_training.learning.refinement_comparison import Comparison
from bike_training.learning.refinement_files import POLICY, TABLE
from bike_training.learning.refinement_settings import RefinementSettings
from bike_training.learning.setting_records import parse

LOG_EVERY: Final = 10.0
"""Time between lines of progress in a log file, s."""

EXAMPLES: Final = """examples:
  bike refine --out runs/exact                          from nothing
  bike refine --out runs/more --from runs/exact/policy --set segments=200 --set learning_rate=3e-4
  bike evaluate runs/exact/policy
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--out", type=Path, required=True, help="folder of the refinement")
    parser.add_argument("--from", dest="start", help="policy that it begins with (default: none, a new network)")
    parser.add_argument("--seed", type=int, help=f"seed of everything (default: {RefinementSettings.seed})")
    names = ", ".join(spec.name for spec in fields(RefinementSettings))
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help=f"change one setting: {names}")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Refine and return what came of it; not ok where no actor rides all rides of a comparison with a stable loop."""
    settings = RefinementSettings()
    for pair in args.set:
        name, equals, text = pair.partition("=")
        if not equals or name not in {spec.name for spec in fields(RefinementSettings)}:
            raise ValueError(f"--set takes NAME=VALUE with a setting of a refinement, got {pair!r}")
        settings = replace(settings, **{name: parse(name, text, getattr(settings, name))})
    if args.seed is not None:
        settings = replace(settings, seed=args.seed)
    start = None if args.start is None else load_bundle(args.start)
    make_folder("--out", args.out)
    if (args.out / TABLE).exists():
        raise ValueError(f"{args.out} already holds a refinement; choose another folder")
    every = 0.1 if sys.stderr.isatty() else LOG_EVERY
    with tqdm(total=settings.segments, unit="segment", smoothing=0.05, mininterval=every) as bar:

        def report(process: Refinement, found: Comparison | None) -> None:
            if found is not None:
                bar.set_postfix_str(f"{found.ridden} ridden, mean {found.mean_m:.4f} m", refresh=False)
            bar.update()

        summary = refine(settings, args.out, start, report)
    best = summary["best_selection"]
    if not args.json:
        print(
            f"{summary['segments']} segments, {summary['updates']} updates, {summary['steps']} control periods, "
            f"{summary['seconds']:.0f} s; best at segment {summary['best_segment']}: {best['ridden']} rides ridden, "
            f"mean {best['mean_m']:.4f} m, spectral radius {best['spectral_radius']:.3f}"
        )
        print(f"policy in {args.out / POLICY}; judge it with: bike evaluate {args.out / POLICY}")
    ok = best["swing_deg"] < 1.0 and best["spectral_radius"] < 1.0
    return {"schema": "bike.refine/1", "ok": ok, "figures": {**summary, "out": str(args.out)}}
