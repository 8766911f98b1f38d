"""`bike validate`: the benchmark bicycle against its publications, and circuits against what a circuit must be."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from bike_analysis.figures.numbers import lap_text
from bike_sim.course.drawing import track_figure
from bike_sim.course.files import load_track
from bike_sim.course.track import Track
from bike_sim.physics.bicycle import linear
from bike_sim.physics.engine import Engine
from bike_sim.physics.engines import make_engine
from bike_sim.planning.envelope import point_mass_envelope
from bike_sim.planning.lap_limit import LapLimit, lap_limit
from bike_sim.planning.minimum_time import with_fastest_line
from bike_sim.validation import bicycle as validation
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle, vehicle_template
from bike_training.arguments import check_positive, make_folder
from bike_training.progress import status

SCHEMA = "bike.validate/1"


BICYCLE_PERIOD: Final = 0.05
"""Control period, s; integration steps must not be longer."""
_PLOT_SPEEDS = np.arange(0.5, 10.01, 0.5)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Measure, print a table unless `args.json`, and return the result.

    Raises:
        ValueError: a broken vehicle's file, or an invalid step. OSError: an unknown vehicle or a folder
            that cannot be made.
    """
    check_positive("--time-step", args.time_step, "s", BICYCLE_PERIOD)
    if args.out is not None:
        make_folder("--out", args.out)
    vehicle = load_vehicle(args.vehicle)
    console = Console(quiet=args.json)
    with status(console, "measuring") as tell:
        result = validation.validate(vehicle, args.engine, args.time_step, tell)
    console.print(*_tables(result))
    answer = as_dict(result)
    if args.out is not None:
        (args.out / "validate.json").write_text(json.dumps(answer, indent=2) + "\n", encoding="utf-8")
        draw_modes(vehicle, args.engine, args.time_step, args.out / "modes.png")
        console.print(f"written: {args.out / 'modes.png'}, {args.out / 'validate.json'}")
    return answer


def run_template(args: argparse.Namespace) -> dict[str, Any]:
    """Print a vehicle's file with all keys explained, or return it.

    Raises:
        ValueError: a broken file. FileNotFoundError: an unknown vehicle.
    """
    text = vehicle_template(args.vehicle)
    if not args.json:
        print(text)
    return {"schema": "bike.validate_template/1", "ok": True, "figures": {"file": text}}


def as_dict(result: validation.Validation) -> dict[str, Any]:
    """Return the result as the JSON object that `--json` prints."""
    figures: dict[str, Any] = {check.name: float(check.measured) for check in result.checks}
    figures["modes"] = [
        {
            "speed_m_s": point.speed,
            "weave_real_1_s": point.measured.weave.real,
            "weave_imaginary_1_s": point.measured.weave.imag,
            "capsize_1_s": point.measured.capsize,
            "published_weave_real_1_s": point.published.weave.real,
            "published_weave_imaginary_1_s": point.published.weave.imag,
            "published_capsize_1_s": point.published.capsize,
        }
        for point in result.points
    ]
    return {
        "schema": SCHEMA,
        "ok": result.passed,
        "vehicle": result.vehicle.name,
        "engine": result.kind,
        "time_step_s": result.time_step,
        "figures": figures,
        "checks": [
            {
                "name": check.name,
                "measured": float(check.measured),
                "reference": check.reference,
                "low": check.low,
                "high": check.high,
                "ok": check.passed,
            }
            for check in result.checks
        ],
    }


def _tables(result: validation.Validation) -> tuple[Table, Table]:
    """Return the modes over speed and the checks as tables for people."""
    eigenvalues = Table(
        title=f"{result.vehicle.name}, {result.kind}, step {1e3 * result.time_step:g} ms", box=box.SIMPLE
    )
    for heading in ("speed, m/s", "weave, 1/s", "published", "capsize, 1/s", "published"):
        eigenvalues.add_column(heading, justify="right", no_wrap=True)
    for point in result.points:
        pairs = [(modes_at.weave, modes_at.capsize) for modes_at in (point.measured, point.published)]
        weaves = [f"{weave.real:.3f} ± {weave.imag:.3f}i" for weave, _ in pairs]
        capsizes = [f"{capsize:.4f}" for _, capsize in pairs]
        eigenvalues.add_row(f"{point.speed:g}", weaves[0], weaves[1], capsizes[0], capsizes[1])

    checks = Table(box=box.SIMPLE, pad_edge=False)
    checks.add_column("figure", no_wrap=True)
    for heading in ("measured", "wanted", "allowed"):
        checks.add_column(heading, justify="right", no_wrap=True)
    checks.add_column("", no_wrap=True)
    for check in result.checks:
        checks.add_row(
            check.title,
            f"{check.measured:.4g}" if abs(check.measured) >= 1e-3 else f"{check.measured:.1e}",
            f"{check.reference:.4g}" if check.reference else "",
            f"{check.low:.4g} to {check.high:.4g}" if check.low else f"≤ {check.high:.4g}",
            "[green]pass[/green]" if check.passed else "[bold red]FAIL[/bold red]",
        )
    return eigenvalues, checks


