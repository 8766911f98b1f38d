"""A circuit: a closed centre line with limits, elevation, run-off, walls, sectors, corners and the lines to ride.

Everything is given on the samples of the centre line. A place on a circuit is its progress (arc length of the nearest
point of the centre line, m) and its offset (distance from there, m, positive to the left).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import SAMPLE_SPACING, Course, check_columns
from bike_sim.course.layout import Piece
from bike_sim.course.road import LARGEST_BANK, RoadSurface
from bike_sim.course.spline import chord_lengths, smooth_line
from bike_sim.schema import Quantity, Schema

FloatArray = NDArray[np.float64]

LINE_SPACING = 1.0
"""Distance of the points that define an offset line, m."""

TABLE: Final = Schema(
    (
        Quantity("x", "m", 1, "of the centre line"),
        Quantity("y", "m", -1, "of the centre line"),
        Quantity("heading", "rad", -1, "of the centre line"),
        Quantity("curvature", "1/m", -1, "of the centre line"),
        Quantity("left", "m", 1, "distance to the left limit"),
        Quantity("right", "m", 1, "distance to the right limit"),
        Quantity("height", "m", 1, "of the centre line"),
        Quantity("ideal", "m", -1, "offset of the ideal line, NaN without one"),
        Quantity("bank", "1", -1, "rise per m to the left"),
    )
)
"""Rows of `Track.table`, at the samples of the centre line."""
X, Y, HEADING, CURVATURE = map(TABLE.index, ("x", "y", "heading", "curvature"))
LEFT, RIGHT, HEIGHT, IDEAL, BANK = map(TABLE.index, ("left", "right", "height", "ideal", "bank"))

SECTORS = 3
"""Sectors of a circuit whose file names none."""

CORNER_CURVATURE = 1.0 / 450.0
"""Curvature above which a circuit without named corners has a corner, 1/m."""

CORNER_ANGLE = math.radians(15.0)
"""A smaller change of heading is not a separate corner, rad."""


@dataclass(frozen=True)
class Corner:
    """A corner of a circuit.

    Attributes:
        name: usually its number.
        begin: progress where it begins, m.
        apex: arc length of its largest curvature, m.
        end: m, beyond the length of the circuit if the corner lies on the line.
        angle: turned angle, rad, positive to the left.
        radius: least radius of the centre line, m.
    """

    name: str
    begin: float
    apex: float
    end: float
    angle: float
    radius: float

    @property
    def direction(self) -> str:
        """``"left"`` or ``"right"``."""
        return "left" if self.angle > 0.0 else "right"


@dataclass(frozen=True)
class Track:
    """A circuit.

    Attributes:
        centre: closed centre line (the median) with widths; its sections are the sectors.
        elevation: height of the centre line, m.
        run_off_left: distance from the left limit to the wall behind it, m.
        run_off_right: the same on the right, m.
        corners: in the order of riding.
        ideal: offset of the ideal line, m, or None until it is computed (see
            :mod:`bike_sim.course.racing_line`).
        description: origin, for people.
        surface: banking, bumps, wet patches, run-off, walls and wind.
    """

    centre: Course
    elevation: FloatArray
    run_off_left: FloatArray
    run_off_right: FloatArray
    corners: tuple[Corner, ...] = ()
    ideal: FloatArray | None = None
    description: str = ""
    surface: RoadSurface = field(default_factory=RoadSurface)

    def __post_init__(self) -> None:
        """Check what every query relies on.

        Raises:
            ValueError: not closed, without widths, unequal lengths, values that are not finite, a wall inside the
                limits, an ideal line outside them, or a surface that no road has.
        """
        name = self.centre.name
        if not self.centre.closed:
            gap = math.hypot(self.centre.x[-1] - self.centre.x[0], self.centre.y[-1] - self.centre.y[0])
            raise ValueError(f"circuit {name!r} is not closed: its ends are {gap:.3g} m apart")
        if self.centre.width_left is None or self.centre.width_right is None:
            raise ValueError(f"circuit {name!r} has no widths; a circuit needs the distance to both limits")
        columns = {"elevation": self.elevation, "run_off_left": self.run_off_left, "run_off_right": self.run_off_right}
        bank = self.surface.bank
        check_columns(f"circuit {name!r}", len(self.centre.s), {**columns, "ideal": self.ideal, "bank": bank})
        for label in ("run_off_left", "run_off_right"):
            if np.any(columns[label] < 0.0):
                raise ValueError(f"circuit {name!r}: {label} is negative, so a wall would stand on the road")
        if self.ideal is not None and not (
            np.all(self.ideal <= self.width_left + 1e-6) and np.all(self.ideal >= -self.width_right - 1e-6)
        ):
            raise ValueError(f"circuit {name!r}: the ideal line leaves the limits")
        steepest = 0.0 if bank is None else float(np.abs(bank).max())
        if steepest > math.tan(LARGEST_BANK):
            raise ValueError(
                f"circuit {name!r} is banked by {math.degrees(math.atan(steepest)):.0f} deg; at most 45 are possible"
            )

    @property
    def name(self) -> str:
        """Name for people and files."""
        return self.centre.name

    @property
    def length(self) -> float:
        """Length of the centre line, m."""
        return self.centre.length

    @property
    def width_left(self) -> FloatArray:
        """Distance to the left limit, m, at the samples."""
        assert self.centre.width_left is not None  # __post_init__ refuses a circuit without
        return self.centre.width_left

    @property
    def width_right(self) -> FloatArray:
        """Distance to the right limit, m, at the samples."""
        assert self.centre.width_right is not None
        return self.centre.width_right

    @property
    def direction(self) -> str:
        """``"clockwise"`` or ``"counter-clockwise"``, seen from above."""
        return "counter-clockwise" if self.centre.heading[-1] > self.centre.heading[0] else "clockwise"

    @property
    def sectors(self) -> tuple[tuple[str, float], ...]:
        """Name and first progress (m) of each sector."""
        return self.centre.sections

    def at(self, column: FloatArray, progress: FloatArray | float) -> FloatArray:
        """Return a column's value at a progress (m, of any lap), linear between samples."""
        u = np.mod(progress, self.length) / self.centre.spacing
        i = np.minimum(u.astype(int) if isinstance(u, np.ndarray) else int(u), len(column) - 2)
        return np.asarray(column[i] + (u - i) * (column[i + 1] - column[i]))

    def points(self, progress: FloatArray, offset: FloatArray | float = 0.0) -> FloatArray:
        """Return points in the map frame.

        Args:
            progress: m, of any lap.
            offset: m, positive to the left of the centre line.

        Returns:
            x, y, z in m, shape (n, 3).
        """
        s = np.asarray(progress, dtype=np.float64)
        heading = self.at(self.centre.heading, s)
        x = self.at(self.centre.x, s) - offset * np.sin(heading)
        y = self.at(self.centre.y, s) + offset * np.cos(heading)
        return np.stack([x, y, self.at(self.elevation, s) + offset * self.at(self.bank, s)], axis=-1)

    def walls(self) -> tuple[FloatArray, FloatArray]:
        """Return the offsets of the left and the right wall (m, positive and negative) at the samples."""
        return self.width_left + self.run_off_left, -(self.width_right + self.run_off_right)

    @cached_property
    def table(self) -> FloatArray:
        """All columns in one array for compiled loops; rows are those of `TABLE`."""
        centre = self.centre
        ideal = np.full(len(centre.s), np.nan) if self.ideal is None else self.ideal
        columns = (*(centre.x, centre.y, centre.heading, centre.curvature, self.width_left, self.width_right),
                   *(self.elevation, ideal, self.bank))  # fmt: skip
        return np.ascontiguousarray(columns)

    @cached_property
    def marks(self) -> FloatArray:
        """Progress of the sectors' beginnings behind the start line, m, growing."""
        return np.array([start for _, start in self.sectors if 0.0 < start < self.length])

    def with_ideal(self, offset: FloatArray) -> Track:
        """Return the circuit with an ideal line, given by its offset at the samples, m."""
        return replace(self, ideal=offset)

    def line(self, lam: float) -> Course:
        """Return a line of the family between the median (0) and the ideal line (1), as a course with limits.

        Its offset is the given fraction of the ideal line's. Arc length begins where the line crosses the start.

        Args:
            lam: interpolation parameter lambda, 0 to 1.

        Raises:
            ValueError: lambda outside 0 to 1, or no ideal line is known.
        """
        if not 0.0 <= lam <= 1.0:
            raise ValueError(f"interpolation parameter must be 0 (median) to 1 (ideal), got {lam!r}")
        if lam == 0.0:
            return _on_road(self.centre, self.elevation, self.bank, self.surface.grip(self.centre.s))
        if self.ideal is None:
            raise ValueError(f"circuit {self.name!r} has no ideal line yet; bike_sim.course.racing_line computes it")
        return self._beside(lam * self.ideal, f"{self.name} ({'ideal' if lam == 1.0 else f'lambda {lam:g}'})")

    def _beside(self, offset: FloatArray, name: str) -> Course:
        """Return a course at an offset (m, at the samples) from the centre line, with the same limits."""
        count = max(16, round(self.length / LINE_SPACING))
        # On samples of the centre line: between them positions are linear, which would show as curvature.
        rows = np.round(np.linspace(0.0, len(self.centre.s) - 1, count + 1))
        progress = rows * self.centre.spacing
        aside = self.at(offset, progress)
        points = self.points(progress, aside)[:, :2]
        points[-1] = points[0]
        samples, before = smooth_line(points, True, SAMPLE_SPACING)
        there = np.interp(before, chord_lengths(points), progress)
        sideways = self.at(offset, there)
        line = Course(
            name,
            *samples,
            closed=True,
            off_course_limit=self.centre.off_course_limit,
            width_left=np.maximum(self.at(self.width_left, there) - sideways, 0.0),
            width_right=np.maximum(self.at(self.width_right, there) + sideways, 0.0),
            sections=tuple((sector, float(np.interp(s, there, samples[0]))) for sector, s in self.sectors),
        )
        across = self.at(self.bank, there)
        height = self.at(self.elevation, there) + sideways * across
        return _on_road(line, height, self._slope_across(line.heading, there, sideways), self.surface.grip(there))

    def _slope_across(self, heading: FloatArray, progress: FloatArray, offset: FloatArray) -> FloatArray:
        """Return how the road rises to the left of a line that crosses it at an angle, rise per m.

        On a hill a line that runs out to a limit has a part of the grade across it, and rides off camber or banked.

        Args:
            heading: of the line, rad.
            progress: arc length on the centre line, m.
            offset: from there, m.
        """
        turned = heading - self.at(self.centre.heading, progress)
        rise = self.at(self.grade, progress) + offset * self.at(slope_of(self.bank, self.centre.spacing), progress)
        along = rise / (1.0 - offset * self.at(self.centre.curvature, progress))
        return np.cos(turned) * self.at(self.bank, progress) - np.sin(turned) * along

    @cached_property
    def grade(self) -> FloatArray:
        """Slope of the road along the centre line, positive uphill (rise per m), at the samples."""
        return slope_of(self.elevation, self.centre.spacing)

    @cached_property
    def bank(self) -> FloatArray:
        """Slope of the road across, positive rising to the left (rise per m), at the samples."""
        return np.zeros(len(self.centre.s)) if self.surface.bank is None else self.surface.bank

    @cached_property
    def crest(self) -> FloatArray:
        """Change of the grade along the centre line, 1/m, negative over a crest, at the samples."""
        return slope_of(self.grade, self.centre.spacing)


