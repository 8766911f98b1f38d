"""`bike analyze --explain`: which parts of its observation make a policy steer as it does, from a recorded ride."""

from __future__ import annotations

import argparse
import json
import math
import textwrap
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.progress import Progress

from bike_analysis import read_recording
from bike_policy.contract.bundle import Bundle, load_bundle
from bike_training.arguments import make_folder
from bike_training.explain.drawing import UNITS, draw, draw_blocks
from bike_training.explain.findings import Statement, correlation, state_findings
from bike_training.explain.observations import (
    WHOLE_RIDE,
    RaceObservations,
    RecordedObservations,
    policy_of,
    read_observations,
    read_race,
)
from bike_training.explain.shap_values import Explanation, explain, outputs_of

SCHEMA: Final = "bike.analyze_explanation/1"
SECTION: Final = "slalom"
"""Section of paths that is explained; races are explained whole."""
LARGEST_RESIDUAL: Final = 1e-5
"""By which values may miss the outputs."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Explain; not ok when the values do not sum to the outputs."""
    named = args.policy
    bundle = _policy(policy_of(read_recording(args.objects[0]).notes, args.objects[0]) if named is None else named)
    make_folder("--out", args.out)
    figures, text, ok = (_explain_race if bundle.layout.races else _explain_path)(args, bundle)
    (args.out / "explanation.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    if not args.json:
        print(text)
        print(f"picture and figures: {args.out}")
    return {"schema": SCHEMA, "ok": ok, "figures": figures}


def _explain_path(args: argparse.Namespace, bundle: Bundle) -> tuple[dict[str, Any], str, bool]:
    """Explain a policy that follows paths; return figures, text, and whether the values sum to its set points."""
    seen = read_observations(args.objects[0], bundle, args.section or SECTION, args.ride)
    explanation = explain(bundle, seen.observations, silent=args.json)
    differ = _answers_differ(bundle, seen)
    statement = state_findings(explanation, differ)
    figures = _figures(bundle, seen, explanation, statement) | {"answers_differ_rad": _number(differ)}
    draw(explanation, f"{_headline(bundle, seen)}: what makes it steer", args.out / "explanation.png")
    return figures, _text(bundle, seen, explanation, statement), explanation.additivity_error < LARGEST_RESIDUAL


def _explain_race(args: argparse.Namespace, bundle: Bundle) -> tuple[dict[str, Any], str, bool]:
    """Explain a policy that races; return figures, text, and whether the values sum to its actions."""
    with Progress(console=Console(stderr=True), disable=args.json, transient=True) as progress:
        riding = progress.add_task("riding again")
        seen = read_race(
            args.objects[0],
            bundle,
            args.section,
            args.ride,
            lambda step, steps: progress.update(riding, completed=step, total=steps),
        )
    explanation = explain(bundle, seen.observations, silent=args.json)
    part = "" if seen.section == WHOLE_RIDE else f", {seen.section}"
    headline = f"{bundle.name} on {seen.course or 'a circuit'}{part}"
    draw_blocks(explanation, f"{headline}: what makes it decide", args.out / "explanation.png")
    counts = f"{len(explanation.outputs)} of {len(seen.observations)} decisions"
    text = f"{headline}: {counts}\n\n{_race_text(seen, explanation)}"
    return _race_figures(bundle, seen, explanation), text, explanation.additivity_error < LARGEST_RESIDUAL


def _race_figures(bundle: Bundle, seen: RaceObservations, explanation: Explanation) -> dict[str, Any]:
    return {
        "recording": str(seen.recording),
        "policy": bundle.name,
        "course": seen.course,
        "section": seen.section,
        "decisions_count": len(seen.observations),
        "observations_count": len(explanation.outputs),
        "background_count": explanation.background,
        "permutations_count": explanation.permutations,
        "unchanged_blocks": list(explanation.steady),
        "seconds": round(explanation.seconds, 2),
        "commands_differ": seen.differ,
        "additivity_error": explanation.additivity_error,
        "actions": [
            {
                "action": action,
                "base": float(explanation.base[column]),
                "blocks": [
                    {
                        "name": explanation.parts[i],
                        "mean_abs": float(explanation.mean_abs[i, column]),
                        "share": float(explanation.shares[i, column]),
                    }
                    for i in np.argsort(-explanation.mean_abs[:, column])
                ],
            }
            for column, action in enumerate(explanation.actions)
        ],
    }


def _race_text(seen: RaceObservations, explanation: Explanation) -> str:
    lines = []
    for column, action in enumerate(explanation.actions):
        unit, sizes = UNITS[action], explanation.mean_abs[:, column]
        parts = [
            f"{explanation.parts[i].replace('_', ' ')} {unit.factor * sizes[i]:.2g} {unit.unit} "
            f"({explanation.shares[i, column]:.0%})"
            for i in np.argsort(-sizes)[:5]
        ]
        lines.append(f"- {unit.name}: {', '.join(parts)}")
    if seen.differ > 1e-6:
        lines.append(
            "- This policy did not drive the ride: its commands differ from the recorded ones by up to "
            f"{seen.differ:.2f}. It is explained on what another rider got to see."
        )
    if explanation.steady:
        steady = ", ".join(explanation.steady)
        lines.append(f"- Unchanged through the ride, and so without a value whatever it is worth: {steady}.")
    lines.append(
        "- A block is put in as a whole against those of other moments of the ride, so that the policy is also asked "
        "about mixtures that no ride has. The values are sizes, and say nothing of causes on the track."
    )
    return "\n".join(textwrap.fill(line, 110, subsequent_indent="  ") for line in lines)


def _policy(name: str) -> Bundle:
    """Load a policy that has an actor.

    Raises:
        FileNotFoundError: there is no such bundle. ValueError: the bundle cannot be read.
    """
    try:
        return load_bundle(name)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{error}; only a policy with an actor can be explained") from error


def _answers_differ(bundle: Bundle, seen: RecordedObservations) -> float:
    """Return the largest difference of a policy's set points to the recorded ones, rad; NaN without commands."""
    if not np.isfinite(seen.steering).any():
        return math.nan
    answers = np.clip(outputs_of(bundle, seen.observations) / seen.steering_limit, -1.0, 1.0)
    return float(np.nanmax(np.abs(answers - seen.steering))) * seen.steering_limit


def _headline(bundle: Bundle, seen: RecordedObservations) -> str:
    place = "the whole ride" if seen.section == WHOLE_RIDE else seen.section
    return f"{bundle.name} on {place} ({seen.course or 'course not recorded'}) at {np.mean(seen.speed):.1f} m/s"


def _text(bundle: Bundle, seen: RecordedObservations, explanation: Explanation, statement: Statement) -> str:
    verdict = {True: "yes", False: "no, the contrary", None: "not clear"}
    lines = [
        f"{_headline(bundle, seen)}: {len(explanation.outputs)} observations, {explanation.seconds:.1f} s",
        "",
        "What it shows",
        *(f"- {finding.sentence}" for finding in statement.findings),
        f"Steers into the fall: {verdict[statement.steers_into_the_fall]}. "
        f"Counter-steers: {verdict[statement.counter_steers]}.",
        "",
        "What it does not show",
        *(f"- {limit}" for limit in statement.limits),
    ]
    return "\n".join(textwrap.fill(line, 110, subsequent_indent="  ") for line in lines)


def _figures(
    bundle: Bundle, seen: RecordedObservations, explanation: Explanation, statement: Statement
) -> dict[str, Any]:
    names, values = explanation.layout.names, explanation.values
    features = [
        {
            "name": name,
            "mean_abs_rad": float(explanation.mean_abs[place]),
            "correlation": _number(correlation(explanation.features[:, place], values[:, place])),
        }
        for place, name in enumerate(names)
    ]
    return {
        "recording": str(seen.recording),
        "policy": bundle.name,
        "course": seen.course,
        "section": seen.section,
        "speed_mean_m_s": float(np.mean(seen.speed)),
        "observations_count": len(explanation.outputs),
        "background_count": explanation.background,
        "permutations_count": explanation.permutations,
        "seconds": round(explanation.seconds, 2),
        "base_rad": explanation.base,
        "additivity_error_rad": explanation.additivity_error,
        "features": sorted(features, key=lambda entry: -float(entry["mean_abs_rad"] or 0.0)),
        "findings": [
            {
                "subject": finding.subject,
                "features": list(finding.features),
                "correlation": _number(finding.correlation),
                "mean_abs_rad": finding.mean_abs,
                "share": finding.share,
                "sign": finding.sign,
                "sentence": finding.sentence,
            }
            for finding in statement.findings
        ],
        "steers_into_the_fall": statement.steers_into_the_fall,
        "counter_steers": statement.counter_steers,
        "limits": list(statement.limits),
    }


def _number(value: float) -> float | None:
    """A number as JSON can hold it."""
    return None if math.isnan(value) else value
