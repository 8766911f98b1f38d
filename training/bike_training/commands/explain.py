"""`bike explain`: which parts of its observation make a policy steer as it does, from a recorded ride."""

from __future__ import annotations

import argparse
import json
import math
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from bike_analysis import read_recording
from bike_policy.contract.bundle import Bundle, load_bundle
from bike_training.arguments import make_folder
from bike_training.explain.drawing import draw
from bike_training.explain.findings import Statement, correlation, state_findings
from bike_training.explain.observations import WHOLE_RIDE, RecordedObservations, policy_of, read_observations
from bike_training.explain.shap_values import Explanation, explain, set_values

EXAMPLES = """examples:
  bike explain out/ride/ride.mcap                        the policy that drove, on the slalom
  bike explain out/ride/ride.mcap --section "full circle" --out out/circle
  bike explain ride.mcap --policy runs/mine/policy       what another policy makes of the same states
  bike explain episode.mcap --policy runs/mine/policy --section all
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.description = "SHAP values of a policy's output on a recorded ride, two plots, and what they show."
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("recording", type=Path, help="an .mcap file or a rosbag2 directory")
    parser.add_argument("--policy", help="name or folder of a policy (default: the one the recording names)")
    parser.add_argument(
        "--section", default="slalom", help=f"section of the course, or {WHOLE_RIDE} (default: %(default)s)"
    )
    parser.add_argument("--ride", type=int, default=1, help="which ride of the recording (default: %(default)s)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/explain"),
        help="folder of explanation.json and .png (default: %(default)s)",
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Explain; not ok when the values do not sum to the outputs."""
    named = args.policy
    bundle = _policy(policy_of(read_recording(args.recording).notes, args.recording) if named is None else named)
    make_folder("--out", args.out)
    seen = read_observations(args.recording, bundle, args.section, args.ride)
    explanation = explain(bundle, seen.observations, silent=args.json)
    differ = _answers_differ(bundle, seen)
    statement = state_findings(explanation, differ)
    figures = _figures(bundle, seen, explanation, statement) | {"answers_differ_rad": _number(differ)}
    (args.out / "explanation.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    draw(explanation, f"{_headline(bundle, seen)}: what makes it steer", args.out / "explanation.png")
    if not args.json:
        print(_text(bundle, seen, explanation, statement))
        print(f"picture and figures: {args.out}")
    return {"schema": "bike.explain/1", "ok": explanation.additivity_error < 1e-5, "figures": figures}


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
    answers = np.clip(set_values(bundle, seen.observations) / seen.steering_limit, -1.0, 1.0)
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
