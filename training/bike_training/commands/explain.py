"""`bike analyze --explain`: which parts of its observation make a policy steer as it does, from a recorded ride."""

from __future__ import annotations

import argparse
import json
import textwrap
from contextlib import ExitStack
from functools import cache
from typing import Any, Final

import numpy as np

from bike_analysis import read_recording
from bike_policy.contract.bundle import Bundle, load_bundle
from bike_training.arguments import make_folder
from bike_training.explain.drawing import UNITS, draw
from bike_training.explain.observations import (
    WHOLE_RIDE,
    RecordedObservations,
    policy_of,
    read_observations,
)
from bike_training.explain.shap_values import Explanation, correlation, explain
from bike_training.progress import progress_bar, setter

SCHEMA: Final = "bike.analyze_explanation/2"
SECTION: Final = "slalom"
"""Section of paths that is explained; races are explained whole."""
LARGEST_RESIDUAL: Final = 1e-5
"""By which values may miss the outputs."""
SAME_COMMANDS: Final = 1e-3
"""Largest difference of commands of a policy that drove the ride, as a part of the largest command."""
LISTED: Final = 5
"""Parts of each action that are printed."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Explain; not ok when the values do not sum to the outputs."""
    path = args.objects[0]
    bundle = load_bundle(policy_of(read_recording(path).notes, path) if args.policy is None else args.policy)
    make_folder("--out", args.out)
    section = args.section or (WHOLE_RIDE if bundle.layout.races else SECTION)
    with ExitStack() as shown:
        # Opened with the first step, so that nothing but the error is printed where there is none.
        report = cache(lambda: setter(shown.enter_context(progress_bar("riding again", "step", quiet=args.json))))
        seen = read_observations(path, bundle, section, args.ride, lambda done, total: report()(done, total))
    explanation = explain(bundle, seen.observations, silent=args.json)
    place = "the whole ride" if seen.section == WHOLE_RIDE else seen.section
    headline = f"{bundle.name} on {place} ({seen.course or 'course not recorded'})"
    draw(explanation, f"{headline}: what makes it decide", args.out / "explanation.png")
    figures = _figures(bundle, seen, explanation)
    (args.out / "explanation.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    if not args.json:
        print(f"{headline}: {len(explanation.outputs)} of {len(seen.observations)} observations\n")
        print("\n".join(textwrap.fill(line, 110, subsequent_indent="  ") for line in _lines(figures, explanation)))
        print(f"picture and figures: {args.out}")
    return {"schema": SCHEMA, "ok": explanation.additivity_error < LARGEST_RESIDUAL, "figures": figures}


def _figures(bundle: Bundle, seen: RecordedObservations, explanation: Explanation) -> dict[str, Any]:
    """Return the figures; sizes are in the unit of the action, rad, m or a part of the largest command."""
    count = len(explanation.parts)
    values = explanation.values.reshape(len(explanation.values), count, -1)
    sizes, shares = (each.reshape(count, -1) for each in (explanation.mean_abs, explanation.shares))

    def part(row: int, column: int) -> dict[str, Any]:
        of_one = None if bundle.layout.races else correlation(explanation.features[:, row], values[:, row, column])
        size, share = float(sizes[row, column]), float(shares[row, column])
        return {"name": explanation.parts[row], "mean_abs": size, "share": share, "correlation": _number(of_one)}

    return {
        "recording": str(seen.recording),
        "policy": bundle.name,
        "course": seen.course,
        "section": seen.section,
        "observations_count": len(seen.observations),
        "explained_count": len(explanation.outputs),
        "background_count": explanation.background,
        "permutations_count": explanation.permutations,
        "unchanged_parts": list(explanation.steady),
        "seconds": round(explanation.seconds, 2),
        "commands_differ": seen.differ,
        "additivity_error": explanation.additivity_error,
        "actions": [
            {
                "action": action,
                "base": float(np.atleast_1d(explanation.base)[column]),
                "parts": [part(row, column) for row in np.argsort(-sizes[:, column], kind="stable")],
            }
            for column, action in enumerate(explanation.actions)
        ],
    }


def _lines(figures: dict[str, Any], explanation: Explanation) -> list[str]:
    """Return what the figures show, and what they do not, as lines of text."""
    lines = []
    for entry in figures["actions"]:
        unit, parts = UNITS[entry["action"]], []
        for each in entry["parts"][:LISTED]:
            sign = "" if each["correlation"] is None else f", correlation {each['correlation']:+.2f}"
            size = f"{unit.factor * each['mean_abs']:.2g} {unit.unit}"
            parts.append(f"{each['name'].replace('_', ' ')} {size} ({each['share']:.0%}{sign})")
        lines.append(f"- {unit.name}: {', '.join(parts)}")
    differ = figures["commands_differ"]
    if differ > SAME_COMMANDS:
        lines.append(
            f"- This policy did not drive the ride: its commands differ from the recorded ones by up to {differ:.2f} "
            "of the largest. It is explained on what another rider got to see."
        )
    if explanation.steady:
        lines.append(f"- Unchanged, and so without a value whatever they are worth: {', '.join(explanation.steady)}.")
    lines.append(
        f"- The values hold for these observations against {explanation.background} of their own. Parts are varied "
        "each on their own, so the policy is also asked about states that no ride has, and large values of opposite "
        "sign may cancel."
    )
    return lines


def _number(value: float | None) -> float | None:
    """Return a number as JSON can hold it."""
    return None if value is None or not np.isfinite(value) else value
