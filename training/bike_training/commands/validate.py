"""`bike validate`: the physics engine compared with publications."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from bike_sim.physics.bicycle import linear
from bike_sim.physics.engine import Engine
from bike_sim.physics.engines import make_engine
from bike_sim.validation import bicycle as validation
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.arguments import check_positive, make_folder

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
    with console.status("measuring") as status:
        result = validation.validate(
            vehicle, args.engine, args.time_step, lambda part: status.update(f"measuring: {part}")
        )
    console.print(*_tables(result))
    answer = as_dict(result)
    if args.out is not None:
        (args.out / "validate.json").write_text(json.dumps(answer, indent=2) + "\n", encoding="utf-8")
        draw_modes(vehicle, args.engine, args.time_step, args.out / "modes.png")
        console.print(f"written: {args.out / 'modes.png'}, {args.out / 'validate.json'}")
    return answer


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
