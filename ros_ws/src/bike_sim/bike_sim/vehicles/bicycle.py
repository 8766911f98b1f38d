"""A bicycle: one YAML file, one frozen dataclass, one flat vector for compiled code.

The numbers keep the names, axes and signs of the benchmark publication (z down), because that
is how they are published and compared:

    Meijaard, Papadopoulos, Ruina, Schwab (2007). Linearized dynamics equations for the balance
    and steer of a bicycle: a benchmark and review. Proc. R. Soc. A 463, 1955-1982, Table 1.

Code that works in the project's z-up frame flips the sign of `zB`, `zH`, `IBxz` and `IHxz`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from bike_sim.vehicles.parameters import (
    VehicleError,
    check_numbers,
    number,
    positive,
    read_record,
    signed,
)

MEASURED: Final = ("w", "c", "lam", "rR", "rF", "g")
"""Parameters that a rule measures and that positions follow from: nobody is wrong about them."""


@dataclass(frozen=True)
class FourBodies:
    """The four rigid bodies of the benchmark: rear wheel R, rear body B with the rider, fork H, front wheel F.

    Inertias are about the body's own centre of mass. Positions and products of inertia are z-down from the rear
    contact point, as published.
    """

    w: float = field(metadata=positive("m", "wheel base"))
    c: float = field(metadata=signed("m", "trail, positive when the front contact is behind the steering axis"))
    lam: float = field(metadata=signed("rad", "steering axis tilt, positive when it leans back") | {"key": "lambda"})
    g: float = field(metadata=number("N/kg", "gravity"))
    rR: float = field(metadata=positive("m", "rear wheel radius"))
    mR: float = field(metadata=positive("kg", "rear wheel mass"))
    IRxx: float = field(metadata=signed("kg m2", "rear wheel inertia about a diameter"))
    IRyy: float = field(metadata=signed("kg m2", "rear wheel inertia about its axle"))
    xB: float = field(metadata=signed("m", "rear body centre of mass"))
    zB: float = field(metadata=signed("m", "rear body centre of mass"))
    mB: float = field(metadata=positive("kg", "rear body mass, rider included"))
    IBxx: float = field(metadata=signed("kg m2", "rear body inertia"))
    IBxz: float = field(metadata=signed("kg m2", "rear body, element xz of the inertia tensor"))
    IByy: float = field(metadata=signed("kg m2", "rear body inertia"))
    IBzz: float = field(metadata=signed("kg m2", "rear body inertia"))
    xH: float = field(metadata=signed("m", "handlebar and fork centre of mass"))
    zH: float = field(metadata=signed("m", "handlebar and fork centre of mass"))
    mH: float = field(metadata=positive("kg", "handlebar and fork mass"))
    IHxx: float = field(metadata=signed("kg m2", "handlebar and fork inertia"))
    IHxz: float = field(metadata=signed("kg m2", "handlebar and fork, element xz of the inertia tensor"))
    IHyy: float = field(metadata=signed("kg m2", "handlebar and fork inertia"))
    IHzz: float = field(metadata=signed("kg m2", "handlebar and fork inertia"))
    rF: float = field(metadata=positive("m", "front wheel radius"))
    mF: float = field(metadata=positive("kg", "front wheel mass"))
    IFxx: float = field(metadata=signed("kg m2", "front wheel inertia about a diameter"))
    IFyy: float = field(metadata=signed("kg m2", "front wheel inertia about its axle"))


PARAMETER_NAMES: Final = (*(entry.name for entry in fields(FourBodies)), "P", "D")
"""Order of `Vehicle.parameters`, the vector that compiled functions take as ``p``. `lam` is the paper's lambda."""


