"""Racing others by rule, compiled: from what is seen of them to a distance from the line and a pace.

The classical law (`line_law`) rides to both targets, so a rider among others is the lone one with other targets. The
rules: keep a gap to who is in the way; pull out where there is room and time to pass, on the inside of the next corner
if it does not matter; leave room to whoever is beside; before a corner hold the inside once against who is close
behind; in a wake on a straight ask for more than the planned speed. Numbers are estimates.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.contract.observation import VehicleRows
from bike_policy.planning.lap_plan import P_CURVATURE, P_LEFT, P_LONGITUDINAL, P_RIGHT, P_SPEED
from bike_policy.planning.line_law import (
    HEADING_ERROR,
    LATERAL_ERROR,
    OFFSET,
    PROGRESS,
    SPEED,
    LineLaw,
    Plans,
    plan_at,
    seen_of,
)
from bike_sim.schema import FLAG, OPPONENT_SLOTS, Quantity, Schema

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

CLEARANCE: Final = 1.4
"""Distance from another machine's middle to that of one that passes it or is beside, m; 0.7 m is a touch."""
ABREAST: Final = 2.0
"""The same across from which on another is not in the way before and in a corner, m."""
ASTRAY: Final = 0.04
"""Part of the planned speed that is given up before and in a corner for each m beyond half of one beside the target."""
MACHINE: Final = 2.1
"""Length of a machine, m."""
GAP: Final = 2.0
HEADWAY: Final = 0.08
"""Gap to who is in the way, m, and what speed adds to it, s."""
CLOSE_IN: Final = 1.2
"""Rate at which a gap is closed, 1/s."""
PULL_OUT: Final = 2.5
"""Time to the other machine at which a pass begins, s."""
TRIED: Final = 12.0
"""Gap from which on no pass is tried where the other is not slower, m."""
LEANT: Final = 6.0
"""Lateral acceleration from which on no pass begins, m/s^2."""
AHEAD: Final = 2.5
LOOKS: Final = 6
"""Time that is looked ahead for corners, braking and room, s, in so many steps."""
MOVE_RATE: Final = 1.6
ESCAPE_RATE: Final = 4.0
"""Rates at which the target moves, m/s: by choice, and to leave room or avoid what stands in the way."""
DRAFT: Final = 0.04
"""Part of the planned speed that is asked beyond it in a wake."""
DEFENDED: Final = 1.0
"""Offset towards the inside that defends, m."""
SLOWEST: Final = 0.5
"""Part of the planned speed that is asked at least."""
_AHEAD, _SECOND, _LEFT, _RIGHT, _BEHIND = range(len(OPPONENT_SLOTS))


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
    for look in range(LOOKS):
        room = min(room, plan_at(plans, row, column, s + AHEAD * look / (LOOKS - 1) * speed))
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
    speed, s = max(observed[SPEED], 1.0), observed[PROGRESS]
    planned = plan_at(plans, row, P_SPEED, s)
    braking, corner, corner_at = False, 0.0, AHEAD
    for look in range(LOOKS):
        ahead = AHEAD * look / (LOOKS - 1)
        place = s + ahead * speed
        braking = braking or plan_at(plans, row, P_LONGITUDINAL, place) < -1.0
        bend = plan_at(plans, row, P_CURVATURE, place)
        if corner == 0.0 and abs(bend) * plan_at(plans, row, P_SPEED, place) ** 2 > LEANT:
            corner, corner_at = math.copysign(1.0, bend), ahead
    wish, pace, rate = 0.0, 0.0, MOVE_RATE
    leader = others[_AHEAD]
    if leader[0] > 0.0:
        aside = _aside(points, observed, leader[1], leader[2])
        gap = math.hypot(leader[1], leader[2]) - MACHINE
        theirs, closing = max(speed + leader[3], 0.0), -leader[3]
        standing = theirs < 0.5 * speed
        contact_in = gap / closing if closing > 0.1 else math.inf
        if memory[_SIDE] == 0.0 and (standing or corner_at > 0.3 or corner == 0.0):
            near = contact_in < PULL_OUT or (gap < TRIED and planned > theirs + 0.5)
            if near or (standing and contact_in < 2.0 * PULL_OUT):
                memory[_SIDE] = _side(aside, corner, memory[_OFFSET], plans, row, s, speed)
        if not near_enough(gap, contact_in):
            memory[_SIDE] = 0.0
        side = memory[_SIDE]
        if side != 0.0:
            wish = aside + side * CLEARANCE
            if standing:
                rate = ESCAPE_RATE
            if abs(wish) > _room(plans, row, s, speed, wish):
                memory[_SIDE], wish = 0.0, 0.0
        # Before and in corners lines converge, and who is ahead takes the corner first.
        beside = ABREAST if braking or corner != 0.0 else 0.8 * CLEARANCE
        if abs(aside - observed[LATERAL_ERROR]) < beside:  # in the way
            wanted = GAP + HEADWAY * theirs
            allowed = theirs + CLOSE_IN * (gap - wanted)
            if standing:
                allowed = math.sqrt(theirs**2 + 2.0 * 7.0 * max(gap - GAP, 0.0))
            pace = min(max(allowed, 0.0) / planned - 1.0, 0.0)
        if pace == 0.0 and gap < 60.0 and not braking and corner == 0.0:
            pace = DRAFT
    elif others[_LEFT, 0] == 0.0 and others[_RIGHT, 0] == 0.0:
        memory[_SIDE] = 0.0
    if memory[_SIDE] == 0.0:
        wish = _defend(others[_BEHIND], memory, corner, corner_at, wish)
    low, high = -math.inf, math.inf
    if others[_LEFT, 0] > 0.0:
        high = _aside(points, observed, others[_LEFT, 1], others[_LEFT, 2]) - CLEARANCE
    if others[_RIGHT, 0] > 0.0:
        low = _aside(points, observed, others[_RIGHT, 1], others[_RIGHT, 2]) + CLEARANCE
    if low > high:
        low = high = 0.5 * (low + high)
    held = min(max(wish, low), high)
    room = _room(plans, row, s, speed, held)
    held = min(max(held, -room), room)
    offset = memory[_OFFSET]
    if offset < low or offset > high or abs(offset) > _room(plans, row, s, speed, offset):
        rate = ESCAPE_RATE
    step = rate * period
    offset = memory[_OFFSET] = offset + min(max(held - offset, -step), step)
    for look in range(LOOKS):  # inside the line the corner is tighter
        bend = plan_at(plans, row, P_CURVATURE, s + 0.6 * AHEAD * look / (LOOKS - 1) * speed)
        if bend * offset > 0.0:
            pace = min(pace, -0.5 * min(bend * offset, 0.5))
    if corner != 0.0:  # who is not where it wants to be has to turn harder than planned
        pace = min(pace, -ASTRAY * max(abs(observed[LATERAL_ERROR] - offset) - 0.5, 0.0))
    target[0], target[1] = offset, max(pace, SLOWEST - 1.0)


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


