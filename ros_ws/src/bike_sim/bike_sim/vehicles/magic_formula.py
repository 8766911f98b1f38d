"""Coefficients of the Magic Formula for motorcycle tyres; the law is `bike_sim.physics.superbike.magic_formula`."""

from __future__ import annotations

from dataclasses import field, fields, make_dataclass
from typing import Final

from bike_sim.vehicles.parameters import VehicleError, positive, signed

_COEFFICIENTS: Final = (
    ("Fz0", positive("N", "nominal load")),
    ("pCx1", signed("", "shape of the longitudinal force")),
    ("pDx1 pDx2", signed("", "peak of the longitudinal force")),
    ("pEx1 pEx2 pEx3 pEx4", signed("", "curvature of the longitudinal force")),
    ("pKx1 pKx2 pKx3", signed("", "longitudinal slip stiffness")),
    ("pCy1", signed("", "shape of the side force")),
    ("pDy1 pDy2 pDy3", signed("", "peak of the side force")),
    ("pEy1 pEy2 pEy4", signed("", "curvature of the side force")),
    ("pKy1 pKy2 pKy3 pKy4 pKy5", signed("", "cornering stiffness")),
    ("pCy2", signed("", "shape of camber's part of the side force")),
    ("pKy6 pKy7", signed("", "camber stiffness")),
    ("pEy5", signed("", "curvature of camber's part of the side force")),
    ("qHz3 qHz4", signed("", "shift of the residual moment")),
    ("qBz1 qBz2 qBz5 qBz6", signed("", "stiffness of the trail")),
    ("qCz1", signed("", "shape of the trail")),
    ("qDz1 qDz2 qDz3 qDz4", signed("", "peak of the trail")),
    ("qEz1 qEz2 qEz3 qEz5", signed("", "curvature of the trail")),
    ("qBz9 qBz10", signed("", "stiffness of the residual moment")),
    ("qDz8 qDz9 qDz10 qDz11", signed("", "peak of the residual moment")),
    ("rBx1 rBx2 rCx1", signed("", "longitudinal force under side slip")),
    ("rBy1 rBy2 rBy3 rCy1", signed("", "side force under longitudinal slip")),
    ("rc", positive("m", "radius of the crown")),
    ("c0", positive("m/N", "relaxation length by cornering stiffness, standing")),
    ("c1", signed("s/N", "change of it with the speed")),
    ("c2", signed("s2/(N m)", "change of it with the square of the speed")),
)
"""Published names with unit and meaning; those without unit count from the nominal load."""

MagicFormula = make_dataclass(
    "MagicFormula",
    [(name, float, field(metadata=meaning)) for names, meaning in _COEFFICIENTS for name in names.split()],
    frozen=True,
    namespace={"__doc__": "A tyre's coefficients by their published names.", "__module__": __name__, "on": 1.0},
)
"""`on` is 1: the tyre follows this law; it is 0 in the record of one without coefficients."""

_TIR_NAMES: Final = {"Fz0": "FNOMIN", "rc": "CROWN_RADIUS"}


def coefficients_of_tir(text: str, origin: str) -> dict[str, float]:
    """Return the coefficients in the text of a ``.tir`` file, by the names of `MagicFormula`.

    Lines are ``NAME = value``, after which ``$`` begins a comment; names are those of the fields in capitals, with
    ``FNOMIN`` for the nominal load and ``CROWN_RADIUS``. Sections and other names are passed over, and so are the
    shifts of an asymmetric tyre, which the law does not have. The relaxation length is by ``C0``, ``C1`` and ``C2``.

    Args:
        text: content of the file.
        origin: of the file, for error messages.

    Raises:
        VehicleError: a coefficient is missing, given twice or no number.
    """
    wanted = {_TIR_NAMES.get(entry.name, entry.name).upper(): entry.name for entry in fields(MagicFormula)}
    found: dict[str, float] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        key, equals, value = line.partition("$")[0].partition("=")
        name = wanted.get(key.strip().upper())
        if name is None or not equals:
            continue
        where = f"{origin}, line {number}: {key.strip()} = {value.strip()[:40]}"
        if name in found:
            raise VehicleError(f"{where} is given twice")
        try:
            found[name] = float(value)
        except ValueError:
            raise VehicleError(f"{where} is not a number") from None
    missing = [key for key, name in wanted.items() if name not in found]
    if len(missing) == len(wanted):
        raise VehicleError(f"{origin} has no coefficient of a motorcycle tyre; lines must be NAME = value")
    if missing:
        raise VehicleError(f"{origin} lacks {', '.join(missing)}")
    return found
