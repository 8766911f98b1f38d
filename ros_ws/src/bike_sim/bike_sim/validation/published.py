"""Machines that give way held against published figures: statics and eigenvalues, with joints switched on and off.

The figures are in ``config/validation/published.yaml``, each beside its source.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.engine import NO_FALL
from bike_sim.physics.superbike import modes, tyres
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.validation import superbike
from bike_sim.validation.report import Check, Mode, Report
from bike_sim.validation.superbike import lateral_error, measure_performance, signal, steady_turns
from bike_sim.vehicles.files import joined, load_superbike, vehicle_document, vehicle_from_document
from bike_sim.vehicles.joints import Flexure
from bike_sim.vehicles.superbike import Superbike

FOLDER: Final = resources.files("bike_sim") / "config" / "validation"
SHARP: Final = "Sharp (1971)"
"""Name of his motorcycle among the variants."""
SHARP_STEP: Final = 2e-5
"""Integration step of the comparison with Sharp, s: at 0.5 ms it changes the damping of wobble by 0.3 1/s."""
LINEAR_STEP: Final = 2e-4
"""The same of the comparison with the linear model, s."""
_SMALL_ROLL_DEG: Final = 5.7
"""Roll, deg, below which torque by roll is a slope."""
_SLOW_TURN: Final = 28.0
"""Speed, m/s, up to which it is compared."""
_TURN_SPEEDS: Final = (14.0, 28.0, 42.0, 55.0)
_TURN_LEANS: Final = (5.0, 20.0, 35.0, 45.0)
"""Speeds, m/s, and leans, deg, at which lateral acceleration is compared with the closed form."""
_STILL: Final = 400.0
"""Frequency of a rider who does not move on his seat, rad/s."""


def published() -> dict[str, Any]:
    """Return the published figures."""
    document: dict[str, Any] = yaml.safe_load((FOLDER / "published.yaml").read_text(encoding="utf-8"))
    return document


def validate(vehicle: Superbike, time_step: float, progress: Callable[[str], None]) -> Report:
    """Measure a machine that gives way, and Sharp's motorcycle, beside all published figures.

    A machine without figures of its own is measured for its modes, hands off and on, and for shake.

    Args:
        vehicle: the machine, with joints.
        time_step: integration step of the road tests, s; comparisons have their own.
        progress: called with a few words before each part.
    """
    progress("statics and modes beside published ones")
    modes = measured_modes(vehicle)
    report = Report(list(check_published(vehicle, modes)), modes)
    progress("steady turns")
    torques, performance = list(steady_torques(vehicle)), measure_performance(vehicle, time_step)
    report.checks += check_rides(vehicle, torques, performance)
    if vehicle.name not in published():
        progress("modes and shake")
        for hands in (False, True):
            report.checks += superbike.check_modes(superbike.measured_modes([vehicle], hands), hands)
        report.checks += superbike.check_shake([vehicle], time_step)
    report.tables = {"torques": torques, "performance": [performance]} if torques else {"performance": [performance]}
    return report


def sharp_modes() -> Iterator[Mode]:
    """Eigenvalues of Sharp's motorcycle, hands off, measured on the nonlinear engine."""
    with resources.as_file(FOLDER / "sharp1971.yaml") as path:
        vehicle = load_superbike(path)
    table = published()["sharp1971"]
    for i, speed in enumerate(table["speed_m_s"]):
        values = straight_eigenvalues(vehicle, speed, SHARP_STEP, 0.0)
        for name in ("capsize", "weave", "wobble"):
            wanted = complex(table[f"{name}_re"][i], table.get(f"{name}_im", [0.0] * 8)[i])
            yield Mode(SHARP, speed, name, nearest(values, wanted), wanted)


def linear_modes(vehicle: Superbike) -> Iterator[Mode]:
    """Eigenvalues of a machine's variants beside those of a linear model; none where the figures lack the machine."""
    for variant in published().get(vehicle.name, {}).get("variants", ()):
        changed = variant_of(vehicle, variant)
        at = {
            speed: straight_eigenvalues(changed, float(speed), LINEAR_STEP)
            for speed in dict.fromkeys([*variant["weave"], *variant["wobble"]])
        }
        for name in ("weave", "wobble"):
            for speed, (real, hertz) in variant[name].items():
                values = at[speed]
                wanted = complex(real, 2.0 * math.pi * hertz)
                yield Mode(variant["name"], float(speed), name, nearest(values, wanted), wanted)


