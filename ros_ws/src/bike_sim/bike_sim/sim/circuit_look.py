"""One control instant on a circuit, compiled: look, course points, limits, grip, wall, lap timing, end of the ride.

One kernel serves the scene of a single simulator and batches, so that both see the same numbers bit for bit. All that a
ride remembers lies in one record, all that is seen in one vector, and what happens is written as rows.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course import track as tr
from bike_sim.course.lap_timing import ideal_distance
from bike_sim.course.placing import EXACT, REACH
from bike_sim.course.projection import project, window
from bike_sim.physics import state as st
from bike_sim.physics.superbike.forces import FALL_NAMES
from bike_sim.sim import look as lk
from bike_sim.sim.ground import LEFT, RIGHT, Road, lay_ground
from bike_sim.sim.request import COURSE_POINTS
from bike_sim.sim.snapshot import DIVERGED, WALL
from bike_sim.sim.walls import touch_of

Record = Any
FloatArray = NDArray[np.float64]

_INTERVAL: Final = COURSE_POINTS.interval

# Where the blocks of a view begin.
PLACE: Final = lk.LOOK_SIZE
CIRCUIT: Final = PLACE + lk.PLACE_SIZE
POINTS: Final = CIRCUIT + lk.CIRCUIT_SIZE
VIEW_SIZE: Final = POINTS + 9 * lk.STATIONS
"""A view is one vector: look, place, the above and the course points."""

ENDS: Final = (*FALL_NAMES, WALL, DIVERGED)
"""How rides end, by code; 0 while they go on."""
_WALL: Final = ENDS.index(WALL)
LOST: Final = ENDS.index(DIVERGED)

FALL_ROW, WALL_ROW, SCRAPE_ROW = 1, 3, 8
"""Kinds of rows beside those of `timing_account`; the numbers are those of ``bike_msgs/RideEvent``."""
CAUSE, SPEED, ANGLE, ENERGY = range(acc.NUMBER, acc.ROW_SIZE)
"""Columns of their rows: code of the end or 0, speed (m/s), and of a wall the angle to it (rad) and the energy (J)."""

SCENE_CONSTANTS: Final = np.dtype(
    [
        (name, np.float64)
        for name in ("spacing", "length", "line_spacing", "line_length", "measured", "mass", "path", "closed")
    ]
)
"""What stays the same over a ride: samples of the centre line and of the followed line, m; whether there is an ideal
line; mass of the vehicle, kg; whether the course is a path without limits, and whether that is closed."""

RIDE: Final = np.dtype(
    [
        ("near", np.float64, (2,)),  # arc lengths of the followed line at which both contact points were found, m
        ("place", np.float64, (lk.PLACE_SIZE,)),
        ("rear", np.float64, (2,)),  # rear contact point of the last look, m
        ("asked", np.float64),  # progress of the start along the centre line, m
        ("begin", np.float64),  # the same along the followed line, m
        ("time", np.float64),  # of the last look, s
        ("widest", np.float64),  # distance beyond the limits then of the contact point that was farther out, m
        ("off_track_time", np.float64),
        ("wall_energy", np.float64),
        ("hit", np.float64, (3,)),  # speed (m/s), angle (rad) and energy (J) of the last touch of a wall
        (
            "scrape",
            np.float64,
            (4,),
        ),  # what it does: turn (rad), what is left of the speed, move (m), see `walls.Touch`
        ("touched", np.int64),  # whether a wall was touched in the last look and the ride goes on
        ("seen", np.int64),  # whether there was a look before
        ("stopped", np.int64),  # whether a wall holds the vehicle
        ("over", np.int64),  # whether the end of the ride was told
        ("end", np.int64),  # its code
        ("off_course", np.int64),
        ("finished", np.int64),
        ("account", acc.ACCOUNT),
    ]
)
"""All that a ride remembers from one look to the next."""


@njit(cache=True)
def observe_circuit(
    state: FloatArray, parameters: FloatArray, rolling: bool, fall: int, time: float, table: FloatArray,
    line: FloatArray, ahead: FloatArray, marks: FloatArray, facts: Record, road: Road, grounds: Record, ride: Record,
    view: FloatArray, rows: FloatArray,
) -> int:  # fmt: skip
    """See, judge and time one control instant; return the number of rows, or -1 where the view is not finite.

    Args:
        state: minimal state; where a wall holds the vehicle its rates are set to 0.
        parameters: flat vehicle parameters.
        rolling: whether the motion follows from the minimal state; else pitch, yaw rate and speed stand in the view.
        fall: code of a fall that the plant reports.
        time: s since the reset.
        table: `Track.table`.
        line: table of the followed line, `Course.table`.
        ahead: what stations show, `FollowedLine.stations`.
        marks: `Track.marks`.
        facts: a record of `SCENE_CONSTANTS`.
        road: the circuit, see `ground.road_of`.
        grounds: under the wheels in the next control period, a record of `physics.ground.GROUND`, shape (1,), written.
        ride: a record of `RIDE`, advanced.
        view: out, shape (VIEW_SIZE,).
        rows: out, shape (at least `timing_account.rows_for` and one more, timing_account.ROW_SIZE).
    """
    look, place = view[:PLACE], view[PLACE:CIRCUIT]
    heading = _find(state, parameters, rolling, table, line, ahead, facts, ride, view)
    if not math.isfinite(look.sum() + place.sum() + heading):
        look[lk.PROGRESS] = math.nan
        return -1
    limits = view[CIRCUIT:POINTS]
    ride.touched = 0
    wall = _judge(state, look, road, grounds, ride, place, time, limits)
    limits[lk.WRONG_WAY] = 1.0 if math.cos(state[st.YAW] - heading) < 0.0 else 0.0
    beyond = limits[lk.OUTSIDE]
    distance = ideal_distance(table, facts.spacing, facts.length, place[0], place[1])
    count = acc.feed(
        ride.account, marks, facts.length, facts.measured > 0.0, time, place[0], beyond, distance, rows
    )  # fmt: skip
    for row in range(count):
        if rows[row, acc.KIND] == acc.LEFT_TRACK:
            rows[row, acc.VALUE] = beyond
    if ride.stopped:
        state[st.ROLL_RATE] = state[st.STEER_RATE] = state[st.FRONT_WHEEL_RATE] = 0.0
    elif fall == 0 and wall >= 0 and _meet(state, look[lk.SPEED], wall, rolling, facts, road, ride):
        _tell(SCRAPE_ROW, place[0], time, ride, rows[count])
        count += 1
    limits[lk.OFF_TRACK_TIME], limits[lk.WALL_ENERGY] = ride.off_track_time, ride.wall_energy
    ride.off_course = 1 if beyond > 0.0 else 0
    ride.finished = 1 if look[lk.PROGRESS] >= ride.begin + facts.line_length else 0
    ride.end = _WALL if ride.stopped else fall
    if ride.end != 0 and not ride.over:
        ride.over = 1
        if time > 0.0:
            _tell_end(state, look[lk.SPEED], place[0], time, ride, rows[count])
            count += 1
    return count


@njit(cache=True)
def _find(
    state: FloatArray, parameters: FloatArray, rolling: bool, table: FloatArray, line: FloatArray,
    ahead: FloatArray, facts: Record, ride: Record, view: FloatArray,
) -> float:  # fmt: skip
    """Find the vehicle on followed line and centre line, fill look and course points; return the centre's heading."""
    look, place = view[:PLACE], view[PLACE:CIRCUIT]
    look[lk.PROGRESS], look[lk.FRONT_PROGRESS] = ride.near[0], ride.near[1]
    for k in range(lk.PLACE_SIZE):
        place[k] = ride.place[k]
    moved = math.hypot(state[st.X] - ride.rear[0], state[st.Y] - ride.rear[1])
    heading = lk.look_at_circuit(
        state,
        parameters,
        rolling,
        ride.stopped != 0,
        (line[0], line[1], line[2], line[3]),
        facts.line_spacing,
        ahead,
        (table[tr.X], table[tr.Y], table[tr.HEADING], table[tr.CURVATURE]),
        facts.spacing,
        table[tr.HEIGHT],
        table[tr.BANK],
        _INTERVAL,
        window(REACH, moved, facts.length),
        look,
        place,
        view[POINTS:VIEW_SIZE].reshape((3, lk.STATIONS, 3)),
    )
    if not ride.seen and abs(place[lk.CENTRE_PROGRESS] - ride.asked) < EXACT:
        place[lk.CENTRE_PROGRESS] = ride.asked  # a start on the line is one
    ride.near[0], ride.near[1] = look[lk.PROGRESS], look[lk.FRONT_PROGRESS]
    ride.rear[0], ride.rear[1] = state[st.X], state[st.Y]
    for k in range(lk.PLACE_SIZE):
        ride.place[k] = place[k]
    return heading


