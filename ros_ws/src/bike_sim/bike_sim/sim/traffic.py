"""Rows of a batch that meet on one circuit: slipstream, contact, fallen machines in the way, who is near. Compiled.

A machine drags air along. Another in its wake rides in a wind that blows with it, so that its drag and its downforce
fall by the same part; the forces know nothing of wakes. Machines touch as capsules over their wheelbase, shifted to
the side to which they lean. The normal velocities decide as at a wall (`bike_sim.sim.ground`): a part of them is thrown
back, Coulomb's friction takes what slides, and momentum is exchanged; who gets too much of it, mostly sideways, is
thrown down. The energy lost is that of the velocities. A fallen machine slides on, lies, and is cleared away.

Positions along and across are those of the centre line, so two machines on both sides of a hairpin are far apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course.projection import project
from bike_sim.physics import state as st
from bike_sim.schema import FLAG, GRAVITY, OPPONENT, OPPONENT_SLOTS, Quantity, Schema
from bike_sim.sim import look as lk
from bike_sim.sim.ground import LEFT_WALL, RIGHT_WALL
from bike_sim.sim.observation import CONTACT_HOLD, BatchState, row_circuit

FloatArray = NDArray[np.float64]
Record = Any

_NUMBERS: Final = len(OPPONENT)
_LEFT, _RIGHT, _BEHIND = map(OPPONENT_SLOTS.index, ("left", "right", "behind"))
RANGE: Final = 100.0
"""Distance along the circuit up to which others are seen and have a wake, m."""
BESIDE: Final = 2.2
"""Distance along the circuit up to which another is beside, m: about the length of a machine, so that both overlap."""

WAKE_SIZE: Final = math.sqrt(0.33 / 0.57)
"""Lengths in the wake of a superbike by those of the measured one: turbulent wakes are similar, their size is the root
of the drag area (Schlichting, Boundary-Layer Theory). Superbikes with a crouching rider have 0.31 to 0.34 m2 (their
files). The measured wake below holds the momentum of 0.57 m2, as an upright rider's on a touring machine; all
motorcycles have 0.18 to 0.7 m2 (Cossalter, Motorcycle Dynamics)."""
WAKE_DISTANCE: Final = WAKE_SIZE * np.array([2.64, 10.0, 30.0, 50.0, RANGE])
WAKE_DEFICIT: Final = np.array([0.48, 0.23, 0.12, 0.07, 0.0])
"""Part of the drag that is missing so far behind a motorcycle, m from its rear to the front of who follows: measured in
the wind tunnel and computed (Blocken et al. 2020, Sports Engineering 23:20, for a cyclist behind a motorcycle); none
at the end of the range."""
WAKE_WIDTH: Final = WAKE_SIZE * 0.45
"""Standard deviation across of the wake where it is deepest, m: half the width of the measured machine and rider
(estimate). It widens as the deficit falls, so that the momentum in it stays."""

RADIUS: Final = 0.35
"""Half the width of machine and rider, and how far both wheels reach beyond their contact points, m."""
TOUCH_HEIGHT: Final = 0.6
"""Height at which leaning machines meet, m: about that of the centre of mass."""
FRICTION: Final = 0.4
RESTITUTION: Final = 0.2
"""Of two machines: those of a wall (`bike_sim.course.road.Walls`)."""
THROWN_ACROSS: Final = 2.0
THROWN_ALONG: Final = 4.0
"""Changes of velocity across and along a machine's heading that throw it down, m/s (estimates): machines of equal mass
that meet at 3.3 m/s across fall, about as at a wall."""
SLIDING: Final = 0.45
"""Coulomb's coefficient of a machine on its side; independent of speed (Lin et al. 2012, Int. J. Phys. Sci. 7(30))."""
CLEARED_AFTER: Final = 15.0
"""Time after which a machine that lies is cleared away, s (estimate)."""
CLEAR_AHEAD: Final = 1.0
"""Distance along the circuit by which a machine must be ahead before it counts as having passed, m."""
TURNING: Final = 1.0 / 250.0
"""Curvature of the followed line from which a machine counts as being in a corner, 1/m."""

