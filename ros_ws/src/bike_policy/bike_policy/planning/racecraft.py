"""Racing others by rule, compiled: from what is seen of them to a distance from the line and a pace.

The classical law (`line_law`) rides to both targets, so a rider among others is the lone one with other targets.

Speeds are compared at the same place: a machine that rides r times the planned speed of where it is gains or loses
r - 1 on the plan, whether it brakes or drives. Who is behind rides as fast as who is ahead at the same place and keeps
a time behind, so both brake at the same place and neither has to brake harder than it would alone.

- Who is ahead by any part of a machine is followed, unless it is being passed.
- A pass begins where the side is free and the difference of speed ends it before the next turn-in, goes on as long as
  that holds, and is given up before who is being passed turns in.
- Beside another, nobody comes nearer than the clearance, whoever is ahead.
- Before a corner, one move to the inside against who is close behind, if that one is not beside.
- In a wake on a straight more than the planned speed is asked for.

Numbers are estimates.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.contract.observation import VehicleRows
from bike_policy.planning.lap_plan import P_CURVATURE, P_FASTER, P_LEFT, P_LONGITUDINAL, P_RIGHT, P_SPEED
from bike_policy.planning.line_law import (
    HEADING_ERROR,
    LATERAL_ERROR,
    OFFSET,
    PROGRESS,
    SPEED,
    LineLaw,
    inside_pace,
    seen_of,
)
from bike_policy.planning.reference import Plans, plan_at
from bike_sim.schema import FLAG, OPPONENT, OPPONENT_SLOTS, Quantity, Schema

FloatArray = NDArray[np.float64]

CRAFT: Final = Schema(
    (
        Quantity("offset", "m", -1, "target that is given now, positive left of the line"),
        Quantity("side", FLAG, -1, "on which another is passed: 1 left, -1 right, 0 nobody is"),
        Quantity("defending", "m", -1, "held offset from the line before a corner; 0 for none"),
    )
)
"""Memory of a ride."""
_OFFSET, _SIDE, _DEFENDING = range(3)

MACHINE: Final = 2.1
"""Length of a machine, m."""
CLEARANCE: Final = 1.8
"""Distance from another machine's middle to that of one that passes it or is beside, m; 0.7 m is a touch."""
CLEAR: Final = 1.1
"""The same from which on who is being passed is not in the way, m."""
CLEAR_BRAKING: Final = 1.4
"""The same before the brakes and in corners, for who follows targets of somebody else, m."""
ABREAST: Final = 2.5
"""The same from which on nobody ahead on a straight is in the way, m."""
HEADWAY: Final = 0.2
SPACING: Final = 3.6
"""Time behind who is ahead, s, and distance that is added to it at the slowest place ahead, m, from place to place, so
that no more of it is asked for on the brake; half the time, and the distance here, where that one is being passed."""
CLOSEST: Final = 0.05
"""The same time where somebody else decides who is followed, s."""
FOLLOW_RATE: Final = 0.6
"""Part of the speed that is given up for each second of headway that is missing, 1/s."""
DROP_BACK: Final = 3.0
"""Speed at which a machine drops back at most, m/s."""
PULL_OUT: Final = 2.5
"""Time before it would have to slow at which a pass begins, s."""
GAIN: Final = 0.01
"""Part of the speed that is gained at least in a pass."""
LEANT: Final = 6.0
"""Lateral acceleration of a corner, m/s^2."""
AHEAD: Final = 5.0
LOOKS: Final = 20
"""Time that is looked ahead for corners, s, in so many steps."""
NEAR: Final = 2.5
NEAR_LOOKS: Final = 5
"""Time that is looked ahead for braking and room, s, and the steps for room."""
SETTLED: Final = 0.8
"""Time before turn-in at which a pass has to be over, s; twice that for one that begins."""
BRAKING: Final = 7.0
"""Deceleration before what stands in the way, m/s^2."""
MOVE_RATE: Final = 1.6
CORNER_RATE: Final = 0.5
ESCAPE_RATE: Final = 4.0
"""Rates at which the target moves, m/s: by choice, in a corner, and to leave room or avoid what stands in the way."""
SETTLING: Final = 1.8
ESCAPE_TIME: Final = 0.8
"""Time constants with which the target is reached, s: by choice, without an overshoot of the machine, for the law
answers the rate of a target too, with a zero at 0.55 rad/s; and otherwise."""
ASTRAY: Final = 0.04
"""Part of the planned speed that is given up before and in a corner for each m beyond half of one beside the target."""
WIDE: Final = 2.0
CROSSING: Final = 0.003
BRAKES_SOON: Final = 1.0
"""Distance beside the line beyond which a policy brakes earlier, m: part of the planned speed for each m that is left,
so long before the plan brakes, s. It has to cross the road while it brakes, with nothing left to brake harder."""
DRAFT: Final = 0.04
"""Part of the planned speed that is asked beyond it in a wake."""
DEFENDED: Final = 1.0
"""Offset towards the inside that defends, m."""
SLOWEST: Final = 0.5
"""Part of the planned speed that is asked at least."""
_AHEAD, _SECOND, _LEFT, _RIGHT, _BEHIND = range(len(OPPONENT_SLOTS))
_SEEN, _X, _Y, _VX, _VY = range(len(OPPONENT))