def draw_modes(vehicle: Vehicle, kind: str, time_step: float, path: Path) -> None:
    """Draw the eigenvalues over speed: measured points on the published curves.

    Args:
        vehicle: the bicycle; its drive is switched off.
        kind: engine kind.
        time_step: integration step, s.
        path: PNG file to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # takes a second; only pictures pay for it
    from matplotlib.figure import Figure

    free = validation.free_of_drive(vehicle)
    fine = np.linspace(0.0, 10.0, 801)
    curves = np.array([np.sort_complex(np.linalg.eigvals(linear.state_matrix(free, speed))) for speed in fine])
    engine = make_engine(kind, free, time_step)
    points = _measured_eigenvalues(engine)
    engine.close()

    figure = Figure(figsize=(8.0, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    weave, capsize = linear.weave_speed(vehicle), linear.capsize_speed(vehicle)
    axes.axhline(0.0, color="0.7", linewidth=0.8)
    axes.axvspan(weave, capsize, color="tab:green", alpha=0.12, label=f"stable, {weave:.3f} to {capsize:.3f} m/s")
    speeds = np.repeat(fine, 4)
    values = curves.ravel()
    oscillating = values.imag > 1e-9
    axes.plot(speeds, values.real, ".", markersize=1.0, color="tab:blue")
    axes.plot(speeds[oscillating], values.imag[oscillating], ".", markersize=1.0, color="tab:orange")
    axes.plot([], [], color="tab:blue", label="real part, published formulas")
    axes.plot([], [], color="tab:orange", label="imaginary part, published formulas")
    at = np.repeat(_PLOT_SPEEDS, 4)
    found = points.ravel()
    above = found.imag > 1e-9
    axes.plot(at, found.real, "o", markersize=4.5, fillstyle="none", color="tab:blue", label="real part, measured")
    axes.plot(
        at[above],
        found.imag[above],
        "s",
        markersize=4.5,
        fillstyle="none",
        color="tab:orange",
        label="imaginary part, measured",
    )
    axes.set(
        xlim=(0.0, 10.0),
        ylim=(-10.0, 10.0),
        xlabel="forward speed, m/s",
        ylabel="eigenvalue, 1/s",
        title=f"Lateral modes of '{vehicle.name}': {kind} at {1e3 * time_step:g} ms",
    )
    for name, at_speed in (("weave", 9.0), ("capsize", 9.0), ("castering", 1.5)):
        value = getattr(linear.modes(vehicle, at_speed), name).real
        axes.annotate(name, (at_speed, value), xytext=(8, 6), textcoords="offset points", fontsize="small")
    axes.legend(loc="lower right", fontsize="small")
    figure.savefig(path, dpi=150)


def _measured_eigenvalues(engine: Engine) -> np.ndarray:
    """Return the measured eigenvalues at the speeds of the picture, 1/s, shape (speeds, 4)."""
    return np.array([np.linalg.eigvals(linear.measured_state_matrix(engine, speed)) for speed in _PLOT_SPEEDS])


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
    with status(console, "computing") as tell:
        tell("the fastest line")
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
    table = Table(box=box.SIMPLE, title=f"{track.name}: a sound circuit", show_header=False)
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
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _draw_circuit(track: Track, ideal: LapLimit, path: Path) -> None:
    title = (
        f"{track.name}: {track.length:.0f} m, {track.direction}, {len(track.corners)} corners; "
        f"{ideal.machine}: {lap_text(ideal.lap_time)}"
    )
    track_figure(track, (track.line(1.0), ideal.s, ideal.speed), title).savefig(path, dpi=100)
