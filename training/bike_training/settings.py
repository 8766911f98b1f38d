"""Records of settings: checks of their values, their plain form for JSON and YAML, and changes by path.

A record is a frozen dataclass whose fields have defaults. Where there are several kinds of a record, it holds the name
of its kind in the field that is called like its place: ``task.task``, ``curriculum.curriculum``, ``learner.learner``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, ClassVar, Final, TypeVar

from bike_sim.documents import DocumentError, alternatives, parse_yaml, show

RecordT = TypeVar("RecordT")


def check_number(name: str, value: float, least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse a number that is not finite or outside its limits.

    Raises:
        ValueError: naming the setting and its value.
    """
    if not (math.isfinite(value) and least <= value <= most):
        wanted = "positive" if least == POSITIVE[0] else f"at least {least:g}"
        if math.isfinite(most) or math.isinf(least):
            wanted = "finite" if math.isinf(least) else f"{least:.10g} to {most:.10g}"
        raise ValueError(f"setting {name}={value!r} must be {wanted}")


def check_choice(name: str, value: str, choices: Any) -> None:
    """Refuse a name that is not one of the choices.

    Raises:
        ValueError: naming the setting and its value.
    """
    if value not in choices:
        raise ValueError(f"setting {name}={show(value)} is not known; {alternatives(value, choices)}")


POSITIVE: Final = (math.nextafter(0.0, 1.0), math.inf)
AT_LEAST_0: Final = (0.0, math.inf)
AT_LEAST_1: Final = (1.0, math.inf)
"""Limits of numbers."""


class Settings:
    """A record whose numbers have limits.

    Attributes:
        place: name of the record, for messages.
        limits: least and largest value of numbers by name.
    """

    place: ClassVar[str] = ""
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {}

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the setting and its value.
        """
        for name, (least, most) in self.limits.items():
            check_number(f"{self.place}.{name}".lstrip("."), getattr(self, name), least, most)


def to_plain(record: Any) -> dict[str, Any]:
    """Return a record as tables, lists, texts, numbers and truth values."""
    return {spec.name: _plain(getattr(record, spec.name)) for spec in fields(record)}


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return to_plain(value)
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list | tuple) else value


def from_plain(kind: type[RecordT], stored: Any, place: str) -> RecordT:
    """Return the record that a table holds; what the table leaves out has its default.

    Args:
        kind: dataclass of the record.
        stored: what was read.
        place: name of the record, for messages.

    Raises:
        ValueError: it is not a table, or an entry is missing, unknown, of another kind than its default, or without
            a meaning.
    """
    if not isinstance(stored, Mapping):
        raise ValueError(f"{place} must be a table of settings, got {show(stored)}")
    known = {spec.name: spec for spec in fields(kind)}  # type: ignore[arg-type]
    for name in stored:
        if name not in known:
            raise ValueError(f"{place} has no setting {show(name)}; {alternatives(str(name), known)}")
    missing = [name for name, spec in known.items() if default_of(spec) is MISSING and name not in stored]
    if missing:
        raise ValueError(f"{place} lacks the setting {missing[0]!r}")
    return kind(**{name: _as_kind(f"{place}.{name}", value, default_of(known[name])) for name, value in stored.items()})


def default_of(spec: Field[Any]) -> Any:
    """Return the default of a field, or MISSING."""
    return spec.default_factory() if spec.default_factory is not MISSING else spec.default


def _as_kind(name: str, value: Any, default: Any) -> Any:
    """Return a value as of the kind of a default.

    Raises:
        ValueError: it is of another kind.
    """
    if default is MISSING or is_dataclass(value):
        return value
    wrong = ValueError(f"setting {name}={show(value)} is not a {_described(default)}")
    if isinstance(default, bool) or isinstance(value, bool):
        if type(default) is not type(value):
            raise wrong
        return value
    if isinstance(default, float):
        try:  # YAML takes 1e-3, which has no point, as text
            return float(value)
        except (TypeError, ValueError):
            raise wrong from None
    if isinstance(default, tuple):
        if not isinstance(value, list | tuple):
            raise wrong
        return tuple(_as_kind(name, part, default[0] if default else "") for part in value)
    if isinstance(default, Mapping):
        if not isinstance(value, Mapping):
            raise wrong
        return {str(key): _as_kind(f"{name}.{key}", part, 0.0) for key, part in value.items()}
    if not isinstance(value, type(default)):
        raise wrong
    return value


def _described(default: Any) -> str:
    names = {bool: "truth value", int: "whole number", float: "number", str: "text", tuple: "list"}
    return next((name for kind, name in names.items() if isinstance(default, kind)), "table of numbers")


def _parsed(path: str, text: str, current: Any) -> Any:
    """Return a value that a command line gives as text: YAML or a list with commas; text stays where it is one."""
    if isinstance(current, str):
        return text
    if isinstance(current, list):
        texts = [part.strip() for part in text.strip("[] ").split(",")]
        return texts if current and isinstance(current[0], str) else [_parsed(path, part, 0) for part in texts]
    try:
        return parse_yaml(text)
    except DocumentError as error:
        raise ValueError(f"setting {path}={show(text)}: {error}") from error


def change_plain(tree: Any, path: str, value: Any, place: str) -> None:
    """Change one setting of a record in plain form.

    Args:
        tree: of the record; it is changed.
        path: names of the setting and of the records around it, with points between them.
        value: in plain form, or as text of a command line.
        place: name of the record, for messages.

    Raises:
        ValueError: there is no such setting.
    """
    *around, name = path.split(".")
    table = tree
    for part in around:
        if not isinstance(table, dict) or part not in table:
            break
        table = table[part]
    else:
        if isinstance(table, dict) and (name in table or around[-1:] == ["weights"]):
            table[name] = _parsed(path, value, table.get(name)) if isinstance(value, str) else value
            return
    raise ValueError(f"{place} has no setting {show(path)}; {alternatives(path, paths_of(tree))}")


def paths_of(tree: Mapping[str, Any], around: str = "") -> list[str]:
    """Return the paths of all settings of a record in plain form; tables of numbers count as one."""
    found: list[str] = []
    for name, value in tree.items():
        deeper = isinstance(value, dict) and name != "weights"
        found += paths_of(value, f"{around}{name}.") if deeper else [f"{around}{name}"]
    return found