@njit(cache=True)
def _aside(points: FloatArray, observed: FloatArray, x: float, y: float) -> float:
    """Return how far left of the followed line a point lies, m; points are the line ahead, base_footprint."""
    if x <= 0.0:
        return y + observed[LATERAL_ERROR] + x * math.sin(observed[HEADING_ERROR])
    best, found = math.inf, y
    for k in range(len(points) - 1):
        dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        length = math.hypot(dx, dy)
        if length < 1e-6:
            continue
        rx, ry = x - points[k, 0], y - points[k, 1]
        part = min(max((rx * dx + ry * dy) / length**2, 0.0), 1.0)
        distance = math.hypot(rx - part * dx, ry - part * dy)
        if distance < best:
            best, found = distance, (dx * ry - dy * rx) / length
    return found


@njit(cache=True)
def _room(plans: Plans, row: int, s: float, speed: float, offset: float) -> float:
    """Return the room on the side of an offset here and ahead, m: a line at an apex is as near to it as it may be."""
    column = P_LEFT if offset > 0.0 else P_RIGHT
    room = math.inf
    for look in range(NEAR_LOOKS + 1):
        room = min(room, plan_at(plans, row, column, s + NEAR * look / NEAR_LOOKS * speed))
    return room


@njit(cache=True)
def race_targets(
    observed: FloatArray, points: FloatArray, opponents: FloatArray, memory: FloatArray, plans: Plans, period: float,
    targets: FloatArray,
) -> None:  # fmt: skip
    """Write the targets of rides side by side: distance from the line, m, and change of the planned speed as a part.

    Args:
        observed: inputs of the law, shape (n, columns of `line_law.INPUTS`).
        points: followed line ahead, base_footprint, m, shape (n, stations, 3).
        opponents: nearest others, shape (n, slots, numbers).
        memory: columns of CRAFT, in and out, shape (n, 3).
        plans: of the law.
        period: control period, s.
        targets: out, shape (n, 2).
    """
    for row in range(len(observed)):
        _decide(observed[row], points[row], opponents[row], memory[row], plans, row, period, targets[row])


