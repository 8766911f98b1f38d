"""Machines that give way held against published figures: statics and eigenvalues, with joints switched on and off.

The figures are in ``config/validation/published.yaml``, each beside its source.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.superbike import modes
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.validation.report import Check
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.joints import Flexure
from bike_sim.vehicles.superbike import Superbike

FOLDER: Final = resources.files("bike_sim") / "config" / "validation"
SHARP: Final = "Sharp (1971)"
"""Name of his motorcycle among the variants."""
SHARP_STEP: Final = 2e-5
"""Integration step of the comparison with Sharp, s: at 0.5 ms it changes the damping of wobble by 0.3 1/s."""
LINEAR_STEP: Final = 2e-4
"""The same of the comparison with the linear model, s."""
_STILL: Final = 400.0
"""Frequency of a rider who does not move on his seat, rad/s."""


@dataclass(frozen=True)
class Mode:
    """An eigenvalue beside its published value.

    Attributes:
        variant: of the machine.
        speed: m/s.
        name: weave, wobble or capsize.
        measured: 1/s, of the engine.
        published: 1/s.
    """

    variant: str
    speed: float
    name: str
    measured: complex
    published: complex


def published() -> dict[str, Any]:
    """Return the published figures."""
    document: dict[str, Any] = yaml.safe_load((FOLDER / "published.yaml").read_text(encoding="utf-8"))
    return document


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
        for name in ("weave", "wobble"):
            for speed, (real, hertz) in variant[name].items():
                values = straight_eigenvalues(changed, float(speed), LINEAR_STEP)
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
    for name, value in published().get(vehicle.name, {}).get("statics", {}).items():
        measured = float(constants[name.removesuffix("_n")]["preload"][0])
        title = f"force of the {'fork' if name == 'fork_n' else 'rear spring unit'} in the design pose, N"
        yield Check(f"static_{name}", title, measured, 0.995 * value, 1.005 * value, value)
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


def _errors(found: list[Mode]) -> tuple[float, float]:
    """Return the largest errors of real and imaginary parts, 1/s."""
    errors = [mode.measured - mode.published for mode in found]
    return max(abs(error.real) for error in errors), max(abs(error.imag) for error in errors)
