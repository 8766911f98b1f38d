"""Vehicle files: those shipped with the package, and the user's own."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable
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
from bike_sim.vehicles.magic_formula import coefficients_of_tir
from bike_sim.vehicles.parameters import FORMAT, VehicleError, explained
from bike_sim.vehicles.superbike import Superbike, SuperbikeFile, superbike_from_document

SHIPPED: Final = resources.files("bike_sim") / "config" / "vehicles"
"""Folder of the vehicles that come with the package."""
VARIANTS: Final = SHIPPED / "variants"
"""Folder of those that stand on another one by ``base``."""

MAX_BASES: Final = 4
"""Largest number of files that stand on each other by ``base``."""

_HEAD: Final = """\
# A vehicle. Change the numbers, save it as a .yaml file, and ride it: bike ride --vehicle mine.yaml
# name: short, without blanks. description: one line. sources: publications of the values, by the mark that cites them.
# Axes and signs: docs/explanation/bicycle.md (z down, as published) and docs/explanation/superbike.md (z up)."""


def shipped_vehicles() -> tuple[str, ...]:
    """Return the names of the vehicles that come with the package, sorted; `shipped_variants` are not among them."""
    return _names_in(SHIPPED)


def shipped_variants() -> tuple[str, ...]:
    """Return the names of the vehicles that come with the package and stand on one of `shipped_vehicles`, sorted."""
    return _names_in(VARIANTS)


def _names_in(folder: Traversable) -> tuple[str, ...]:
    return tuple(sorted(entry.name[: -len(".yaml")] for entry in folder.iterdir() if entry.name.endswith(".yaml")))


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
    return vehicle_from_document(vehicle_document(name_or_path), shorten(str(name_or_path)))


def vehicle_template(name_or_path: str | Path) -> str:
    """Return the text of a vehicle file with the values of another one, and unit and meaning of every key.

    Args:
        name_or_path: of the other one, as for `load_vehicle`.

    Raises:
        FileNotFoundError, VehicleError: as of `load_vehicle`.
    """
    load_vehicle(name_or_path)
    document = vehicle_document(name_or_path) | {"sources": {"M1": "where a value comes from"}}
    kind = SuperbikeFile if "type" in document else BicycleFile
    return "\n".join([_HEAD, *explained(kind, document | {"name": "mine", "description": "My vehicle"})])


def vehicle_document(name_or_path: str | Path, bases: int = 0) -> Any:
    """Return the content of a vehicle's file, put over that of its ``base``, if it names one; see `load_vehicle`.

    A base is a shipped vehicle, or a file beside the one that names it; of several, each is put over those before it.
    Sections are joined key by key.

    Args:
        name_or_path: of the vehicle.
        bases: number of files that name this one as their base.

    Raises:
        FileNotFoundError: there is no such vehicle or file.
        VehicleError: a file is not YAML, or too many stand on each other.
    """
    document, folder = _own_document(name_or_path)
    base = document.pop("base", None) if isinstance(document, dict) else None
    if base is None:
        return document
    text = shorten(str(name_or_path))
    names = base if isinstance(base, list) else [base]
    if not names or not all(isinstance(name, str) for name in names):
        raise VehicleError(f"vehicle '{text}': base = {show(base)} is no name of a vehicle")
    if bases >= MAX_BASES:
        raise VehicleError(f"vehicle '{text}': base = {show(base)} is one base too many, at most {MAX_BASES}")
    for name in reversed(names):
        below = vehicle_document(folder / name if name.endswith((".yaml", ".yml")) else name, bases + 1)
        if not isinstance(below, dict):
            return below
        document = joined(below, document)
    return document


def joined(below: dict[Any, Any], above: dict[Any, Any]) -> dict[Any, Any]:
    """Return nested mappings put over others."""
    nested = {
        key: joined(below[key], value)
        for key, value in above.items()
        if isinstance(value, dict) and isinstance(below.get(key), dict)
    }
    return below | above | nested


def _own_document(name_or_path: str | Path) -> tuple[Any, Path]:
    """Return the content of a file alone, with the coefficients of its ``.tir`` files, and the file's folder."""
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or text.endswith((".yaml", ".yml")) or "/" in text:
        path = Path(name_or_path)
        return _read(path, text), path.parent
    folder = SHIPPED if text in shipped_vehicles() else VARIANTS
    if folder is VARIANTS and text not in shipped_variants():
        known = alternatives(text, (*shipped_vehicles(), *shipped_variants()))
        raise FileNotFoundError(f"no vehicle '{shorten(text)}'; {known}; a file of your own must end in .yaml")
    with resources.as_file(folder / f"{text}.yaml") as path:
        return _read(path, text), path.parent


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
        document = parse_yaml(read_text(path, MAX_YAML_SIZE))
    except FileNotFoundError:
        raise FileNotFoundError(f"vehicle file '{origin}' does not exist") from None
    except DocumentError as error:
        raise VehicleError(f"vehicle '{origin}' {error}") from None
    for name in ("front_tyre", "rear_tyre"):
        tyre = document.get(name) if isinstance(document, dict) else None
        if isinstance(tyre, dict) and isinstance(tyre.get("magic_formula"), str):
            where = f"vehicle '{origin}': {name}.magic_formula"
            tyre["magic_formula"] = _tir(path.parent, tyre["magic_formula"], where)
    return document


def _tir(folder: Path, name: str, where: str) -> dict[str, float]:
    """Return the coefficients of a ``.tir`` file in the folder of a vehicle's file.

    Raises:
        VehicleError: there is no such file, or it is broken.
    """
    where = f"{where} = {show(name)}"
    if not name.lower().endswith(".tir"):
        raise VehicleError(f"{where} is no name of a .tir file")
    try:
        return coefficients_of_tir(read_text(folder / name, MAX_YAML_SIZE), where)
    except FileNotFoundError:
        raise VehicleError(f"{where} does not exist beside the vehicle's file") from None
    except DocumentError as error:
        raise VehicleError(f"{where} {error}") from None


def vehicle_from_document(document: Any, origin: str) -> Vehicle:
    """Build a vehicle from the parsed content of a vehicle file.

    A file with ``type: superbike`` gives a `bike_sim.vehicles.superbike.Superbike`, one without type a bicycle.

    Args:
        document: result of the YAML parser.
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
        if isinstance(document, dict) and document.get("format", FORMAT) != FORMAT:
            raise VehicleError(f"vehicle '{origin}': format is '{document['format']}', this version reads '{FORMAT}'")
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
