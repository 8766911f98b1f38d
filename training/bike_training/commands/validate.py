"""`bike validate`: the physics against publications, statics and closed formulas; circuits against their rules."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from bike_analysis.figures.cells import lines_of
from bike_analysis.figures.numbers import lap_text
from bike_analysis.figures.results import finite
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS
from bike_policy.riders.classical import ClassicalRider
from bike_sim.course.course import Course
from bike_sim.course.drawing import track_figure
from bike_sim.course.files import load_track
from bike_sim.course.track import Track
from bike_sim.planning.envelope import point_mass_envelope
from bike_sim.planning.lap_limit import LapLimit, lap_limit
from bike_sim.planning.minimum_time import with_fastest_line
from bike_sim.sim.config import superbike_config
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.validation import bicycle, energy, parameters, published, superbike
from bike_sim.validation.report import Check, Report
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_superbike, load_vehicle, vehicle_template
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, make_folder
from bike_training.commands.declarations import ALL_SUPERBIKES
from bike_training.progress import told_parts
from bike_training.rollout.laps import ride_laps
from bike_training.rollout.rollout import rollout

BICYCLE_PERIOD: Final = 0.05
"""Control period of a bicycle, s; integration steps must not be longer."""
SUPERBIKE_PERIOD: Final = 0.02
"""The same of a superbike, s."""
BOLD: Final = (0.9, 0.92)
"""Parts of the lateral limit that riders use who try the theoretical laps; the last falls at times."""

LAP_COURSE: Final = "barcelona"
CALM: Final = 0.7
"""Part of the lateral limit of a rider who laps calmly."""
ACCOUNT_STEPS: Final = (0.002, 0.001)
"""Steps at which the energy of a lap must close, s."""
LAP_STEPS: Final = (0.004, *ACCOUNT_STEPS, 0.0005)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Measure a bicycle, print tables unless `args.json`, and return the result.

    Raises:
        ValueError: a broken vehicle's file, or an invalid step.
        OSError: an unknown vehicle or a folder that cannot be made.
    """
    vehicle = load_vehicle(args.vehicle)
    check_positive("--time-step", args.time_step, "s", BICYCLE_PERIOD)
    head = {"schema": "bike.validate/1", "vehicle": vehicle.name, "engine": args.engine, "time_step_s": args.time_step}
    title = f"{vehicle.name}, {args.engine}, step {1e3 * args.time_step:g} ms"
    return _report(args, head, title, partial(bicycle.validate, vehicle, args.engine, args.time_step))


def run_superbikes(args: argparse.Namespace) -> dict[str, Any]:
    """Measure one superbike or all shipped ones, print tables unless `args.json`, and return the result.

    Raises:
        ValueError: a broken vehicle's file, or an invalid step.
        OSError: an unknown vehicle or a folder that cannot be made.
    """
    names = superbike.MACHINES if args.vehicle == ALL_SUPERBIKES else (args.vehicle,)
    machines = [load_superbike(name) for name in names]
    check_positive("--time-step", args.time_step, "s", SUPERBIKE_PERIOD)

    def measure(progress: Callable[[str], None]) -> Report:
        if machines[0].joints is not None:
            report = published.validate(machines[0], args.time_step, progress)
        else:
            report = superbike.validate(machines, args.time_step, progress)
            progress("theoretical laps")
            report.checks += bound_checks(names)
        progress("energy of a lap")
        return add_laps(report, names)

    engine = "" if machines[0].joints is not None else f", PyBullet, step {1e3 * args.time_step:g} ms"
    head = {"schema": "bike.validate_superbike/1", "time_step_s": args.time_step}
    return _report(args, head, ", ".join(machine.name for machine in machines) + engine, measure)


def run_parameters(args: argparse.Namespace) -> dict[str, Any]:
    """Compare the eigenvalues of measured bicycles with the closed formulas, print a table, and return the result.

    Raises:
        ValueError: a broken file.
        FileNotFoundError: there is none.
    """
    head = {"schema": "bike.validate_parameters/1"}
    return _report(args, head, "measured bicycles", partial(parameters.validate, args.parameters))