def _on_road(line: Course, height: FloatArray, across: FloatArray, grip: FloatArray) -> Course:
    """Return a line with the road below it where that is not level or not dry.

    Args:
        line: of which nothing is said yet.
        height: of the road at its samples, m.
        across: its slope to the left, rise per m.
        grip: factor on friction.
    """
    hilly, banked, wet = bool(np.any(height != height[0])), bool(np.any(across)), bool(np.any(grip != 1.0))
    if not (hilly or banked or wet):
        return line
    return replace(line, height=height if hilly else None, bank=across if banked else None, grip=grip if wet else None)


def slope_of(column: FloatArray, spacing: float) -> FloatArray:
    """Return the change by m of a closed column, whose last sample repeats the first, by central differences."""
    inner = np.diff(column) / spacing
    ends = 0.5 * (inner[0] + inner[-1])
    return np.concatenate(([ends], 0.5 * (inner[1:] + inner[:-1]), [ends]))


def equal_sectors(length: float) -> tuple[tuple[str, float], ...]:
    """Return the names and beginnings of equal sectors of a lap (m)."""
    return tuple((f"sector {i + 1}", i * length / SECTORS) for i in range(SECTORS))


def corners_of(pieces: Sequence[Piece], begins: FloatArray) -> tuple[Corner, ...]:
    """Return one corner for each run of neighbouring pieces with the same corner name.

    Args:
        pieces: of a closed layout.
        begins: arc length at which each begins, m.

    Raises:
        ValueError: a corner has pieces in two places.
    """
    corners: dict[str, Corner] = {}
    for name, run in itertools.groupby(zip(pieces, begins.tolist(), strict=True), key=lambda item: item[0].corner):
        members = list(run)
        if not name:
            continue
        if name in corners:
            raise ValueError(f"corner {name!r} has pieces in two places")
        # Of the table, not of the samples: a ramp to a sharper neighbour lies half within this corner.
        sharpest, begin = max(members, key=lambda member: abs(member[0].curvature))
        end = members[-1][1] + members[-1][0].length
        angle = sum(piece.angle for piece, _ in members)
        radius = 1.0 / abs(sharpest.curvature)
        corners[name] = Corner(name, members[0][1], begin + 0.5 * sharpest.length, end, angle, radius)
    return tuple(corners.values())


