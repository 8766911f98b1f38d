"""The JSON Schema of ``bike analyze --json``, generated from the records in `results` and their docstrings.

The package carries it as ``analyze.schema.json``; ``python -m bike_analysis.figures.schema`` prints it.
"""

from __future__ import annotations

import inspect
import json
import re
import types
from dataclasses import fields, is_dataclass
from importlib.resources import files
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from bike_analysis.figures.metrics import RideFigures
from bike_analysis.figures.results import SCHEMA, WRITTEN, Analysis

FILE_NAME: Final = "analyze.schema.json"

_PLAIN: Final[dict[Any, str]] = {str: "string", int: "integer", bool: "boolean"}
_ATTRIBUTE: Final = re.compile(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


def shipped_schema() -> dict[str, Any]:
    """The schema that comes with the package."""
    return json.loads((files("bike_analysis.figures") / FILE_NAME).read_text(encoding="utf-8"))


def make_schema() -> dict[str, Any]:
    """Return the schema of the whole output."""
    definitions: dict[str, Any] = {}
    figures = _object(Analysis, definitions)
    figures["required"] = [name for name in figures["required"] if name not in WRITTEN]
    for name in WRITTEN:
        figures["properties"][name]["type"] = "string"
    ride = _object(RideFigures, definitions)
    ride["properties"] = {"recording": {"type": "string", "description": "The file."}, **ride["properties"]}
    ride["required"] = ["recording", *ride["required"]]
    definitions.pop("RideEntry")
    definitions["Ride"] = ride
    figures["properties"]["rides"]["items"] = {"$ref": "#/$defs/Ride"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": SCHEMA,
        "description": "What `bike analyze --json` prints. Names end in their units; null is what is not known.",
        "type": "object",
        "properties": {
            "schema": {"const": SCHEMA},
            "ok": {"type": "boolean", "description": "Whether all recordings could be read."},
            "figures": figures,
        },
        "required": ["schema", "ok", "figures"],
        "additionalProperties": False,
        "$defs": dict(sorted(definitions.items())),
    }


def _object(kind: type, definitions: dict[str, Any]) -> dict[str, Any]:
    """Schema of a record; records within it go to the definitions."""
    hints, told = get_type_hints(kind), _told(kind)
    properties = {}
    for f in fields(kind):
        properties[f.name] = _value(hints[f.name], definitions)
        if f.name in told:
            properties[f.name]["description"] = told[f.name]
    first_line = inspect.cleandoc(kind.__doc__ or "").splitlines()[0]
    return {
        "type": "object",
        "description": first_line,
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _told(kind: type) -> dict[str, str]:
    """Description of each attribute from a docstring, as plain text."""
    text = inspect.cleandoc(kind.__doc__ or "")
    return {name: " ".join(said.replace("`", "").split()) for name, said in _ATTRIBUTE.findall(text)}


def _value(hint: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    """Schema of a value."""
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if hint is float:
        return {"type": ["number", "null"]}  # what is not finite is null
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (tuple, list):
        return {"type": "array", "items": _value(arguments[0], definitions)}
    if origin is dict:
        return {"type": "object", "additionalProperties": _value(arguments[1], definitions)}
    if origin in (Union, types.UnionType):
        inner = _value(next(a for a in arguments if a is not type(None)), definitions)
        if "$ref" in inner:
            return {"anyOf": [inner, {"type": "null"}]}
        kinds = inner["type"] if isinstance(inner["type"], list) else [inner["type"]]
        return {**inner, "type": list(dict.fromkeys([*kinds, "null"]))}
    if is_dataclass(hint) and isinstance(hint, type):
        definitions.setdefault(hint.__name__, {})
        definitions[hint.__name__] = _object(hint, definitions)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    raise TypeError(f"no JSON Schema for {hint!r}")


if __name__ == "__main__":
    print(json.dumps(make_schema(), indent=2, ensure_ascii=False))
