"""A racing policy that has ridden its circuit before: it may ask for less where a verification ended.

The guide's plan is rehearsed as planned and a little faster; a policy asks for more than that in some places, and rides
beside the line. So before it rides a line for the first time it rehearses it on the compiled engine. Where such a ride
ends, it is granted half as much for some seconds before, then no more than the planned speed; a policy that rides well
is not changed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.riders.line_law import UNLIMITED, LinePlan
from bike_policy.riders.plan_verification import ROUNDS, RolloutBatch, before, kept, rehearsal_key, rehearsed
from bike_policy.riders.race_guide import GUIDE, Planner
from bike_policy.riders.race_reference import References
from bike_policy.riders.racer import Racer
from bike_sim.course.course import Course
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

if TYPE_CHECKING:
    from bike_sim.sim.superbike_batch import CompiledSuperbikeBatch

FloatArray = NDArray[np.float64]

RIDES: Final = 8
"""Rides of a verification; all but one begin in different places."""
LONGEST: Final = 6
"""Times the usual time before the end of a ride that less is granted for at most; after that it is less everywhere."""


def rehearsed_racer(bundle: Bundle, vehicle: Vehicle, period: float, count: int) -> Racer:
    """Return a racing policy for machines side by side that rehearses each line before it rides it.

    Args:
        bundle: the policy.
        vehicle: the machine.
        period: control period, s.
        count: number of machines.

    Raises:
        ValueError: a policy that does not race, or a vehicle that is no superbike.
    """
    references = References(vehicle)
    assert isinstance(vehicle, Superbike), "there are references to superbikes only"
    return Racer(
        bundle, vehicle, period, count, lambda line: _plan(bundle, vehicle, line, period, references), references
    )


def _plan(bundle: Bundle, vehicle: Superbike, line: Course, period: float, references: References) -> LinePlan:
    plan = rehearsed(vehicle, line, GUIDE, period)
    rider = b"".join((repr((bundle.layout, bundle.action, GUIDE, period)).encode(), bundle.actor.digest()))
    key = rehearsal_key(vehicle, line, plan, rider)
    return plan.with_room_above(kept(key, plan, lambda: _room(bundle, vehicle, line, plan, period, references)))


def _room(
    bundle: Bundle, vehicle: Superbike, line: Course, plan: LinePlan, period: float, references: References
) -> FloatArray:
    """Return how much more than the planned speed a policy may ask for, as a part of it."""
    room = np.full(len(plan.profile.s) - 1, UNLIMITED)
    with RolloutBatch(vehicle, line, period, RIDES) as stage:
        for _ in range(ROUNDS):
            tried = plan.with_room_above(room)
            racer = Racer(bundle, vehicle, period, RIDES, _always(tried), references)
            ends = stage.ride(tried, _Decided(racer, line), RIDES - 1)
            if not len(ends):
                break
            for place, speed in ends:
                _grant_less(room, plan, place, speed, bundle.action.pace)
    return room


def _always(plan: LinePlan) -> Planner:
    return lambda _: plan


def _grant_less(room: FloatArray, plan: LinePlan, place: float, speed: float, pace: float) -> None:
    """Grant half of what can be asked before the end of a ride, then nothing, then nothing for longer before it."""
    for longer in range(1, LONGEST + 1):
        near = before(plan.profile, place, speed, longer)
        if room[near].any():
            room[near] = np.where(room[near] > 0.5 * pace, 0.5 * pace, 0.0)
            return
    room[:] = 0.0


class _Decided:
    """A policy on a line; implements `bike_policy.riders.plan_verification.RideLaw`."""

    def __init__(self, racer: Racer, line: Course) -> None:
        self._racer, self._line = racer, line

    def begin(self, row: int, batch: CompiledSuperbikeBatch) -> None:
        self._racer.begin(row, batch, self._line)

    def commands(self, batch: CompiledSuperbikeBatch, step: int) -> FloatArray:
        if step % self._racer.layout.repeat == 0:
            self._racer.decide(batch, self._racer.observe(batch))
        return np.nan_to_num(self._racer.commands(batch))