ABSENT, RIDES, LIES = 0, 1, 2
"""What a row is to the others."""
BODY: Final = np.dtype(
    [
        ("kind", np.int64),
        ("turned_in", np.int64),  # whether it is in a corner
        *(
            (name, np.float64)
            for name in (
                "x", "y", "cos", "sin", "length", "vx", "vy", "shift_x", "shift_y", "move_x", "move_y", "along",
                "across", "drift", "left",
            )
        ),
    ]
)  # fmt: skip
"""A machine as the others meet it: rear contact point and heading in the map, wheelbase, velocity, shift of the body by
its lean, move out of another body; progress, offset from the centre line and their rate of change of it to the left
(m/s), and the time until a lying one is cleared away, s."""

INCIDENT: Final = Schema(
    (
        Quantity("kind", "1", 1, "CONTACT, PASS or CLEARED"),
        Quantity("step", "1", 1, "control steps of the first since its reset"),
        Quantity("row", "1", 1, "of the machine: of the passing one, of the one ahead at a contact"),
        Quantity("other", "1", 1, "of the other machine"),
        Quantity("along", "m", 1, "by which the first is ahead"),
        Quantity("across", "m", 1, "by which the first is to the left"),
        Quantity("approach", "m/s", 1, "normal velocity at a contact"),
        Quantity("energy", "J", 1, "kinetic energy that the contact took"),
        Quantity("thrown", FLAG, 1, "the first is thrown down"),
        Quantity("other_thrown", FLAG, 1, "the other is thrown down"),
        Quantity("overlap", "m", 1, "by which the first was ahead when it turned into the corner; NaN on a straight"),
        Quantity("drift", "m/s", 1, "rate at which the first moves across the circuit, positive to the left"),
        Quantity("other_drift", "m/s", 1, "rate at which the other does"),
        Quantity("closing", "m/s", 1, "rate at which the other comes nearer along the circuit"),
        Quantity("lying", FLAG, 1, "one of them lay before"),
    )
)
"""Columns of what happened between machines."""
CONTACT, PASS, CLEARED = 0, 1, 2
_KIND, _STEP, _ROW, _OTHER, _ALONG, _ACROSS, _APPROACH, _ENERGY = range(8)
_THROWN, _OTHER_THROWN, _OVERLAP, _DRIFT, _OTHER_DRIFT, _CLOSING, _LYING = range(8, 15)


class Traffic(NamedTuple):
    """What rows know of each other.

    Attributes:
        bodies: records of `BODY`, shape (n,).
        racing: which rows take part, shape (n,); set by whoever runs the race.
        group: number of the race of each row, shape (n,); rows of different races do not meet.
        opponents: what each row sees, shape (n, slots, numbers of OPPONENT).
        ahead: 1 where a row is ahead of another, -1 behind, 0 unknown, shape (n, n).
        overlap: by how much each row was ahead of another when it turned in, m, shape (n, n); NaN on a straight.
        incidents: rows of INCIDENT of the last step, shape (most, columns).
    """

    bodies: Any
    racing: NDArray[np.int64]
    group: NDArray[np.int64]
    opponents: FloatArray
    ahead: NDArray[np.int64]
    overlap: FloatArray
    incidents: FloatArray


def make_traffic(groups: Sequence[int]) -> Traffic:
    """Return traffic of rows that know nothing of each other yet, by the number of each row's race."""
    count = len(groups)
    return Traffic(
        np.zeros(count, dtype=BODY),
        np.ones(count, dtype=np.int64),
        np.array(groups, dtype=np.int64),
        np.zeros((count, len(OPPONENT_SLOTS), _NUMBERS)),
        np.zeros((count, count), dtype=np.int64),
        np.full((count, count), np.nan),
        np.zeros((2 * count * count, len(INCIDENT))),
    )


