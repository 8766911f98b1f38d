"""`bike validate`: the physics against publications, statics and closed formulas; circuits against their rules."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from rich.console import Console, Group
from rich.table import Table

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
from bike_sim.validation import bicycle, energy, superbike
from bike_sim.validation.parameters import SPEEDS, measured_bicycles
from bike_sim.validation.published import Mode, Torque, check_published, check_rides, measured_modes, steady_torques
from bike_sim.validation.report import Check, Report
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_superbike, load_vehicle, vehicle_template
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, make_folder
from bike_training.commands.declarations import ALL_SUPERBIKES
from bike_training.progress import status, text_table
from bike_training.rollout.laps import ride_laps
from bike_training.rollout.rollout import rollout

SCHEMA: Final = "bike.validate/1"
SUPERBIKE_SCHEMA: Final = "bike.validate_superbike/1"
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

_Report = TypeVar("_Report", bound=Report)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Measure a bicycle, print tables unless `args.json`, and return the result.

    Raises:
        ValueError: a broken vehicle's file, or an invalid step.
        OSError: an unknown vehicle or a folder that cannot be made.
    """
    vehicle = load_vehicle(args.vehicle)

    def measure(progress: Callable[[str], None]) -> bicycle.Validation:
        return bicycle.validate(vehicle, args.engine, args.time_step, progress)

    def draw(result: bicycle.Validation, folder: Path) -> Sequence[Path]:
        from bike_training.commands.validation_pictures import draw_bicycle_modes

        draw_bicycle_modes(vehicle, args.engine, args.time_step, folder / "modes.png")
        return (folder / "modes.png",)

    def describe(result: bicycle.Validation) -> dict[str, Any]:
        head = {"schema": SCHEMA, "vehicle": vehicle.name, "engine": args.engine}
        return head | result.as_dict({"modes": [_mode_figures(point) for point in result.points]})

    check_positive("--time-step", args.time_step, "s", BICYCLE_PERIOD)
    title = f"{vehicle.name}, {args.engine}, step {1e3 * args.time_step:g} ms"
    return _report(args, title, measure, describe, draw, _mode_table)


def run_superbikes(args: argparse.Namespace) -> dict[str, Any]:
    """Measure one superbike or all shipped ones, print tables unless `args.json`, and return the result.

    Raises:
        ValueError: a broken vehicle's file, or an invalid step.
        OSError: an unknown vehicle or a folder that cannot be made.
    """
    names = superbike.MACHINES if args.vehicle == ALL_SUPERBIKES else (args.vehicle,)
    machines = [load_superbike(name) for name in names]

    modes: list[Mode] = []  # of a machine that gives way, beside published ones
    torques: list[Torque] = []
    accounts: dict[str, dict[float, energy.Account]] = {}

    def measure(progress: Callable[[str], None]) -> superbike.Validation:
        if machines[0].joints is not None:
            progress("statics and modes beside published ones")
            modes.extend(measured_modes(machines[0]))
            checks = list(check_published(machines[0], modes))
            result = superbike.Validation(args.time_step, checks, machines=tuple(machines))
            progress("steady turns")
            torques.extend(steady_torques(machines[0]))
            performance = superbike.measure_performance(machines[0], args.time_step)
            result.performance.append(performance)
            result.checks.extend(check_rides(machines[0], torques, performance))
        else:
            result = superbike.validate(machines, args.time_step, progress)
            progress("theoretical laps")
            result.checks.extend(bound_checks(names))
            result.performance.extend(superbike.measure_performance(each, args.time_step) for each in machines)
        progress("energy of a lap")
        result.checks.extend(lap_checks(names, accounts))
        return result

    def draw(result: superbike.Validation, folder: Path) -> Sequence[Path]:
        from bike_training.commands.validation_pictures import draw_root_loci, draw_superbikes

        return (draw_root_loci(modes, folder / "root_loci.png"),) if modes else draw_superbikes(result, folder)

    def describe(result: superbike.Validation) -> dict[str, Any]:
        figures = _superbike_figures(result) | _energy_figures(accounts) | {"torques": _torque_figures(torques)}
        return {"schema": SUPERBIKE_SCHEMA} | result.as_dict(figures)

    def tables(result: superbike.Validation) -> Group:
        beside = _torque_table(torques) if torques else _range_table(result)
        return Group(beside, _performance_table(result), _energy_table(accounts))

    check_positive("--time-step", args.time_step, "s", SUPERBIKE_PERIOD)
    engine = (
        "steps of the comparisons" if machines[0].joints is not None else f"PyBullet, step {1e3 * args.time_step:g} ms"
    )
    title = f"{', '.join(machine.name for machine in machines)}, {engine}"
    return _report(args, title, measure, describe, draw, tables)