def variant_of(vehicle: Superbike, variant: dict[str, Any]) -> Superbike:
    """Return a machine as the linear model has it, with joints changed: nothing rolls or turns its crank.

    Args:
        vehicle: with joints.
        variant: an entry of the figures.
    """
    joints = vehicle.joints
    assert joints is not None
    if "head_stiffness" in variant and joints.head is not None:
        joints = replace(joints, head=replace(joints.head, stiffness=variant["head_stiffness"]))
    if "fork_bending" in variant:
        joints = replace(joints, fork_bending=Flexure(**variant["fork_bending"]))
    joints = replace(joints, **dict.fromkeys(variant.get("without", ()), None))
    damper = variant.get("damper", vehicle.steering.damper_slow)
    return replace(
        vehicle,
        joints=joints,
        front_tyre=replace(vehicle.front_tyre, rolling=0.0),
        rear_tyre=replace(vehicle.rear_tyre, rolling=0.0),
        steering=replace(vehicle.steering, damper_slow=damper, damper_fast=damper),
        rider=replace(vehicle.rider, slide_frequency=_STILL),
        motor=replace(vehicle.motor, crank_momentum=0.0, engine_brake=0.0),
    )


def straight_eigenvalues(
    vehicle: Superbike, speed: float, step: float, throttle: float | None = None
) -> NDArray[np.complex128]:
    """Return the eigenvalues of straight running hands off, 1/s.

    Args:
        vehicle: the machine.
        speed: m/s.
        step: integration step, s.
        throttle: held; None holds the speed.
    """
    engine = CompiledSuperbikeEngine(modes.hands_off(vehicle), step)
    command = 0.0, modes.holding_throttle(vehicle, speed) if throttle is None else throttle
    engine.reset(st.upright_state(speed, vehicle.rF))
    engine.advance(*command, round(0.5 / step))
    return modes.eigenvalues(engine, command, modes.lateral_states(engine), round(0.006 / step))


def nearest(values: NDArray[np.complex128], wanted: complex) -> complex:
    """Return the eigenvalue next to a published one."""
    return complex(values[np.argmin(np.abs(values - wanted))])


def machine_of_table(vehicle: Superbike) -> Superbike:
    """Return a shipped machine with the changes of whoever published its table of steady torques."""
    changes = published()[vehicle.name]["steady_torque"]["changes"]
    machine = vehicle_from_document(joined(vehicle_document(vehicle.name), changes), "table")
    assert isinstance(machine, Superbike)
    return machine


def steady_torques(vehicle: Superbike) -> Iterator[dict[str, float]]:
    """Yield the rider's torques in steady turns beside published ones; none where the figures lack the machine.

    A torque is in N m, positive to the left in a turn to the right. `miss_by_twist` is the miss by what the front
    tyre's own moment about the normal asks for; the torque is what other moments leave of that.
    """
    table = published().get(vehicle.name, {}).get("steady_torque")
    if table is None:
        return
    machine = machine_of_table(vehicle)
    turns = steady_turns(machine, table["speed_m_s"], table["roll_rad"])
    tyre, slips = machine.machine["front_tyre"], ("front_slip", "front_slip_angle", "front_camber", "front_load")
    for j, speed in enumerate(table["speed_m_s"]):
        for i, roll in enumerate(table["roll_rad"]):
            turn, wanted = next(turns), table["torque_nm"][i][j]
            slip, angle, camber, load = (float(turn.telemetry[:, signal(name)].mean()) for name in slips)
            twist = -tyres.forces(slip, math.tan(angle), camber, load, 1.0, tyre)[2] * math.cos(machine.lam)
            torque = float(turn.telemetry[:, signal("steer_torque")].mean()) if turn.fall == NO_FALL else math.nan
            yield {
                "speed_m_s": speed,
                "roll_deg": math.degrees(roll),
                "torque_nm": torque,
                "published_nm": wanted,
                "slope_nm_rad": torque / roll,
                "published_slope_nm_rad": wanted / roll,
                "miss": torque / wanted - 1.0,
                "miss_by_twist": (torque - wanted) / twist,
            }