def forget(traffic: Traffic, row: int) -> None:
    """Let a row begin anew."""
    traffic.bodies[row] = np.zeros(1, dtype=BODY)[0]
    traffic.opponents[row] = 0.0
    for table, value in ((traffic.ahead, 0), (traffic.overlap, np.nan)):
        table[row], table[:, row] = value, value


@njit(cache=True)
def wake_deficit(behind: float, aside: float) -> float:
    """Return the part of the drag that is missing at a place behind and beside the rear of another machine, m."""
    if behind <= 0.0 or behind >= WAKE_DISTANCE[-1]:
        return 0.0
    deepest = np.interp(behind, WAKE_DISTANCE, WAKE_DEFICIT)
    width = WAKE_WIDTH * math.sqrt(WAKE_DEFICIT[0] / max(deepest, 1e-6))
    return deepest * math.exp(-0.5 * (aside / width) ** 2)


@njit(cache=True)
def meet(period: float, rows: BatchState, traffic: Traffic, only: int) -> int:
    """Let all rows meet after they were observed, and return the number of incidents.

    Args:
        period: time since the last call, s; 0 after a reset.
        rows: in and out: wakes in the wind of the next period, scrapes and ends of rides by contact.
        traffic: in and out.
        only: number of the race whose rows meet; -1 for all races.
    """
    count, bodies, group = 0, traffic.bodies, traffic.group
    n = len(bodies)
    for i in range(n):
        if only < 0 or group[i] == only:
            count = _place(i, period, rows, traffic, count)
            traffic.opponents[i] = 0.0
    for i in range(n):
        if bodies[i].kind == ABSENT or (only >= 0 and group[i] != only):
            continue
        for j in range(i + 1, n):
            if group[i] != group[j] or bodies[j].kind == ABSENT:
                continue
            if bodies[i].kind == LIES and bodies[j].kind == LIES:
                continue
            length = rows.around[i].length
            along = bodies[i].along - bodies[j].along
            near = along - length * np.rint(along / length)
            if abs(near) < RANGE:
                _see(i, j, near, traffic)
                _see(j, i, -near, traffic)
                count = _touch(i, j, near, rows, traffic, count)
            if bodies[i].kind == RIDES and bodies[j].kind == RIDES:
                count = _pass(i, j, along, rows, traffic, count)
    for i in range(n):
        if bodies[i].kind == RIDES and (only < 0 or group[i] == only):
            _deflect(i, rows, bodies[i])
            _turn_in(i, rows, traffic)
            _draft(i, rows, traffic)
    return count


@njit(cache=True)
def _place(i: int, period: float, rows: BatchState, traffic: Traffic, count: int) -> int:
    """Place a row's body; return the number of incidents."""
    body, ride = traffic.bodies[i], rows.ride[i]
    body.move_x = body.move_y = 0.0
    if rows.steps[i] < 0 or traffic.racing[i] == 0:
        body.kind = ABSENT
        return count
    over = rows.end[i] != 0 or ride.stopped != 0
    if over and body.kind == RIDES:
        body.kind, body.left = LIES, CLEARED_AFTER
        if ride.stopped == 1:  # a wall holds it
            body.vx = body.vy = 0.0
    if body.kind == LIES:
        _slide(i, period, rows, body)
        if body.left <= 0.0:
            body.kind = ABSENT
            return _write(CLEARED, i, i, 0.0, rows, traffic, count)
    elif not over:
        _ride(i, period, rows, body)
    return count


@njit(cache=True)
def _ride(i: int, period: float, rows: BatchState, body: Record) -> None:
    """Place the body of a row that rides."""
    state, look, before = rows.state[i], rows.views[i], body.across
    body.x, body.y = state[st.X], state[st.Y]
    body.cos, body.sin = math.cos(state[st.YAW]), math.sin(state[st.YAW])
    body.length = math.hypot(look[lk.FRONT_X] - body.x, look[lk.FRONT_Y] - body.y)
    body.vx, body.vy = look[lk.SPEED] * body.cos, look[lk.SPEED] * body.sin
    lean = TOUCH_HEIGHT * math.sin(state[st.ROLL])  # positive to the right
    body.shift_x, body.shift_y = lean * body.sin, -lean * body.cos
    body.along, body.across = look[lk.PLACE], look[lk.PLACE + lk.CENTRE_OFFSET]
    body.drift = (body.across - before) / period if body.kind == RIDES and period > 0.0 else 0.0
    body.kind = RIDES