def _report(
    args: argparse.Namespace,
    title: str,
    measure: Callable[[Callable[[str], None]], _Report],
    describe: Callable[[_Report], dict[str, Any]],
    draw: Callable[[_Report, Path], Sequence[Path]],
    table: Callable[[_Report], Table | Group],
) -> dict[str, Any]:
    """Measure, print and write a report, and return it for JSON.

    Args:
        args: ``json`` and ``out`` (folder or None).
        title: of the table of checks.
        measure: makes the report; takes who shows the progress.
        describe: returns it for JSON.
        draw: makes pictures in a folder.
        table: of what is beside the checks.
    """
    if args.out is not None:
        make_folder("--out", args.out)
    console = Console(quiet=args.json)
    with status(console, "measuring") as progress:
        result = measure(progress)
    console.print(table(result), _check_table(title, result))
    answer = finite(describe(result))
    if args.out is not None:
        written = [args.out / f"{answer['schema'].split('/')[0].removeprefix('bike.')}.json", *draw(result, args.out)]
        written[0].write_text(json.dumps(answer, indent=2) + "\n", encoding="utf-8")
        console.print("written: " + ", ".join(str(path) for path in written))
    return answer


def bound_checks(names: Sequence[str]) -> Iterator[Check]:
    """Return checks of laps of bold riders on random circuits against the theoretical laps, their bounds.

    Args:
        names: of superbikes, or their files.
    """
    margin, passed, unpaid, tightest = math.inf, 0.0, 0, math.inf
    for seed, vehicle in enumerate(names):
        for lateral in BOLD:
            rider = ClassicalRider(replace(CLASSICAL_SETTINGS, lateral=lateral))
            ride = ride_laps(vehicle, f"random_circuit:{seed}", 1, rider=rider, engine="compiled")
            passed = max([passed, *(passing.excess for passing in ride.passings)])
            unpaid += sum(not passing.repaid for passing in ride.passings)
            if ride.excess is not None and ride.closest_excess is not None:
                margin = min(margin, ride.closest_excess)
                tightest = min(tightest, ride.excess)
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


def lap_checks(names: Sequence[str], accounts: dict[str, dict[float, energy.Account]]) -> Iterator[Check]:
    """Return checks of laps of a circuit's median at several steps: their energy, and what the step does to their time.

    Args:
        names: of superbikes, or their files.
        accounts: of laps by machine and step, s, filled.
    """
    rests, spreads = [], []
    for name in names:
        rider, found = _OnePlan(replace(CLASSICAL_SETTINGS, lateral=CALM)), accounts.setdefault(name, {})
        times = []
        for step in LAP_STEPS if name == names[0] else ACCOUNT_STEPS:
            lap, found[step] = _ridden_lap(rider, name, step)
            times.append(lap)
        rests += [abs(found[step].rest) for step in ACCOUNT_STEPS]
        spreads.append(max(times) / min(times) - 1.0)
    title = "rest of the energy of a lap at 2 and 1 ms, share of the engine's work"
    yield Check("energy_rest", title, max(rests), 0.0, energy.ALLOWED)
    title = "a lap at steps of 0.5 to 4 ms: largest difference of its times, share"
    yield Check("lap_step", title, spreads[0], 0.0, 0.002)


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


def _energy_figures(accounts: Mapping[str, Mapping[float, energy.Account]]) -> dict[str, Any]:
    """Return the accounts of laps for JSON."""
    laps = [
        {"vehicle": name, "step_s": step}
        | {f"{entry}_j": one.work[entry] for entry in energy.ENTRIES}
        | {"stored_j": one.stored, "rest": one.rest}
        for name, found in accounts.items()
        for step, one in found.items()
        if step in ACCOUNT_STEPS
    ]
    return {"energy": laps}


def _energy_table(accounts: Mapping[str, Mapping[float, energy.Account]]) -> Table:
    """Return what did work on each lap, kJ, as a table for people."""
    laps = [(name, step, found[step]) for name, found in accounts.items() for step in ACCOUNT_STEPS]
    head = ("work of", *(f"{name}\n{1e3 * step:g} ms" for name, step, _ in laps))
    rows = [(name.replace("_", ", "), *(f"{1e-3 * one.work[name]:.1f}" for *_, one in laps)) for name in energy.ENTRIES]
    rows.append(("stored", *(f"{1e-3 * one.stored:.1f}" for *_, one in laps)))
    rows.append(("rest by engine", *(f"{one.rest:.1e}" for *_, one in laps)))
    return text_table("energy of a lap of the median of Barcelona, kJ", head, rows)