@dataclass(frozen=True)
class Vehicle(FourBodies):
    """A Whipple bicycle with its steering drive and its limits.

    Variants come from `dataclasses.replace`, which checks again: ``replace(vehicle, P=0.0, D=0.0)``
    switches the steering drive off, ``replace(vehicle, g=0.0)`` switches gravity off.

    Attributes:
        name: short name, also that of the shipped file.
        description: one line for people.
    """

    name: str
    description: str
    P: float = field(metadata=number("N m/rad", "stiffness of the steering drive"))
    D: float = field(metadata=number("N m s/rad", "damping of the steering drive"))
    max_steer: float = field(metadata=positive("rad", "largest set point of the steering angle on either side"))
    fall_roll: float = field(metadata=positive("rad", "roll angle beyond which the vehicle counts as fallen"))
    control_period: float = field(metadata=positive("s", "time between two steering commands"))

    def __post_init__(self) -> None:
        """Check that the numbers describe a bicycle that can exist.

        Raises:
            VehicleError: naming the first invalid value.
        """
        check_numbers(self, self.name)
        for key in ("lam", "max_steer", "fall_roll"):
            if abs(getattr(self, key)) >= math.pi / 2.0:
                self._refuse(f"{key} = {math.degrees(getattr(self, key)):.6g} deg must stay below 90 deg")
        for key in ("zB", "zH"):
            if getattr(self, key) >= 0.0:
                self._refuse(
                    f"{key} = {getattr(self, key)} puts a centre of mass below the ground; "
                    "z points down in vehicle files, so heights are negative"
                )
        self._check_inertia("IR", self.IRxx, 0.0, self.IRyy, self.IRxx)
        self._check_inertia("IB", self.IBxx, self.IBxz, self.IByy, self.IBzz)
        self._check_inertia("IH", self.IHxx, self.IHxz, self.IHyy, self.IHzz)
        self._check_inertia("IF", self.IFxx, 0.0, self.IFyy, self.IFxx)

    def _refuse(self, text: str) -> None:
        raise VehicleError(f"vehicle '{self.name}': {text}")

    def _check_inertia(self, body: str, xx: float, xz: float, yy: float, zz: float) -> None:
        """Check that a body symmetric about its xz plane can have this inertia tensor."""
        mean, radius = 0.5 * (xx + zz), math.hypot(0.5 * (xx - zz), xz)
        moments = sorted((mean - radius, yy, mean + radius))
        text = ", ".join(f"{value:.6g}" for value in moments)
        if moments[0] <= 0.0:
            self._refuse(f"inertia {body} is not positive definite (principal moments {text} kg m2)")
        # Published values are rounded, and a thin disc sits exactly on the limit.
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            self._refuse(
                f"inertia {body} breaks the triangle inequality: its largest principal moment "
                f"exceeds the sum of the other two ({text} kg m2), which no mass distribution has"
            )

    @property
    def mass(self) -> float:
        """Mass of vehicle and rider, kg."""
        return self.mR + self.mB + self.mH + self.mF

    @property
    def scalable(self) -> tuple[str, ...]:
        """Names of the parameters of `scaled`: not those that a rule measures and that positions follow from."""
        return tuple(name for name, value in vars(self).items() if isinstance(value, float) and name not in MEASURED)

    def scaled(self, factors: Mapping[str, float]) -> Self:
        """Return the vehicle with parameters times factors, by names of `scalable`."""
        changed: dict[str, Any] = {name: getattr(self, name) * factor for name, factor in factors.items()}
        return replace(self, **changed)

    @cached_property
    def parameters(self) -> NDArray[np.float64]:
        """The parameters in the order of `PARAMETER_NAMES` as a read-only vector, the ``p`` of compiled code."""
        vector = np.array([getattr(self, name) for name in PARAMETER_NAMES], dtype=np.float64)
        vector.setflags(write=False)
        return vector


@dataclass(frozen=True)
class Limits:
    """Limits of a vehicle as its file states them."""

    fall_roll_deg: float = field(metadata=positive("deg", "roll angle beyond which the vehicle counts as fallen"))


@dataclass(frozen=True)
class VehicleFile:
    """Content that all vehicle files share.

    Attributes:
        format: `parameters.FORMAT`.
        name: short name.
        description: one line for people.
        sources: publications of the values, by the mark that cites them.
        limits: of the vehicle.
    """

    format: Any
    name: Any
    description: Any
    sources: Any
    limits: Limits
    control_period_s: float = field(metadata=positive("s", "time between two commands"))


@dataclass(frozen=True)
class _SteeringDrive:
    P: float = field(metadata=number("N m/rad", "stiffness"))
    D: float = field(metadata=number("N m s/rad", "damping"))
    max_steer_deg: float = field(metadata=positive("deg", "range of the set point to either side"))


@dataclass(frozen=True)
class BicycleFile(VehicleFile):
    """Content of the file of a bicycle."""

    bicycle: FourBodies
    steering_drive: _SteeringDrive


def bicycle_from_document(document: Any, origin: str) -> Vehicle:
    """Build a bicycle from the parsed content of its vehicle file.

    Args:
        document: result of the YAML parser.
        origin: name or path for error messages.

    Raises:
        VehicleError: a key is missing or unknown, or a value is invalid.
    """
    file = read_record(BicycleFile, document, origin)
    drive = file.steering_drive
    return Vehicle(
        **vars(file.bicycle),
        name=str(file.name),
        description=str(file.description),
        P=drive.P,
        D=drive.D,
        max_steer=math.radians(drive.max_steer_deg),
        fall_roll=math.radians(file.limits.fall_roll_deg),
        control_period=file.control_period_s,
    )
