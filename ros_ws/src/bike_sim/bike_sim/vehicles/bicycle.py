"""Parameters of a bicycle: one YAML file, one frozen dataclass, one flat vector for compiled code.

The numbers keep the names, axes and signs of the benchmark publication (z down), because that
is how they are published and compared:

    Meijaard, Papadopoulos, Ruina, Schwab (2007). Linearized dynamics equations for the balance
    and steer of a bicycle: a benchmark and review. Proc. R. Soc. A 463, 1955-1982, Table 1.

Code that works in the project's z-up frame flips the sign of `zB`, `zH`, `IBxz` and `IHxz`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FORMAT: Final = "bike.vehicle/1"

PARAMETER_NAMES: Final = (
    "w",
    "c",
    "lam",
    "g",
    "rR",
    "mR",
    "IRxx",
    "IRyy",
    "xB",
    "zB",
    "mB",
    "IBxx",
    "IBxz",
    "IByy",
    "IBzz",
    "xH",
    "zH",
    "mH",
    "IHxx",
    "IHxz",
    "IHyy",
    "IHzz",
    "rF",
    "mF",
    "IFxx",
    "IFyy",
    "P",
    "D",
)
"""Order of `Vehicle.parameters`, the vector that compiled functions take as ``p``. `lam` is the paper's lambda."""

_BICYCLE_KEYS: Final = tuple("lambda" if name == "lam" else name for name in PARAMETER_NAMES[:-2])
_SECTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "bicycle": _BICYCLE_KEYS,
    "steering_drive": ("P", "D", "max_steer_deg"),
    "limits": ("fall_roll_deg",),
}
_TOP_LEVEL: Final = ("format", "name", "description", "sources", *_SECTIONS, "control_period_s")


class VehicleError(ValueError):
    """A vehicle's parameters are incomplete, unknown or physically impossible."""


@dataclass(frozen=True)
class Vehicle:
    """A Whipple bicycle with its steering drive and its limits.

    Masses in kg, lengths in m, inertias in kg m^2 about the body's own centre of mass, angles in
    rad. Positions and products of inertia are z-down from the rear contact point, as published.

    Variants come from `dataclasses.replace`, which checks again: ``replace(vehicle, P=0.0, D=0.0)``
    switches the steering drive off, ``replace(vehicle, g=0.0)`` switches gravity off.

    Attributes:
        name: short name, also that of the shipped file.
        description: one line for people.
        w: wheel base.
        c: trail, positive when the front contact is behind the steering axis.
        lam: steering axis tilt (the paper's lambda), positive when the axis leans back.
        g: gravity, N/kg.
        rR: rear wheel radius.
        mR: rear wheel mass.
        IRxx: rear wheel inertia about a diameter.
        IRyy: rear wheel inertia about its axle.
        xB: rear body centre of mass.
        zB: rear body centre of mass.
        mB: rear body mass, rider included.
        IBxx: rear body inertia.
        IBxz: rear body, element xz of the inertia tensor.
        IByy: rear body inertia.
        IBzz: rear body inertia.
        xH: handlebar and fork centre of mass.
        zH: handlebar and fork centre of mass.
        mH: handlebar and fork mass.
        IHxx: handlebar and fork inertia.
        IHxz: handlebar and fork, element xz of the inertia tensor.
        IHyy: handlebar and fork inertia.
        IHzz: handlebar and fork inertia.
        rF: front wheel radius.
        mF: front wheel mass.
        IFxx: front wheel inertia about a diameter.
        IFyy: front wheel inertia about its axle.
        P: stiffness of the steering drive, N m/rad.
        D: damping of the steering drive, N m s/rad.
        max_steer: largest set point of the steering angle on either side.
        fall_roll: roll angle beyond which the vehicle counts as fallen.
        control_period: time between two steering commands, s.
    """

    name: str
    description: str
    w: float
    c: float
    lam: float
    g: float
    rR: float
    mR: float
    IRxx: float
    IRyy: float
    xB: float
    zB: float
    mB: float
    IBxx: float
    IBxz: float
    IByy: float
    IBzz: float
    xH: float
    zH: float
    mH: float
    IHxx: float
    IHxz: float
    IHyy: float
    IHzz: float
    rF: float
    mF: float
    IFxx: float
    IFyy: float
    P: float
    D: float
    max_steer: float
    fall_roll: float
    control_period: float

    def __post_init__(self) -> None:
        """Check that the numbers describe a bicycle that can exist.

        Raises:
            VehicleError: naming the first invalid value.
        """
        for field in fields(self):
            if field.type == "float":
                require_finite(self.name, field.name, getattr(self, field.name))
        for key in ("w", "rR", "rF", "mR", "mB", "mH", "mF", "max_steer", "fall_roll", "control_period"):
            if getattr(self, key) <= 0.0:
                raise VehicleError(f"vehicle '{self.name}': {key} = {getattr(self, key)} must be positive")
        for key in ("g", "P", "D"):
            if getattr(self, key) < 0.0:
                raise VehicleError(f"vehicle '{self.name}': {key} = {getattr(self, key)} must not be negative")
        for key in ("lam", "max_steer", "fall_roll"):
            if abs(getattr(self, key)) >= math.pi / 2.0:
                degrees = math.degrees(getattr(self, key))
                raise VehicleError(f"vehicle '{self.name}': {key} = {degrees:.6g} deg must stay below 90 deg")
        for key in ("zB", "zH"):
            if getattr(self, key) >= 0.0:
                raise VehicleError(
                    f"vehicle '{self.name}': {key} = {getattr(self, key)} puts a centre of mass below the ground; "
                    "z points down in vehicle files, so heights are negative"
                )
        self._check_inertia("IR", self.IRxx, 0.0, self.IRyy, self.IRxx)
        self._check_inertia("IB", self.IBxx, self.IBxz, self.IByy, self.IBzz)
        self._check_inertia("IH", self.IHxx, self.IHxz, self.IHyy, self.IHzz)
        self._check_inertia("IF", self.IFxx, 0.0, self.IFyy, self.IFxx)

    def _check_inertia(self, body: str, xx: float, xz: float, yy: float, zz: float) -> None:
        """Check that a body symmetric about its xz plane can have this inertia tensor."""
        mean, radius = 0.5 * (xx + zz), math.hypot(0.5 * (xx - zz), xz)
        moments = sorted((mean - radius, yy, mean + radius))
        text = ", ".join(f"{value:.6g}" for value in moments)
        if moments[0] <= 0.0:
            raise VehicleError(
                f"vehicle '{self.name}': inertia {body} is not positive definite (principal moments {text} kg m2)"
            )
        # Published values are rounded, and a thin disc sits exactly on the limit.
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise VehicleError(
                f"vehicle '{self.name}': inertia {body} breaks the triangle inequality: its largest principal moment "
                f"exceeds the sum of the other two ({text} kg m2), which no mass distribution has"
            )

    @property
    def mass(self) -> float:
        """Mass of vehicle and rider, kg."""
        return self.mR + self.mB + self.mH + self.mF

    @cached_property
    def parameters(self) -> NDArray[np.float64]:
        """The parameters in the order of `PARAMETER_NAMES` as a read-only vector, the ``p`` of compiled code."""
        vector = np.array([getattr(self, name) for name in PARAMETER_NAMES], dtype=np.float64)
        vector.setflags(write=False)
        return vector


