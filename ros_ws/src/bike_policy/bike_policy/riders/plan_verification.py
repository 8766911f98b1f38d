"""A plan that has been ridden: it is slower where a ride of it on the compiled engine did not end well.

A plan is quasi-steady, and asks for nearly all that a machine can hold so. What a crest in a lean, or a chicane ridden
hop by hop, leaves of that depends on the whole motion; it is found by riding. As in iterative learning control, what
went wrong in a lap corrects the next one at the same place; here only the speed is corrected, and only downwards, so a
plan that rides well stays what it is, bit for bit.

The road is the followed line's: its hills, banking, wet patches and limits. Bumps and wind are not in a line, so a
verification knows nothing of them; the plan is ridden a little faster than it will be instead.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy import contract, riders
from bike_policy.riders.lap_plan import RiderSettings
from bike_policy.riders.line_law import LineLaw, LinePlan, plan_line, seen_of
from bike_sim import course, physics, sim
from bike_sim.course.course import Course
from bike_sim.course.road import RoadSurface, WetPatch
from bike_sim.course.track import Track
from bike_sim.physics.superbike_engine import TIME_STEP
from bike_sim.planning.lap_limit import LapLimit
from bike_sim.planning.line_cache import cache_folder, read_column, write_column
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.superbike import Superbike

if TYPE_CHECKING:
    from bike_sim.sim.superbike_batch import CompiledSuperbikeBatch

FloatArray = NDArray[np.float64]

PACES: Final = (0.0, 0.005)
"""Changes of the planned speed that a plan must bear, as parts of it."""
STARTS: Final = 2
"""Places of a lap at which rides of each of them begin; one more ride, as planned, begins as rides do by default."""
START_SHARE: Final = 0.7
"""Speed of a start as a part of the planned one."""
LAPS: Final = 1.25
"""Laps that are ridden: the first corners are met at the start's speed, and again at full speed."""
LONGEST: Final = 3.0
"""Time of a ride after which it is given up, by that of the planned laps."""
SLOWER: Final = 0.98
"""By this the speed is lowered at once before a place where a ride ended."""
SLOWEST: Final = 0.5
"""Part of the first plan's speed that is never lowered."""
BEFORE: Final = 2.5
"""Time before the end of a ride from which on the speed is lowered, s: where it went wrong is seen only later."""
LEAST_BEFORE: Final = 50.0
"""Distance that this is at least, m."""
BEHIND: Final = 20.0
"""Distance behind it up to which it is, m."""
ROUNDS: Final = 20
"""Rehearsals after which the plan is taken as it is."""
PATIENCE: Final = 4
"""Rehearsals after which the speed is lowered from as much further ahead again."""
FAR: Final = 40.0
"""Distance of the walls from the limits, m, and of the limits from a line without: so far that neither matters."""

_CIRCUIT: Final = "verification"


def rehearsed(vehicle: Superbike, line: Course, settings: RiderSettings, period: float) -> LinePlan:
    """Plan a lap of a closed line, ride it, and plan it slower before places where a ride ended, until none does.

    What came out is kept beside the lines of circuits (`bike_sim.planning.line_cache`), so the same is rehearsed once.

    Args:
        vehicle: the machine.
        line: closed line to follow.
        settings: how to ride.
        period: control period, s.

    Returns:
        The plan; after `ROUNDS` rehearsals that failed, the last one.

    Raises:
        ValueError: the line is open.
    """
    plan = plan_line(vehicle, line, settings)
    key = rehearsal_key(vehicle, line, plan, repr((settings, period)).encode())
    share = kept(key, plan, lambda: _share(vehicle, line, plan, settings, period))
    return _slower(vehicle, line, plan, settings, share) if share.min() < 1.0 else plan


def kept(key: str, plan: LinePlan, rehearse: Callable[[], FloatArray]) -> FloatArray:
    """Return what a verification found at the points of a plan's profile but the last, found now or before.

    Args:
        key: of the verification, see `rehearsal_key`.
        plan: that is rehearsed.
        rehearse: finds it.
    """
    path = cache_folder() / f"{key}.npy"
    found = read_column(path, len(plan.profile.s) - 1)
    if found is None:
        found = rehearse()
        write_column(path, found)
    return found