def check_rides(
    vehicle: Superbike, torques: Sequence[Mapping[str, float]], performance: Mapping[str, Any]
) -> Iterator[Check]:
    """Checks of rides of a machine that gives way: steady turns, and what road tests measure.

    Args:
        vehicle: the machine.
        torques: its `steady_torques`.
        performance: of it, see `superbike.measure_performance`.
    """
    for torque in torques:
        if torque["roll_deg"] < _SMALL_ROLL_DEG:
            speed, wanted = torque["speed_m_s"], torque["published_slope_nm_rad"]
            title = f"steering torque of steady turns at 2 deg, {speed:.0f} m/s, N m/rad"
            low, high = (0.94 * wanted, 1.06 * wanted) if speed < _SLOW_TURN else (-math.inf, math.inf)
            yield Check(f"torque_slope_{speed:.0f}", title, torque["slope_nm_rad"], low, high, wanted)
    for name, machine in (("suspended", vehicle), ("rigid", replace(vehicle, joints=None))):
        turns = steady_turns(machine, _TURN_SPEEDS, np.radians(_TURN_LEANS).tolist())
        error = max(lateral_error(machine, turn) for turn in turns)
        title = f"lateral acceleration of steady turns by lean, {name}, share off the formula"
        yield Check(f"lateral_{name}", title, error, 0.0, 0.01)
    titles = {"to_100_s": "0 to 100 km/h, s", "top_km_h": "top speed, km/h", "stop_100_m": "stop from 100 km/h, m"}
    for name, (low, high) in published().get(vehicle.name, {}).get("performance", {}).items():
        yield Check(name, titles[name], performance[name], low, high)


def measured_modes(vehicle: Superbike) -> list[Mode]:
    """Return the eigenvalues of Sharp's motorcycle, and of a machine's variants."""
    return [*sharp_modes(), *linear_modes(vehicle)]


def check_published(vehicle: Superbike, found: Sequence[Mode]) -> Iterator[Check]:
    """Checks of a machine that gives way against all published figures.

    Args:
        vehicle: the machine.
        found: its `measured_modes`.
    """
    constants = CompiledSuperbikeEngine(vehicle, LINEAR_STEP).constants["joints"]
    figures = published().get(vehicle.name, {})
    yield from _static_checks("", constants, figures.get("statics", {}))
    if table := figures.get("steady_torque"):
        other = machine_of_table(vehicle)
        springs = CompiledSuperbikeEngine(other, LINEAR_STEP).constants["joints"]
        yield from _static_checks("machine of the TU Munich: ", springs, table["statics"])
        front = other.mass * other.g * other.com_x / other.w
        for name, load in (("rear_n", other.mass * other.g - front), ("front_n", front)):
            wanted = table["loads"][name]
            title = f"and load of its {name.removesuffix('_n')} tyre, N"
            yield Check(f"load_{name}", title, load, 0.995 * wanted, 1.005 * wanted, wanted)
    linear = [mode for mode in found if mode.variant != SHARP]
    real, imaginary = _errors([mode for mode in found if mode.variant == SHARP])
    yield Check("sharp_real_1_s", "Sharp (1971), 8 speeds: real parts, largest error, 1/s", real, 0.0, 0.03)
    yield Check("sharp_imaginary_1_s", "and frequencies, largest error, rad/s", imaginary, 0.0, 0.1)
    for variant in dict.fromkeys(mode.variant for mode in linear):
        of_it = [mode for mode in linear if mode.variant == variant]
        key = "".join(letter if letter.isalnum() else "_" for letter in variant)
        share = max(abs(mode.measured.imag / mode.published.imag - 1.0) for mode in of_it)
        yield Check(f"{key}_real_1_s", f"linear model, {variant}: real parts, 1/s", _errors(of_it)[0], 0.0, 1.0)
        yield Check(f"{key}_frequency", f"linear model, {variant}: frequencies, share", share, 0.0, 0.03)


def _static_checks(of: str, joints: NDArray[np.void], figures: dict[str, float]) -> Iterator[Check]:
    """Checks of spring forces in the design pose against published ones."""
    for name, value in figures.items():
        measured = float(joints[name.removesuffix("_n")]["preload"][0])
        title = f"{of}force of the {'fork' if name == 'fork_n' else 'rear spring unit'} in the design pose, N"
        yield Check(f"{'table_' if of else ''}static_{name}", title, measured, 0.995 * value, 1.005 * value, value)


def _errors(found: list[Mode]) -> tuple[float, float]:
    """Return the largest errors of real and imaginary parts, 1/s."""
    errors = [mode.measured - mode.published for mode in found]
    return max(abs(error.real) for error in errors), max(abs(error.imag) for error in errors)
