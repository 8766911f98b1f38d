"""`bike validate --vehicle superbikes`: the five machines compared with statics and closed-form solutions."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS
from bike_policy.riders.classical import ClassicalRider
from bike_sim.physics.superbike import statics, tyres
from bike_sim.planning.envelope import envelope
from bike_sim.schema import GRAVITY, SIGNALS
from bike_sim.validation import superbike as validation
from bike_sim.validation.bicycle import Check
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, make_folder
from bike_training.progress import status
from bike_training.rollout.laps import ride_laps

signal = SIGNALS.index

SCHEMA: Final = "bike.validate_superbike/1"
SUPERBIKE_PERIOD: Final = 0.02
"""Control period, s; integration steps must not be longer."""
PICTURES: Final = ("tyres", "lean_steps", "turns", "modes", "launch_and_stop", "envelopes", "convergence", "shake")
BOLD: Final = (0.9, 0.92)
"""Parts of the lateral limit that riders use who try the theoretical laps; the last falls at times."""
_FALLEN: Final = 1.0  # g, drawn for a ride that ends in a fall


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Measure, print a table unless `args.json`, draw into `args.out`, and return the result.

    Args:
        args: ``json``, ``time_step`` (s) and ``out`` (folder or None).
    """
    check_positive("--time-step", args.time_step, "s", SUPERBIKE_PERIOD)
    if args.out is not None:
        make_folder("--out", args.out)
    console = Console(quiet=args.json)
    with status(console, "measuring") as tell:
        result = validation.validate(args.time_step, tell)
        tell("theoretical laps")
        result.checks.extend(bound_checks())
    console.print(_table(result))
    console.print(_ranges(result))
    answer = as_dict(result)
    if args.out is not None:
        (args.out / "validate_superbike.json").write_text(json.dumps(answer, indent=2) + "\n", encoding="utf-8")
        written = draw(result, args.out)
        console.print("written: " + ", ".join(str(path) for path in written))
    return answer


def bound_checks() -> Iterator[Check]:
    """Laps of bold riders on random circuits against the theoretical laps, which must be bounds of them."""
    margin, passed, unpaid, tightest = math.inf, 0.0, 0, math.inf
    for seed, vehicle in enumerate(validation.MACHINES):
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


def as_dict(result: validation.Validation) -> dict[str, Any]:
    """Return the result as the JSON object that `--json` prints; values that are not finite are null."""
    figures: dict[str, Any] = {check.name: _number(check.measured) for check in result.checks}
    figures["convergence"] = [
        {"step_s": step, "lean_error_deg": _number(lean), "position_error_m": _number(place)}
        for step, lean, place in result.convergence
    ]
    figures["turns"] = [
        {"lean_deg": lean, "speed_m_s": speed, "lateral_g": lateral, "formula_lateral_g": formula}
        for lean, speed, lateral, formula in result.turns
    ]
    figures["machines"] = [
        {
            "vehicle": name,
            "time_to_100_km_h_s": float(np.interp(100.0 / 3.6, launch.speed, launch.time)),
            "speed_after_30_s_m_s": float(launch.speed[-1]),
            "modes": [
                {
                    "speed_m_s": point.speed,
                    "weave_real_1_s": _number(point.weave.real),
                    "weave_hz": _number(point.weave.imag / (2.0 * math.pi)),
                    "wobble_real_1_s": _number(point.wobble.real),
                    "wobble_hz": _number(point.wobble.imag / (2.0 * math.pi)),
                    "capsize_1_s": _number(point.capsize),
                }
                for point in result.modes[name]
            ],
        }
        for name, launch in result.launches.items()
    ]
    figures["ranges"] = [
        {
            "name": row.name,
            "low": _number(row.low),
            "high": _number(row.high),
            "published_low": row.published_low,
            "published_high": row.published_high,
            "within": bool(row.within),
        }
        for row in result.ranges
    ]
    return {
        "schema": SCHEMA,
        "ok": result.passed,
        "time_step_s": result.time_step,
        "figures": figures,
        "checks": [
            {
                "name": check.name,
                "measured": _number(check.measured),
                "low": _number(check.low),
                "high": _number(check.high),
                "ok": check.passed,
            }
            for check in result.checks
        ],
    }


