"""Plans of a lap: the machine's theoretical lap with a rider's reserve, as a table along the line."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import UNSEEN
from bike_policy.planning.reference import KEPT, LineTable
from bike_sim.course.course import Course
from bike_sim.physics.superbike.statics import steady_lateral
from bike_sim.planning.envelope import Envelope, envelope, left_by_turning
from bike_sim.planning.lap_limit import LapLimit, lap_limit
from bike_sim.schema import Quantity, Schema
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

PLAN: Final = Schema(
    (
        Quantity("speed", "m/s", 1, "planned"),
        Quantity("longitudinal", "m/s^2", 1, "acceleration along the line"),
        Quantity("curvature", "1/m", -1, "of the line, smoothed"),
        Quantity("grade", "1", 1, "rise of the road per m"),
        Quantity("crest", "1/m", 1, "vertical curvature of the road, positive in a dip"),
        Quantity("left", "m", 1, "room for targets on the left"),
        Quantity("right", "m", 1, "room for targets on the right"),
        Quantity("faster", "1", 1, "room for targets above the planned speed, as a part of it"),
    )
)
"""Columns of a plan at even distances along its line; in the mirrored ride left and right change places."""
P_SPEED, P_LONGITUDINAL, P_CURVATURE = map(PLAN.index, ("speed", "longitudinal", "curvature"))
P_GRADE, P_CREST = map(PLAN.index, ("grade", "crest"))
P_LEFT, P_RIGHT, P_FASTER = map(PLAN.index, ("left", "right", "faster"))
CLEARANCE: Final = 0.9
"""Distance from the limits that no target may ask for, m: that of the line itself; feedback misses it by up to this."""
UNLIMITED: Final = 1e3
"""Room beside a line without limits, m; and part of the planned speed by which targets may ask for more than that."""


@dataclass(frozen=True)
class RiderSettings:
    """Settings of a rider with a plan; the same for all machines and circuits.

    Attributes:
        lateral: part of the machine's lateral limit that the speed profile uses.
        brake: part of the braking limit.
        brake_upright: part of this that is used upright, where a wheel that lifts or locks is nearest.
        drive_exponent: by which driving leaves room for turning, however much the tyres would give; 2 is an ellipse.
        brake_exponent: the same of braking; 1 is a straight line.
        brake_decline: power of what turning leaves for braking; None for one by the exponent, which is a superellipse.
            Larger, with a larger exponent, it brakes more in a moderate lean and less in the deepest, where a machine
            on the brake weaves.
        dip: part of the load of a dip that the plan counts on; the tyres have to take up the change first.
        bank: part of banking that helps that the plan counts on: it has to be leaned for, and no rider may ask for more
            than `largest_lean`. Banking that hinders counts in full.
        lean_rate: part of the lean rate that the rider can ask for.
        preview: time from steering to lean beyond the reference model's own, s.
        bandwidth: rate at which errors are ridden out, by the frequency of the virtual rider's reference.
        stencil: time step of the derivatives along the line, s.
        smoothing: distance over which the line's curvature is averaged, m.
        lateral_trust: largest lateral error that feedback answers in full, m.
        speed_gain: acceleration by error of speed, 1/s.
        speed_preview: time from throttle to force, s.
        period: control period for which both previews are meant; also the age up to which the difference of two states
            is the rate of the lateral error, s.
        rate_memory: time constant of the estimate that replaces it when the previous state is older, s.
        largest_lean: largest lean that is requested, rad.
        unseen: grip that is kept in reserve where no lap has been.
    """

    lateral: float = 0.88
    brake: float = 0.9
    drive_exponent: float = 3.0
    brake_exponent: float = 1.75
    brake_upright: float = 1.0
    brake_decline: float | None = None
    dip: float = 0.0
    bank: float = 0.0
    lean_rate: float = 0.9
    preview: float = 0.16
    bandwidth: float = 0.55
    stencil: float = 0.2
    smoothing: float = 6.0
    lateral_trust: float = 2.0
    speed_gain: float = 5.0
    speed_preview: float = 0.10
    period: float = 0.02
    rate_memory: float = 0.1
    largest_lean: float = math.radians(57.3)
    unseen: float = 0.0


CLASSICAL_SETTINGS: Final = RiderSettings(
    lateral=0.93, brake=0.9, brake_upright=1.04, brake_exponent=3.2, brake_decline=1.0, dip=0.7, bank=0.35,
    lean_rate=0.95,
)  # fmt: skip
"""Settings of the classical rider, tuned on random circuits. The defaults above are not: others plan with them, whose
plans a policy has learned to see."""

CAREFUL_SETTINGS: Final = replace(CLASSICAL_SETTINGS, unseen=UNSEEN)
"""Of the same rider where nobody tells of the road."""

GUIDE: Final = RiderSettings(
    lateral=0.91, brake_exponent=3.2, brake_upright=1.04, brake_decline=1.0, dip=0.7, lean_rate=1.0
)
"""Settings of the guide of racing policies: fixed, so that what a policy adds does not change with the classical
rider."""

REFERENCE: Final = RiderSettings(
    lateral=0.87,
    brake=0.92,
    drive_exponent=1.9,
    brake_exponent=1.9,
    lean_rate=0.9,
    smoothing=6.0,
    largest_lean=math.radians(58.0),
)
"""Settings of the reference: fixed, so that what a policy sees does not change when the classical rider is tuned."""


def reserved(vehicle: Superbike, settings: RiderSettings) -> Envelope:
    """Return a machine's limits minus the rider's reserve."""
    limits = envelope(vehicle).within(settings.lateral)
    drag, drive, brake = limits.drag[:, None], limits.drive_table, limits.brake_table - limits.drag[:, None]
    count = brake.shape[2]
    decline = 1.0 / settings.brake_exponent if settings.brake_decline is None else settings.brake_decline
    driving = left_by_turning(count, settings.drive_exponent, 1.0 / settings.drive_exponent)
    braking = settings.brake_upright * left_by_turning(count, settings.brake_exponent, decline)
    driven = (drive[:, :, :1] + drag[..., None]) * driving[:, None] - drag[..., None]
    return replace(
        limits,
        drive_table=np.minimum(drive, driven),
        brake_table=drag + settings.brake * np.maximum(np.minimum(brake, brake[:, :, :1] * braking), 0.0),
        lean_rate=settings.lean_rate * limits.lean_rate,
    )


class SteadyLeans:
    """Lateral accelerations of a machine's steady turns, tabulated over speed and lean.

    Attributes:
        speeds: m/s.
        leans: rad, from 0 to the largest that the rider may request.
        table: lateral accelerations, m/s^2, shape (speeds, leans).
    """

    def __init__(self, vehicle: Superbike) -> None:
        """Compute the table."""
        self.speeds = np.linspace(5.0, 1.1 * vehicle.top_gear_speed, 24)
        self.leans = np.linspace(0.0, math.radians(vehicle.virtual_rider.max_lean_deg), 31)
        self.table = np.array([[steady_lateral(vehicle, lean, speed) for lean in self.leans] for speed in self.speeds])

    def row(self, speed: float) -> FloatArray:
        """Return the lateral accelerations of the leans at a speed, m/s^2."""
        u = float(np.interp(speed, self.speeds, np.arange(len(self.speeds))))
        i = min(int(u), len(self.speeds) - 2)
        return np.asarray(self.table[i] + (u - i) * (self.table[i + 1] - self.table[i]))


def plan_lap(vehicle: Superbike, line: Course, settings: RiderSettings, cap: FloatArray | None = None) -> LapLimit:
    """Return the fastest profile with the rider's reserve.

    Args:
        vehicle: the machine.
        line: closed line to follow.
        settings: of the ride.
        cap: largest speed that is wanted at each point of the profile but the last, m/s; None for any.

    Raises:
        ValueError: the line is open.
    """
    crest = np.where(line.crest > 0.0, settings.dip * line.crest, line.crest)
    across = line.slope_across
    across = np.where(across * line.curvature > 0.0, across, settings.bank * across)
    return lap_limit(reserved(vehicle, settings), replace(line, bank=across), crest=crest, cap=cap)


def smooth_curvature(profile: LapLimit, distance: float) -> FloatArray:
    """Return the curvature of a lap's line averaged over a distance (m), the last value repeating the first, 1/m."""
    count = max(1, round(distance / float(profile.s[1])))
    window = np.hanning(count + 2)[1:-1]
    lap = (profile.lateral / profile.speed**2)[:-1]
    padded = np.concatenate((lap[-count:], lap, lap[:count]))
    smooth = np.convolve(padded, window / window.sum(), mode="same")[count:-count]
    return np.append(smooth, smooth[0])