def _share(vehicle: Superbike, line: Course, plan: LinePlan, settings: RiderSettings, period: float) -> FloatArray:
    """Return the part of a plan's speed that can be ridden, at the points of its profile but the last."""
    share, tried = np.ones(len(plan.profile.s) - 1), plan
    paces = np.array((*np.repeat(PACES, STARTS), 0.0))
    with RolloutBatch(vehicle, line, period, len(paces)) as stage:
        for number in range(ROUNDS):
            ends = stage.ride(tried, _AsPlanned(vehicle, tried, settings, period, paces), STARTS)
            if not len(ends):
                break
            for place, speed in ends:
                # a rider who arrives too fast however slow the place is planned has to begin braking further ahead
                near = before(tried.profile, place, speed, 1 + number // PATIENCE)
                share[near] = np.maximum(SLOWER * share[near], SLOWEST)
            tried = _slower(vehicle, line, plan, settings, share)
    return share


def before(profile: LapLimit, place: float, speed: float, longer: int = 1) -> NDArray[np.bool_]:
    """Return at which points of a profile, but the last, less speed helps a ride that ended.

    Args:
        profile: planned lap.
        place: of the end, m.
        speed: there, m/s.
        longer: times the usual time before it.
    """
    length = float(profile.s[-1])
    ahead = np.mod(place - profile.s[:-1], length)
    return (ahead < longer * max(BEFORE * speed, LEAST_BEFORE)) | (ahead > length - BEHIND)


def _slower(vehicle: Superbike, line: Course, plan: LinePlan, settings: RiderSettings, share: FloatArray) -> LinePlan:
    return plan_line(vehicle, line, settings, np.where(share < 1.0, share * plan.profile.speed[:-1], np.inf))


def rehearsal_key(vehicle: Superbike, line: Course, plan: LinePlan, rider: bytes) -> str:
    """Return the hash over everything that a verification depends on.

    Args:
        vehicle: the machine.
        line: to follow.
        plan: that is rehearsed.
        rider: what says how it is ridden.
    """
    digest = hashlib.sha256(_sources())
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        digest.update(repr(vehicle).encode())
    digest.update(rider)
    for values in (line.table, line.height, line.bank, line.grip, line.width_left, line.width_right, plan.table):
        digest.update(b"none" if values is None else np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:32]


@cache
def _sources() -> bytes:
    """Return the hash over the code that rides; a change of it has to be rehearsed."""
    digest = hashlib.sha256()
    for package in (course, physics, sim, contract, riders):
        for path in sorted(Path(package.__path__[0]).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.digest()


class RideLaw(Protocol):
    """Who rides the machines of a stage."""

    def begin(self, row: int, batch: CompiledSuperbikeBatch) -> None:
        """Begin a ride, after its machine has been reset."""

    def commands(self, batch: CompiledSuperbikeBatch, step: int) -> FloatArray:
        """Return steering and throttle in [-1, 1] for a control period, shape (n, 2)."""


class _AsPlanned:
    """The law on a plan, each ride a little faster than planned or not; implements `RideLaw`."""

    def __init__(
        self, vehicle: Superbike, plan: LinePlan, settings: RiderSettings, period: float, paces: FloatArray
    ) -> None:
        self._law, self._plan = LineLaw(vehicle, period, settings, len(paces)), plan
        self._targets = np.stack((np.zeros(len(paces)), paces), axis=1)

    def begin(self, row: int, batch: CompiledSuperbikeBatch) -> None:
        self._law.begin(row, self._plan)

    def commands(self, batch: CompiledSuperbikeBatch, step: int) -> FloatArray:
        return self._law.commands(np.nan_to_num(seen_of(batch.state, batch.look)), self._targets)


class RolloutBatch:
    """A machine on a line, several times side by side."""

    def __init__(self, vehicle: Superbike, line: Course, period: float, count: int) -> None:
        """Prepare for a number of rides.

        Args:
            vehicle: the machine.
            line: closed line to follow.
            period: control period, s.
            count: number of rides.
        """
        step = period / max(1, round(period / TIME_STEP))
        config = SimulatorConfig(vehicle.name, "compiled", step, period)
        # Late: who has rehearsed before is spared the compiled loop, which takes seconds to load.
        from bike_sim.sim.superbike_batch import CompiledSuperbikeBatch

        self._batch = CompiledSuperbikeBatch(count, config, machine=vehicle)
        self._batch.add_circuit(_CIRCUIT, _circuit_of(line))

    def __enter__(self) -> RolloutBatch:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the rides."""
        self._batch.close()

    def ride(self, plan: LinePlan, rides: RideLaw, starts: int) -> FloatArray:
        """Ride a plan; return arc length (m) and speed (m/s) at the ends of rides that did not end well, shape (n, 2).

        Rides that are off the course have ended as those that have fallen.

        Args:
            plan: of the lap.
            rides: who rides it.
            starts: places of a lap at which rides begin, over and over; the last ride begins as rides do by default.
        """
        batch, profile = self._batch, plan.profile
        at_once = batch.at_own_speed(0, ResetRequest(course=_CIRCUIT, line=0.0))
        places = _gentle_places(profile, starts)
        for row in range(batch.count):
            late = row == batch.count - 1
            batch.reset(row, at_once if late else _start(profile, float(places[row % starts])))
            rides.begin(row, batch)
        length, period = float(profile.s[-1]), batch.config.control_period
        goal = batch.look[:, lk.PROGRESS] + LAPS * length
        riding = np.ones(batch.count, dtype=bool)
        ends: list[tuple[float, float]] = []
        for step in range(round(LONGEST * LAPS * profile.lap_time / period)):
            batch.step(np.where(riding[:, None], rides.commands(batch, step), 0.0))
            lost = riding & (batch.fallen | batch.off_course)
            ends += [(progress % length, speed) for progress, speed in batch.look[lost][:, [lk.PROGRESS, lk.SPEED]]]
            riding &= ~lost & (batch.look[:, lk.PROGRESS] < goal)
            if not riding.any():
                break
        return np.nan_to_num(np.array(ends).reshape(-1, 2))


def _start(profile: LapLimit, place: float) -> ResetRequest:
    speed = START_SHARE * float(profile.speed_at(place))
    return ResetRequest(course=_CIRCUIT, line=0.0, progress=place, speed_range=(speed, speed))


def _circuit_of(line: Course) -> Track:
    """Return a line as a circuit of its own, with its limits and the road below it."""
    far = np.full(len(line.s), FAR)
    left, right = (far if width is None else width for width in (line.width_left, line.width_right))
    hills = np.zeros(len(line.s)) if line.height is None else line.height
    surface = RoadSurface(bank=line.bank, wet=() if line.grip is None else _wet_patches(line.s, line.grip))
    return Track(replace(line, width_left=left, width_right=right), hills, far, far, surface=surface)


def _wet_patches(s: FloatArray, grip: FloatArray) -> tuple[WetPatch, ...]:
    """Return the stretches of a line (m) on which one factor on friction other than 1 holds."""
    begins = np.flatnonzero(np.diff(grip, prepend=np.nan) != 0.0)
    ends = np.append(s[begins[1:]], s[-1] + 1.0)
    found = zip(s[begins].tolist(), ends.tolist(), grip[begins].tolist(), strict=True)
    return tuple(WetPatch(begin, end, factor) for begin, end, factor in found if factor != 1.0)


def _gentle_places(profile: LapLimit, count: int) -> FloatArray:
    """Return the arc lengths at which a lap turns least in each of so many equal parts of it, m."""
    parts = np.array_split(np.arange(len(profile.s) - 1), count)
    return np.array([profile.s[part[np.argmin(np.abs(profile.lateral[part]))]] for part in parts])
