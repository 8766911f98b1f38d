"""Weave and wobble of superbikes in turns, coasting and on the brake: what loses its damping at the limit of the tyres.

The machine is brought to speed and lean, the brake is pulled for 0.3 s, and the ride is linearised there, with the
rider, the arms and the electronics in the loop.

    python -m bench.turn_modes
    python -m bench.turn_modes --vehicle r1 --speed 50
    python -m bench.turn_modes --scale rear_tyre.cornering=1.2 --scale front_tyre.cornering=1.2
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from bike_sim.physics import state as st
from bike_sim.physics import superbike_forces as sf
from bike_sim.physics.compiled_superbike_engine import CompiledSuperbikeEngine
from bike_sim.physics.superbike.turn_modes import modes_now
from bike_sim.validation.superbike import at_speed, holding
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.commands.lap import shipped_superbikes

TIME_STEP: Final = 0.001
SPEEDS: Final = (20.0, 35.0, 50.0)
LEANS: Final = (20.0, 45.0, 50.0, 55.0, 57.0)
BRAKES: Final = (0.0, 0.2, 0.7)
PULLED: Final = 0.3
"""Time for which the brake has been pulled, s."""


def scaled(vehicle: Superbike, change: str) -> Superbike:
    """Return a machine with one of its numbers multiplied, ``section.key=factor``.

    Raises:
        ValueError: another form, or no such number.
    """
    place, _, factor = change.partition("=")
    section, _, key = place.partition(".")
    try:
        values = getattr(vehicle, section)
        return replace(vehicle, **{section: replace(values, **{key: float(factor) * getattr(values, key)})})
    except (AttributeError, TypeError, ValueError):
        raise ValueError(f"{change!r} is not section.key=factor of a number in a vehicle's file") from None


def moment(vehicle: Superbike, speed: float, lean: float, brake: float) -> tuple[CompiledSuperbikeEngine, float]:
    """Return a machine in a turn (m/s, deg) on the brake, and the throttle that it is held with."""
    engine = at_speed(CompiledSuperbikeEngine(vehicle, TIME_STEP), speed, lean, 2.0)
    if brake == 0.0:
        return engine, holding(vehicle, speed, lambda now: lean)(0.0, engine.telemetry())[1]
    engine.advance_commands(-lean / vehicle.virtual_rider.max_lean_deg, -brake, round(PULLED / TIME_STEP))
    return engine, -brake


def told(value: complex) -> str:
    """Return growth (1/s) and frequency (Hz)."""
    return f"{value.real:+6.2f} at {value.imag / (2.0 * math.pi):4.1f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description="Weave and wobble in turns.")
    parser.add_argument("--vehicle", default="panigale_v4r", choices=shipped_superbikes())
    parser.add_argument("--speed", type=float, action="append", help="m/s (default: 20, 35, 50)")
    parser.add_argument("--scale", action="append", default=[], help="multiply a number: section.key=factor")
    args = parser.parse_args(arguments)
    vehicle = load_vehicle(args.vehicle)
    assert isinstance(vehicle, Superbike)
    try:
        for change in args.scale:
            vehicle = scaled(vehicle, change)
    except ValueError as error:
        parser.error(str(error))
    print("m/s  deg  brake  lean  use front, rear   weave 1/s, Hz    wobble 1/s, Hz")
    for speed in args.speed or SPEEDS:
        for lean in LEANS:
            for brake in BRAKES:
                engine, throttle = moment(vehicle, speed, lean, brake)
                found = modes_now(engine, (-lean / vehicle.virtual_rider.max_lean_deg, throttle))
                telemetry, roll = engine.telemetry(), math.degrees(engine.state()[st.ROLL])
                use = f"{telemetry[sf.T_FRONT_USE]:5.2f} {telemetry[sf.T_REAR_USE]:5.2f}"
                values = f"{told(found.weave)}   {told(found.wobble)}"
                print(f"{speed:3.0f}  {lean:3.0f}   {brake:.1f}  {roll:5.1f}   {use}      {values}")


if __name__ == "__main__":
    main()
