"""`bike race`: machines against each other on one circuit; recording, table, page, and the same race again."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.figures.cells import table_text
from bike_analysis.page.race_page import PAGE_NAME, RaceFigures, Racer, write_race_page
from bike_policy.riders.wheel_to_wheel import CLASSICAL, RaceField
from bike_sim.course.course import Course
from bike_sim.course.projection import project
from bike_sim.physics import state as st
from bike_sim.sim.race import CLEARED, TOUCHED, Race, RaceSettings, check_names, entries_of
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_whole, recording_folder
from bike_training.progress import progress_bar, told_parts

if TYPE_CHECKING:
    from bike_training.nodes.race_recording import RecordedRace

FloatArray = NDArray[np.float64]

SCHEMA: Final = "bike.race/1"
MACHINES: Final = ("panigale_v4r", "r1", "m1000rr", "zx10rr")
PAGE_PERIOD: Final = 0.04
"""Time between the states of a page, s."""
REACH: Final = 8.0
"""Distance along the circuit within which a machine is looked for from one state to the next, m."""
RESULT: Final = {
    "machine": "{name}", "vehicle": "{vehicle}", "rider": "{rider}", "end": "{end}", "pos": "{position}",
    "grid": "{grid}", "laps": "{laps}", "time": "{time_s!l}", "penalty": "{penalty_s:.1f}",
    "best lap": "{best_lap_s!l}", "passes": "{passes:+d}", "contacts": "{contacts}", "avoidable": "{avoidable}",
}  # fmt: skip
"""Columns of the classification."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Race, record, write the page; ok when at least one machine has finished.

    Raises:
        ValueError: what is no race, or a rider that cannot race.
        FileNotFoundError: an unknown vehicle, rider or circuit.
    """
    check_whole("--laps", args.laps, 1)
    settings = RaceSettings(args.course, args.laps, entries_of(args.machines or MACHINES, CLASSICAL), args.line)
    check_names([entry.name for entry in settings.entries])
    from bike_training.nodes.race_recording import RaceRecorder  # a refusal needs no ROS

    began = time.monotonic()
    with recording_folder(args.out, "race", args.overwrite) as out:
        report = told_parts("bike race", args.json)
        recording, race = out / "race.mcap", Race(settings, report)
        try:
            field = RaceField.of(race, report=report)
            total = round(race.theory * (settings.laps + 0.1))
            with (
                RaceRecorder(recording, race, overwrite=True) as recorder,
                progress_bar(f"race on {args.course}", "s", total, quiet=args.json, leave=False) as bar,
            ):
                for commands, events in field.ride(race):
                    recorder.step(commands, events)
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

    recorded, centre = RecordedRace.read(recording), race.track.centre
    lines = {line["name"]: line for line in recorded.result["classification"]}
    cleared = {event.names[0]: event.time for event in recorded.events if event.kind == CLEARED}
    powered = isinstance(race.batch.vehicles[0], Superbike)
    racers = []
    for row, entry in enumerate(recorded.settings.entries):
        line = lines[entry.name]
        columns = racer_columns(recorded, row, centre, race.batch.config.control_period, powered)
        until = int(np.searchsorted(columns["time"], cleared.get(entry.name, np.inf), "right"))
        end = line["end"].replace("_", " ") if line["end"] not in ("finished", "running") else ""
        contacts = [event.time for event in recorded.events if event.kind == TOUCHED and entry.name in event.names]
        racers.append(Racer(entry.name, line["grid"], {name: c[:until] for name, c in columns.items()}, end, contacts))
    laps = recorded.settings.laps
    figures = RaceFigures(
        f"{laps} {'lap' if laps == 1 else 'laps'} of {recorded.settings.course}", recorded.result["classification"],
        [(int(lap), int(sector), str(name), float(gap)) for lap, sector, name, gap in recorded.result["gaps"]],
        [(event.time, event.text) for event in recorded.events], racers, centre, powered,
    )  # fmt: skip
    return write_race_page(figures, path)


def racer_columns(
    recorded: RecordedRace, row: int, centre: Course, period: float, powered: bool
) -> dict[str, FloatArray]:
    """Return what the page shows of a machine, by column; distances are those of the centre line from the start line.

    Args:
        recorded: the race.
        row: of the machine.
        centre: line of the circuit.
        period: control period, s.
        powered: whether it has an engine.
    """
    states, steps = recorded.states[:, row], np.arange(len(recorded.states))
    x, y, distance = states[:, st.X], states[:, st.Y], np.zeros(len(states))
    near = float(centre.s[np.argmin(np.hypot(centre.x - x[0], centre.y - y[0]))]) - centre.length
    for step in steps:
        near, _, _ = project(centre.samples, x[step], y[step], near, REACH, REACH)
        distance[step] = near
    throttle = np.append(recorded.commands[:, row, 1], recorded.commands[-1:, row, 1])
    every = steps[:: max(1, round(PAGE_PERIOD / period))]
    columns = {
        "time": steps * period, "distance": distance, "x": x, "y": y, "yaw": states[:, st.YAW],
        "roll": np.degrees(states[:, st.ROLL]), "steer": np.degrees(states[:, st.STEER]),
        "speed": (3.6 if powered else 1.0) * recorded.speeds[:, row], "throttle": 100.0 * np.maximum(throttle, 0.0),
        "brake": 100.0 * np.maximum(-throttle, 0.0),
    }  # fmt: skip
    return {name: column[every] for name, column in columns.items()}


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