def _superbike_figures(result: superbike.Validation) -> dict[str, Any]:
    """Return the figures beside the checks for JSON."""
    convergence = ("step_s", "lean_error_deg", "position_error_m")
    turns = ("lean_deg", "speed_m_s", "lateral_g", "formula_lateral_g")
    machines = [
        {
            "vehicle": name,
            "time_to_100_km_h_s": float(np.interp(100.0 / 3.6, launch.speed, launch.time)),
            "speed_after_30_s_m_s": float(launch.speed[-1]),
            "modes": [
                {
                    "speed_m_s": point.speed,
                    "weave_real_1_s": point.weave.real,
                    "weave_hz": point.weave.imag / (2.0 * math.pi),
                    "wobble_real_1_s": point.wobble.real,
                    "wobble_hz": point.wobble.imag / (2.0 * math.pi),
                    "capsize_1_s": point.capsize,
                }
                for point in result.modes[name]
            ],
        }
        for name, launch in result.launches.items()
    ]
    return {
        "convergence": [dict(zip(convergence, row, strict=True)) for row in result.convergence],
        "turns": [dict(zip(turns, row, strict=True)) for row in result.turns],
        "machines": machines,
        "ranges": [vars(row) | {"within": bool(row.within)} for row in result.ranges],
        "performance": [vars(each) for each in result.performance],
    }


def _mode_figures(point: bicycle.ModePoint) -> dict[str, float]:
    """Return the modes at one speed for JSON."""
    figures = {"speed_m_s": point.speed}
    for prefix, modes in (("", point.measured), ("published_", point.published)):
        figures[f"{prefix}weave_real_1_s"] = modes.weave.real
        figures[f"{prefix}weave_imaginary_1_s"] = modes.weave.imag
        figures[f"{prefix}capsize_1_s"] = modes.capsize
    return figures


def _check_table(title: str, result: Report) -> Table:
    """Return the checks as a table for people."""
    rows = []
    for check in result.checks:
        digits = ".4g" if abs(check.measured) >= 1e-3 or not check.measured else ".1e"
        limits = f"≤ {check.high:.4g}" if check.low in (0.0, -math.inf) else f"{check.low:.4g} to {check.high:.4g}"
        reference = f"{check.reference:.4g}" if check.reference else ""
        verdict = "[green]pass[/green]" if check.passed else "[bold red]FAIL[/bold red]"
        rows.append((check.title, format(float(check.measured), digits), reference, limits, verdict))
    return text_table(title, ("figure", "measured", "reference", "allowed", ""), rows)


def _mode_table(result: bicycle.Validation) -> Table:
    """Return a bicycle's modes over speed as a table for people."""
    rows = []
    for point in result.points:
        both = (point.measured, point.published)
        weaves = [f"{modes.weave.real:.3f} ± {modes.weave.imag:.3f}i" for modes in both]
        rows.append((f"{point.speed:g}", *weaves, *(f"{modes.capsize:.4f}" for modes in both)))
    head = ("speed, m/s", "weave, 1/s", "published", "capsize, 1/s", "published")
    return text_table("modes over speed", head, rows, left=0)


def _range_table(result: superbike.Validation) -> Table:
    """Return frequencies beside published ones as a table for people."""
    rows = [
        (
            row.title,
            f"{row.low:.2f} to {row.high:.2f}",
            f"{row.published_low:g} to {row.published_high:g}",
            "within" if row.within else "[yellow]outside[/yellow]",
        )
        for row in result.ranges
    ]
    return text_table("beside published ranges", ("figure", "measured", "published", ""), rows)


def _torque_figures(torques: Sequence[Torque]) -> list[dict[str, float | None]]:
    """Return torques of steady turns beside published ones for JSON."""
    return [
        {
            "speed_m_s": torque.speed,
            "roll_deg": math.degrees(torque.roll),
            "torque_nm": torque.measured,
            "published_nm": torque.published,
            "miss": torque.measured / torque.published - 1.0,
            "miss_by_twist": (torque.measured - torque.published) / torque.twist,
        }
        for torque in torques
    ]


def _torque_table(torques: Sequence[Torque]) -> Table:
    """Return torques of steady turns beside published ones as a table for people, a row for each roll."""
    speeds, rows = dict.fromkeys(torque.speed for torque in torques), []
    for roll in dict.fromkeys(torque.roll for torque in torques):
        row = [torque for torque in torques if torque.roll == roll]
        rows.append((f"{math.degrees(roll):.0f}°", *(f"{each.measured:.2f} ({each.published:.2f})" for each in row)))
    title = "rider's torque in steady turns, N m: measured (published)"
    return text_table(title, ("roll", *(f"{speed:.0f} m/s" for speed in speeds)), rows, left=0)


