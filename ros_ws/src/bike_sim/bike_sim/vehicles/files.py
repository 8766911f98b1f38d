"""Vehicle files: those that ship with the package, and one's own."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any, Final

import yaml

from bike_sim.unique_keys import UniqueKeys
from bike_sim.vehicles.bicycle import Vehicle, VehicleError, bicycle_from_document
from bike_sim.vehicles.superbike import superbike_from_document

SHIPPED: Final = resources.files("bike_sim") / "config" / "vehicles"
"""Folder of the vehicles that come with the package."""


def shipped_vehicles() -> tuple[str, ...]:
    """Return the names of the vehicles that come with the package, sorted."""
    return tuple(sorted(entry.name[: -len(".yaml")] for entry in SHIPPED.iterdir() if entry.name.endswith(".yaml")))


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Load a vehicle that ships with the package, or one's own from a file.

    Args:
        name_or_path: name of a shipped vehicle (see `shipped_vehicles`), or the path of a YAML file. What ends in
            ``.yaml`` or ``.yml`` or contains a folder separator is a path.

    Raises:
        FileNotFoundError: there is no such vehicle or file.
        VehicleError: the file is not YAML, lacks a key, has one too many, or describes an impossible vehicle.
    """
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or text.endswith((".yaml", ".yml")) or "/" in text:
        path = Path(name_or_path)
        if not path.is_file():
            raise FileNotFoundError(f"vehicle file '{path}' does not exist")
        content = _read(path)
    elif text in shipped_vehicles():
        content = (SHIPPED / f"{text}.yaml").read_text(encoding="utf-8")
    else:
        known = ", ".join(shipped_vehicles())
        raise FileNotFoundError(f"no vehicle '{text}'; shipped are: {known}; a file of your own must end in .yaml")
    try:
        document = yaml.load(content, Loader=_UniqueKeyLoader)
    except (yaml.YAMLError, ValueError) as error:  # a date or a number that cannot be is a ValueError
        raise VehicleError(f"vehicle '{text}' is not valid YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise VehicleError(f"vehicle '{text}' is nested too deeply") from None
    return vehicle_from_document(document, text)


class _UniqueKeyLoader(UniqueKeys, yaml.SafeLoader):
    """Safe loader that refuses a key given twice."""


def _read(path: Path) -> str:
    """Return the text of a file."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        wrong = error.object[error.start]
        raise VehicleError(f"vehicle '{path}' is not a UTF-8 text file (byte {error.start} is {wrong:#04x})") from None


def vehicle_from_document(document: Any, origin: str) -> Vehicle:
    """Build a vehicle from the parsed content of a vehicle file.

    A file with ``type: superbike`` gives a `bike_sim.vehicles.superbike.Superbike`, one without type a bicycle.

    Args:
        document: what the YAML parser returned.
        origin: name or path for error messages.

    Raises:
        VehicleError: a key is missing or unknown, or a value cannot be.
    """
    kind = document.get("type") if isinstance(document, dict) else None
    if kind == "superbike":
        return superbike_from_document(document, origin)
    if kind is not None:
        raise VehicleError(f"vehicle '{origin}': unknown type '{kind}'; there is 'superbike', and a bicycle has none")
    return bicycle_from_document(document, origin)
