"""Worlds: random disturbances of superbikes by number, to learn on and to be judged by.

`world:N` names the Nth. A world is what no rider is told: grip of the road and of patches, mass, power, damper,
bumps, wind, and the delay of commands. Numbers below `JUDGED` are there to learn on, the others to judge by.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from bike_sim.documents import DocumentError, show
from bike_sim.sim.disturbances import Disturbances, RoadChanges, load_disturbances

PREFIX: Final = "world:"
JUDGED: Final = 1000
"""First world that nothing may be learned or tuned on."""
MOST: Final = 10**6
GRIP: Final = (0.82, 1.03)
"""Interval of the grip of the whole road."""
PATCH_GRIP: Final = (0.9, 1.0)
"""Interval of the further factor of a patch: nobody could foresee a worse one."""
PATCHES: Final = 4
"""Most patches of a lap."""
PATCH_LENGTH: Final = (30.0, 90.0)
"""m."""
LAP: Final = 4500.0
"""Patches lie within this part of a lap, m; those beyond the end of a shorter one are not met."""
SECTIONS: Final[dict[str, tuple[tuple[str, ...], tuple[float, float]]]] = {
    "mass": (("frame.mass", "frame.Ixx", "frame.Iyy", "frame.Izz"), (0.97, 1.07)),
    "power": (("motor.peak_power", "motor.peak_torque"), (0.93, 1.03)),
    "damper": (("steering.damper_slow", "steering.damper_fast"), (0.75, 1.1)),
}
"""Numbers of a vehicle's file that a world scales together, and the interval of the factor."""
BUMPS: Final = (4e-6, 64e-6)
"""Interval of the density of bumps, m3; 16e-6 is class A of ISO 8608, 64e-6 class B."""
WIND: Final = (2.0, 12.0)
"""m/s."""
GUSTS: Final = 0.2
DELAYS: Final = (0.0, 0.0, 0.02, 0.04)
"""Delays of commands, s, each as likely as the others."""


def draw_world(number: int) -> Disturbances:
    """Return the world of a number.

    Raises:
        ValueError: it is negative or too large.
    """
    if not 0 <= number < MOST:
        raise DocumentError(f"worlds have numbers from 0 to {MOST - 1}, got {number}")
    rng = np.random.default_rng([number, 2026])
    starts = rng.uniform(0.0, LAP, rng.integers(PATCHES + 1))
    patches = tuple((float(a), float(a + rng.uniform(*PATCH_LENGTH)), float(rng.uniform(*PATCH_GRIP))) for a in starts)
    rough, windy = rng.random(2) < 0.4
    road = RoadChanges(
        grip=float(rng.uniform(*GRIP)),
        patches=patches,
        bumps_m3=float(np.exp(rng.uniform(*np.log(BUMPS)))) * bool(rough),
        wind_m_s=float(rng.uniform(*WIND)) * bool(windy),
        wind_towards_deg=float(rng.uniform(0.0, 360.0)),
        wind_gusts=GUSTS,
        seed=number,
    )
    factors = {name: float(rng.uniform(*bounds)) for name, (_, bounds) in SECTIONS.items()}
    vehicle = {part: factors[name] for name, (parts, _) in SECTIONS.items() for part in parts}
    return Disturbances(
        name=f"{PREFIX}{number}",
        seed=number,
        command_delay_s=float(rng.choice(DELAYS)),
        vehicle=vehicle,
        road=road,
    )


def world_of(name: str) -> Disturbances | None:
    """Return the world that a name asks for; None where it names something else.

    Raises:
        ValueError: it has no number.
    """
    if not name.startswith(PREFIX):
        return None
    return draw_world(_whole(name.removeprefix(PREFIX), name))


def load_worlds(names: Sequence[str]) -> list[Disturbances]:
    """Load disturbances by names, where ``world:0-59`` names the worlds 0 to 59.

    Raises:
        ValueError: a name without a number, or see `load_disturbances`. FileNotFoundError: there is no such file.
    """
    found = []
    for name in names:
        first, dash, last = name.removeprefix(PREFIX).partition("-")
        if name.startswith(PREFIX) and dash:
            found += [draw_world(number) for number in range(_whole(first, name), _whole(last, name) + 1)]
        else:
            found.append(load_disturbances(name))
    return found


def _whole(digits: str, name: str) -> int:
    if not digits.isdecimal() or len(digits) > 9:
        raise DocumentError(f"{show(name)} names no world: {PREFIX} takes a whole number, or two with a dash between")
    return int(digits)