class LinePlan(NamedTuple):
    """Plan of a closed line, as the law follows it, at even distances, the last sample repeating the first.

    Attributes:
        profile: the planned lap.
        spacing: of the samples, m.
        table: columns of PLAN, shape (n, 8).
    """

    profile: LapLimit
    spacing: float
    table: FloatArray

    def with_room_above(self, room: FloatArray) -> LinePlan:
        """Return the plan with other bounds of what targets may add to its speed.

        Args:
            room: part of the planned speed at the points of the profile but the last, shape (n - 1,).
        """
        table = self.table.copy()
        table[:, P_FASTER] = np.append(room, room[0])
        return self._replace(table=table)


def plan_line(vehicle: Superbike, line: Course, settings: RiderSettings, cap: FloatArray | None = None) -> LinePlan:
    """Plan a lap of a closed line.

    Args:
        vehicle: the machine.
        line: the line.
        settings: of the ride.
        cap: largest speed that is wanted, see `lap_plan.plan_lap`.

    Raises:
        ValueError: the line is open.
    """
    profile = plan_lap(vehicle, line, settings, cap)
    spacing = float(profile.s[1])
    curvature = smooth_curvature(profile, settings.smoothing)
    grade, crest = (np.interp(profile.s, line.s, column) for column in (line.grade, line.crest))
    rooms = (_room(profile.s, line.s, width) for width in (line.width_left, line.width_right))
    above = np.full(len(profile.s), UNLIMITED)
    columns = (profile.speed, profile.longitudinal, curvature, grade, crest, *rooms, above)
    return LinePlan(profile, spacing, np.stack(columns, axis=1))


def _room(places: FloatArray, s: FloatArray, width: FloatArray | None) -> FloatArray:
    """Return how far beside the line targets may lie towards a limit, m; without limits as far as they like."""
    if width is None:
        return np.full(len(places), UNLIMITED)
    return np.maximum(np.interp(places, s, width) - CLEARANCE, 0.0)


Planner = Callable[[Course], LinePlan]
"""Plans a lap of a closed line."""


def on_grip(vehicle: Superbike, grip: float) -> Superbike:
    """Return a machine whose tyres have a part of its own friction."""
    return vehicle.scaled(dict.fromkeys(("front_tyre.friction", "rear_tyre.friction"), grip))


def references_of(vehicle: Superbike) -> Callable[[Course], LineTable]:
    """Return references of a machine by line, each planned once."""

    @lru_cache(maxsize=KEPT)
    def reference(line: Course) -> LineTable:
        profile = plan_lap(vehicle, line, REFERENCE)
        return LineTable(
            float(profile.s[1]), np.stack((smooth_curvature(profile, REFERENCE.smoothing), profile.speed), axis=1)
        )

    return reference
