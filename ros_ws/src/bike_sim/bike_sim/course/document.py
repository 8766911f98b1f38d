"""Checks of the values in a course's document, with one clear error for each invalid one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bike_sim.course.csv_line import MAX_COORDINATE, CourseFileError
from bike_sim.documents import check_name, check_text, show

MAX_LENGTH = 100e3
"""Longest course, m. A longer one is a mistake of units, and would fill the memory with samples."""

START_KEYS = ("x_m", "y_m", "heading_deg")
"""Keys of the position and heading at which a course begins."""


def values_of(value: Any, where: str, keys: tuple[str, ...]) -> list[Any]:
    """Return the values of a mapping that has exactly these keys."""
    if not isinstance(value, dict):
        raise CourseFileError(f"{where} must be a mapping with {' and '.join(keys)}, got {show(value)}")
    check_keys(f"{where}: ", value, keys)
    for key in keys:
        if key not in value:
            raise CourseFileError(f"{where}: {key} is missing")
    return [value[key] for key in keys]


def check_keys(where: str, found: Mapping[Any, Any], known: tuple[str, ...]) -> None:
    """Refuse keys that are not known."""
    for key in found:
        if key not in known:
            raise CourseFileError(f"{where}unknown key {show(key)}; known are {', '.join(known)}")


def name_of(found: Mapping[str, Any], key: str, default: str, where: str = "") -> str:
    """Return the name under a key, or the default where the key is not there.

    Raises:
        DocumentError: it is not a valid name, nor is the default, the file's name.
    """
    if key not in found:
        return default and check_name(default, f"{where}the file's name, which the course takes without '{key}',")
    return check_name(found[key], f"{where}{key}")


def description_of(found: Mapping[str, Any], default: str) -> str:
    """Return the description, or the default if there is none."""
    return check_text(found["description"], "description") if "description" in found else default


def truth_of(value: Any, name: str) -> bool:
    """Return a truth value, written true or false."""
    if value not in ("true", "false"):
        raise CourseFileError(f"{name} must be true or false, got {show(value)}")
    return bool(value == "true")


def number_of(value: Any, name: str) -> float:
    """Return a finite number."""
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        raise CourseFileError(f"{name} is {show(value)}, a number is needed") from None
    if not math.isfinite(number):
        raise CourseFileError(f"{name} is {show(value)}, a finite number is needed")
    return number


def length_of(value: Any, name: str) -> float:
    """Return a finite number that can be a length of a course, m."""
    number = number_of(value, name)
    if abs(number) > MAX_LENGTH:
        raise CourseFileError(f"{name} is {show(value)}, more than {MAX_LENGTH:g} m; metres?")
    return number


def start_of(start: Any) -> tuple[float, float, float]:
    """Return x, y, heading of a beginning (m, m, rad)."""
    if not isinstance(start, dict):
        raise CourseFileError(f"start must be a mapping with the keys {', '.join(START_KEYS)}, got {show(start)}")
    check_keys("start: ", start, START_KEYS)
    x, y, heading = (number_of(start.get(key, "0"), f"start: {key}") for key in START_KEYS)
    for key, value in zip(START_KEYS, (x, y, heading), strict=True):
        if abs(value) > MAX_COORDINATE:
            raise CourseFileError(f"start: {key} is {value:g}, beyond {MAX_COORDINATE:g}; metres and degrees?")
    return x, y, math.radians(heading)
