"""`bike analyze --replay`: replays a recording from its commands and reports whether the ride is the same."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any, Final

from bike_analysis.figures.cells import table_text
from bike_training.progress import progress_bar, setter
from bike_training.replay import Difference, Replay, RideSource, read_rides, ride_again

SCHEMA: Final = "bike.analyze_replay/1"
APART: Final = {
    "time s": "{time_s:.2f}",
    "apart m": "{position_m:.3g}",
    "roll °": "{roll_deg:+.3g}",
    "steer °": "{steer_deg:+.3g}",
}


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Replay all rides; not ok if one differs.

    Raises:
        FileNotFoundError: there is no such recording, or its vehicle or course is not here.
        ValueError: it cannot be replayed, with the reason.
    """
    recording, rides = read_rides(args.objects[0], args.namespace)
    episodes = [recorded.ride.episode for recorded in rides]
    if args.episode is not None and args.episode not in episodes:
        known = ", ".join(map(str, sorted(set(episodes))))
        raise ValueError(f"{recording.path} has no ride of episode {args.episode}; it has {known}")
    for warning in recording.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    found = []
    for recorded in rides:
        if args.episode in (None, recorded.ride.episode):
            found.append(_ride(recorded, args))
    figures = {"recording": str(recording.path), "warnings": list(recording.warnings), "rides": found}
    return {"schema": SCHEMA, "ok": all(ride["same"] for ride in found), "figures": figures}


def _ride(recorded: RideSource, args: argparse.Namespace) -> dict[str, Any]:
    began = time.monotonic()
    with progress_bar(f"ride {recorded.ride.index}", "step", quiet=args.json, leave=False) as bar:
        replay = ride_again(recorded, args.engine, args.time_step, setter(bar))
    if not args.json:
        print("\n".join(text_of(recorded, replay)))
    return figures_of(recorded, replay) | {"wall_s": round(time.monotonic() - began, 2)}


def figures_of(recorded: RideSource, replay: Replay) -> dict[str, Any]:
    """Return the results as plain values."""
    return {
        "ride": recorded.ride.index,
        "episode": recorded.ride.episode,
        "vehicle": recorded.vehicle,
        "engine": replay.config.engine,
        "time_step_s": replay.config.time_step,
        "as_recorded": recorded.start is not None and replay.config == recorded.start.config,
        "same": replay.same,
        "states": replay.states,
        "recorded_states": replay.recorded_states,
        "missing_states": replay.missing,
        "stopped": replay.stopped or None,
        "first_difference": replay.difference and replay.difference._asdict(),
        "apart": [apart._asdict() for apart in replay.apart],
        "learning_steps": replay.learned,
        "first_learning_difference": replay.learned_difference and replay.learned_difference._asdict(),
    }


def text_of(recorded: RideSource, replay: Replay) -> list[str]:
    """Return the results as text."""
    ride, config = recorded.ride, replay.config
    head = (
        f"ride {ride.index} (episode {ride.episode}, {recorded.vehicle}, {_physics(config.engine, config.time_step)})"
    )
    lines = [f"{head}: {_verdict(replay)}"]
    start = recorded.start
    if start is not None and config != start.config:
        lines.append(f"  recorded with {_physics(start.config.engine, start.config.time_step)}, so they must part")
    if replay.missing and not replay.stopped:
        lines.append(f"  {replay.missing} states are missing in the recording and were bridged by recorded commands")
    if replay.stopped:
        lines.append(f"  {replay.stopped}")
    if replay.apart:
        lines.append("  how far they are apart, now less recorded:")
        lines += [f"  {line}" for line in table_text(APART, [apart._asdict() for apart in replay.apart], left=0)]
    if replay.learned_difference is not None:
        lines.append(f"  what was learned from is not of this ride: {_where(replay.learned_difference)}")
    elif replay.learned:
        lines.append(f"  observations and rewards of {replay.learned} steps of learning are those of this ride")
    return lines


def _verdict(replay: Replay) -> str:
    if replay.difference is None:
        return f"the same ride, bit for bit, in {replay.states} of {replay.recorded_states} states"
    return f"not the same ride; {replay.states} states compared, the first that differs: {_where(replay.difference)}"


def _where(place: Difference) -> str:
    values = f"{place.field} is {place.recorded!r} in the recording, {place.ridden!r} now"
    return f"step {place.step} ({place.time_s:.2f} s), {values}"


def _physics(engine: str, time_step: float) -> str:
    return f"{engine} at {1e3 * time_step:g} ms"
