"""The road's surface out of a circuit's document; docs/circuits.md shows the keys."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.bumps import CLASSES
from bike_sim.course.csv_line import CourseFileError
from bike_sim.course.document import check_keys, length_of, number_of, values_of
from bike_sim.course.road import SIDES, RoadSurface, RunOffKind, RunOffPart, Walls, WetPatch, Wind
from bike_sim.documents import DocumentError, show

FloatArray = NDArray[np.float64]
Made = TypeVar("Made")

SURFACE_KEYS: Final = ("banking_deg", "bumps", "wet", "wind", "run_off_kinds", "walls")
"""Keys of a circuit file that describe its surface; none must be there."""

MAX_PARTS: Final = 200
MAX_SEED: Final = 2**62


def surface_of(document: Mapping[str, Any], s: FloatArray) -> RoadSurface:
    """Return the surface that a document describes.

    Args:
        document: content of the file; values are strings.
        s: arc length of the centre line's samples, m.

    Raises:
        ValueError: naming the key and the fault.
    """
    density, seed = _bumps(document.get("bumps"))
    return RoadSurface(
        _bank(document.get("banking_deg"), s),
        density,
        seed,
        tuple(_parts(document.get("wet"), "wet", s, ("grip",), _wet)),
        tuple(_parts(document.get("run_off_kinds"), "run_off_kinds", s, ("side", "kind"), _run_off)),
        _wind(document.get("wind")),
        _walls(document.get("walls")),
    )


def _refused(where: str, make: Callable[[], Made]) -> Made:
    """Return what is made, or refuse its values with the key in front."""
    try:
        return make()
    except DocumentError:
        raise
    except ValueError as error:
        raise CourseFileError(f"{where}: {error}") from None


def _bank(entries: Any, s: FloatArray) -> FloatArray | None:
    """Lay a closed curve without overshoot through pairs of distance and angle."""
    if entries is None:
        return None
    from scipy.interpolate import PchipInterpolator  # late: a start that needs none is spared it

    if not isinstance(entries, list) or len(entries) < 2:
        raise CourseFileError("banking_deg must be a list of at least two pairs of distance and angle")
    pairs = []
    for number, entry in enumerate(entries, start=1):
        where = f"banking_deg: entry {number}"
        if not isinstance(entry, list) or len(entry) != 2:
            raise CourseFileError(f"{where} must be a pair of distance and angle")
        at, angle = length_of(entry[0], where), number_of(entry[1], where)
        if abs(angle) > 45.0:
            raise CourseFileError(f"{where}: the angle is {angle:g} deg; at most 45 are possible")
        pairs.append((at, math.tan(math.radians(angle))))
    at_all, slope = np.array(pairs).T
    if np.any(np.diff(at_all) <= 0.0) or at_all[0] < 0.0 or at_all[-1] >= s[-1]:
        raise CourseFileError(f"banking_deg: distances must grow from 0 and stay below the length of {s[-1]:.0f} m")
    # a lap before and one behind, so that the curve closes
    around = np.concatenate([at_all - s[-1], at_all, at_all + s[-1]])
    return np.asarray(PchipInterpolator(around, np.tile(slope, 3))(s))


def _bumps(value: Any) -> tuple[float, int]:
    if value is None:
        return 0.0, 0
    if not isinstance(value, dict) or ("class" in value) == ("density_m3" in value):
        raise CourseFileError(f"bumps must be a mapping with seed and either class or density_m3, got {show(value)}")
    key = "class" if "class" in value else "density_m3"
    chosen, seed = values_of(value, "bumps", (key, "seed"))
    if key == "density_m3":
        density = number_of(chosen, "bumps: density_m3")
        if not 0.0 <= density <= 1.0:
            raise CourseFileError(f"bumps: density_m3 is {density:g}; m3, as 16e-6 of class A?")
        return density, _seed(seed, "bumps: seed")
    if not isinstance(chosen, str) or chosen not in CLASSES:
        raise CourseFileError(f"bumps: class must be one of {', '.join(CLASSES)}, got {show(chosen)}")
    return CLASSES[chosen], _seed(seed, "bumps: seed")


def _seed(value: Any, where: str) -> int:
    if not isinstance(value, str) or not value.isdecimal() or int(value) > MAX_SEED:
        raise CourseFileError(f"{where} must be a whole number from 0 to {MAX_SEED}, got {show(value)}")
    return int(value)


def _parts(entries: Any, key: str, s: FloatArray, others: tuple[str, ...], make: Callable[..., Made]) -> list[Made]:
    """Return the parts of the lap in a list of mappings with from_m, to_m and other keys."""
    if entries is None:
        return []
    if not isinstance(entries, list) or len(entries) > MAX_PARTS:
        raise CourseFileError(f"{key} must be a list of at most {MAX_PARTS} parts")
    made = []
    for number, entry in enumerate(entries, start=1):
        where = f"{key}: part {number}"
        begin, end, *values = values_of(entry, where, ("from_m", "to_m", *others))
        places = [length_of(begin, f"{where}: from_m"), length_of(end, f"{where}: to_m")]
        if not all(0.0 <= place <= s[-1] for place in places):
            raise CourseFileError(f"{where}: from_m and to_m must be 0 to the length of {s[-1]:.0f} m")
        made.append(_refused(where, partial(make, *places, *values, where)))
    return made


def _wet(begin: float, end: float, grip: Any, where: str) -> WetPatch:
    return WetPatch(begin, end, number_of(grip, f"{where}: grip"))


def _run_off(begin: float, end: float, side: Any, kind: Any, where: str) -> RunOffPart:
    kinds = {item.name.lower(): item for item in RunOffKind}
    if not isinstance(kind, str) or kind not in kinds:
        raise CourseFileError(f"{where}: kind must be one of {', '.join(kinds)}, got {show(kind)}")
    if not isinstance(side, str) or side not in SIDES:
        raise CourseFileError(f"{where}: side must be one of {', '.join(SIDES)}, got {show(side)}")
    return RunOffPart(begin, end, side, kinds[kind])


def _wind(value: Any) -> Wind:
    if value is None:
        return Wind()
    keys = ("speed_m_s", "towards_deg", "gusts", "seed")
    speed, towards, gusts, seed = values_of(value, "wind", keys)
    numbers = [number_of(v, f"wind: {k}") for k, v in zip(keys[:3], (speed, towards, gusts), strict=True)]
    return _refused("wind", lambda: Wind(numbers[0], math.radians(numbers[1]), numbers[2], _seed(seed, "wind: seed")))


def _walls(value: Any) -> Walls:
    if value is None:
        return Walls()
    if not isinstance(value, dict):
        raise CourseFileError(f"walls must be a mapping, got {show(value)}")
    keys = {"friction": "friction", "restitution": "restitution", "hit_m_s": "hit"}
    check_keys("walls: ", value, tuple(keys))
    numbers = {keys[key]: number_of(number, f"walls: {key}") for key, number in value.items()}
    return _refused("walls", lambda: Walls(**numbers))
