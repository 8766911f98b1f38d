"""Records of settings: checks of their values, and their way through JSON and the command line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any


def check_entries(kind: type[Any], stored: Any, needed: Sequence[str] = ()) -> None:
    """Check that stored values are those of a record of settings.

    Args:
        kind: dataclass of the record.
        stored: what was read.
        needed: entries without a default.

    Raises:
        ValueError: it is no table, or an entry is missing, unknown, or of another kind than its default.
    """
    if not isinstance(stored, dict):
        raise ValueError(f"{kind.__name__} must be a table of settings, got {type(stored).__name__}")
    defaults = {spec.name: spec.default for spec in fields(kind)}
    unknown, missing = sorted(set(stored) - set(defaults)), sorted(set(needed) - set(stored))
    if unknown or missing:
        raise ValueError(f"{kind.__name__}: unknown entries {unknown}, missing entries {missing}")
    for name, value in stored.items():
        default = defaults[name]
        if default is MISSING:
            continue  # it is needed, or a record that checks itself
        wanted = (int, float) if isinstance(default, float) else list if isinstance(default, tuple) else type(default)
        if not isinstance(value, wanted):
            raise ValueError(f"{kind.__name__}: entry {name} is {value!r}, not a {type(default).__name__}")


def check_number(name: str, value: float, least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse a number that is not finite or outside its limits.

    Raises:
        ValueError: naming the setting and its value.
    """
    if math.isnan(value) or not least <= value <= most or math.isinf(value):
        wanted = "finite" if math.isinf(least) else f"at least {least:g}"
        if math.isfinite(most):
            wanted = f"{least:g} to {most:g}"
        raise ValueError(f"preset setting {name}={value!r} must be {wanted}")


def check_positive(name: str, value: float) -> None:
    """Refuse a number that is not positive and finite.

    Raises:
        ValueError: naming the setting and its value.
    """
    check_number(name, value)
    if not value > 0.0:
        raise ValueError(f"preset setting {name}={value!r} must be positive")


def parse(name: str, text: str, current: Any) -> Any:
    """Return a value given as text, as on a command line.

    Args:
        name: of the setting.
        text: its value.
        current: its present value, which says of which kind it is.

    Raises:
        ValueError: a value of another kind.
    """
    try:
        if isinstance(current, bool):
            return {"true": True, "false": False}[text.lower()]
        if isinstance(current, tuple):
            return tuple(int(part) for part in text.split(","))
        if isinstance(current, Mapping):
            return {name: float(weight) for name, _, weight in (part.partition(":") for part in text.split(","))}
        return type(current)(text)
    except (KeyError, ValueError) as error:
        kind = "list like 64,64" if isinstance(current, tuple) else type(current).__name__
        if isinstance(current, Mapping):
            kind = "list like path_linear:0.5,path_peak:0.5"
        raise ValueError(f"preset setting {name}={text!r} is not a {kind}") from error
