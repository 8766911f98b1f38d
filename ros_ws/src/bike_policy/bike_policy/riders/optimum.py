"""The best lap found of a machine on a circuit: a line and its speeds by arc length, ridden by the classical law.

A lap is found by riding (`bike_training.rollout.optimum`): no plan is trusted, and what is kept has been ridden. The
law brings the machine back to the lap after a start or a push, so it is ridden from any start and through the nodes,
and the same ride is the same bit for bit. The lap is an upper bound of the optimum of the full model.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from bike_policy.contract.observation import VehicleRows, rows_of
from bike_policy.planning.lap_plan import (
    P_CURVATURE,
    P_LONGITUDINAL,
    P_SPEED,
    LinePlan,
    RiderSettings,
    plan_line,
)
from bike_policy.planning.line_law import HEADING_ERROR, LATERAL_ERROR, PROGRESS, LineLaw, seen_of
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

OPTIMUM: Final = "optimum"
"""Name of this rider."""
KNOT_SPACING: Final = 10.0
"""Distance of the knots of a lap, m; their number divides the line evenly."""
SETTINGS: Final = RiderSettings(
    lateral=0.93, brake=0.9, brake_upright=1.04, brake_exponent=3.2, brake_decline=1.0, dip=0.7, bank=0.35,
    lean_rate=0.95, largest_lean=math.radians(60.0),
)  # fmt: skip
"""Settings of the law and of the plan that a search begins with: those of the classical rider when the laps were found,
but the largest lean, which is the machine's. They are fixed, so that a lap stays what it is."""
DIGITS: Final = 4
"""Decimals of a stored lap (m, m/s); a search rounds to them, so that what is stored is what was ridden."""
LENGTH_TOLERANCE: Final = 0.01
"""Difference of length up to which two lines are the same, m."""
IDEAL_SUFFIX: Final = " (ideal)"
FOLDER: Final = "laps"


@dataclass(frozen=True, eq=False)
class BestLap:
    """A lap by evenly spaced knots along the ideal line of a machine; the knot at its end is the first one.

    Attributes:
        vehicle: name of the machine.
        circuit: name of the circuit.
        length: of the ideal line, m.
        lap_time: of the slower of two flying laps on the compiled engine, s.
        offset: distance of the ridden line from the ideal line, positive to the left, m, shape (knots,).
        speed: that the law asks for, m/s, shape (knots,).
    """

    vehicle: str
    circuit: str
    length: float
    lap_time: float
    offset: FloatArray
    speed: FloatArray

    @property
    def s(self) -> FloatArray:
        """Arc length of the knots along the ideal line, m."""
        knots: FloatArray = np.arange(len(self.offset), dtype=np.float64)
        return knots * (self.length / len(self.offset))

    def write(self, path: Path, **head: object) -> None:
        """Write a file that :meth:`read` reads.

        Args:
            path: of the file.
            head: further entries of its head, for people.
        """
        entries = {"vehicle": self.vehicle, "circuit": self.circuit, "length_m": self.length, "lap_s": self.lap_time}
        with path.open("w", newline="", encoding="utf-8") as file:
            file.writelines(f"# {key}: {value}\n" for key, value in (entries | head).items())
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("offset_m", "speed_m_s"))
            writer.writerows(
                (f"{d:.{DIGITS}f}", f"{v:.{DIGITS}f}") for d, v in zip(self.offset, self.speed, strict=True)
            )

    @classmethod
    def read(cls, path: Path) -> BestLap:
        """Read a lap.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is another file, or damaged.
        """
        lines = path.read_text(encoding="utf-8").splitlines()
        head = dict(line[2:].split(": ", 1) for line in lines if line.startswith("# ") and ": " in line)
        try:
            rows = np.array([line.split(",") for line in lines if not line.startswith("#")][1:], dtype=np.float64)
            offset, speed = rows.T
            lap = cls(head["vehicle"], head["circuit"], float(head["length_m"]), float(head["lap_s"]), offset, speed)
        except (KeyError, ValueError) as error:
            raise ValueError(f"{path} holds no lap ({error!r}); it is damaged or another file") from error
        if not (np.isfinite(rows).all() and (speed > 0.0).all() and lap.length > 0.0):
            raise ValueError(f"{path} holds a lap with values that are not finite, or speeds that are not positive")
        return lap


def shipped_lap(vehicle: str, circuit: str) -> Path:
    """Return the file of a machine's shipped lap on a circuit, which need not exist."""
    return Path(str(resources.files("bike_policy") / FOLDER / f"{vehicle}_{circuit}.csv"))


def circuit_of(line: Course) -> str:
    """Return the name of the circuit that a line is the ideal line of.

    Raises:
        ValueError: it is another line.
    """
    if not line.name.endswith(IDEAL_SUFFIX):
        raise ValueError(f"best laps lie along a circuit's ideal line, and {line.name!r} is another line")
    return line.name.removesuffix(IDEAL_SUFFIX)


