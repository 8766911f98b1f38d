"""Pictures of `bike validate`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bike_sim.physics.bicycle import linear
from bike_sim.physics.engine import Engine
from bike_sim.physics.engines import make_engine
from bike_sim.physics.superbike import statics, tyres
from bike_sim.planning.envelope import envelope
from bike_sim.schema import GRAVITY, SIGNALS
from bike_sim.validation import superbike
from bike_sim.validation.bicycle import free_of_drive
from bike_sim.validation.published import Mode
from bike_sim.vehicles.bicycle import Vehicle

PICTURES: Final = ("tyres", "lean_steps", "turns", "modes", "launch_and_stop", "envelopes", "convergence")
_PLOT_SPEEDS: Final = np.arange(0.5, 10.01, 0.5)
signal = SIGNALS.index


def draw_bicycle_modes(vehicle: Vehicle, kind: str, time_step: float, path: Path) -> None:
    """Draw the eigenvalues over speed: measured points on the published curves.

    Args:
        vehicle: the bicycle; its drive is switched off.
        kind: engine kind.
        time_step: integration step, s.
        path: PNG file to write.
    """
    free = free_of_drive(vehicle)
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


def draw_superbikes(result: superbike.Validation, folder: Path) -> list[Path]:
    """Draw all pictures of superbikes as PNG files and return their paths."""
    painters = (
        _draw_tyres, _draw_lean_steps, _draw_turns, _draw_modes, _draw_launch_and_stop, _draw_envelopes,
        _draw_convergence,
    )  # fmt: skip
    paths = []
    for name, paint in zip(PICTURES, painters, strict=True):
        figure = Figure(figsize=(10.0, 5.5), layout="constrained")
        FigureCanvasAgg(figure)
        paint(result, figure)
        for axes in figure.axes:
            axes.grid(alpha=0.3)
            if axes.get_legend_handles_labels()[0]:
                axes.legend(fontsize="x-small")
        paths.append(folder / f"superbike_{name}.png")
        figure.savefig(paths[-1], dpi=110)
    return paths


def _draw_tyres(result: superbike.Validation, figure: Any) -> None:
    side, along, ellipse = figure.subplots(1, 3)
    vehicle = result.machines[0]
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
    for angle in (0.0, 1.0, 2.0, 4.0, 8.0):
        forces = np.array([tyres.forces(s, math.tan(math.radians(angle)), 0.0, load, 1.0, row)[:2] for s in slips])
        ellipse.plot(forces[:, 0] / load, forces[:, 1] / load, label=f"side slip {angle:.0f}°")
    turn = np.linspace(0.0, 2.0 * math.pi, 200)
    mu_y = tyres.friction(0.0, load, row)
    mu_x = mu_y * row["friction_ratio"]
    ellipse.plot(mu_x * np.cos(turn), mu_y * np.sin(turn), "k--", linewidth=0.8, label="ellipse")
    ellipse.set(xlabel="longitudinal by load", ylabel="lateral by load", title="combined slip", aspect="equal")


def _draw_lean_steps(result: superbike.Validation, figure: Any) -> None:
    axes = figure.subplots(3, len(superbike.LEANS), sharex=True)
    for column, lean in enumerate(superbike.LEANS):
        for speed in superbike.SPEEDS:
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


def _draw_turns(result: superbike.Validation, figure: Any) -> None:
    axes = figure.subplots()
    leans = np.radians(np.linspace(1.0, 58.0, 100))
    vehicle = result.machines[0]
    for speed, colour in ((10.0, "tab:blue"), (40.0, "tab:orange"), (80.0, "tab:red")):
        formula = [statics.steady_lateral(vehicle, lean, speed) / GRAVITY for lean in leans]
        axes.plot(np.degrees(leans), formula, color=colour, label=f"closed formula, {speed:.0f} m/s")
    axes.plot(np.degrees(leans), np.tan(leans), "k--", linewidth=0.8, label="tan(lean): a point on a blade")
    turns = np.array(result.turns)
    axes.scatter(turns[:, 0], turns[:, 2], c=turns[:, 1], cmap="turbo", zorder=3, s=24, label="simulated, 10 to 90 m/s")
    axes.set(xlabel="lean, deg", ylabel="steady lateral acceleration, g", title=f"steady turns of '{vehicle.name}'")


def _draw_modes(result: superbike.Validation, figure: Any) -> None:
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


def _draw_launch_and_stop(result: superbike.Validation, figure: Any) -> None:
    speeds, drive, brake = figure.subplots(1, 3)
    for machine in result.machines:
        name, limits = machine.name, envelope(machine)
        launch, stop = result.launches[name], result.stops[name]
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


def _draw_envelopes(result: superbike.Validation, figure: Any) -> None:
    over_speed, circle = figure.subplots(1, 2)
    for machine in result.machines:
        name, limits = machine.name, envelope(machine)
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


def _draw_convergence(result: superbike.Validation, figure: Any) -> None:
    axes = figure.subplots()
    table = np.array(result.convergence)
    axes.loglog(1e3 * table[:, 0], table[:, 1], "o-", label="largest error of lean, deg")
    axes.loglog(1e3 * table[:, 0], table[:, 2], "s-", label="error of place after 5 s, m")
    axes.loglog(1e3 * table[:, 0], table[0, 1] * table[:, 0] / table[0, 0], "k:", label="first order")
    axes.set(xlabel="step, ms", ylabel="error", title="braking, turning in and driving out from 45 m/s")


def draw_root_loci(found: Sequence[Mode], path: Path) -> Path:
    """Draw measured eigenvalues of a machine's variants, and of Sharp's motorcycle, on the published ones.

    Args:
        found: from `published.measured_modes`.
        path: PNG file to write.
    """
    variants = list(dict.fromkeys(mode.variant for mode in found))
    rows = math.ceil(len(variants) / 2)
    figure = Figure(figsize=(9.0, 2.8 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, variant in zip(figure.subplots(rows, 2, sharex=True, squeeze=False).flat, variants, strict=False):
        axes.axvline(0.0, color="0.7", linewidth=0.8)
        for name, colour in (("weave", "tab:blue"), ("wobble", "tab:orange")):
            modes = [mode for mode in found if mode.variant == variant and mode.name == name]
            for values, marker, label in (
                ([mode.published for mode in modes], "x-", "published"),
                ([mode.measured for mode in modes], "o", "measured"),
            ):
                points = np.array(values)
                hertz = points.imag / (2.0 * math.pi)
                axes.plot(
                    points.real, hertz, marker, color=colour, markersize=5.0, linewidth=0.8, fillstyle="none",
                    label=f"{name}, {label}",
                )  # fmt: skip
            axes.annotate(f"{modes[-1].speed:g} m/s", (modes[-1].published.real, modes[-1].published.imag / math.tau),
                          fontsize="x-small", xytext=(4, 4), textcoords="offset points")  # fmt: skip
        axes.set(title=variant, ylim=(0.0, 10.5), xlabel="real part, 1/s", ylabel="frequency, Hz")
    figure.axes[0].legend(loc="lower left", fontsize="x-small")
    figure.savefig(path, dpi=100)
    return path