def _report(
    args: argparse.Namespace, head: dict[str, Any], title: str, measure: Callable[[Callable[[str], None]], Report]
) -> dict[str, Any]:
    """Measure, print and write a report, and return it for JSON.

    Args:
        args: ``json`` and ``out`` (folder or None).
        head: first entries of the result.
        title: of the table of checks.
        measure: makes the report; takes who shows the progress.
    """
    if args.out is not None:
        make_folder("--out", args.out)
    report = measure(told_parts("measuring", args.json))
    if not args.json:
        for name, rows in report.tables.items():
            print(_table(name, rows))
        print(_check_table(title, report))
    answer = finite(head | report.as_dict())
    if args.out is not None:
        written = [args.out / f"{answer['schema'].split('/')[0].removeprefix('bike.')}.json"]
        written[0].write_text(json.dumps(answer, indent=2) + "\n", encoding="utf-8")
        if report.modes:
            from bike_training.commands.validation_pictures import draw_modes

            written.append(draw_modes(report.modes, args.out / "modes.png"))
        if not args.json:
            print("written: " + ", ".join(str(path) for path in written))
    return answer


def _table(title: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of plain values as a table for people, each in a column where that is narrower."""
    keys = [key for key, value in rows[0].items() if not isinstance(value, list)]
    cells = [[key.replace("_", " ") for key in keys]]
    cells += [[f"{row[key]:.4g}" if isinstance(row[key], float) else str(row[key]) for key in keys] for row in rows]
    if len(rows) < len(keys):
        cells = [list(column) for column in zip(*cells, strict=True)]
    return "\n".join([title, *lines_of(cells), ""])


def bound_checks(names: Sequence[str]) -> Iterator[Check]:
    """Return checks of laps of bold riders on random circuits against the theoretical laps, their bounds.

    Args:
        names: of superbikes, or their files.
    """
    margin, passed, unpaid, tightest = math.inf, 0.0, 0, math.inf
    for seed, vehicle in enumerate(names):
        for lateral in BOLD:
            rider = ClassicalRider(replace(CLASSICAL_SETTINGS, lateral=lateral))
            ride, passings = ride_laps(vehicle, f"random_circuit:{seed}", 1, rider=rider, engine="compiled")
            passed = max([passed, *(passing.excess for passing in passings)])
            unpaid += sum(not passing.repaid for passing in passings)
            if ride["laps"]:
                margin, tightest = min(margin, ride["closest_excess"]), min(tightest, ride["excess"])
    yield Check("bound_lap_margin", "fastest lap over the closest line's theoretical lap, share", margin, -0.001, 0.06)
    yield Check("bound_line_margin", "fastest lap over its own line's theoretical lap, share", tightest, -0.001, 0.06)
    yield Check("bound_passings_unpaid", "gains on the theoretical lap not lost again", unpaid, 0.0, 0.0)
    yield Check("bound_passed", "largest speed above the theoretical lap's, share", passed, 0.0, 0.03)


class _OnePlan(ClassicalRider):
    """Keeps its first plan, so that laps differ by the integration step alone."""

    _first: tuple[Vehicle, Course] | None = None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare for a ride; see `ClassicalRider`."""
        self._first = self._first or (vehicle, course)
        super().begin(*self._first, period, preview)


def add_laps(report: Report, names: Sequence[str]) -> Report:
    """Add laps of a circuit's median at several steps: their energy, and what the step does to their time.

    Args:
        report: to which checks and a table are added.
        names: of superbikes, or their files.
    """
    rests, spreads, rows = [], [], []
    for name in names:
        rider, times = _OnePlan(replace(CLASSICAL_SETTINGS, lateral=CALM)), []
        for step in LAP_STEPS if name == names[0] else ACCOUNT_STEPS:
            lap, account = _ridden_lap(rider, name, step)
            times.append(lap)
            if step in ACCOUNT_STEPS:
                rests.append(abs(account.rest))
                work = {f"{entry}_j": value for entry, value in account.work.items()}
                rows.append(
                    {"vehicle": name, "step_s": step} | work | {"stored_j": account.stored, "rest": account.rest}
                )
        spreads.append(max(times) / min(times) - 1.0)
    title = "rest of the energy of a lap at 2 and 1 ms, share of the engine's work"
    report.checks.append(Check("energy_rest", title, max(rests), 0.0, energy.ALLOWED))
    title = "a lap at steps of 0.5 to 4 ms: largest difference of its times, share"
    report.checks.append(Check("lap_step", title, spreads[0], 0.0, 0.002))
    report.tables["energy"] = rows
    return report


def _ridden_lap(rider: ClassicalRider, name: str, step: float) -> tuple[float, energy.Account]:
    """Return the time (s) of a lap at an integration step (s), infinite after a fall, and the account of its energy."""
    machine = Simulator(replace(superbike_config(name), engine="compiled", time_step=step))
    request = machine.at_own_speed(ResetRequest(course=LAP_COURSE, line=0.0))
    parts, commands = [], []
    for snapshot in rollout(machine, rider, request):
        if snapshot.step:
            commands.append((snapshot.steering, snapshot.throttle))
        if snapshot.fallen or machine.batch.log(0).laps:
            break
        stored = machine.batch.state_dict()
        assert stored is not None
        parts.append((stored["slot"]["motion"], stored["slot"]["memory"], stored["rows"]["ground"]))
    assert isinstance(machine.vehicle, Superbike)
    assert machine.begun is not None
    assert machine.begun.followed is not None
    kinds = energy.PERIOD_KINDS
    motion, memory, ground = (
        np.concatenate(rows).reshape(-1).view(kind) for rows, kind in zip(zip(*parts, strict=True), kinds, strict=True)
    )
    periods = energy.Periods(motion, memory, ground, np.array(commands), machine.begun.followed.road.bumps)
    lap = math.inf if snapshot.fallen else machine.batch.log(0).laps[0].duration
    return lap, energy.account(machine.vehicle, periods, step, machine.config.substeps)


def _check_table(title: str, result: Report) -> str:
    """Return the checks as a table for people."""
    rows = [("figure", "measured", "reference", "allowed", "")]
    for check in result.checks:
        digits = ".4g" if abs(check.measured) >= 1e-3 or not check.measured else ".1e"
        limits = f"≤ {check.high:.4g}" if check.low in (0.0, -math.inf) else f"{check.low:.4g} to {check.high:.4g}"
        reference = f"{check.reference:.4g}" if check.reference else ""
        verdict = "pass" if check.passed else "FAIL"
        rows.append((check.title, format(float(check.measured), digits), reference, limits, verdict))
    return "\n".join([title, *lines_of(rows)])


def run_template(args: argparse.Namespace) -> dict[str, Any]:
    """Print a vehicle's file with all keys explained, or return it.

    Raises:
        ValueError: a broken file. FileNotFoundError: an unknown vehicle.
    """
    text = vehicle_template(args.vehicle)
    if not args.json:
        print(text)
    return {"schema": "bike.validate_template/1", "ok": True, "figures": {"file": text}}


LARGEST_LATERAL: Final = 10.0
"""Largest cornering of a reference machine, in g: far more than any has, and far from where no line is found."""


def run_circuit(args: argparse.Namespace) -> dict[str, Any]:
    """Check or draw, print a table unless `args.json`, and return the figures.

    Raises:
        ValueError: the file is broken. FileNotFoundError: it does not exist.
    """
    check_positive("--lateral-g", args.lateral_g, "g", LARGEST_LATERAL)
    if args.out is not None:
        make_folder("--out", args.out)
    envelope = point_mass_envelope(args.lateral_g)
    told_parts("computing", args.json)("the fastest line")
    track = with_fastest_line(load_track(args.course), envelope)
    ideal, median = lap_limit(envelope, track.line(1.0)), lap_limit(envelope, track.line(0.0))
    figures = _circuit_figures(track, ideal, median)
    if not args.json:
        print(_table(f"{track.name}: a sound circuit", [figures | {"corners": len(track.corners)}]))
    if args.out is not None:
        path = args.out / f"{track.name}.png"
        title = (
            f"{track.name}: {track.length:.0f} m, {track.direction}, {len(track.corners)} corners; "
            f"{ideal.machine}: {lap_text(ideal.lap_time)}"
        )
        track_figure(track, track.line(1.0), ideal.s, ideal.speed, title).savefig(path, dpi=100)
        if not args.json:
            print(f"written: {path}")
        figures["picture"] = str(path)
    return {"schema": "bike.validate_course/1", "ok": ideal.lap_time <= median.lap_time, "figures": figures}


def _circuit_figures(track: Track, ideal: LapLimit, median: LapLimit) -> dict[str, Any]:
    width = track.width_left + track.width_right
    return {
        "circuit": track.name,
        "length_m": track.length,
        "direction": track.direction,
        "width_min_m": float(width.min()),
        "width_max_m": float(width.max()),
        "radius_min_m": float(1.0 / np.abs(track.centre.curvature).max()),
        "height_range_m": float(np.ptp(track.elevation)),
        "corners": [
            {"name": corner.name, "direction": corner.direction, "apex_m": corner.apex, "radius_m": corner.radius}
            for corner in track.corners
        ],
        "machine": ideal.machine,
        "ideal_lap_s": ideal.lap_time,
        "median_lap_s": median.lap_time,
        "ideal_length_m": float(ideal.s[-1]),
    }