class LapLaw:
    """The classical law on laps that lie beside a line, for rides side by side; implements `BatchRider`.

    Attributes:
        law: the classical law.
    """

    def __init__(self, vehicle: Superbike, line: Course, period: float, count: int = 1) -> None:
        """Prepare rides of a line.

        Args:
            vehicle: the machine.
            line: its ideal line.
            period: control period, s.
            count: number of rides.

        Raises:
            ValueError: the line is open.
        """
        self.law, self.plan = LineLaw(vehicle, period, SETTINGS, count), plan_line(vehicle, line, SETTINGS)
        self._beside = np.zeros((count, 2, len(self.plan.table)))
        for row in range(count):
            self.law.begin(row, LinePlan(self.plan.profile, self.plan.spacing, self.plan.table.copy()))

    def follow(self, row: int, lap: BestLap) -> None:
        """Let a ride follow a lap from now on; what it remembers stays."""
        s, curvature = self.plan.profile.s, self.plan.table[:, P_CURVATURE]
        # SciPy's spline takes the period's end as a knot of its own.
        knots = np.append(lap.s, lap.length)
        line = CubicSpline(knots, np.append(lap.offset, lap.offset[0]), bc_type="periodic")
        speed = CubicSpline(knots, np.append(lap.speed, lap.speed[0]), bc_type="periodic")
        d, slope, bend, asked = line(s), line(s, 1), line(s, 2), speed(s)
        ahead = 1.0 - curvature * d
        stretch = np.hypot(ahead, slope)
        turn = np.gradient(curvature, self.plan.spacing)
        table = self.law.table(row)
        table[:, P_CURVATURE] = ahead * (curvature * ahead + bend) + slope * (turn * d + 2.0 * curvature * slope)
        table[:, P_CURVATURE] /= stretch**3
        table[:, P_SPEED], table[:, P_LONGITUDINAL] = asked, asked * speed(s, 1) / stretch
        self._beside[row] = d, np.arctan2(slope, ahead)

    def begin(self, row: int, rows: VehicleRows | None, line: Course) -> None:
        """Begin a ride of the lap that is followed, without a past; see `BatchRider`."""
        self.law.memory[row] = 0.0

    def commands(self, rows: VehicleRows, step: int = 0) -> FloatArray:
        """Return steering and throttle in [-1, 1], shape (n, 2); see `BatchRider`."""
        seen = np.nan_to_num(seen_of(rows.state, rows.look))
        last = len(self.plan.table) - 2
        u = np.mod(seen[:, PROGRESS] / self.plan.spacing, last + 1)
        i = np.minimum(u.astype(np.int64), last)
        each = np.arange(len(seen))
        here, there = self._beside[each, :, i], self._beside[each, :, i + 1]
        seen[:, [LATERAL_ERROR, HEADING_ERROR]] -= here + (u - i)[:, None] * (there - here)
        return self.law.commands(seen)


class OptimumRider:
    """Rides the best lap found of a machine on a circuit; implements `bike_policy.riders.base.Rider`.

    Attributes:
        lap: that is ridden; None before the first ride of one that is shipped.
    """

    name = OPTIMUM
    preview: Preview | None = None

    def __init__(self, lap: BestLap | None = None) -> None:
        """Take a lap; None for the one that is shipped of the machine and the circuit."""
        self.lap, self._given = lap, lap is not None
        self._ride: tuple[Vehicle, Course, float] | None = None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Find the lap; see `Rider`.

        Raises:
            ValueError: a vehicle that is no superbike, or a lap of another machine or line.
            FileNotFoundError: no lap of this machine on this circuit is shipped.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"best laps are those of superbikes, and {vehicle.name!r} is none")
        known = self._ride
        if known is None or known[0] is not vehicle or known[1] is not course or known[2] != period:
            lap = self.lap if self._given else _shipped(vehicle.name, circuit_of(course))
            assert lap is not None, "it is given or shipped"
            check_fit(lap, vehicle, course)
            self.lap, self._law = lap, LapLaw(vehicle, course, period)
            self._law.follow(0, lap)
            self._ride = (vehicle, course, period)
        self._law.begin(0, None, course)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the law's command; None where the snapshot is not finite."""
        if not np.isfinite(seen_of(snapshot.state[None], snapshot.look[None])).all():
            return None
        steering, throttle = self._law.commands(rows_of(snapshot))[0].tolist()
        return steering, throttle


def check_fit(lap: BestLap, vehicle: Superbike, line: Course) -> None:
    """Check that a lap is of a machine and a line.

    Raises:
        ValueError: it is of another.
    """
    if (lap.vehicle, lap.circuit) != (vehicle.name, circuit_of(line)):
        raise ValueError(f"the lap is of {lap.vehicle} on {lap.circuit}, not of {vehicle.name} on {circuit_of(line)}")
    if abs(lap.length - line.length) > LENGTH_TOLERANCE:
        raise ValueError(
            f"the lap of {lap.vehicle} on {lap.circuit} lies along a line of {lap.length:.3f} m, and this one has "
            f"{line.length:.3f} m: circuit, machine or the method of lines have changed; search the lap anew"
        )


def _shipped(vehicle: str, circuit: str) -> BestLap:
    path = shipped_lap(vehicle, circuit)
    if not path.is_file():
        known = sorted(entry.stem for entry in path.parent.glob("*.csv"))
        raise FileNotFoundError(
            f"no best lap of {vehicle} on {circuit} is shipped ({', '.join(known)} are); "
            f"`bike train {vehicle} --preset {OPTIMUM} --course {circuit}` searches one"
        )
    return BestLap.read(path)
