"""Disturbances by name: shipped ones, files, and worlds, which are random ones by number.

`world:N` names the Nth. A world is what no rider is told: grip of the road and of patches, mass, power, damper,
bumps, wind, and the delay of commands. Numbers below `JUDGED` are there to learn on, the others to judge by.

The ride of a world (`draw_ride`) adds what a rider is told: machine, circuit and start.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from bike_sim.documents import MAX_YAML_SIZE, DocumentError, alternatives, read_text, show
from bike_sim.sim.disturbances import Disturbances, RoadChanges, read_disturbances

SHIPPED: Final = resources.files("bike_sim") / "config" / "disturbances"
"""Folder of the files that come with the package."""
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
MACHINES: Final = ("panigale_v4r", "zx10rr", "cbr1000rr_r", "r1", "m1000rr", "gsxr1000")
"""Superbikes of the rides. The circuits take them in turn: lines and plans are made for each pair, so pairs are few."""
RIGID_ONLY: Final = ("gsxr1000",)
SUSPENDED_EACH: Final = 4
"""Of so many circuits the last has the suspended variant of its machine, where there is one."""
CIRCUITS: Final = ("barcelona", "cremona", "phillip_island")
RANDOM_CIRCUITS: Final = (22, 1000, 2000)
"""Number of random circuits beside these, and the first of them below `JUDGED` and from there on."""
STARTS: Final = 32
"""Rides that meet disturbances by name."""
GOLDEN: Final = 0.6180339887
"""The golden ratio spreads the speeds of these evenly."""
START_SHARES: Final = (0.5, 0.9)
"""Interval of the speed of a start, as a part of the theoretical one at its place."""


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


class WorldRide(NamedTuple):
    """A ride of a world, as its rider is told it, and what nobody tells.

    Attributes:
        number: of the world.
        vehicle: name of the machine.
        circuit: name of the circuit.
        place: of the start, as a part of the lap.
        share: speed of the start as a part of the theoretical one there.
        disturbances: the world.
    """

    number: int
    vehicle: str
    circuit: str
    place: float
    share: float
    disturbances: Disturbances

    @property
    def key(self) -> tuple[str, int]:
        """Name of the world and number of the ride."""
        return self.disturbances.name, self.number

    @property
    def world(self) -> tuple[str, str, str]:
        """Machine, circuit and name of the world, which rides from other starts share."""
        return self.vehicle, self.circuit, self.disturbances.name


def draw_ride(number: int) -> WorldRide:
    """Return the ride of a world.

    Raises:
        ValueError: the number is negative or too large.
    """
    disturbances = draw_world(number)
    rng = np.random.default_rng([number, 2027])
    count, *firsts = RANDOM_CIRCUITS
    first = firsts[number >= JUDGED]
    place = int(rng.integers(len(CIRCUITS) + count))
    circuit = CIRCUITS[place] if place < len(CIRCUITS) else f"random_circuit:{first + place - len(CIRCUITS)}"
    vehicle = MACHINES[place % len(MACHINES)]
    if place % SUSPENDED_EACH == SUSPENDED_EACH - 1 and vehicle not in RIGID_ONLY:
        vehicle += "_suspended"
    return WorldRide(number, vehicle, circuit, float(rng.random()), float(rng.uniform(*START_SHARES)), disturbances)


def load_rides(names: Sequence[str]) -> list[WorldRide]:
    """Return rides by names: a number of judged worlds, the numbers of the first and the last one, or disturbances.

    Args:
        names: each as ``200`` for the worlds 1000 to 1199, ``0-59``, or the name or file of disturbances, which
            `STARTS` rides meet that begin evenly around the first circuit, on the first machine.

    Raises:
        ValueError: numbers that name no world, or see `load_disturbances`. FileNotFoundError: there is no such file.
    """
    found = []
    for name in names:
        first, dash, last = name.partition("-")
        if name.isdecimal():
            found += [draw_ride(number) for number in range(JUDGED, JUDGED + _whole(name, name))]
        elif dash and first.isdecimal():
            found += [draw_ride(number) for number in range(_whole(first, name), _whole(last, name) + 1)]
        else:
            known = load_disturbances(name)
            low, high = START_SHARES
            for start in range(STARTS):
                share = low + (high - low) * (start * GOLDEN % 1.0)
                found.append(WorldRide(start, MACHINES[0], CIRCUITS[0], (start + 0.5) / STARTS, share, known))
    return found


def world_of(name: str) -> Disturbances | None:
    """Return the world that a name asks for; None where it names something else.

    Raises:
        ValueError: it has no number.
    """
    if not name.startswith(PREFIX):
        return None
    return draw_world(_whole(name.removeprefix(PREFIX), name))


def load_disturbances(name_or_path: str | Path) -> Disturbances:
    """Load disturbances that come with the package, or from a file.

    Args:
        name_or_path: name of a shipped file, the path of a YAML file (it ends in ``.yaml`` or ``.yml``), or
            ``world:N`` for the Nth random world of superbikes.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not YAML, has a key too many, or a value that means nothing.
    """
    text = str(name_or_path)
    if text.endswith((".yaml", ".yml")):
        return read_disturbances(read_text(Path(text), MAX_YAML_SIZE), Path(text).stem)
    world = world_of(text)
    if world is not None:
        return world
    shipped = shipped_disturbances()
    if text not in shipped:
        raise FileNotFoundError(
            f"no disturbances {show(text)}; {alternatives(text, shipped)}; a file of your own must end in .yaml"
        )
    with resources.as_file(SHIPPED / f"{text}.yaml") as path:
        return read_disturbances(read_text(path, MAX_YAML_SIZE), path.stem)


def shipped_disturbances() -> tuple[str, ...]:
    """Return the names of the files that come with the package, sorted."""
    return tuple(sorted(entry.name[: -len(".yaml")] for entry in SHIPPED.iterdir() if entry.name.endswith(".yaml")))


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