def _number(value: float) -> float | None:
    """Return a number that JSON knows."""
    return float(value) if math.isfinite(value) else None


def _table(result: validation.Validation) -> Table:
    """Return the checks as a table for people."""
    title = f"five superbikes, PyBullet, step {1e3 * result.time_step:g} ms"
    table = Table(title=title, box=box.SIMPLE, pad_edge=False)
    table.add_column("figure")
    for heading in ("measured", "allowed", ""):
        table.add_column(heading, justify="right", no_wrap=True)
    for check in result.checks:
        allowed = f"≤ {check.high:.4g}" if check.low in (0.0, -math.inf) else f"{check.low:.4g} to {check.high:.4g}"
        digits = ".4g" if abs(check.measured) >= 1e-3 or not check.measured else ".0e"
        verdict = "[green]pass[/green]" if check.passed else "[bold red]FAIL[/bold red]"
        table.add_row(check.title, format(float(check.measured), digits), allowed, verdict)
    return table


def _ranges(result: validation.Validation) -> Table:
    """Return frequencies beside published ones as a table for people."""
    table = Table(title="beside published ranges", box=box.SIMPLE, pad_edge=False)
    table.add_column("figure")
    for heading in ("measured", "published", ""):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in result.ranges:
        verdict = "within" if row.within else "[yellow]outside[/yellow]"
        published = f"{row.published_low:g} to {row.published_high:g}"
        table.add_row(row.title, f"{row.low:.2f} to {row.high:.2f}", published, verdict)
    return table