@njit(cache=True)
def _judge(
    state: FloatArray, look: FloatArray, road: Road, grounds: Record, ride: Record, place: FloatArray, time: float,
    limits: FloatArray,
) -> int:  # fmt: skip
    """Lay the ground, fill distances to the limits and time outside; return which contact point is at a wall, or -1."""
    rear, front, wall = lay_ground(
        state[st.X], state[st.Y], look[lk.FRONT_X], look[lk.FRONT_Y], place, time, road, grounds
    )
    for contact in (lk.CENTRE_PROGRESS, lk.FRONT_CENTRE_PROGRESS):
        left, right = _limits_at(place[contact], road)
        limits[contact], limits[contact + 1] = left - place[contact + 1], right + place[contact + 1]
    limits[lk.OUTSIDE] = min(rear, front)
    widest = max(rear, front)
    if ride.seen:
        ride.off_track_time += (time - ride.time) * acc.share_above_zero(ride.widest, widest)
    ride.seen, ride.time, ride.widest = 1, time, widest
    return wall


@njit(cache=True)
def _limits_at(progress: float, road: Road) -> tuple[float, float]:
    """Return the distances of the left and the right limit from the centre line at a progress of any lap, m."""
    table, facts = road.table, road.facts[0]
    u = (progress % facts.length) / facts.spacing
    i = min(int(u), len(table) - 2)
    here, there, part = table[i], table[i + 1], u - i
    return here[LEFT] + part * (there[LEFT] - here[LEFT]), here[RIGHT] + part * (there[RIGHT] - here[RIGHT])


