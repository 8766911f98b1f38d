"""Vehicle files: those shipped with the package, and the user's own."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any, Final

from bike_sim.documents import (
    MAX_MESSAGE,
    MAX_YAML_SIZE,
    DocumentError,
    alternatives,
    check_name,
    check_text,
    parse_yaml,
    read_text,
    shorten,
    show,
)
from bike_sim.vehicles.bicycle import BicycleFile, Vehicle, bicycle_from_document
from bike_sim.vehicles.parameters import VehicleError, explained
from bike_sim.vehicles.superbike import Superbike, SuperbikeFile, superbike_from_document

SHIPPED: Final = resources.files("bike_sim") / "config" / "vehicles"
"""Folder of the vehicles that come with the package."""

_HEAD: Final = """\
# A vehicle. Change the numbers, save it as a .yaml file, and ride it: bike ride --vehicle mine.yaml
# name: short, without blanks. description: one line. sources: publications of the values, by the mark that cites them.
# Axes and signs: docs/explanation/bicycle.md (z down, as published) and docs/explanation/superbike.md (z up)."""


def shipped_vehicles() -> tuple[str, ...]:
    """Return the names of the vehicles that come with the package, sorted."""
    return tuple(sorted(entry.name[: -len(".yaml")] for entry in SHIPPED.iterdir() if entry.name.endswith(".yaml")))


def shipped_superbikes() -> tuple[str, ...]:
    """Return the names of the superbikes among them, sorted."""
    return tuple(name for name in shipped_vehicles() if isinstance(load_vehicle(name), Superbike))


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Load a vehicle shipped with the package, or from a file.

    Args:
        name_or_path: name of a shipped vehicle (see `shipped_vehicles`), or the path of a YAML file. What ends in
            ``.yaml`` or ``.yml`` or contains a folder separator is a path.

    Raises:
        FileNotFoundError: there is no such vehicle or file.
        VehicleError: the file is not YAML, lacks a key, has one too many, or describes an impossible vehicle.
    """
    return vehicle_from_document(_document(name_or_path), shorten(str(name_or_path)))


def vehicle_template(name_or_path: str | Path) -> str:
    """Return the text of a vehicle file with the values of another one, and unit and meaning of every key.

    Args:
        name_or_path: of the other one, as for `load_vehicle`.

    Raises:
        FileNotFoundError, VehicleError: as of `load_vehicle`.
    """
    load_vehicle(name_or_path)
    document = _document(name_or_path) | {"sources": {"M1": "where a value comes from"}}
    kind = SuperbikeFile if "type" in document else BicycleFile
    return "\n".join([_HEAD, *explained(kind, document | {"name": "mine", "description": "My vehicle"})])


def _document(name_or_path: str | Path) -> Any:
    """Return the content of a vehicle's file; see `load_vehicle`."""
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or text.endswith((".yaml", ".yml")) or "/" in text:
        return _read(Path(name_or_path), text)
    if text not in shipped_vehicles():
        known = alternatives(text, shipped_vehicles())
        raise FileNotFoundError(f"no vehicle '{shorten(text)}'; {known}; a file of your own must end in .yaml")
    with resources.as_file(SHIPPED / f"{text}.yaml") as path:
        return _read(path, text)


def load_superbike(name_or_path: str | Path) -> Superbike:
    """Load a superbike; see `load_vehicle`.

    Raises:
        FileNotFoundError: there is no such vehicle or file.
        VehicleError: the file is broken, or describes a bicycle.
    """
    vehicle = load_vehicle(name_or_path)
    if not isinstance(vehicle, Superbike):
        raise VehicleError(f"vehicle '{vehicle.name}' is no superbike: it has no tyres")
    return vehicle


def _read(path: Path, origin: str) -> Any:
    origin = shorten(origin)
    try:
        return parse_yaml(read_text(path, MAX_YAML_SIZE))
    except FileNotFoundError:
        raise FileNotFoundError(f"vehicle file '{origin}' does not exist") from None
    except DocumentError as error:
        raise VehicleError(f"vehicle '{origin}' {error}") from None


def vehicle_from_document(document: Any, origin: str) -> Vehicle:
    """Build a vehicle from the parsed content of a vehicle file.

    A file with ``type: superbike`` gives a `bike_sim.vehicles.superbike.Superbike`, one without type a bicycle.

    Args:
        document: what the YAML parser returned.
        origin: name or path for error messages.

    Raises:
        VehicleError: a key is missing or unknown, or a value is invalid.
    """
    kind = document.get("type") if isinstance(document, dict) else None
    if kind is not None and kind != "superbike":
        raise VehicleError(
            f"vehicle '{origin}': unknown type {show(kind)}; there is 'superbike', and a bicycle has none"
        )
    try:
        vehicle = (superbike_from_document if kind else bicycle_from_document)(document, origin)
        # Of the document: the vehicle has them as text already.
        check_name(document["name"], "name")
        check_text(document["description"], "description")
    except VehicleError as error:
        # It may repeat any value of the file, whatever its length.
        raise VehicleError(shorten(str(error), MAX_MESSAGE)) from None
    except DocumentError as error:
        raise VehicleError(f"vehicle '{origin}': {error}") from None
    return vehicle