def draw(result: validation.Validation, folder: Path) -> list[Path]:
    """Draw all pictures as PNG files and return their paths."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # takes a second; only pictures pay for it
    from matplotlib.figure import Figure

    painters = (
        _draw_tyres, _draw_lean_steps, _draw_turns, _draw_modes, _draw_launch_and_stop, _draw_envelopes,
        _draw_convergence, _draw_shake,
    )  # fmt: skip
    paths = []
    for name, paint in zip(PICTURES, painters, strict=True):
        figure = Figure(figsize=(10.0, 5.5), layout="constrained")
        FigureCanvasAgg(figure)
        paint(result, figure)
        paths.append(folder / f"superbike_{name}.png")
        figure.savefig(paths[-1], dpi=110)
    return paths


def _machine(name: str) -> Superbike:
    vehicle = load_vehicle(name)
    assert isinstance(vehicle, Superbike)
    return vehicle


def _draw_tyres(result: validation.Validation, figure: Any) -> None:
    side, along, ellipse = figure.subplots(1, 3)
    vehicle = _machine(validation.MACHINES[0])
    load, row = 1500.0, vehicle.machine["front_tyre"]
    angles = np.radians(np.linspace(-12.0, 12.0, 241))
    for camber in (0.0, 20.0, 40.0, 57.0):
        lateral = [tyres.forces(0.0, math.tan(a), math.radians(camber), load, 1.0, row)[1] / load for a in angles]
        side.plot(np.degrees(angles), lateral, label=f"camber {camber:.0f}°")
    side.set(xlabel="side slip angle, deg", ylabel="lateral force by load", title="front tyre, 1500 N")
    slips = np.linspace(-0.4, 0.4, 401)
    for grip, label in ((1.0, "on the track"), (0.5, "grip 0.5")):
        along.plot(slips, [tyres.forces(s, 0.0, 0.0, load, grip, row)[0] / load for s in slips], label=label)
    along.plot(
        slips, [tyres.forces(s, 0.0, math.radians(45.0), load, 1.0, row)[0] / load for s in slips], label="camber 45°"
    )
    along.set(xlabel="longitudinal slip", ylabel="longitudinal force by load", title="upright and leaning")
    for drift in (0.0, 1.0, 2.0, 4.0, 8.0):
        forces = np.array([tyres.forces(s, math.tan(math.radians(drift)), 0.0, load, 1.0, row)[:2] for s in slips])
        ellipse.plot(forces[:, 0] / load, forces[:, 1] / load, label=f"side slip {drift:.0f}°")
    turn = np.linspace(0.0, 2.0 * math.pi, 200)
    mu_y = tyres.friction(0.0, row)
    mu_x = mu_y * row["friction_ratio"]
    ellipse.plot(mu_x * np.cos(turn), mu_y * np.sin(turn), "k--", linewidth=0.8, label="ellipse")
    ellipse.set(xlabel="longitudinal by load", ylabel="lateral by load", title="combined slip", aspect="equal")
    for axes in (side, along, ellipse):
        axes.grid(alpha=0.3)
        axes.legend(fontsize="x-small")


def _draw_lean_steps(result: validation.Validation, figure: Any) -> None:
    axes = figure.subplots(3, len(validation.LEANS), sharex=True)
    for column, lean in enumerate(validation.LEANS):
        for speed in validation.SPEEDS:
            recorded = result.steps[lean, speed]
            rows = recorded.time <= 4.0
            now, telemetry = recorded.time[rows], recorded.telemetry[rows]
            label = f"{speed:.0f} m/s"
            line = axes[0, column].plot(now, np.degrees(recorded.lean[rows]), linewidth=1.0, label=label)
            colour = line[0].get_color()
            reference = np.degrees(telemetry[:, signal("lean_reference")])
            axes[0, column].plot(now, reference, ":", color=colour, linewidth=0.8)
            axes[1, column].plot(now, telemetry[:, signal("steer_torque")], color=colour, linewidth=1.0)
            axes[2, column].plot(now, telemetry[:, signal("front_use")], color=colour, linewidth=1.0)
        axes[0, column].set_title(f"lean step to {lean:.0f}° (dotted: the rider's reference)", fontsize="small")
        axes[2, column].set_xlabel("time, s")
    for row, label in enumerate(("lean, deg", "steering torque, N m", "front slip, normalised")):
        axes[row, 0].set_ylabel(label)
    axes[0, 0].legend(fontsize="xx-small", ncols=2)
    for panel in axes.ravel():
        panel.grid(alpha=0.3)


def _draw_turns(result: validation.Validation, figure: Any) -> None:
    axes = figure.subplots()
    leans = np.radians(np.linspace(1.0, 58.0, 100))
    vehicle = _machine(validation.MACHINES[0])
    for speed, colour in ((10.0, "tab:blue"), (40.0, "tab:orange"), (80.0, "tab:red")):
        formula = [statics.steady_lateral(vehicle, lean, speed) / GRAVITY for lean in leans]
        axes.plot(np.degrees(leans), formula, color=colour, label=f"closed formula, {speed:.0f} m/s")
    axes.plot(np.degrees(leans), np.tan(leans), "k--", linewidth=0.8, label="tan(lean): a point on a blade")
    turns = np.array(result.turns)
    axes.scatter(turns[:, 0], turns[:, 2], c=turns[:, 1], cmap="turbo", zorder=3, s=24, label="simulated, 10 to 90 m/s")
    axes.set(xlabel="lean, deg", ylabel="steady lateral acceleration, g", title=f"steady turns of '{vehicle.name}'")
    axes.grid(alpha=0.3)
    axes.legend()


def _draw_modes(result: validation.Validation, figure: Any) -> None:
    real, frequency = figure.subplots(1, 2)
    for name, points in result.modes.items():
        speed = [point.speed for point in points]
        line = real.plot(speed, [point.weave.real for point in points], label=name)
        colour = line[0].get_color()
        real.plot(speed, [point.wobble.real for point in points], "--", color=colour)
        real.plot(speed, [point.capsize for point in points], ":", color=colour)
        frequency.plot(speed, [point.weave.imag / (2.0 * math.pi) for point in points], color=colour)
        frequency.plot(speed, [point.wobble.imag / (2.0 * math.pi) for point in points], "--", color=colour)
    real.axhline(0.0, color="0.5", linewidth=0.8)
    real.set(xlabel="speed, m/s", ylabel="real part, 1/s", title="hands off: weave —, wobble - -, capsize ···")
    frequency.set(xlabel="speed, m/s", ylabel="frequency, Hz", title="weave —, wobble - -", ylim=(0.0, None))
    real.legend(fontsize="small")
    for axes in (real, frequency):
        axes.grid(alpha=0.3)


def _draw_launch_and_stop(result: validation.Validation, figure: Any) -> None:
    speeds, drive, brake = figure.subplots(1, 3)
    for name in result.launches:
        launch, stop, limits = result.launches[name], result.stops[name], envelope(_machine(name))
        line = speeds.plot(launch.time, launch.speed, label=name)
        colour = line[0].get_color()
        for axes, recorded, sign, limit in ((drive, launch, 1.0, limits.drive), (brake, stop, -1.0, limits.brake)):
            rows = (recorded.speed > 12.0) & (recorded.time > 0.4)
            acceleration = sign * np.gradient(recorded.speed, recorded.time) / GRAVITY
            axes.plot(recorded.speed[rows], acceleration[rows], color=colour, linewidth=1.0)
            at = np.linspace(12.0, 90.0 if sign > 0.0 else 78.0, 200)
            axes.plot(at, limit(at) / GRAVITY, "--", color=colour, linewidth=0.8)
    speeds.set(xlabel="time, s", ylabel="speed, m/s", title="full throttle from 10 m/s")
    drive.set(xlabel="speed, m/s", ylabel="acceleration, g", title="full throttle (dashed: envelope)")
    brake.set(xlabel="speed, m/s", ylabel="deceleration, g", title="full brake from 80 m/s", ylim=(0.0, None))
    speeds.legend(fontsize="small")
    for axes in (speeds, drive, brake):
        axes.grid(alpha=0.3)


def _draw_envelopes(result: validation.Validation, figure: Any) -> None:
    over_speed, circle = figure.subplots(1, 2)
    for name in validation.MACHINES:
        limits = envelope(_machine(name))
        line = over_speed.plot(limits.speeds, limits.lateral_max / GRAVITY, label=name)
        colour = line[0].get_color()
        over_speed.plot(limits.speeds, limits.drive_max / GRAVITY, "--", color=colour)
        over_speed.plot(limits.speeds, -limits.brake_max / GRAVITY, ":", color=colour)
        for speed, width in ((30.0, 1.4), (70.0, 0.7)):
            lateral = np.linspace(0.0, float(limits.lateral(speed)), 100)
            both = np.concatenate([lateral, lateral[::-1]])
            long = np.concatenate([limits.drive(speed, lateral), -limits.brake(speed, lateral[::-1])])
            circle.plot(both / GRAVITY, long / GRAVITY, color=colour, linewidth=width)
    over_speed.set(xlabel="speed, m/s", ylabel="g", title="lateral —, drive - -, brake ···")
    circle.set(xlabel="lateral, g", ylabel="longitudinal, g", title="at 30 m/s (bold) and 70 m/s", aspect="equal")
    over_speed.legend(fontsize="small")
    for axes in (over_speed, circle):
        axes.grid(alpha=0.3)


def _draw_convergence(result: validation.Validation, figure: Any) -> None:
    axes = figure.subplots()
    table = np.array(result.convergence)
    axes.loglog(1e3 * table[:, 0], table[:, 1], "o-", label="largest error of lean, deg")
    axes.loglog(1e3 * table[:, 0], table[:, 2], "s-", label="error of place after 5 s, m")
    axes.loglog(1e3 * table[:, 0], table[0, 1] * table[:, 0] / table[0, 0], "k:", label="first order")
    axes.set(xlabel="step, ms", ylabel="error", title="braking, turning in and driving out from 45 m/s")
    axes.grid(alpha=0.3, which="both")
    axes.legend()


def _draw_shake(result: validation.Validation, figure: Any) -> None:
    panels = figure.subplots(1, len(result.shakes), sharey=True)
    for axes, (name, shakes) in zip(panels, result.shakes.items(), strict=True):
        for brake in validation.SHAKE_BRAKES:
            worst = [
                max(shakes[speed, lean, brake] for speed in validation.SHAKE_SPEEDS) for lean in validation.SHAKE_LEANS
            ]
            axes.plot(validation.SHAKE_LEANS, np.minimum(worst, _FALLEN), "o-", markersize=3, label=f"brake {brake:g}")
        axes.axhline(0.05, color="0.5", linewidth=0.8)
        axes.set(title=name, xlabel="lean, deg")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("shake, worst of 15 to 80 m/s, g rms (top: a fall)")
    panels[0].legend(fontsize="x-small")
