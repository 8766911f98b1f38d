"""Coefficients of the Magic Formula for motorcycle tyres; the law is `bike_sim.physics.superbike.magic_formula`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from bike_sim.vehicles.parameters import VehicleError

COEFFICIENTS: Final = (
    "Fz0", "pCx1", "pDx1", "pDx2", "pEx1", "pEx2", "pEx3", "pEx4", "pKx1", "pKx2", "pKx3", "pCy1", "pDy1", "pDy2",
    "pDy3", "pEy1", "pEy2", "pEy4", "pKy1", "pKy2", "pKy3", "pKy4", "pKy5", "pCy2", "pKy6", "pKy7", "pEy5", "qHz3",
    "qHz4", "qBz1", "qBz2", "qBz5", "qBz6", "qCz1", "qDz1", "qDz2", "qDz3", "qDz4", "qEz1", "qEz2", "qEz3", "qEz5",
    "qBz9", "qBz10", "qDz8", "qDz9", "qDz10", "qDz11", "rBx1", "rBx2", "rCx1", "rBy1", "rBy2", "rBy3", "rCy1",
)  # fmt: skip
"""Names of the coefficients; all are without unit but the nominal load Fz0, N."""

MAGIC_FORMULA: Final = np.dtype([(name, np.float64) for name in ("on", *COEFFICIENTS, "rc", "c0", "c1", "c2")])
"""Record of a tyre: 1 where it follows this law, its coefficients, the radius of its crown, m, and the relaxation
length by cornering stiffness, m/N, as a polynomial of the speed, m/s."""


def check_coefficients(values: Mapping[str, Any]) -> None:
    """Check that a tyre has all coefficients and nothing else.

    Raises:
        VehicleError: naming those that are missing, unknown or no finite numbers.
    """
    wanted = MAGIC_FORMULA.names[1:]  # type: ignore[index]
    missing, unknown = [n for n in wanted if n not in values], [str(n) for n in values if n not in wanted]
    if missing or unknown:
        raise VehicleError(
            f"magic_formula lacks {', '.join(missing) or 'nothing'}, has unknown {', '.join(unknown) or 'nothing'}"
        )
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise VehicleError(f"magic_formula.{name} = {value!r} is not a finite number")
