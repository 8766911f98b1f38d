"""A plan that has been ridden: it is slower where a ride of it on the compiled engine did not end well.

A plan is quasi-steady, and asks for nearly all that a machine can hold so. What a crest in a lean, or a chicane ridden
hop by hop, leaves of that depends on the whole motion; it is found by riding. As in iterative learning control, what
went wrong in a lap corrects the next one at the same place; here only the speed is corrected, and only downwards, so a
plan that rides well stays what it is, bit for bit.

The road is the followed line's: its hills and limits. Banking, bumps, wet patches and wind are not in a line, so a
rehearsal knows nothing of them; the plan is ridden a little faster than it will be instead.
"""

from __future__ import annotations

import hashlib
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy import riders
from bike_policy.riders.lap_plan import RiderSettings
from bike_policy.riders.line_law import LineLaw, LinePlan, plan_line, seen_of
from bike_sim import course, physics, sim
from bike_sim.course.course import Course
from bike_sim.course.track import Track
from bike_sim.physics.superbike_engine import TIME_STEP
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.theory.lap_limit import LapLimit
from bike_sim.theory.line_cache import cache_folder, read_column, write_column
from bike_sim.vehicles.superbike import Superbike

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
FAR: Final = 40.0
"""Distance of the walls from the limits, m, and of the limits from a line without: so far that neither matters."""

_CIRCUIT: Final = "rehearsal"


def rehearsed(vehicle: Superbike, line: Course, settings: RiderSettings, period: float) -> LinePlan:
    """Plan a lap of a closed line, ride it, and plan it slower before places where a ride ended, until none does.

    What came out is kept beside the lines of circuits (`bike_sim.theory.line_cache`), so the same is rehearsed once.

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
    path = cache_folder() / f"{_key(vehicle, line, plan, settings, period)}.npy"
    share = read_column(path, len(plan.profile.s) - 1)
    if share is None:
        share = _share(vehicle, line, plan, settings, period)
        write_column(path, share)
    return _slower(vehicle, line, plan, settings, share) if share.min() < 1.0 else plan


def _share(vehicle: Superbike, line: Course, plan: LinePlan, settings: RiderSettings, period: float) -> FloatArray:
    """Return the part of a plan's speed that can be ridden, at the points of its profile but the last."""
    s = plan.profile.s[:-1]
    share, tried = np.ones(len(s)), plan
    with _Stage(vehicle, line, settings, period) as stage:
        for _ in range(ROUNDS):
            ends = stage.ride(tried)
            if not len(ends):
                break
            for place, speed in ends:
                ahead = np.mod(place - s, line.length)
                near = (ahead < max(BEFORE * speed, LEAST_BEFORE)) | (ahead > line.length - BEHIND)
                share[near] = np.maximum(SLOWER * share[near], SLOWEST)
            tried = _slower(vehicle, line, plan, settings, share)
    return share


def _slower(vehicle: Superbike, line: Course, plan: LinePlan, settings: RiderSettings, share: FloatArray) -> LinePlan:
    return plan_line(vehicle, line, settings, np.where(share < 1.0, share * plan.profile.speed[:-1], np.inf))


def _key(vehicle: Superbike, line: Course, plan: LinePlan, settings: RiderSettings, period: float) -> str:
    """Return the hash over everything that a rehearsal depends on."""
    digest = hashlib.sha256(_sources())
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        digest.update(repr((vehicle, settings, period)).encode())
    for values in (line.table, line.height, line.width_left, line.width_right, plan.table):
        digest.update(b"none" if values is None else np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:32]


@cache
def _sources() -> bytes:
    """Return the hash over the code that rides; a change of it has to be rehearsed."""
    digest = hashlib.sha256()
    for package in (course, physics, sim, riders):
        for path in sorted(Path(package.__path__[0]).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.digest()


class _Stage:
    """The machine on the line, several times side by side."""

    def __init__(self, vehicle: Superbike, line: Course, settings: RiderSettings, period: float) -> None:
        paces = (*np.repeat(PACES, STARTS), 0.0)
        count = len(paces)
        step = period / max(1, round(period / TIME_STEP))
        config = SimulatorConfig(vehicle.name, "compiled", step, period)
        # Late: who has rehearsed before is spared the compiled loop, which takes seconds to load.
        from bike_sim.sim.superbike_batch import CompiledSuperbikeBatch

        self._batch = CompiledSuperbikeBatch(count, config, machine=vehicle)
        self._batch.add_circuit(_CIRCUIT, _circuit_of(line))
        self._law = LineLaw(vehicle, period, settings, count)
        self._targets = np.stack((np.zeros(count), paces), axis=1)

    def __enter__(self) -> _Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self._batch.close()

    def ride(self, plan: LinePlan) -> FloatArray:
        """Ride a plan; return arc length (m) and speed (m/s) at the ends of rides that did not end well, shape (n, 2).

        Rides that are off the course have ended as those that have fallen.
        """
        batch, profile = self._batch, plan.profile
        at_once = batch.at_own_speed(0, ResetRequest(course=_CIRCUIT, line=0.0))
        for row, place in enumerate((*np.tile(_gentle_places(profile), len(PACES)), None)):
            batch.reset(row, at_once if place is None else _start(profile, float(place)))
            self._law.begin(row, plan)
        length, period = float(profile.s[-1]), batch.config.control_period
        goal = batch.look[:, lk.PROGRESS] + LAPS * length
        riding = np.ones(batch.count, dtype=bool)
        ends: list[tuple[float, float]] = []
        for _ in range(round(LONGEST * LAPS * profile.lap_time / period)):
            batch.step(np.where(riding[:, None], self._commands(), 0.0))
            lost = riding & (batch.fallen | batch.off_course)
            ends += [(progress % length, speed) for progress, speed in batch.look[lost][:, [lk.PROGRESS, lk.SPEED]]]
            riding &= ~lost & (batch.look[:, lk.PROGRESS] < goal)
            if not riding.any():
                break
        return np.nan_to_num(np.array(ends).reshape(-1, 2))

    def _commands(self) -> FloatArray:
        return self._law.commands(np.nan_to_num(seen_of(self._batch.state, self._batch.look)), self._targets)


def _start(profile: LapLimit, place: float) -> ResetRequest:
    speed = START_SHARE * float(profile.speed_at(place))
    return ResetRequest(course=_CIRCUIT, line=0.0, progress=place, speed_range=(speed, speed))


def _circuit_of(line: Course) -> Track:
    """Return a line as a circuit of its own, with its limits and hills."""
    far = np.full(len(line.s), FAR)
    left, right = (far if width is None else width for width in (line.width_left, line.width_right))
    hills = np.zeros(len(line.s)) if line.height is None else line.height
    return Track(replace(line, width_left=left, width_right=right), hills, far, far)


def _gentle_places(profile: LapLimit) -> FloatArray:
    """Return the arc lengths at which a lap turns least in each of `STARTS` equal parts of it, m."""
    parts = np.array_split(np.arange(len(profile.s) - 1), STARTS)
    return np.array([profile.s[part[np.argmin(np.abs(profile.lateral[part]))]] for part in parts])