@njit(cache=True)
def _slide(i: int, period: float, rows: BatchState, body: Record) -> None:
    """Move a body that lies: on over the ground, and up to a wall."""
    speed = math.hypot(body.vx, body.vy)
    if speed == 0.0:
        body.left -= period
        return
    share = max(0.0, speed - SLIDING * GRAVITY * period) / speed
    body.vx, body.vy = share * body.vx, share * body.vy
    body.x, body.y = body.x + period * body.vx, body.y + period * body.vy
    body.drift = 0.0
    circuit = row_circuit(rows, i)
    reach = 1.0 + speed * period
    body.along, body.across, _ = project(circuit.lines.centre, body.x, body.y, body.along, reach, reach)
    road = circuit.road
    facts = road.facts[0]
    here = road.table[int((body.along % facts.length) / facts.spacing)]
    if not here[RIGHT_WALL] < body.across < here[LEFT_WALL]:
        body.vx = body.vy = 0.0


@njit(cache=True)
def _see(i: int, j: int, near: float, traffic: Traffic) -> None:
    """Show a row another one that lies behind it by a distance along the circuit, m, where it is among the nearest."""
    me, other = traffic.bodies[i], traffic.bodies[j]
    if me.kind != RIDES:
        return
    seen = traffic.opponents[i]
    x, y = other.x - me.x, other.y - me.y
    vx, vy = other.vx - me.vx, other.vy - me.vy
    found = (
        1.0, me.cos * x + me.sin * y, me.cos * y - me.sin * x, me.cos * vx + me.sin * vy, me.cos * vy - me.sin * vx
    )  # fmt: skip
    distance = math.hypot(x, y)
    slot = _BEHIND
    if near < -BESIDE:
        slot = 0
        if seen[0, 0] > 0.0 and distance >= math.hypot(seen[0, 1], seen[0, 2]):
            slot = 1
        elif seen[0, 0] > 0.0:
            seen[1] = seen[0]
            seen[0, 0] = 0.0
    elif near <= BESIDE:
        slot = _LEFT if other.across + 1e-9 > me.across else _RIGHT
    if seen[slot, 0] > 0.0 and distance >= math.hypot(seen[slot, 1], seen[slot, 2]):
        return
    for k in range(_NUMBERS):
        seen[slot, k] = found[k]


@njit(cache=True)
def _touch(i: int, j: int, near: float, rows: BatchState, traffic: Traffic, count: int) -> int:
    """Let two bodies touch; return the number of incidents."""
    a, b = traffic.bodies[i], traffic.bodies[j]
    reach = a.length + b.length + 4.0 * RADIUS + abs(a.shift_x - b.shift_x) + abs(a.shift_y - b.shift_y)
    if abs(a.x - b.x) + abs(a.y - b.y) > 2.0 * reach or rows.ride[i].touched == 1 or rows.ride[j].touched == 1:
        return count
    gap, nx, ny = _between(a, b)
    if gap >= 2.0 * RADIUS:
        return count
    approach = (b.vx - a.vx) * nx + (b.vy - a.vy) * ny
    if approach <= 0.0:
        return count
    lying = a.kind == LIES or b.kind == LIES
    masses = rows.vehicle[i].mass, rows.vehicle[j].mass
    before = _energy(a, masses[0]) + _energy(b, masses[1])
    # The bodies exchange momentum along the normal, and friction takes what slides across it.
    common = masses[0] * masses[1] / (masses[0] + masses[1])
    normal = (1.0 + RESTITUTION) * common * approach
    slip = (b.vy - a.vy) * nx - (b.vx - a.vx) * ny
    across = math.copysign(min(FRICTION * normal, common * abs(slip)), slip)
    px, py = normal * nx - across * ny, normal * ny + across * nx
    thrown = _push(i, px / masses[0], py / masses[0], rows, a)
    other_thrown = _push(j, -px / masses[1], -py / masses[1], rows, b)
    inside = 2.0 * RADIUS - gap
    _move_out(a, b, inside * common / masses[0], inside * common / masses[1], nx, ny)
    count = _write(CONTACT, i, j, near, rows, traffic, count)
    row = traffic.incidents[count - 1]
    row[_APPROACH], row[_ENERGY] = approach, before - _energy(a, masses[0]) - _energy(b, masses[1])
    ahead = near >= 0.0
    row[_THROWN], row[_OTHER_THROWN] = (thrown, other_thrown) if ahead else (other_thrown, thrown)
    row[_LYING] = 1.0 if lying else 0.0
    return count


