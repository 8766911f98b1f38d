"""Centre lines from CSV text: points, and the widths to both sides where the file gives them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bike_sim.documents import DocumentError

FloatArray = NDArray[np.float64]

COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")
"""Columns of a file, in the order used where no header names them; the widths may be left out together."""

MAX_CSV_SIZE = 8_000_000
"""Largest CSV file, bytes: some 200,000 points, which take a few seconds to read."""

MAX_COORDINATE = 1e7
"""Largest coordinate, m: that of any map's grid, and so small that a sample's spacing is not rounded away."""

LEAST_POINTS = 4
"""Fewer points do not make a course. (A repeated first point at the end does not count.)"""

SAME_POINT = 1e-6
"""Points nearer than this are the same point, m."""

REVERSAL = math.radians(150.0)
"""A line whose chords turn by more at one point (rad) has its points out of order."""

CLOSING_GAP = 1.5
"""The ends of a closed line are at most this many times the largest distance of neighbours apart."""

CLOSING_TURN = math.radians(75.0)
"""The chord that closes a line turns by at most this angle at both ends, rad."""

HOLE = 10.0
"""Neighbours of a line with widths that are farther apart than this many times the median have a hole between them."""

BENT_HOLE, HOLE_TURN = 4.0, math.radians(30.0)
"""So have neighbours of any line that are this many medians apart, where the line continues in a direction that differs
by so much (rad): the corner between them is not known."""

LARGEST_GAP = 250.0
"""Points of a circuit are nowhere farther apart, m: a file of a few points is no measurement."""

LEAST_STEPS = 8
"""Of fewer steps the median says nothing."""


class CourseFileError(DocumentError):
    """A course file is broken. The message says the row or element, and the fault."""


@dataclass(frozen=True)
class CentreLine:
    """Points of a CSV file.

    Attributes:
        points: shape (n, 2), m. A closed line repeats its first point at the end.
        closed: whether the line is closed.
        width_left: distance to the left limit at the points, m, or None.
        width_right: distance to the right limit at the points, m, or None.
        rows: row of the file of each point, counted from 1 as by an editor.
    """

    points: FloatArray
    closed: bool
    width_left: FloatArray | None
    width_right: FloatArray | None
    rows: tuple[int, ...]


def parse_csv(text: str, closed: bool | None = None) -> CentreLine:
    """Read the text of a CSV file.

    Separators are commas, semicolons or tabs, with or without spaces. Lines that begin with ``#`` are comments. A
    line of names, commented out or not, says which column is which; further columns are ignored. Without names the
    columns are those of :data:`COLUMNS`.

    Args:
        text: text of the file.
        closed: whether the line is closed, or None to find out: it is when the last point repeats the first, or when
            its ends are about as far apart as neighbours are and the gap continues the line.

    Raises:
        CourseFileError: naming the row (as counted by an editor) and the fault.
    """
    rows, lines, with_widths = _parse_rows(text)
    repeated = len(rows) > 1 and math.dist(rows[0, :2], rows[-1, :2]) < SAME_POINT
    if repeated:
        rows, lines = rows[:-1], lines[:-1]
        if closed is False:
            raise CourseFileError("is called open, but its last point repeats its first; remove that row")
    if len(rows) < LEAST_POINTS:
        raise CourseFileError(f"has {len(rows)} different points, at least {LEAST_POINTS} are needed")
    if closed is None:
        closed = repeated or _looks_closed(rows[:, :2])
    if closed:
        rows, lines = np.vstack([rows, rows[:1]]), [*lines, lines[0]]
    points = rows[:, :2]
    _check_order(points, lines, closed)
    _check_gaps(points, lines, closed, with_widths)
    left, right = (rows[:, 3], rows[:, 2]) if with_widths else (None, None)
    return CentreLine(points, closed, left, right, tuple(lines))


def _parse_rows(text: str) -> tuple[FloatArray, list[int], bool]:
    """Return the numbers in the order of COLUMNS, their line numbers, and whether widths are among them."""
    columns: list[int] | None = None
    wanted = 0
    rows: list[list[float]] = []
    lines: list[int] = []
    for number, line in enumerate(text.splitlines(), start=1):
        cells = _split(line.lstrip("#"))
        if line.lstrip().startswith("#") or not any(cells):
            if not rows and {"x_m", "y_m"} <= set(cells):
                columns, wanted = _named_columns(cells, number), len(cells)
            continue
        if not rows and columns is None and all(cell[:1].isalpha() and not _is_number(cell) for cell in cells):
            columns, wanted = _named_columns(cells, number), len(cells)
            continue
        if columns is None:
            if len(cells) not in (2, len(COLUMNS)):
                raise CourseFileError(
                    f"row {number} has {len(cells)} columns; without a row of names they must be "
                    f"{','.join(COLUMNS[:2])} or {','.join(COLUMNS)}"
                )
            columns, wanted = list(range(len(cells))), len(cells)
        if len(cells) != wanted:
            raise CourseFileError(f"row {number} has {len(cells)} columns instead of {wanted}: {line[:60]!r}")
        rows.append([_number(cells[column], COLUMNS[i], number) for i, column in enumerate(columns)])
        lines.append(number)
    if columns is None or not rows:
        raise CourseFileError(f"has no points; rows of {','.join(COLUMNS)} are expected")
    return np.array(rows), lines, len(columns) == len(COLUMNS)


def _split(line: str) -> list[str]:
    separator = next((each for each in (";", "\t") if each in line), ",")
    cells = [cell.strip() for cell in line.split(separator)]
    # Spreadsheets and some tools end every row with a separator.
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _number(cell: str, name: str, line: int) -> float:
    if not _is_number(cell):
        raise CourseFileError(f"row {line}: {name} is {cell[:40]!r}, a number is needed")
    value = float(cell)
    if not math.isfinite(value):
        raise CourseFileError(f"row {line}: {name} is {cell[:40]!r}, a finite number is needed")
    if abs(value) > MAX_COORDINATE:
        raise CourseFileError(f"row {line}: {name} is {cell[:40]!r}, beyond {MAX_COORDINATE:g} m; metres?")
    if name.startswith("w_") and value < 0.0:
        raise CourseFileError(f"row {line}: {name} is {value}, a width must not be negative")
    return value


def _named_columns(names: list[str], line: int) -> list[int]:
    for name in COLUMNS[:2]:
        if name not in names:
            raise CourseFileError(f"row {line} has names, but {name} is not among them: {', '.join(names)[:60]!r}")
    widths = [name for name in COLUMNS[2:] if name in names]
    if len(widths) == 1:
        raise CourseFileError(f"row {line} names {widths[0]} alone; give the widths to both sides or none")
    return [names.index(name) for name in (*COLUMNS[:2], *widths)]


def _looks_closed(points: FloatArray) -> bool:
    """Tell from the gap between the ends whether a line without a repeated point is closed.

    Raises:
        CourseFileError: the gap is small, but closing it would bend the line sharply.
    """
    steps = np.diff(points, axis=0)
    gap = points[0] - points[-1]
    distance = float(np.hypot(*gap))
    if distance > CLOSING_GAP * float(np.hypot(*steps.T).max()):
        return False
    turn = float(np.abs(_turns(np.array([steps[-1], gap]), np.array([gap, steps[0]]))).max())
    if turn > CLOSING_TURN:
        raise CourseFileError(
            f"may be open or closed: its ends are {distance:.3g} m apart, but closing it would turn by "
            f"{math.degrees(turn):.0f} deg at one point. Say 'closed: true' or 'closed: false' in a YAML file beside it"
        )
    return True


def _turns(steps: FloatArray, following: FloatArray) -> FloatArray:
    """Return the angles from steps to those that follow them, rad, positive to the left."""
    cross = steps[:, 0] * following[:, 1] - steps[:, 1] * following[:, 0]
    return np.asarray(np.arctan2(cross, np.sum(steps * following, axis=1)))


def _check_order(points: FloatArray, lines: list[int], closed: bool) -> None:
    """Refuse neighbours that are the same point, and lines that turn back, as where a part is there twice."""
    steps = np.diff(points, axis=0)
    for i in np.flatnonzero(np.hypot(*steps.T) < SAME_POINT)[:1]:
        raise CourseFileError(f"rows {lines[i]} and {lines[i + 1]} are the same point ({points[i, 0]}, {points[i, 1]})")
    turns = _turns(steps, np.roll(steps, -1, axis=0))
    if not closed:
        turns[-1] = 0.0
    for i in np.flatnonzero(np.abs(turns) > REVERSAL)[:1]:
        raise CourseFileError(
            f"row {lines[i + 1]}: the line turns back by {math.degrees(abs(turns[i])):.0f} deg here; are the rows in "
            "order, and none there twice?"
        )


def _check_gaps(points: FloatArray, lines: list[int], closed: bool, measured: bool) -> None:
    """Refuse a line with a hole, the gap that closes it included."""
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    typical = float(np.median(lengths))
    bends = np.abs(_turns(np.roll(steps, 1, axis=0), np.roll(steps, -1, axis=0)))
    if not closed:
        bends[[0, -1]] = 0.0
    hole = (lengths > BENT_HOLE * typical) & (bends > HOLE_TURN)
    if measured:
        hole |= lengths > HOLE * typical
    hole &= len(lengths) >= LEAST_STEPS
    if measured and closed:
        hole |= lengths > LARGEST_GAP
    if not np.any(hole):
        return
    i = int(np.argmax(np.where(hole, lengths, 0.0)))
    closing = ", where the line closes," if closed and i == len(lengths) - 1 else ""
    raise CourseFileError(
        f"rows {lines[i]} and {lines[i + 1]}{closing} are {lengths[i]:.4g} m apart, where neighbours are "
        f"{typical:.3g} m apart; is a part missing? A long straight needs points too"
    )