def find_corners(centre: Course) -> tuple[Corner, ...]:
    """Find the corners of a closed line: parts of one direction of curvature, numbered from the start."""
    count, spacing = len(centre.s) - 1, centre.spacing
    bend = centre.curvature[:count]
    kind = np.where(bend > CORNER_CURVATURE, 1, np.where(bend < -CORNER_CURVATURE, -1, 0))
    changes = np.flatnonzero(kind != np.roll(kind, 1))
    corners: list[Corner] = []
    for first, last in zip(changes, np.append(changes[1:], changes[:1] + count), strict=True):
        if kind[first] == 0 or abs(np.sum(bend[np.arange(first, last) % count]) * spacing) < CORNER_ANGLE:
            continue
        samples = np.arange(math.ceil(first * spacing / spacing), math.floor(last * spacing / spacing) + 1)
        part = bend[samples % count]
        sharpest = np.abs(part).max()
        # The middle of the part with the largest curvature, not its first sample.
        apex = float(np.mean(samples[np.abs(part) > 0.999 * sharpest]) * spacing) % centre.length
        angle, name = float(np.sum(part) * spacing), str(len(corners) + 1)
        corners.append(Corner(name, first * spacing, apex, last * spacing, angle, float(1.0 / sharpest)))
    return tuple(corners)
