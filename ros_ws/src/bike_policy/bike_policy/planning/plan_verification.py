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
import logging
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy import contract, planning
from bike_policy.contract.observation import VehicleRows
from bike_policy.planning.lap_plan import UNLIMITED, LinePlan, RiderSettings, plan_line
from bike_policy.planning.line_law import LineLaw, seen_of
from bike_sim import course, physics, sim
from bike_sim.course.course import Course
from bike_sim.course.road import RoadSurface, WetPatch
from bike_sim.course.track import Track
from bike_sim.physics.superbike.engine import TIME_STEP
from bike_sim.planning.lap_limit import LapLimit
from bike_sim.planning.line_cache import cache_folder, read_column, write_column
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.superbike import Superbike

if TYPE_CHECKING:
    from bike_sim.sim.batch import Batch

FloatArray = NDArray[np.float64]
_LOG: Final = logging.getLogger(__name__)

PACES: Final = (0.0, 0.005)
"""Changes of the planned speed that a plan must bear, as parts of it."""
STARTS: Final = 2
"""Places of a lap at which rides of each of them begin; one more ride, as planned, begins as rides do by default."""
START_SHARE: Final = 0.7
"""Speed of a start as a part of the planned one."""
LAPS: Final = 1.25
"""Laps that are ridden: the first corners are met at the start's speed, and again at full speed."""
MAX_TIME_RATIO: Final = 3.0
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
"""Rounds after which the plan is taken as it is."""
PATIENCE: Final = 4
"""Rounds after which the speed is lowered from as much further ahead again."""
FAR: Final = 40.0
"""Distance of the walls from the limits, m, and of the limits from a line without: so far that neither matters."""

MARGIN_RIDES: Final = 8
"""Rides of a policy's verification; all but one begin in different places."""
MAX_AHEAD: Final = 6
"""Times the usual time before the end of a ride that less is granted for at most; after that it is less everywhere."""

_CIRCUIT: Final = "verification"


class BatchRider(Protocol):
    """Rides machines side by side."""

    def begin(self, row: int, rows: VehicleRows, line: Course) -> None:
        """Begin a ride, after its machine has been reset.

        Args:
            row: of the machine.
            rows: of all machines.
            line: followed line.
        """

    def commands(self, rows: VehicleRows, step: int) -> FloatArray:
        """Return steering and throttle in [-1, 1] for a control period, shape (n, 2).

        Args:
            rows: of all machines.
            step: control periods since they began.
        """


class PlanFollower:
    """The classical law on a plan, each ride a little faster than planned or not; implements `BatchRider`."""

    def __init__(
        self, vehicle: Superbike, period: float, settings: RiderSettings, plan: LinePlan, paces: Sequence[float]
    ) -> None:
        """Prepare for as many rides as there are paces.

        Args:
            vehicle: the machine.
            period: control period, s.
            settings: of the ride.
            plan: of the lap.
            paces: change of the planned speed of each ride, as a part of it.
        """
        self._law, self._plan = LineLaw(vehicle, period, settings, len(paces)), plan
        self._targets = np.stack((np.zeros(len(paces)), paces), axis=1)

    def begin(self, row: int, rows: VehicleRows, line: Course) -> None:
        """Begin a ride; see `BatchRider`."""
        self._law.begin(row, self._plan)

    def commands(self, rows: VehicleRows, step: int) -> FloatArray:
        """Return the law's commands; see `BatchRider`."""
        return self._law.commands(np.nan_to_num(seen_of(rows.state, rows.look)), self._targets)


