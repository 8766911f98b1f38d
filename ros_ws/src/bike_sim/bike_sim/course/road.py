"""What a circuit's road is like beside its line: banking, bumps, wet patches, run-off, walls and the wind over it.

All of it is off by default: a road that nobody describes is level across, smooth, dry and without wind. Run-off and
walls have defaults, for no road is without.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LARGEST_BANK: Final = math.radians(45.0)
"""More is a wall."""


class RunOffKind(IntEnum):
    """What lies behind a limit."""

    ASPHALT = 0
    GRASS = 1
    GRAVEL = 2
    MIXED = 3
    """Grass, and gravel from GRASS_STRIP on."""


GRASS_STRIP: Final = 6.0
"""Width of the grass before the gravel of a mixed run-off, m (estimate)."""

SIDES: Final = ("left", "right", "both")


@dataclass(frozen=True)
class WetPatch:
    """A part of the road with less grip, over its whole width.

    Attributes:
        begin: progress along the centre line, m. end: m; less than the beginning where it lies over the start line.
        grip: factor on friction, above 0.
    """

    begin: float
    end: float
    grip: float

    def __post_init__(self) -> None:
        """Refuse a grip that is none."""
        if not 0.0 < self.grip <= 2.0:
            raise ValueError(f"grip must be above 0 and at most 2, got {self.grip!r}")


@dataclass(frozen=True)
class RunOffPart:
    """A part of the run-off.

    Attributes:
        begin: progress along the centre line, m. end: m; less than the beginning where it lies over the start line.
        side: one of SIDES.
        kind: what it is.
    """

    begin: float
    end: float
    side: str
    kind: RunOffKind

    def __post_init__(self) -> None:
        """Refuse a side that is none."""
        if self.side not in SIDES:
            raise ValueError(f"side must be one of {', '.join(SIDES)}, got {self.side!r}")


@dataclass(frozen=True)
class Wind:
    """Wind over a circuit, everywhere the same.

    Attributes:
        speed: mean, m/s. towards: where it blows to, rad from the map's x axis to the left.
        gusts: standard deviation over the mean, 0.1 over water to 0.3 among buildings.
        seed: same seed, same gusts.
    """

    speed: float = 0.0
    towards: float = 0.0
    gusts: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no wind."""
        if not (0.0 <= self.speed <= 60.0 and math.isfinite(self.towards) and 0.0 <= self.gusts <= 1.0):
            raise ValueError(
                "wind must have a speed of 0 to 60 m/s, a finite direction and gusts of 0 to 1, got "
                f"{self.speed!r} m/s, {self.towards!r} rad and {self.gusts!r}"
            )


@dataclass(frozen=True)
class Walls:
    """What walls do to those who touch them.

    Attributes:
        friction: along the wall, Coulomb's coefficient.
        restitution: part of the normal speed that is thrown back.
        hit: normal speed from which a touch ends the ride, m/s.
    """

    friction: float = 0.4
    restitution: float = 0.2
    hit: float = 3.0

    def __post_init__(self) -> None:
        """Refuse what no wall does."""
        if not (0.0 <= self.friction <= 2.0 and 0.0 <= self.restitution <= 1.0 and 0.0 <= self.hit <= 100.0):
            raise ValueError(
                "walls must have a friction of 0 to 2, a restitution of 0 to 1 and a hit of 0 to 100 m/s, got "
                f"{self.friction!r}, {self.restitution!r} and {self.hit!r} m/s"
            )


