"""Measured bicycles: parameter files of BicycleParameters and the eigenvalues of what they describe.

A file has a line ``name = value+/-deviation`` for each parameter, in names, axes and signs of the benchmark bicycle:

    Moore, J. K. (2012). Human control of a bicycle. PhD thesis, University of California, Davis;
    github.com/moorepants/BicycleParameters, data/bicycles/*/Parameters/*Benchmark.txt.

Eigenvalues are measured on the compiled nonlinear bicycle and compared with the closed formulas, which know nothing of
it. A bicycle without wheels (the two-mass skate) cannot roll on the engine; it has the formulas alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Final

import numpy as np

from bike_sim.documents import DocumentError, read_text
from bike_sim.physics.bicycle import linear
from bike_sim.physics.bicycle.whipple import WhippleEngine
from bike_sim.validation.report import Check, Report
from bike_sim.vehicles.bicycle import FourBodies, Vehicle
from bike_sim.vehicles.parameters import VehicleError

SPEEDS: Final = tuple(np.arange(1.0, 10.1, 1.0).tolist())
"""Speeds, m/s, at which the eigenvalues are compared."""
ALLOWED: Final = 1e-6
"""Largest error of an eigenvalue, 1/s."""
_STEP: Final = 0.001
"""Integration step of the engine, s."""
_FINEST: Final = 0.01
"""Distance of the speeds at which stability is looked for, m/s."""
_LARGEST: Final = 20_000  # bytes of a file
_LINE: Final = re.compile(r"^\s*(\w+)\s*=\s*([^\s+]+(?:e\+\d+)?)\s*(?:\+/-.*)?$")
_PITCH: Final = {"IByy": ("IBxx", "IBzz"), "IHyy": ("IHxx", "IHzz")}
"""Moments on which nothing lateral depends. A file may lack them, and measured ones may belong to no distribution of
mass, so those of plane bodies take their place."""


def read_parameters(path: Path) -> FourBodies:
    """Return the four bodies of a parameter file.

    Raises:
        FileNotFoundError: there is no such file.
        VehicleError: a line is not one of a parameter, or one is missing.
    """
    found: dict[str, float] = {}
    try:
        text = read_text(path, _LARGEST)
    except DocumentError as error:
        raise VehicleError(f"parameters '{path.name}' {error}") from None
    for line in filter(str.strip, text.splitlines()):
        match = _LINE.match(line)
        try:
            found[match[1]] = float(match[2])  # type: ignore[index]
        except (TypeError, ValueError):
            raise VehicleError(f"parameters '{path.name}': {line.strip()[:60]!r} is not 'name = value'") from None
    found |= {name: sum(found.get(part, math.nan) for part in parts) for name, parts in _PITCH.items()}
    names = [entry.name for entry in fields(FourBodies)]
    if missing := [name for name in names if not math.isfinite(found.get(name, math.nan))]:
        raise VehicleError(f"parameters '{path.name}' lack {', '.join(missing)}")
    return FourBodies(**{name: found[name] for name in names})


def validate(path: Path, progress: Callable[[str], None] = lambda _: None) -> Report:
    """Measure the bicycle of a file, or of each file of a folder.

    Args:
        path: of the file or the folder.
        progress: called with the name of each bicycle.

    Raises:
        FileNotFoundError: there is no such file, or none in the folder.
        VehicleError: see `read_parameters`; a bicycle with wheels that cannot exist.
    """
    files = sorted(path.glob("*.txt")) if path.is_dir() else [path]
    if not files:
        raise FileNotFoundError(f"folder '{path}' has no parameter files (*.txt)")
    report, rows = Report(), []
    for file in files:
        name, bodies, error = file.stem, read_parameters(file), None
        progress(name)
        formula = [np.linalg.eigvals(linear.state_matrix(bodies, speed)) for speed in SPEEDS]
        if bodies.rR > 0.0 and bodies.rF > 0.0:
            limits = {"max_steer": 1.0, "fall_roll": 1.0, "control_period": 0.05}
            engine = WhippleEngine(Vehicle(**vars(bodies), name=name, description="", P=0.0, D=0.0, **limits), _STEP)
            measured = [np.linalg.eigvals(linear.measured_state_matrix(engine, speed)) for speed in SPEEDS]
            pairs = zip(formula, measured, strict=True)
            error = max(float(np.abs(np.subtract.outer(ours, wanted)).min(axis=0).max()) for wanted, ours in pairs)
            title = f"{name}: eigenvalues at 1 to 10 m/s, largest error, 1/s"
            report.checks.append(Check(name, title, error, 0.0, ALLOWED))
        lowest, highest = _stable(bodies)
        values = [
            {"speed_m_s": speed, "real_1_s": row.real.tolist(), "imaginary_1_s": row.imag.tolist()}
            for speed, row in zip(SPEEDS, formula, strict=True)
        ]
        rows.append(
            {
                "bicycle": name, "stable_from_m_s": lowest, "stable_to_m_s": highest, "error_1_s": error,
                "eigenvalues": values,
            }
        )  # fmt: skip
    report.tables["bicycles"] = rows
    return report


def _stable(bodies: FourBodies) -> tuple[float, float]:
    """Return the lowest and the highest speed up to 20 m/s at which no eigenvalue grows, m/s; nan without."""

    def growth(speed: float) -> float:
        return float(np.linalg.eigvals(linear.state_matrix(bodies, speed)).real.max())

    speeds = np.arange(_FINEST, 20.0, _FINEST)
    calm = np.flatnonzero([growth(speed) < 0.0 for speed in speeds])
    if not calm.size:
        return math.nan, math.nan
    last = calm[np.append(np.diff(calm) > 1, True)][0]
    ends = []
    for inside, outside in ((speeds[calm[0]], speeds[calm[0]] - _FINEST), (speeds[last], speeds[last] + _FINEST)):
        for _ in range(40):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if growth(middle) < 0.0 else (inside, middle)
        ends.append(float(inside))
    return ends[0], ends[1] if last < len(speeds) - 1 else math.inf
