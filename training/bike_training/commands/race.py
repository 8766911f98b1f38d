"""`bike race`: machines against each other on one circuit; recording, table, page, and the same race again."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from bike_analysis.figures.cells import table_text
from bike_analysis.page.race_page import PAGE_NAME, RaceFigures, write_race_page
from bike_policy.riders.wheel_to_wheel import CLASSICAL, RaceField
from bike_sim.sim.race import Entry, Race, RaceSettings
from bike_training.arguments import check_whole, recording_folder
from bike_training.progress import progress_bar

SCHEMA: Final = "bike.race/1"
MACHINES: Final = ("panigale_v4r", "r1", "m1000rr", "zx10rr")
RESULT: Final = {
    "machine": "{name}", "vehicle": "{vehicle}", "rider": "{rider}", "end": "{end}", "pos": "{position}",
    "grid": "{grid}", "laps": "{laps}", "time": "{time_s!l}", "penalty": "{penalty_s:.1f}",
    "best lap": "{best_lap_s!l}", "passes": "{passes:+d}", "contacts": "{contacts}", "avoidable": "{avoidable}",
}  # fmt: skip
"""Columns of the classification."""


def entries_of(machines: list[str]) -> tuple[Entry, ...]:
    """Return machines given as ``[NAME=]VEHICLE[:RIDER]``; those without a name are numbered."""
    entries = []
    for number, text in enumerate(machines, start=1):
        name, _, rest = text.rpartition("=")
        vehicle, _, rider = rest.partition(":")
        entries.append(Entry(name or f"bike_{number}", vehicle, rider or CLASSICAL))
    return tuple(entries)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Race, record, write the page; ok when at least one machine has finished.

    Raises:
        ValueError: what is no race, or a rider that cannot race.
        FileNotFoundError: an unknown vehicle, rider or circuit.
    """
    check_whole("--laps", args.laps, 1)
    settings = RaceSettings(args.course, args.laps, entries_of(args.machines or list(MACHINES)), args.line)
    from bike_training.nodes.race_recording import RaceRecorder, check_names  # a refusal needs no ROS

    check_names([entry.name for entry in settings.entries])
    began = time.monotonic()
    with recording_folder(args.out, "race", args.overwrite) as out:
        recording, race = out / "race.mcap", Race(settings)
        try:
            riders = [entry.rider for entry in settings.entries]
            field = RaceField(riders, race.batch.vehicles, race.batch.config.control_period)
            for row in range(race.count):
                field.begin(row, race.batch, race.batch.course(row))
            total = round(race.theory * (settings.laps + 0.1))
            with (
                RaceRecorder(recording, race, overwrite=True) as recorder,
                progress_bar(f"race on {args.course}", "s", total, quiet=args.json, leave=False) as bar,
            ):
                while not race.over:
                    commands = field.commands(race.batch, race.step_number)
                    recorder.step(commands, race.step(commands))
                    if race.step_number % 50 == 0:
                        bar.update(round(race.time) - bar.n)
                recorder.finish()
            lines = [line._asdict() for line in race.classification()]
            figures = {
                "course": args.course, "laps": args.laps, "time_s": race.time, "classification": lines,
                "events": [event._asdict() for event in race.log], "contact_energy_j": race.energy,
                "recording": str(recording), "page": str(page_of(recording, race, out / PAGE_NAME)),
                "wall_s": round(time.monotonic() - began, 1),
            }  # fmt: skip
        finally:
            race.close()
    if not args.json:
        for event in figures["events"]:
            print(f"{event['time']:8.2f} s  {event['text']}")
        print("\n".join(table_text(RESULT, lines, left=4)))
        print(f"report: {figures['page']}")
    return {"schema": SCHEMA, "ok": any(line["end"] == "finished" for line in lines), "figures": figures}


def page_of(recording: Path, race: Race, path: Path) -> Path:
    """Write the page of a recorded race; the limits are those of its circuit."""
    from bike_training.nodes.race_recording import RecordedRace

    recorded, track = RecordedRace.read(recording), race.track
    heading = track.centre.heading[::20]
    sides = ((track.width_left[::20], 1.0), (track.width_right[::20], -1.0))
    limits = [
        np.stack([
            track.centre.x[::20] - sign * width * np.sin(heading), track.centre.y[::20] + sign * width * np.cos(heading)
        ])
        for width, sign in sides
    ]  # fmt: skip
    gaps = [(int(lap), int(sector), str(name), float(gap)) for lap, sector, name, gap in recorded.result["gaps"]]
    figures = RaceFigures(
        f"{recorded.settings.laps} laps of {recorded.settings.course}", recorded.result["classification"], gaps,
        [(event.time, event.text) for event in recorded.events], [entry.name for entry in recorded.settings.entries],
        recorded.states[:, :, 0], recorded.states[:, :, 1], race.time, np.array(limits),
    )  # fmt: skip
    return write_race_page(figures, path)


def run_replay(args: argparse.Namespace) -> dict[str, Any]:
    """Race a recording again; ok where every state and every event is the same.

    Raises:
        ValueError: no race, or one whose machines are others now.
        FileNotFoundError: no recording, or a machine or circuit that is not here.
    """
    from bike_training.nodes.race_recording import RecordedRace

    recorded = RecordedRace.read(args.replay)
    compared, difference = recorded.replay()
    if not args.json:
        print(f"{compared} states of {len(recorded.settings.entries)} machines, {difference or 'the same bit for bit'}")
    figures = {"states": compared, "recorded_states": len(recorded.states), "difference": difference}
    return {"schema": SCHEMA, "ok": not difference, "figures": figures}