@njit(cache=True)
def _energy(body: Record, mass: float) -> float:
    return 0.5 * mass * (body.vx * body.vx + body.vy * body.vy)


@njit(cache=True)
def _push(i: int, dx: float, dy: float, rows: BatchState, body: Record) -> float:
    """Change a body's velocity, m/s; return 1 where that throws a machine down that rode."""
    body.vx, body.vy = body.vx + dx, body.vy + dy
    if body.kind == LIES:
        return 0.0
    along, across = dx * body.cos + dy * body.sin, dy * body.cos - dx * body.sin
    ride, speed = rows.ride[i], rows.views[i, lk.SPEED]
    if abs(across) < THROWN_ACROSS and abs(along) < THROWN_ALONG and rows.vehicle[i].rolling == 0:
        return 0.0
    ride.stopped = CONTACT_HOLD
    ride.hit[0], ride.hit[1] = speed, math.atan2(abs(across), abs(along))
    ride.hit[2] = 0.5 * rows.vehicle[i].mass * speed * speed
    body.kind, body.left = LIES, CLEARED_AFTER
    return 1.0


@njit(cache=True)
def _move_out(a: Record, b: Record, mine: float, others: float, nx: float, ny: float) -> None:
    """Move two bodies apart along a normal that points from the second to the first, m."""
    a.move_x, a.move_y = a.move_x + mine * nx, a.move_y + mine * ny
    b.move_x, b.move_y = b.move_x - others * nx, b.move_y - others * ny


@njit(cache=True)
def _deflect(i: int, rows: BatchState, body: Record) -> None:
    """Have the engine turn and slow a row that was touched, as at a wall, in the next period."""
    speed, ride = rows.views[i, lk.SPEED], rows.ride[i]
    untouched = body.move_x == 0.0 and body.move_y == 0.0  # every touch moves
    if untouched or ride.touched == 1 or speed <= 0.0:
        return
    left = math.hypot(body.vx, body.vy)
    turn = math.atan2(body.cos * body.vy - body.sin * body.vx, body.cos * body.vx + body.sin * body.vy)
    ride.touched = 2
    ride.scrape[0], ride.scrape[1], ride.scrape[2], ride.scrape[3] = turn, left / speed, body.move_x, body.move_y