@njit(cache=True)
def near_enough(gap: float, contact_in: float) -> bool:
    """Return whether a pass goes on: the other machine is near (m) or will be (s)."""
    return gap < 2.0 * TRIED or contact_in < 2.0 * PULL_OUT


@njit(cache=True)
def _side(aside: float, corner: float, offset: float, plans: Plans, row: int, s: float, speed: float) -> float:
    """Return the side on which to pass another that lies beside the line (m): 1 left, -1 right, 0 where is no room."""
    best, found = math.inf, 0.0
    for side in (1.0, -1.0):
        wish = aside + side * CLEARANCE
        if abs(wish) > _room(plans, row, s, speed, wish):
            continue
        cost = abs(wish - offset) + 0.3 * abs(wish) - 0.7 * side * corner
        if cost < best:
            best, found = cost, side
    return found


@njit(cache=True)
def _defend(follower: FloatArray, memory: FloatArray, corner: float, corner_at: float, wish: float) -> float:
    """Return the target with one move to the inside before a corner, where another is close behind."""
    if corner == 0.0:
        memory[_DEFENDING] = 0.0
    elif memory[_DEFENDING] == 0.0 and corner_at > 1.0:
        close = follower[0] > 0.0 and -follower[1] < MACHINE + 4.0 and follower[3] > 0.0
        memory[_DEFENDING] = corner * DEFENDED if close else 0.0
    return memory[_DEFENDING] if memory[_DEFENDING] != 0.0 and corner_at > 0.3 else wish
