"""Parameters of vehicles: dataclasses of numbers whose fields say unit, meaning and bounds, read from nested mappings.

A record is a frozen dataclass. A field made with `positive`, `number` or `signed` is a number of the file, one made
with `point` two of them, one whose type is a record is a section of it, and any other value is taken as it stands. What
has a default may be left out. Errors name the path in the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Final, TypeVar, get_args, get_type_hints

import numpy as np
import yaml

FORMAT: Final = "bike.vehicle/1"

_Record = TypeVar("_Record")


class VehicleError(ValueError):
    """A vehicle's parameters are incomplete, unknown or physically impossible."""


def number(unit: str, meaning: str, low: float = 0.0, strict: bool = False) -> dict[str, Any]:
    """Return the metadata of a field that is a number, by default not negative.

    Args:
        unit: of the value; empty where it has none.
        meaning: description.
        low: smallest value.
        strict: whether the value must be larger than that.
    """
    return {"unit": unit, "meaning": meaning, "low": low, "strict": strict}


def positive(unit: str, meaning: str) -> dict[str, Any]:
    """Return the metadata of a number above zero; see `number`."""
    return number(unit, meaning, 0.0, strict=True)


def signed(unit: str, meaning: str) -> dict[str, Any]:
    """Return the metadata of a number of any sign; see `number`."""
    return number(unit, meaning, -math.inf)


def point(meaning: str) -> dict[str, Any]:
    """Return the metadata of a point of the middle plane, x forward and z up, m; its field is a tuple of two."""
    return signed("m", meaning) | {"size": 2}


def read_record(kind: type[_Record], document: Any, origin: str, path: str = "") -> _Record:
    """Return a record from a mapping that has exactly its keys; sections are read from nested mappings.

    Args:
        kind: the dataclass; metadata may name another ``key`` than the field's name.
        document: result of the YAML parser for it.
        origin: name or path of the file, for error messages.
        path: of the mapping in the file, empty at its top.

    Raises:
        VehicleError: it is no mapping, a key is missing or unknown, or a number is not finite or out of bounds.
    """
    where = f"vehicle '{origin}': {path}" if path else f"vehicle '{origin}'"
    keys = {field.metadata.get("key", field.name): field for field in fields(kind)}  # type: ignore[arg-type]
    if not isinstance(document, dict):
        raise VehicleError(f"{where}: expected a mapping with the keys {', '.join(keys)}")
    missing = [key for key, entry in keys.items() if key not in document and entry.default is MISSING]
    unknown = [str(key) for key in document if key not in keys]
    problems = [f"lacks {', '.join(missing)}"] if missing else []
    problems += [f"has unknown {', '.join(unknown)}"] if unknown else []
    if problems:
        raise VehicleError(f"{where}: {' and '.join(problems)}")
    types, values = get_type_hints(kind), {}
    for key, field in keys.items():
        if key not in document:
            continue
        value, here = document[key], f"{path}.{key}" if path else key
        section = _section_of(types[field.name])
        if field.metadata:
            check_number(field.metadata, value, origin, here)
            value = tuple(map(float, value)) if "size" in field.metadata else float(value)
        elif section is not None:
            value = read_record(section, value, origin, here)  # type: ignore[arg-type]
        values[field.name] = value
    return kind(**values)


def _section_of(kind: Any) -> Any:
    """Return the record that a field's type is or may be, None where it is none."""
    return next((each for each in (kind, *get_args(kind)) if is_dataclass(each)), None)


def explained(kind: type, document: dict[str, Any], indent: str = "") -> Iterator[str]:
    """Yield the lines of a file with the values of another one, and unit and meaning beside every number.

    Args:
        kind: the dataclass that the file is read into.
        document: content of the other file.
        indent: of the lines.
    """
    types, keys = get_type_hints(kind), {field.metadata.get("key", field.name): field for field in fields(kind)}
    for key, value in document.items():
        field = keys[key]
        if (section := _section_of(types[field.name])) is not None:
            yield f"{indent}{key}:"
            yield from explained(section, value, indent + "  ")
        else:
            dumped = yaml.safe_dump({key: value}, width=100).rstrip()
            line = f"{indent}{f'{key}: {value}' if isinstance(value, list) else dumped}"
            texts = [text for name in ("unit", "meaning") if (text := field.metadata.get(name))]
            yield f"{line:32} # {', '.join(texts)}" if texts else line


def check_numbers(record: Any, origin: str, path: str = "") -> None:
    """Check all numbers of a record and of the records in it.

    Args:
        record: a dataclass.
        origin: name of the vehicle, for error messages.
        path: of the record in the vehicle, empty for the vehicle itself.

    Raises:
        VehicleError: naming the first number that is not finite or out of its bounds.
    """
    for field in fields(record):
        value, here = getattr(record, field.name), f"{path}.{field.name}" if path else field.name
        if field.metadata:
            check_number(field.metadata, value, origin, here)
        elif is_dataclass(value):
            check_numbers(value, origin, here)


def check_number(metadata: Any, value: Any, origin: str, path: str) -> None:
    """Check one value against the metadata of its field (YAML reads ``1e3`` as text: it wants ``1.0e+3``).

    Raises:
        VehicleError: it is not a finite real number within its bounds.
    """
    if "size" in metadata:
        size = metadata["size"]
        if not isinstance(value, list | tuple) or len(value) != size:
            raise VehicleError(f"vehicle '{origin}': {path} = {value!r} is no list of {size} numbers")
        for entry in value:
            check_number({name: metadata[name] for name in ("low", "strict")}, entry, origin, path)
        return
    try:
        finite = isinstance(value, int | float | np.floating) and math.isfinite(value)
    except OverflowError:
        raise VehicleError(f"vehicle '{origin}': {path} is a whole number beyond all floating-point numbers") from None
    if isinstance(value, bool) or not finite:
        raise VehicleError(f"vehicle '{origin}': {path} = {value!r} is not a finite number")
    if metadata["strict"] and value <= metadata["low"]:
        raise VehicleError(f"vehicle '{origin}': {path} = {value} must be positive")
    if value < metadata["low"]:
        raise VehicleError(f"vehicle '{origin}': {path} = {value} must not be negative")