def _performance_table(result: superbike.Validation) -> Table:
    """Return what road tests measure as a table for people."""
    rows = [
        (
            each.vehicle,
            f"{each.to_100_s:.2f} s",
            f"{each.quarter_mile_s:.2f} s",
            f"{each.quarter_mile_km_h:.0f} km/h",
            f"{each.top_km_h:.0f} km/h",
            f"{each.stop_100_m:.1f} m",
        )
        for each in result.performance
    ]
    head = ("machine", "0 to 100 km/h", "quarter mile", "at", "top speed", "stop from 100 km/h")
    return text_table("as road tests measure", head, rows)


def run_template(args: argparse.Namespace) -> dict[str, Any]:
    """Print a vehicle's file with all keys explained, or return it.

    Raises:
        ValueError: a broken file. FileNotFoundError: an unknown vehicle.
    """
    text = vehicle_template(args.vehicle)
    if not args.json:
        print(text)
    return {"schema": "bike.validate_template/1", "ok": True, "figures": {"file": text}}


PARAMETERS_SCHEMA: Final = "bike.validate_parameters/1"


def run_parameters(args: argparse.Namespace) -> dict[str, Any]:
    """Compare the eigenvalues of measured bicycles with the closed formulas, print a table, and return the result.

    Raises:
        ValueError: a broken file.
        FileNotFoundError: there is none.
    """
    console = Console(quiet=args.json)
    found = []
    with status(console, "measuring") as progress:
        for one in measured_bicycles(args.parameters):
            progress(one.name)
            found.append(one)
    checks = [check for check in (one.check() for one in found) if check is not None]
    figures = [
        {
            "bicycle": one.name,
            "stable_from_m_s": one.stable[0],
            "stable_to_m_s": one.stable[1],
            "eigenvalues": [
                {"speed_m_s": speed, "real_1_s": row.real.tolist(), "imaginary_1_s": row.imag.tolist()}
                for speed, row in zip(SPEEDS, one.formula, strict=True)
            ],
            "error_1_s": next((check.measured for check in checks if check.name == one.name), None),
        }
        for one in found
    ]
    result = Report(0.0, checks)
    rows = [(one.name, *(f"{speed:.4f}" for speed in one.stable)) for one in found]
    ranges = text_table("balances itself", ("bicycle", "from, m/s", "to, m/s"), rows)
    console.print(ranges, _check_table("measured bicycles", result))
    return finite({"schema": PARAMETERS_SCHEMA} | result.as_dict({"bicycles": figures}))


CIRCUIT_SCHEMA: Final = "bike.validate_course/1"

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
    console = Console(quiet=args.json)
    with status(console, "computing") as progress:
        progress("the fastest line")
        track = with_fastest_line(load_track(args.course), envelope)
        ideal, median = lap_limit(envelope, track.line(1.0)), lap_limit(envelope, track.line(0.0))
    figures = _circuit_figures(track, ideal, median)
    console.print(_circuit_table(track, figures))
    if args.out is not None:
        path = args.out / f"{track.name}.png"
        _draw_circuit(track, ideal, path)
        console.print(f"written: {path}")
        figures["picture"] = str(path)
    return {"schema": CIRCUIT_SCHEMA, "ok": ideal.lap_time <= median.lap_time, "figures": figures}


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


def _circuit_table(track: Track, figures: dict[str, Any]) -> Table:
    directions = [corner["direction"] for corner in figures["corners"]]
    rows = {
        "length": f"{figures['length_m']:.1f} m, {figures['direction']}",
        "width": f"{figures['width_min_m']:.1f} to {figures['width_max_m']:.1f} m",
        "corners": f"{len(directions)}: {directions.count('left')} left, {directions.count('right')} right",
        "smallest radius": f"{figures['radius_min_m']:.1f} m",
        "height": f"{figures['height_range_m']:.0f} m between lowest and highest",
        f"theoretical lap ({figures['machine']})": f"{figures['ideal_lap_s']:.2f} s on the ideal line, "
        f"{figures['median_lap_s']:.2f} s on the median",
    }
    return text_table(f"{track.name}: a sound circuit", ("", ""), rows.items())


def _draw_circuit(track: Track, ideal: LapLimit, path: Path) -> None:
    title = (
        f"{track.name}: {track.length:.0f} m, {track.direction}, {len(track.corners)} corners; "
        f"{ideal.machine}: {lap_text(ideal.lap_time)}"
    )
    track_figure(track, track.line(1.0), ideal.s, ideal.speed, title).savefig(path, dpi=100)