@njit(cache=True)
def _decide(
    observed: FloatArray, points: FloatArray, others: FloatArray, memory: FloatArray, plans: Plans, row: int,
    period: float, target: FloatArray,
) -> None:  # fmt: skip
    speed, s, here = max(observed[SPEED], 1.0), observed[PROGRESS], observed[LATERAL_ERROR]
    planned = max(plan_at(plans, row, P_SPEED, s), 1.0)
    braking, corner, turn_in, slowest, _ = road_ahead(plans, row, s, speed)
    asides, ratios = np.zeros(len(others)), np.ones(len(others))
    low, high = _beside(observed, points, others, plans, row, asides, ratios)
    standing = False
    # a pass: who is it, does it end before the turn-in?
    side = memory[_SIDE]
    passed = _AHEAD
    if side != 0.0 and others[_RIGHT if side > 0.0 else _LEFT, _SEEN] > 0.0:
        passed = _RIGHT if side > 0.0 else _LEFT
    other, wish, rate = others[passed], 0.0, MOVE_RATE if turn_in > 0.4 else CORNER_RATE
    if other[_SEEN] == 0.0:
        side = 0.0
    else:
        standing = ratios[passed] * plan_at(plans, row, P_SPEED, s + other[_X]) < 0.5 * speed
        gain = max(speed / planned, 1.0) - ratios[passed]
        ends = (other[_X] + MACHINE) / (gain * speed) if gain > GAIN else math.inf
        goes = standing or other[_X] <= 0.0 or ends < turn_in - (1.0 if side != 0.0 else 2.0) * SETTLED
        if not goes:
            side = 0.0
        elif side == 0.0 and (standing or turn_in > 0.0):
            free = other[_X] - (HEADWAY + SPACING / slowest) * speed
            if (standing and abs(asides[passed]) < ABREAST) or (not standing and free < PULL_OUT * gain * speed):
                side = _side(asides[passed], corner, memory[_OFFSET], low, high, others, asides, plans, row, s, speed)
        if side != 0.0:
            wish = side * max(side * asides[passed] + CLEARANCE, 0.0)
            if other[_X] > MACHINE and abs(wish) > _room(plans, row, s, speed, wish):
                side, wish = 0.0, 0.0
            elif standing:
                rate = ESCAPE_RATE
    memory[_SIDE] = side
    # followed is who is ahead by any part of a machine, but for the one that is being passed
    pace = math.inf
    for k in range(_BEHIND):
        if others[k, _SEEN] == 0.0 or others[k, _X] <= 0.0:
            continue
        theirs = ratios[k] * plan_at(plans, row, P_SPEED, s + others[k, _X])
        passing, lying = side != 0.0 and k == passed, theirs < 0.5 * speed
        apart = _apart(asides[k] - here, others[k, _VY])
        if passing and apart > CLEAR:
            continue
        if (turn_in > 1.0 or lying) and min(apart, abs(asides[k] - memory[_OFFSET])) > ABREAST:
            continue
        headway = 0.5 * HEADWAY + SPACING / speed if passing else HEADWAY + SPACING / slowest
        pace = min(pace, _behind(others[k, _X], ratios[k], theirs, speed, planned, headway, lying, FOLLOW_RATE))
    if side == 0.0:
        wish = _defend(others[_BEHIND], memory, corner, turn_in, wish)
    straight = not braking and turn_in > NEAR
    near = others[_AHEAD, _SEEN] > 0.0 and others[_AHEAD, _X] < 60.0
    pace = min(pace, DRAFT if straight and (near or side != 0.0) else 0.0)
    offset = memory[_OFFSET] = _moved(memory[_OFFSET], wish, low, high, rate, plans, row, s, speed, period)
    bound = inside_pace(plans, row, s, speed, offset)
    pace = min(pace, bound) if bound < 0.0 else pace
    if turn_in < NEAR:
        pace = min(pace, -_lost(here - offset))
    target[0], target[1] = offset, max(pace, SLOWEST - 1.0)