@njit(cache=True)
def _between(a: Record, b: Record) -> tuple[float, float, float]:
    """Return the distance of the middle lines of two bodies, m, and the direction from the second to the first.

    Closest points of two segments: Ericson, Real-Time Collision Detection, 5.1.9.
    """
    ax, ay, bx, by = a.x + a.shift_x, a.y + a.shift_y, b.x + b.shift_x, b.y + b.shift_y
    ux, uy, wx, wy = a.length * a.cos, a.length * a.sin, b.length * b.cos, b.length * b.sin
    rx, ry = ax - bx, ay - by
    uu, ww, uw = ux * ux + uy * uy, wx * wx + wy * wy, ux * wx + uy * wy
    ur, wr = ux * rx + uy * ry, wx * rx + wy * ry
    parallel = uu * ww - uw * uw
    s = min(max((uw * wr - ur * ww) / parallel, 0.0), 1.0) if parallel > 1e-9 else 0.5
    t = (uw * s + wr) / ww
    if t < 0.0:
        t, s = 0.0, min(max(-ur / uu, 0.0), 1.0)
    elif t > 1.0:
        t, s = 1.0, min(max((uw - ur) / uu, 0.0), 1.0)
    dx, dy = rx + s * ux - t * wx, ry + s * uy - t * wy
    gap = math.hypot(dx, dy)
    if gap < 1e-6:  # they cross: apart along the line of their middles
        dx, dy = rx + 0.5 * (ux - wx), ry + 0.5 * (uy - wy)
        middle = max(math.hypot(dx, dy), 1e-9)
        return 0.0, dx / middle, dy / middle
    return gap, dx / gap, dy / gap


@njit(cache=True)
def _pass(i: int, j: int, along: float, rows: BatchState, traffic: Traffic, count: int) -> int:
    """Note which of two rows is ahead in the race; return the number of incidents."""
    ahead = traffic.ahead
    if abs(along) < CLEAR_AHEAD and ahead[i, j] != 0:
        return count
    side = 1 if along >= 0.0 else -1
    if ahead[i, j] == -side:
        first, second = (i, j) if side > 0 else (j, i)
        count = _write(PASS, first, second, abs(along), rows, traffic, count)
    ahead[i, j], ahead[j, i] = side, -side
    return count


@njit(cache=True)
def _turn_in(i: int, rows: BatchState, traffic: Traffic) -> None:
    """Note by how much a row is ahead of the others where it turns into a corner."""
    body = traffic.bodies[i]
    corner = abs(rows.views[i, lk.CURVATURE]) > TURNING
    if not corner:
        traffic.overlap[i] = np.nan
    elif body.turned_in == 0:
        length = rows.around[i].length
        for j in range(len(traffic.bodies)):
            along = body.along - traffic.bodies[j].along
            traffic.overlap[i, j] = along - length * np.rint(along / length)
    body.turned_in = 1 if corner else 0


@njit(cache=True)
def _draft(i: int, rows: BatchState, traffic: Traffic) -> None:
    """Add the deepest wake in which a row rides to its wind."""
    body, ground, deepest = traffic.bodies[i], rows.ground[i], 0.0
    length = rows.around[i].length
    for j in range(len(traffic.bodies)):
        other = traffic.bodies[j]
        if j == i or other.kind != RIDES or traffic.group[j] != traffic.group[i]:
            continue
        along = other.along - body.along
        behind = along - length * np.rint(along / length) - body.length - 2.0 * RADIUS
        if 0.0 < behind < RANGE:
            deepest = max(deepest, wake_deficit(behind, body.across - other.across))
    if deepest == 0.0:
        return
    head = (body.vx - ground.wind_x) * body.cos + (body.vy - ground.wind_y) * body.sin
    along = (1.0 - math.sqrt(1.0 - deepest)) * max(head, 0.0)
    ground.wind_x, ground.wind_y = ground.wind_x + along * body.cos, ground.wind_y + along * body.sin


@njit(cache=True)
def _write(kind: int, i: int, j: int, near: float, rows: BatchState, traffic: Traffic, count: int) -> int:
    """Write what happened to two rows, of which the first is ahead by a distance, m; return how many incidents."""
    if near < 0.0:
        i, j, near = j, i, -near
    row, a, b = traffic.incidents[count], traffic.bodies[i], traffic.bodies[j]
    row[:] = 0.0
    row[_KIND], row[_STEP], row[_ROW], row[_OTHER] = kind, rows.steps[i], i, j
    row[_ALONG], row[_ACROSS], row[_OVERLAP] = near, a.across - b.across, traffic.overlap[i, j]
    row[_DRIFT], row[_OTHER_DRIFT] = a.drift, b.drift
    row[_CLOSING] = math.hypot(b.vx, b.vy) - math.hypot(a.vx, a.vy)
    return count + 1