@dataclass(frozen=True)
class RoadSurface:
    """Everything about a circuit's ground beside its height; the values of a file are in docs/reference/circuits.md.

    Attributes:
        bank: rise per m to the left at the samples of the centre line; None where it is level across.
        bumps: density of the heights at 0.1 cycles per m, m3, see :mod:`bike_sim.course.road`; 0 is smooth.
        seed: of the bumps.
        wet: patches with less grip; where they overlap the last counts.
        run_off: parts that are not like the rest, which is grass, and grass and gravel where it is wide.
        wind: over all of it.
        walls: behind it.
    """

    bank: FloatArray | None = None
    bumps: float = 0.0
    seed: int = 0
    wet: tuple[WetPatch, ...] = ()
    run_off: tuple[RunOffPart, ...] = ()
    wind: Wind = field(default_factory=Wind)
    walls: Walls = field(default_factory=Walls)

    def check(self, count: int) -> None:
        """Check the values against a centre line.

        Args:
            count: its number of samples.

        Raises:
            ValueError: another number of values, or some that no road has.
        """
        if not 0.0 <= self.bumps <= 1.0:
            raise ValueError(f"bumps must have a density of 0 to 1 m3, got {self.bumps!r} m3")
        if self.bank is None:
            return
        if len(self.bank) != count:
            raise ValueError(f"bank has {len(self.bank)} samples, s has {count}")
        steepest = float(np.abs(self.bank).max())
        if not steepest <= math.tan(LARGEST_BANK):
            raise ValueError(
                f"the road is banked by {math.degrees(math.atan(steepest)):.0f} deg; at most 45 are possible"
            )

    def grip(self, s: FloatArray) -> FloatArray:
        """Return the factor on friction at places of a lap, m: 1 where it is dry."""
        found = np.ones(len(s))
        for patch in self.wet:
            found[between(s, patch.begin, patch.end)] = patch.grip
        return found

    def mirrored(self) -> RoadSurface:
        """Return the surface of the mirrored circuit: left becomes right."""
        other = {"left": "right", "right": "left", "both": "both"}
        return replace(
            self,
            bank=None if self.bank is None else -self.bank,
            run_off=tuple(replace(part, side=other[part.side]) for part in self.run_off),
            wind=replace(self.wind, towards=-self.wind.towards),
        )


WIDE: Final = 20.0
"""Width from which a run-off that nobody describes has gravel behind its grass, m (estimate)."""


def run_off_kinds(
    s: FloatArray, widths: tuple[FloatArray, FloatArray], parts: tuple[RunOffPart, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return what lies behind the left and the right limit at the samples of a centre line, as `RunOffKind`.

    Args:
        s: arc length of the samples, m.
        widths: of the left and the right run-off, m.
        parts: that somebody has described.
    """
    kinds = tuple(np.where(width >= WIDE, int(RunOffKind.MIXED), int(RunOffKind.GRASS)) for width in widths)
    for part in parts:
        within = between(s, part.begin, part.end)
        for side, kind in zip(("left", "right"), kinds, strict=True):
            if part.side in (side, "both"):
                kind[within] = int(part.kind)
    return kinds[0], kinds[1]


def between(s: FloatArray, begin: float, end: float) -> NDArray[np.bool_]:
    """Return which places lie in a part of a lap, m, that may go over the start line."""
    return (s >= begin) & (s < end) if begin <= end else (s >= begin) | (s < end)


REFERENCE: Final = 16e-6
"""Density of class A at 0.1 cycles per m, m3."""
CLASSES: Final = {name: REFERENCE * 4.0**k for k, name in enumerate("ABCDEFGH")}
"""Geometric mean of the density at 0.1 cycles per m by class, m3."""

_BAND: Final = (0.011, 2.83)
"""Spatial frequencies that the standard covers, cycles per m."""
_AT: Final = 0.1


def bump_profile(seed: int, samples: int, spacing: float) -> NDArray[np.float64]:
    """Return heights of a periodic profile of class A, m, shape (samples,); read-only.

    Each frequency has the amplitude of the spectrum and a random phase.

    Args:
        seed: same seed, same road.
        samples: number of heights.
        spacing: distance between them, m.
    """
    frequency = np.fft.rfftfreq(samples, spacing)
    within = (frequency >= _BAND[0]) & (frequency <= _BAND[1])
    amplitude = np.zeros(len(frequency))
    amplitude[within] = np.sqrt(2.0 * REFERENCE * (frequency[within] / _AT) ** -2.0 * frequency[1])
    phase = 2.0 * np.pi * np.random.default_rng(seed).random(len(frequency))
    profile = np.fft.irfft(0.5 * samples * amplitude * np.exp(1j * phase), samples)
    profile.setflags(write=False)
    return profile