@njit(cache=True)
def _beside(
    observed: FloatArray, points: FloatArray, others: FloatArray, plans: Plans, row: int, asides: FloatArray,
    ratios: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Return the least and the largest target that leave room to who is beside, m.

    Args:
        observed: inputs of the law.
        points: followed line ahead, m.
        others: nearest others.
        plans: of the law.
        row: of the machine in the plans.
        asides: out: how far left of the line each other is, m.
        ratios: out: its speed by the planned one of where it is.
    """
    speed, here = max(observed[SPEED], 1.0), observed[LATERAL_ERROR]
    low, high = -math.inf, math.inf
    for k in range(len(others)):
        if others[k, _SEEN] == 0.0:
            continue
        asides[k] = _aside(points, observed, others[k, _X], others[k, _Y])
        theirs = math.hypot(speed + others[k, _VX], others[k, _VY])
        ratios[k] = theirs / max(plan_at(plans, row, P_SPEED, observed[PROGRESS] + others[k, _X]), 1.0)
        if abs(others[k, _X]) < MACHINE + 1.0 and (k in (_LEFT, _RIGHT) or abs(asides[k] - here) > 0.5 * CLEARANCE):
            if asides[k] > here:
                high = min(high, asides[k] - CLEARANCE)
            else:
                low = max(low, asides[k] + CLEARANCE)
    if low > high:
        low = high = 0.5 * (low + high)
    return low, high


@njit(cache=True)
def _apart(apart: float, rate: float) -> float:
    """Return the least distance across to another within a second, m, from that of now and its rate, m/s."""
    soon = apart + rate
    return 0.0 if apart * soon < 0.0 else min(abs(apart), abs(soon))


@njit(cache=True)
def _behind(
    gap: float, ratio: float, theirs: float, speed: float, planned: float, headway: float, lying: bool, rate: float
) -> float:
    """Return the pace behind another at a distance (m): that of its speed at the same place, a time (s) behind it.

    It comes nearer, or drops back, at a rate (1/s).
    """
    if lying:
        free = max(gap - SPACING, 0.0)
        return math.sqrt(theirs**2 + 2.0 * BRAKING * free) / planned - 1.0
    keep = ratio * (1.0 - rate * (headway - gap / speed))
    return max(keep, ratio - DROP_BACK / speed) - 1.0


@njit(cache=True)
def _moving_out(gap: float, apart: float, rate: float, ratio: float, speed: float) -> float:
    """Return the pace of who moves from behind another (m, m/s): clear of it by when it is reached."""
    out = rate if apart > 0.0 else -rate
    if out < 0.3:
        return -1.0
    return ratio * (1.0 + max(gap - MACHINE - 0.7, 0.0) / (speed * max((CLEAR - abs(apart)) / out, 0.2))) - 1.0


@njit(cache=True)
def _lost(astray: float) -> float:
    """Return the part of its speed that who is beside its target (m) gives up: it has to turn harder than planned."""
    return ASTRAY * max(abs(astray) - 0.5, 0.0)


@njit(cache=True)
def _moved(
    offset: float, wish: float, low: float, high: float, rate: float, plans: Plans, row: int, s: float, speed: float,
    period: float,
) -> float:  # fmt: skip
    """Return the distance from the line (m) after a period (s), on the way to another within bounds and limits."""
    held = min(max(wish, low), high)
    room = _room(plans, row, s, speed, held)
    held = min(max(held, -room), room)
    if offset < low or offset > high or abs(offset) > _room(plans, row, s, speed, offset):
        rate = ESCAPE_RATE
    move = (held - offset) / (ESCAPE_TIME if rate == ESCAPE_RATE else SETTLING)
    return offset + period * min(max(move, -rate), rate)


@njit(cache=True)
def guard_targets(
    observed: FloatArray, points: FloatArray, opponents: FloatArray, plans: Plans, rate: float, period: float,
    offsets: FloatArray, targets: FloatArray,
) -> None:  # fmt: skip
    """Bound the targets of somebody else, in place: room to who is beside, no nearer to who is straight ahead.

    Distances from the line move as those of the classical rider do, slowly from shortly before a turn-in on, and where
    the machine is not where it should be it is slower before corners.

    Args:
        observed: inputs of the law, shape (n, columns of `line_law.INPUTS`).
        points: followed line ahead, base_footprint, m, shape (n, stations, 3).
        opponents: nearest others, shape (n, slots, numbers).
        plans: of the law.
        rate: at which distances move at most, m/s.
        period: control period, s.
        offsets: distances that are asked now, in and out, m, shape (n,).
        targets: in and out, shape (n, 2).
    """
    for row in range(len(observed)):
        others, speed, s = opponents[row], max(observed[row, SPEED], 1.0), observed[row, PROGRESS]
        asides, ratios = np.zeros(len(others)), np.ones(len(others))
        low, high = _beside(observed[row], points[row], others, plans, row, asides, ratios)
        planned = max(plan_at(plans, row, P_SPEED, s), 1.0)
        braking, _, turn_in, slowest, until = road_ahead(plans, row, s, speed)
        careful = braking or turn_in < SETTLED  # there is little left
        most, wish = rate if turn_in > SETTLED else min(rate, CORNER_RATE), targets[row, 0]
        offsets[row] = _moved(offsets[row], wish, low, high, most, plans, row, s, speed, period)
        targets[row, 0] = offsets[row]
        here = observed[row, LATERAL_ERROR]
        if turn_in < NEAR:  # of what is granted there
            granted = plan_at(plans, row, P_FASTER, s + turn_in * speed)
            targets[row, 1] = min(targets[row, 1], granted) - _lost(here - offsets[row])
        if abs(here) > WIDE and plan_at(plans, row, P_LONGITUDINAL, s + BRAKES_SOON * speed) < -1.0:
            targets[row, 1] = min(targets[row, 1], -CROSSING * (abs(here) - WIDE))
        for k in range(_BEHIND):
            if others[k, _SEEN] == 0.0 or others[k, _X] <= 0.0:
                continue
            if _apart(asides[k] - here, others[k, _VY]) > (CLEAR_BRAKING if careful else CLEAR):
                continue
            theirs = ratios[k] * plan_at(plans, row, P_SPEED, s + others[k, _X])
            headway = CLOSEST + SPACING / slowest if careful else 0.5 * HEADWAY + SPACING / speed
            closing = careful and others[k, _X] > headway * speed
            nearing = 1.0 / max(until, 1.0 / FOLLOW_RATE) if closing else FOLLOW_RATE
            pace = _behind(others[k, _X], ratios[k], theirs, speed, planned, headway, theirs < 0.5 * speed, nearing)
            if turn_in > SETTLED:
                pace = max(pace, _moving_out(others[k, _X], asides[k] - here, others[k, _VY], ratios[k], speed))
            targets[row, 1] = min(targets[row, 1], max(pace, SLOWEST - 1.0))


class Road(NamedTuple):
    """What the plan asks for ahead.

    Attributes:
        braking: whether it brakes within `NEAR`.
        corner: side of the next corner: 1 left, -1 right, 0 none in sight.
        turn_in: time to it, s.
        slowest: speed of the slowest place in sight, m/s.
        until: time to that place, s.
    """

    braking: bool
    corner: float
    turn_in: float
    slowest: float
    until: float


@njit(cache=True)
def road_ahead(plans: Plans, row: int, s: float, speed: float) -> Road:
    """Return the road ahead of a place (m) at a speed (m/s)."""
    braking, slowest, until, corner, turn_in = False, speed, AHEAD, 0.0, math.inf
    for look in range(LOOKS + 1):
        ahead = AHEAD * look / LOOKS
        place = s + ahead * speed
        planned, bend = plan_at(plans, row, P_SPEED, place), plan_at(plans, row, P_CURVATURE, place)
        if planned < slowest:
            slowest, until = planned, ahead
        braking = braking or (ahead <= NEAR and plan_at(plans, row, P_LONGITUDINAL, place) < -1.0)
        if corner == 0.0 and abs(bend) * planned**2 > LEANT:
            corner, turn_in = math.copysign(1.0, bend), ahead
    return Road(braking, corner, turn_in, max(slowest, 1.0), until)


@njit(cache=True)
def _side(
    aside: float, corner: float, offset: float, low: float, high: float, others: FloatArray, asides: FloatArray,
    plans: Plans, row: int, s: float, speed: float,
) -> float:  # fmt: skip
    """Return the side on which to pass another that lies beside the line (m): 1 left, -1 right, 0 where is no room."""
    best, found = math.inf, 0.0
    for side in (1.0, -1.0):
        wish = side * max(side * aside + CLEARANCE, 0.0)
        if not low <= wish <= high or abs(wish) > _room(plans, row, s, speed, wish):
            continue
        taken = False  # by who is ahead of the other, or comes from behind
        for k in (_SECOND, _BEHIND):
            reach = SPACING + max(-others[k, _VX] if k == _SECOND else others[k, _VX], 0.0) * PULL_OUT
            near = others[k, _SEEN] > 0.0 and abs(others[k, _X]) < reach + (MACHINE if k == _BEHIND else 20.0)
            taken = taken or (near and abs(asides[k] - wish) < CLEARANCE)
        cost = abs(wish - offset) + 0.3 * abs(wish) - 0.7 * side * corner
        if not taken and cost < best:
            best, found = cost, side
    return found


@njit(cache=True)
def _defend(follower: FloatArray, memory: FloatArray, corner: float, turn_in: float, wish: float) -> float:
    """Return the target with one move to the inside before a corner, where another is close behind."""
    if corner == 0.0 or turn_in > NEAR:
        memory[_DEFENDING] = 0.0
    elif memory[_DEFENDING] == 0.0 and turn_in > 1.0:
        close = follower[_SEEN] > 0.0 and -follower[_X] < MACHINE + 4.0 and follower[_VX] > 0.0
        memory[_DEFENDING] = corner * DEFENDED if close else 0.0
    return memory[_DEFENDING] if memory[_DEFENDING] != 0.0 and turn_in > 0.3 else wish


class Racecraft:
    """Targets of machines of one kind among others, with the memory of their rides.

    Attributes:
        memory: columns of CRAFT, shape (n, 3).
    """

    def __init__(self, law: LineLaw, count: int) -> None:
        """Take the law that rides to the targets, and a number of machines."""
        self._law = law
        self.memory, self._targets = np.zeros((count, len(CRAFT))), np.zeros((count, 2))

    def begin(self, row: int, rows: VehicleRows) -> None:
        """Begin a ride where the machine is beside its line, after the law has begun it."""
        aside = float(seen_of(rows.state[row : row + 1], rows.look[row : row + 1])[0, LATERAL_ERROR])
        self.memory[row] = 0.0
        self.memory[row, _OFFSET] = self._law.memory[row, OFFSET] = aside

    def targets(self, rows: VehicleRows, period: float) -> FloatArray:
        """Return the targets of a control period (s), shape (n, 2); see `race_targets`."""
        seen = np.nan_to_num(seen_of(rows.state, rows.look))
        points, opponents = np.ascontiguousarray(rows.points[:, 0]), np.ascontiguousarray(rows.opponents)
        race_targets(seen, points, opponents, self.memory, self._law.plans, period, self._targets)
        return self._targets
