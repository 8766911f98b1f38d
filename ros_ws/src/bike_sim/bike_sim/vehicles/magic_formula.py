"""Coefficients of the Magic Formula for motorcycle tyres; the law is `bike_sim.physics.superbike.magic_formula`."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Final

from bike_sim.vehicles.parameters import VehicleError, positive, signed


@dataclass(frozen=True)
class MagicFormula:
    """A tyre's coefficients by their published names; those without unit count from the nominal load."""

    Fz0: float = field(metadata=positive("N", "nominal load"))
    pCx1: float = field(metadata=signed("", "shape of the longitudinal force"))
    pDx1: float = field(metadata=signed("", "peak of the longitudinal force"))
    pDx2: float = field(metadata=signed("", "peak of the longitudinal force"))
    pEx1: float = field(metadata=signed("", "curvature of the longitudinal force"))
    pEx2: float = field(metadata=signed("", "curvature of the longitudinal force"))
    pEx3: float = field(metadata=signed("", "curvature of the longitudinal force"))
    pEx4: float = field(metadata=signed("", "curvature of the longitudinal force"))
    pKx1: float = field(metadata=signed("", "longitudinal slip stiffness"))
    pKx2: float = field(metadata=signed("", "longitudinal slip stiffness"))
    pKx3: float = field(metadata=signed("", "longitudinal slip stiffness"))
    pCy1: float = field(metadata=signed("", "shape of the side force"))
    pDy1: float = field(metadata=signed("", "peak of the side force"))
    pDy2: float = field(metadata=signed("", "peak of the side force"))
    pDy3: float = field(metadata=signed("", "peak of the side force"))
    pEy1: float = field(metadata=signed("", "curvature of the side force"))
    pEy2: float = field(metadata=signed("", "curvature of the side force"))
    pEy4: float = field(metadata=signed("", "curvature of the side force"))
    pKy1: float = field(metadata=signed("", "cornering stiffness"))
    pKy2: float = field(metadata=signed("", "cornering stiffness"))
    pKy3: float = field(metadata=signed("", "cornering stiffness"))
    pKy4: float = field(metadata=signed("", "cornering stiffness"))
    pKy5: float = field(metadata=signed("", "cornering stiffness"))
    pCy2: float = field(metadata=signed("", "shape of camber's part of the side force"))
    pKy6: float = field(metadata=signed("", "camber stiffness"))
    pKy7: float = field(metadata=signed("", "camber stiffness"))
    pEy5: float = field(metadata=signed("", "curvature of camber's part of the side force"))
    qHz3: float = field(metadata=signed("", "shift of the residual moment"))
    qHz4: float = field(metadata=signed("", "shift of the residual moment"))
    qBz1: float = field(metadata=signed("", "stiffness of the trail"))
    qBz2: float = field(metadata=signed("", "stiffness of the trail"))
    qBz5: float = field(metadata=signed("", "stiffness of the trail"))
    qBz6: float = field(metadata=signed("", "stiffness of the trail"))
    qCz1: float = field(metadata=signed("", "shape of the trail"))
    qDz1: float = field(metadata=signed("", "peak of the trail"))
    qDz2: float = field(metadata=signed("", "peak of the trail"))
    qDz3: float = field(metadata=signed("", "peak of the trail"))
    qDz4: float = field(metadata=signed("", "peak of the trail"))
    qEz1: float = field(metadata=signed("", "curvature of the trail"))
    qEz2: float = field(metadata=signed("", "curvature of the trail"))
    qEz3: float = field(metadata=signed("", "curvature of the trail"))
    qEz5: float = field(metadata=signed("", "curvature of the trail"))
    qBz9: float = field(metadata=signed("", "stiffness of the residual moment"))
    qBz10: float = field(metadata=signed("", "stiffness of the residual moment"))
    qDz8: float = field(metadata=signed("", "peak of the residual moment"))
    qDz9: float = field(metadata=signed("", "peak of the residual moment"))
    qDz10: float = field(metadata=signed("", "peak of the residual moment"))
    qDz11: float = field(metadata=signed("", "peak of the residual moment"))
    rBx1: float = field(metadata=signed("", "longitudinal force under side slip"))
    rBx2: float = field(metadata=signed("", "longitudinal force under side slip"))
    rCx1: float = field(metadata=signed("", "longitudinal force under side slip"))
    rBy1: float = field(metadata=signed("", "side force under longitudinal slip"))
    rBy2: float = field(metadata=signed("", "side force under longitudinal slip"))
    rBy3: float = field(metadata=signed("", "side force under longitudinal slip"))
    rCy1: float = field(metadata=signed("", "side force under longitudinal slip"))
    rc: float = field(metadata=positive("m", "radius of the crown"))
    c0: float = field(metadata=positive("m/N", "relaxation length by cornering stiffness, standing"))
    c1: float = field(metadata=signed("s/N", "change of it with the speed"))
    c2: float = field(metadata=signed("s2/(N m)", "change of it with the square of the speed"))

    @property
    def on(self) -> float:
        """1: the tyre follows this law; 0 in the record of one without coefficients."""
        return 1.0


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