def bicycle_from_document(document: Any, origin: str) -> Vehicle:
    """Build a bicycle from the parsed content of its vehicle file.

    Args:
        document: what the YAML parser returned.
        origin: name or path for error messages.

    Raises:
        VehicleError: a key is missing or unknown, or a value is invalid.
    """
    top = require_keys(document, _TOP_LEVEL, f"vehicle '{origin}'")
    if top["format"] != FORMAT:
        raise VehicleError(f"vehicle '{origin}': format is '{top['format']}', this version reads '{FORMAT}'")
    values: dict[str, Any] = {"control_period": top["control_period_s"]}
    for section, keys in _SECTIONS.items():
        values.update(require_keys(top[section], keys, f"vehicle '{origin}', section '{section}'"))
    for key, value in values.items():
        require_finite(origin, key, value)
    values = {key: float(value) for key, value in values.items()}
    values["lam"] = values.pop("lambda")
    values["max_steer"] = math.radians(values.pop("max_steer_deg"))
    values["fall_roll"] = math.radians(values.pop("fall_roll_deg"))
    return Vehicle(name=str(top["name"]), description=str(top["description"]), **values)


def require_keys(mapping: Any, keys: tuple[str, ...], where: str) -> dict[str, Any]:
    """Return the mapping if it has exactly these keys."""
    if not isinstance(mapping, dict):
        raise VehicleError(f"{where}: expected a mapping with the keys {', '.join(keys)}")
    missing = [key for key in keys if key not in mapping]
    unknown = [str(key) for key in mapping if key not in keys]
    problems = [f"lacks {', '.join(missing)}"] if missing else []
    problems += [f"has unknown {', '.join(unknown)}"] if unknown else []
    if problems:
        raise VehicleError(f"{where}: {' and '.join(problems)}")
    return dict(mapping)


def require_finite(origin: str, key: str, value: Any) -> None:
    """Raise unless the value is a finite real number (YAML reads ``1e3`` as text: it wants ``1.0e+3``)."""
    try:
        finite = isinstance(value, int | float | np.floating) and math.isfinite(value)
    except OverflowError:
        raise VehicleError(f"vehicle '{origin}': {key} is a whole number beyond all floating-point numbers") from None
    if isinstance(value, bool) or not finite:
        raise VehicleError(f"vehicle '{origin}': {key} = {value!r} is not a finite number")