@njit(cache=True)
def _meet(
    state: FloatArray, speed: float, contact: int, rolling: bool, facts: Record, road: Road, ride: Record
) -> bool:  # fmt: skip
    """Note the wall that a contact point has reached; return whether it is only scraped.

    A hit holds the vehicle from the next step on, and so does any touch a bicycle, whose rolling nothing can deflect.
    """
    touch = touch_of(state[st.YAW], speed, ride.place, contact, road)
    hit = rolling or touch.approach >= road.facts[0].hit
    if not hit and touch.approach <= 0.0:
        return False
    energy = 0.5 * facts.mass * speed * speed
    ride.hit[0], ride.hit[1], ride.hit[2] = speed, touch.angle, energy
    ride.wall_energy += energy * math.sin(touch.angle) ** 2
    ride.stopped = 1 if hit else 0
    if hit:
        return False
    ride.touched = 1
    ride.scrape[0], ride.scrape[1], ride.scrape[2], ride.scrape[3] = touch.turn, touch.share, touch.dx, touch.dy
    return True


@njit(cache=True)
def _tell(kind: int, progress: float, time: float, ride: Record, row: FloatArray) -> None:
    """Write the row of a touch of a wall."""
    row[:] = 0.0
    row[acc.KIND], row[acc.TIME], row[acc.PROGRESS], row[acc.VALUE] = kind, time, progress, ride.hit[0]
    row[CAUSE], row[SPEED], row[ANGLE], row[ENERGY] = ride.end, ride.hit[0], ride.hit[1], ride.hit[2]


@njit(cache=True)
def _tell_end(state: FloatArray, speed: float, progress: float, time: float, ride: Record, row: FloatArray) -> None:
    """Write the row of how the ride ended."""
    if ride.end == _WALL:
        _tell(WALL_ROW, progress, time, ride, row)
        return
    row[:] = 0.0
    row[acc.TIME], row[acc.PROGRESS], row[CAUSE] = time, progress, ride.end
    row[acc.KIND], row[acc.VALUE], row[SPEED] = FALL_ROW, state[st.ROLL], speed


@njit(cache=True)
def begin_ride(
    state: FloatArray, wheelbase: float, asked: float, near: float, s: float, table: FloatArray, facts: Record,
    road: FloatArray, road_facts: Record, bumps: FloatArray, gusts: FloatArray, grounds: Record, rides: Record,
) -> None:  # fmt: skip
    """Set where the search for the nearest points begins, as if the vehicle were upright, and lay the ground there.

    Args:
        state: first state.
        wheelbase: m.
        asked: progress of the start along the centre line, m.
        near: progress near which the rear contact point is, m.
        s: the same along the followed line, m.
        table: `Track.table`.
        facts: a record of `SCENE_CONSTANTS`, shape (1,).
        road: table of `ground.Road`, whose parts follow.
        road_facts: its facts.
        bumps: its bumps.
        gusts: its gusts.
        grounds: of `physics.ground.GROUND`, shape (1,), written.
        rides: of `RIDE`, shape (1,), all zeros; written.
    """
    ride, x, y, yaw = rides[0], state[st.X], state[st.Y], state[st.YAW]
    for contact in range(2):
        ahead = wheelbase * contact
        at = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)
        ride.place[2 * contact], ride.place[2 * contact + 1], _ = project(
            table[tr.X],
            table[tr.Y],
            table[tr.HEADING],
            facts[0].spacing,
            True,
            at[0],
            at[1],
            near + ahead,
            REACH,
            REACH,
        )
        ride.near[contact] = s + ahead
    ride.asked, ride.begin, ride.rear[0], ride.rear[1] = asked, s, x, y
    lay_ground(
        x, y, at[0], at[1], ride.place, 0.0, Road(road, road_facts, bumps, gusts), grounds
    )  # fmt: skip


@njit(cache=True)
def look_one(
    state: FloatArray, parameters: FloatArray, rolling: bool, fall: int, time: float, table: FloatArray,
    line: FloatArray, ahead: FloatArray, marks: FloatArray, facts: Record, road: FloatArray, road_facts: Record,
    bumps: FloatArray, gusts: FloatArray, grounds: Record, rides: Record, view: FloatArray, rows: FloatArray,
) -> tuple[int, int, bool, bool, bool]:  # fmt: skip
    """Do as `observe_circuit` with arrays of one record, which cost a caller in Python less than records.

    Returns:
        Number of rows, code of the end, whether off course, finished, and stopped by a wall.
    """
    ride = rides[0]
    count = observe_circuit(
        state, parameters, rolling, fall, time, table, line, ahead, marks, facts[0],
        Road(road, road_facts, bumps, gusts), grounds, ride, view, rows,
    )  # fmt: skip
    return count, ride.end, ride.off_course != 0, ride.finished != 0, ride.stopped != 0
