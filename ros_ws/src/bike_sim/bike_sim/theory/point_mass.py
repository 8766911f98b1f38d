"""A superbike reduced to a point mass: the limits of a machine from six numbers, to compare circuits and lines with."""

from __future__ import annotations

import math

import numpy as np

from bike_sim.theory.envelope import Envelope, ellipse_envelope

GRAVITY = 9.81
AIR_DENSITY = 1.2


def point_mass_envelope(
    lateral_g: float = 1.4,
    *,
    mass: float = 281.0,
    power: float = 151_800.0,
    drag_area: float = 0.33,
    wheelie_g: float = 1.13,
    stoppie_g: float = 1.15,
    highest_speed: float = 110.0,
) -> Envelope:
    """Return the limits of a point mass.

    The defaults are a litre superbike with its rider: mass and drag area from the motorcycle simulators' parameter sets
    (Sharp & Limebeer 2001 among others), 165 kW at the crank with 92 % reaching the road, the wheelie limit of a centre
    of mass 0.70 m ahead of the rear contact and 0.62 m high, a stoppie limit estimated the same way.

    Args:
        lateral_g: largest lateral acceleration, g.
        mass: kg.
        power: at the road, W.
        drag_area: drag coefficient times frontal area, m^2.
        wheelie_g: acceleration that lifts the front wheel, g.
        stoppie_g: deceleration that lifts the rear wheel, drag not counted, g.
        highest_speed: end of the tables, m/s.

    Raises:
        ValueError: a value that is not positive and finite.
    """
    values = {
        "lateral_g": lateral_g,
        "mass": mass,
        "power": power,
        "wheelie_g": wheelie_g,
        "stoppie_g": stoppie_g,
        "highest_speed": highest_speed,
    }
    for name, value in values.items():
        if not math.isfinite(value) or value <= 0.0:
            raise ValueError(f"{name} of a point mass must be positive and finite, got {value!r}")
    if not math.isfinite(drag_area) or drag_area < 0.0:
        raise ValueError(f"drag_area of a point mass must be finite and not negative, got {drag_area!r}")
    speeds = np.arange(1.0, highest_speed + 1.0)
    drag = 0.5 * AIR_DENSITY * drag_area * speeds**2 / mass
    lifting = np.full_like(speeds, wheelie_g * GRAVITY)
    return ellipse_envelope(
        name=f"point mass {lateral_g:g} g",
        speeds=speeds,
        lateral_max=np.full_like(speeds, lateral_g * GRAVITY),
        drive_max=np.minimum(lifting, power / (mass * speeds)) - drag,
        brake_max=stoppie_g * GRAVITY + drag,
        grip_drive_max=lifting,
        drag=drag,
    )