def verified_plan(vehicle: Superbike, line: Course, settings: RiderSettings, period: float) -> LinePlan:
    """Plan a lap of a closed line, ride it, and plan it slower before places where a ride ended, until none does.

    Args:
        vehicle: the machine.
        line: closed line to follow.
        settings: of the ride.
        period: control period, s.

    Returns:
        The plan; after `ROUNDS` verifications that failed the last one, with a warning in the log.

    Raises:
        ValueError: the line is open.
    """
    plan = plan_line(vehicle, line, settings)
    paces = (*np.repeat(PACES, STARTS), 0.0)

    def slower(share: FloatArray) -> LinePlan:
        if share.min() == 1.0:
            return plan
        return plan_line(vehicle, line, settings, np.where(share < 1.0, share * plan.profile.speed[:-1], np.inf))

    def rider(tried: LinePlan) -> BatchRider:
        return PlanFollower(vehicle, period, settings, tried, paces)

    key, share = repr((settings, period)).encode(), np.ones(len(plan.profile.s) - 1)
    return slower(
        Rollouts(vehicle, line, period).corrected(share, slower, lower_before, rider, plan, key, len(paces), STARTS)
    )


def lower_before(share: FloatArray, tried: LinePlan, end: FloatArray, number: int) -> None:
    """Ask for less speed before the place where a ride ended.

    Args:
        share: of the first plan's speed, at the points of its profile but the last; changed in place.
        tried: plan that was ridden.
        end: arc length (m) and speed (m/s) at the end of the ride.
        number: of the round, from 0 on.
    """
    # a rider who arrives too fast however slow the place is planned has to begin braking further ahead
    near = _points_before(tried.profile, end, 1 + number // PATIENCE)
    share[near] = np.maximum(SLOWER * share[near], SLOWEST)


def verified_margin(
    rollouts: Rollouts, plan: LinePlan, policy: Callable[[LinePlan, int], BatchRider], pace: float, key: bytes
) -> LinePlan:
    """Return a plan with as much room above its speed as a policy can use.

    A plan is verified as planned and a little faster; a policy asks for more than that in some places, and rides beside
    the line. Where such a ride ends, it is granted half as much for some seconds before, then no more than the planned
    speed; a policy that rides well is not changed.

    Args:
        rollouts: of the machine on the line.
        plan: verified plan of the line.
        policy: returns the policy for a plan and a number of machines.
        pace: largest change of the planned speed that it may ask for, as a part of it.
        key: everything that decides how it rides.
    """

    def grant_less(room: FloatArray, tried: LinePlan, end: FloatArray, number: int) -> None:
        for longer in range(1, MAX_AHEAD + 1):
            near = _points_before(plan.profile, end, longer)
            if room[near].any():
                room[near] = np.where(room[near] > 0.5 * pace, 0.5 * pace, 0.0)
                return
        room[:] = 0.0

    def rider(tried: LinePlan) -> BatchRider:
        return policy(tried, MARGIN_RIDES)

    make, room = plan.with_room_above, np.full(len(plan.profile.s) - 1, UNLIMITED)
    return make(rollouts.corrected(room, make, grant_less, rider, plan, key, MARGIN_RIDES, MARGIN_RIDES - 1))


def _points_before(profile: LapLimit, end: FloatArray, longer: int = 1) -> NDArray[np.bool_]:
    """Return at which points of a profile, but the last, less speed helps a ride.

    It ended at an arc length (m) and speed (m/s); `longer` are times the usual time before that.
    """
    place, speed = end
    length = float(profile.s[-1])
    ahead = np.mod(place - profile.s[:-1], length)
    return (ahead < longer * max(BEFORE * speed, LEAST_BEFORE)) | (ahead > length - BEHIND)


def _key(vehicle: Superbike, line: Course, plan: LinePlan, rider: bytes) -> str:
    """Return the hash over everything that a verification depends on."""
    digest = hashlib.sha256(sources_digest())
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        digest.update(repr(vehicle).encode())
    digest.update(rider)
    for values in (line.table, line.height, line.bank, line.grip, line.width_left, line.width_right, plan.table):
        digest.update(b"none" if values is None else np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:32]


@cache
def sources_digest() -> bytes:
    """Return the hash over the code that rides; what a changed one does has to be verified anew."""
    digest = hashlib.sha256()
    for package in (course, physics, sim, contract, planning):
        for path in sorted(Path(package.__path__[0]).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.digest()


class Rollouts(NamedTuple):
    """Rides of one machine on one line, for verifications.

    Attributes:
        vehicle: the machine.
        line: closed line to follow.
        period: control period, s.
    """

    vehicle: Superbike
    line: Course
    period: float

    def corrected(
        self,
        values: FloatArray,
        make: Callable[[FloatArray], LinePlan],
        correct: Callable[[FloatArray, LinePlan, FloatArray, int], None],
        rider: Callable[[LinePlan], BatchRider],
        plan: LinePlan,
        key: bytes,
        rides: int,
        starts: int,
    ) -> FloatArray:
        """Return the values with which no ride ends, or those after `ROUNDS` rounds, with a warning in the log.

        They are kept beside the lines of circuits (`bike_sim.planning.line_cache`), so a verification is ridden once.

        Args:
            values: at the points of the plan's profile but the last, to begin with.
            make: makes a plan of them.
            correct: changes them for the end of a ride, given as values, plan, end and number of the round.
            rider: rides a plan.
            plan: that is verified.
            key: everything that decides how it is ridden.
            rides: number of rides.
            starts: see `ride`.
        """
        path = cache_folder() / f"{_key(self.vehicle, self.line, plan, key)}.npy"
        found = read_column(path, len(values) + 1)
        if found is None:
            ends = np.zeros((0, 2))
            with self.batch(rides) as batch:
                for number in range(ROUNDS):
                    tried = make(values)
                    ends = self.ride(batch, tried, rider(tried), starts)
                    for end in ends:
                        correct(values, tried, end, number)
                    if not len(ends):
                        break
            found = np.append(values, len(ends))
            write_column(path, found)
        if found[-1]:
            _LOG.warning(
                "%s on line %r: %d of %d rides of the plan still end early after %d corrections; it is used as it is",
                self.vehicle.name, self.line.name, found[-1], rides, ROUNDS,
            )  # fmt: skip
        return found[:-1]

    def batch(self, count: int) -> closing[Batch]:
        """Return a number of machines on the line, closed at the end of a with statement."""
        step = self.period / max(1, round(self.period / TIME_STEP))
        config = SimulatorConfig(self.vehicle.name, "compiled", step, self.period)
        # Late: who has verified before is spared the compiled loop, which takes seconds to load.
        from bike_sim.sim.batch import Batch

        batch = Batch(count, config, vehicles=[self.vehicle] * count)
        batch.add_circuit(_CIRCUIT, _circuit_of(self.line))
        return closing(batch)

    def ride(self, batch: Batch, plan: LinePlan, rider: BatchRider, starts: int) -> FloatArray:
        """Ride a plan; return arc length (m) and speed (m/s) at the ends of rides that did not end well, shape (n, 2).

        Rides that are off the course have ended as those that have fallen.

        Args:
            batch: machines.
            plan: of the lap.
            rider: of all machines.
            starts: places of a lap at which rides begin, over and over; the last ride begins as rides do by default.
        """
        profile = plan.profile
        at_once = batch.at_own_speed(0, ResetRequest(course=_CIRCUIT, line=0.0))
        parts = np.array_split(np.arange(len(profile.s) - 1), starts)  # where the lap turns least in each of them
        places = [float(profile.s[part[np.argmin(np.abs(profile.lateral[part]))]]) for part in parts]
        for row in range(batch.count):
            late = row == batch.count - 1
            batch.reset(row, at_once if late else _start(profile, places[row % starts]))
            rider.begin(row, batch, self.line)
        length = float(profile.s[-1])
        goal = batch.look[:, lk.PROGRESS] + LAPS * length
        riding = np.ones(batch.count, dtype=bool)
        ends: list[tuple[float, float]] = []
        for step in range(round(MAX_TIME_RATIO * LAPS * profile.lap_time / self.period)):
            batch.step(np.where(riding[:, None], rider.commands(batch, step), 0.0))
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
