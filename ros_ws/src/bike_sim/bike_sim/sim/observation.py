"""One control instant of rows of vehicles, compiled: derived quantities, limits, grip, walls, timing, end of the ride.

One kernel observes every vehicle, bicycle or superbike, on a path or a circuit, alone or among others. All that a ride
remembers lies in one record, all that is observed in one vector, and what happens is written as rows. A row whose
physics diverged shows its last finite instant and is lost, until it is finite again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numba import carray, njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course import track as tr
from bike_sim.course.lap_timing import EXACT, REACH, ideal_distance
from bike_sim.course.projection import AHEAD, SampledLine, project, window
from bike_sim.physics import state as st
from bike_sim.physics.engine import compiled_entry
from bike_sim.physics.ground import BUMP_SAMPLES, GROUND
from bike_sim.schema import SIGNALS
from bike_sim.sim import look as lk
from bike_sim.sim.events import ANGLE, CAUSE, CONTACT, DIVERGED, ENDS, ENERGY, SPEED, TIPPED, WALL, EventKind
from bike_sim.sim.ground import COLUMNS, FACTS, GUST_SAMPLES, LEFT, RIGHT, Road, lay_ground, touch_of
from bike_sim.vehicles.bicycle import PARAMETER_NAMES

Record = Any
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TIP_OVER: Final = ENDS.index(TIPPED)
_WALL: Final = ENDS.index(WALL)
_CONTACT: Final = ENDS.index(CONTACT)
WALL_HOLD, CONTACT_HOLD = 1, 2
"""What holds a vehicle: a wall, or a fall by the touch of another one."""
LOST: Final = ENDS.index(DIVERGED)
FALL_ROW, WALL_ROW, SCRAPE_ROW = int(EventKind.FALL), int(EventKind.WALL), int(EventKind.SCRAPE)

_PITCH: Final = SIGNALS.index("pitch")
_YAW_RATE: Final = SIGNALS.index("yaw_rate")
_SPEED: Final = SIGNALS.index("speed")
_WHEELBASE: Final = PARAMETER_NAMES.index("w")

VEHICLE: Final = np.dtype([("rolling", np.int64), *((name, np.float64) for name in ("mass", "max_steer", "fall_roll"))])
"""A row's vehicle: whether it rolls without slip, mass (kg), set point of the steering at full command and roll beyond
which a bicycle has fallen (rad)."""

SURROUNDINGS: Final = np.dtype(
    [
        (name, np.int64)
        for name in (
            "kind", "by_time", "measured", "line", "line_samples", "ahead", "table", "samples", "marks", "mark_count",
            "road", "bumps", "gusts",
        )
    ]
    + [(name, np.float64) for name in ("interval", "limit", "spacing", "length", "line_spacing", "line_length")]
)  # fmt: skip
"""Constants of a ride: kind of the course (`timing_account.CIRCUIT`, CLOSED_PATH or OPEN_PATH), form of the
preview, whether there is an ideal line; addresses and sizes of `Course.table`, `FollowedLine.stations`, `Track.table`,
`Track.marks` or those of the path, and the parts of a `ground.Road`; distance beyond which a path is left, samples and
length of centre line and followed line, m. Rows on the same course have the same addresses."""

RIDE: Final = np.dtype(
    [
        ("near", np.float64, (2,)),  # arc lengths of the followed line at which both contact points were found, m
        ("place", np.float64, (lk.PLACE_SIZE,)),
        ("rear", np.float64, (2,)),  # rear contact point of the last look, m
        ("asked", np.float64),  # progress of the start along the centre line, m
        ("goal", np.float64),  # arc length of the followed line at which the ride is finished, m
        ("time", np.float64),  # of the last look, s
        ("widest", np.float64),  # distance beyond the limits then of the contact point that was farther out, m
        ("off_track_time", np.float64),
        ("wall_energy", np.float64),
        ("hit", np.float64, (3,)),  # speed (m/s), angle (rad) and energy (J) of the last touch of a wall
        ("scrape", np.float64, (4,)),  # turn (rad), share of the speed that is left, move (m), see `ground.Touch`
        ("touched", np.int64),  # whether a wall (1) or another vehicle (2) was touched and the ride goes on
        ("seen", np.int64),  # whether there was a look before
        ("stopped", np.int64),  # WALL_HOLD or CONTACT_HOLD where the vehicle is held
        ("over", np.int64),  # whether the end of the ride was reported
        ("end", np.int64),  # its code
        ("off_course", np.int64),
        ("finished", np.int64),
        ("account", acc.ACCOUNT),
    ]
)
"""All that a ride remembers from one look to the next."""


class BatchState(NamedTuple):
    """State of the vehicles, one row each.

    Attributes:
        state: minimal states, shape (n, 10).
        moved: where the engines have brought them; taken over where it is finite.
        signals: telemetry, shape (n, k).
        moved_signals: the same of the engines.
        fall: code of the fall that the engine reports, 0 for none.
        vehicle: records of `VEHICLE`.
        parameters: flat vehicle parameters.
        around: records of `SURROUNDINGS`.
        road_facts: records of `ground.FACTS`.
        ground: under the wheels, records of `physics.ground.GROUND`.
        ride: records of `RIDE`.
        views: shape (n, lk.VIEW_SIZE), as `look` lays them out; zeros beyond the derived quantities on a path.
        preview: points of the followed line, m, base_footprint, shape (n, 2, points).
        steps: control steps since the reset; -1 before the first.
        end: code of the end of the ride, see `ENDS`.
        events: rows of what happened in the last step, shape (n, most, timing_account.ROW_SIZE).
        event_count: number of them that count.
    """

    state: FloatArray
    moved: FloatArray
    signals: FloatArray
    moved_signals: FloatArray
    fall: IntArray
    vehicle: Any
    parameters: FloatArray
    around: Any
    road_facts: Any
    ground: Any
    ride: Any
    views: FloatArray
    preview: FloatArray
    steps: IntArray
    end: IntArray
    events: FloatArray
    event_count: IntArray


def make_rows(count: int, signals: int, points: int) -> BatchState:
    """Return rows in which nothing rides yet, with a number of signals and of points of the preview."""
    return BatchState(
        state=np.zeros((count, st.STATE_SIZE)),
        moved=np.zeros((count, st.STATE_SIZE)),
        signals=np.zeros((count, signals)),
        moved_signals=np.zeros((count, signals)),
        fall=np.zeros(count, dtype=np.int64),
        vehicle=np.zeros(count, dtype=VEHICLE),
        parameters=np.zeros((count, len(PARAMETER_NAMES))),
        around=np.zeros(count, dtype=SURROUNDINGS),
        road_facts=np.zeros(count, dtype=FACTS),
        ground=np.zeros(count, dtype=GROUND),
        ride=np.zeros(count, dtype=RIDE),
        views=np.zeros((count, lk.VIEW_SIZE)),
        preview=np.zeros((count, 2, points)),
        steps=np.full(count, -1),
        end=np.zeros(count, dtype=np.int64),
        events=np.zeros((count, 8, acc.ROW_SIZE)),
        event_count=np.zeros(count, dtype=np.int64),
    )


class Around(NamedTuple):
    """Surroundings of a row on any course, with arrays in place of addresses.

    Attributes:
        line: the followed line.
        lines: across the course.
        points: form of the preview of a vehicle without course points.
        limit: distance beyond which a path is left, m.
        line_length: of the followed line, m.
    """

    line: SampledLine
    lines: acc.Lines
    points: lk.Points
    limit: float
    line_length: float


class OnCircuit(NamedTuple):
    """Further arguments on a circuit.

    Attributes:
        table: `Track.table`.
        lines: centre line, limits and stations.
        road: under the wheels.
    """

    table: FloatArray
    lines: lk.Circuit
    road: Road


class Observed(NamedTuple):
    """Output of an observation.

    Attributes:
        ground: under the wheels in the next control period, a record of `physics.ground.GROUND`, shape (1,).
        quantities: a view, shape (lk.VIEW_SIZE,).
        preview: shape (2, points).
        events: rows, shape (at least `timing_account.rows_for` and one more, timing_account.ROW_SIZE).
    """

    ground: Record
    quantities: FloatArray
    preview: FloatArray
    events: FloatArray


_NAMES: Final = SURROUNDINGS.names or ()


def surroundings_of(values: Mapping[str, float]) -> NDArray[np.void]:
    """Return a record of `SURROUNDINGS`, shape (1,), with some values; the others are 0."""
    record = np.empty(1, dtype=SURROUNDINGS)
    record[0] = tuple([values.get(name, 0) for name in _NAMES])
    return record


def address_of(array: FloatArray) -> int:
    """Return the address of numbers that a row reads; whoever keeps the address keeps the array.

    Raises:
        ValueError: no contiguous array of floats.
    """
    if array.dtype != np.float64 or not array.flags.c_contiguous:
        raise ValueError(f"rows read contiguous arrays of floats, not {array.dtype} with strides {array.strides}")
    return int(array.__array_interface__["data"][0])


_entries: dict[Any, Any] = {}


def call(function: Any, *args: Any) -> Any:
    """Call a compiled function whose arguments have the same types every time; see `compiled_entry`."""
    entry = _entries.get(function)
    if entry is None:
        entry = _entries[function] = compiled_entry(function, *args)
    return entry(*args)


@intrinsic  # type: ignore[misc]
def _pointer(typing: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


@njit(cache=True)
def array_at(address: int, rows: int, columns: int) -> FloatArray:
    """Return the array of floats at an address."""
    return carray(_pointer(address), (rows, columns), np.float64)


@njit(cache=True)
def _around(rows: BatchState, i: int) -> Around:
    """Return the surroundings of a row."""
    a = rows.around[i]
    line, marks = array_at(a.line, 4, a.line_samples), array_at(a.marks, 1, a.mark_count)[0]
    return Around(
        SampledLine(line[0], line[1], line[2], line[3], a.line_spacing, a.kind != acc.OPEN_PATH),
        acc.Lines(marks, a.length if a.kind == acc.CIRCUIT else a.line_length, a.kind, a.measured != 0),
        lk.Points(a.by_time != 0, a.interval),
        a.limit,
        a.line_length,
    )


@njit(cache=True)
def row_circuit(rows: BatchState, i: int) -> OnCircuit:
    """Return the circuit of a row."""
    a = rows.around[i]
    table = array_at(a.table, tr.BANK + 1, a.samples)
    centre = SampledLine(
        table[tr.X], table[tr.Y], table[tr.HEADING], table[tr.CURVATURE], a.spacing, a.kind == acc.CIRCUIT
    )
    ahead = array_at(a.ahead, a.line_samples, lk.STATION_SIZE)
    road = Road(
        array_at(a.road, a.samples, COLUMNS), rows.road_facts[i : i + 1], array_at(a.bumps, 1, BUMP_SAMPLES),
        array_at(a.gusts, 2, GUST_SAMPLES),
    )  # fmt: skip
    return OnCircuit(table, lk.Circuit(ahead, centre, table[tr.HEIGHT], table[tr.BANK]), road)


@njit(cache=True)
def _machine(rows: BatchState, i: int) -> lk.Machine:
    vehicle = rows.vehicle[i]
    return lk.Machine(rows.parameters[i], vehicle.rolling != 0, vehicle.mass)


@njit(cache=True)
def observe_rows(period: float, rows: BatchState, kept: FloatArray) -> int:
    """Take over where the engines have brought all rows in a control period, observe them and return what happened.

    Args:
        period: s.
        rows: observed.
        kept: scratch memory for the numbers that a row showed before, shape (at least VIEW_SIZE and the preview).

    Returns:
        Number of events of all rows.
    """
    count = 0
    for i in range(len(rows.steps)):
        rows.event_count[i] = 0
        if rows.steps[i] < 0:
            continue
        rows.steps[i] += 1
        observe_row(i, rows.steps[i] * period, rows, kept)
        count += rows.event_count[i]
    return count


@njit(cache=True)
def observe_row(i: int, time: float, rows: BatchState, kept: FloatArray) -> None:
    """Observe one row at a time (s) since its reset; see `observe_rows`."""
    state, signals, view, preview = rows.moved[i], rows.moved_signals[i], rows.views[i], rows.preview[i]
    if not math.isfinite(state.sum() + signals.sum()):
        _lose(i, time, rows)
        return
    machine, around, ride = _machine(rows, i), _around(rows, i), rows.ride[i]
    on_circuit = around.lines.kind == acc.CIRCUIT
    used = lk.VIEW_SIZE if on_circuit else lk.PLACE
    points = preview.reshape(preview.size)
    kept[:used] = view[:used]
    kept[used : used + len(points)] = points
    if not machine.rolling:
        view[lk.PITCH], view[lk.YAW_RATE], view[lk.SPEED] = signals[_PITCH], signals[_YAW_RATE], signals[_SPEED]
    out = Observed(rows.ground[i : i + 1], view, preview, rows.events[i])
    instant = (time, rows.fall[i])
    if on_circuit:
        count = _observe_circuit(state, machine, instant, around, row_circuit(rows, i), ride, out)
    else:
        count = _observe_path(state, machine, instant, around, ride, out)
    if count < 0:
        view[:used] = kept[:used]
        points[:] = kept[used : used + len(points)]
        _lose(i, time, rows)
        return
    rows.state[i] = state
    rows.signals[i] = signals
    rows.event_count[i], rows.end[i] = count, ride.end


@njit(cache=True)
def _lose(i: int, time: float, rows: BatchState) -> None:
    """End a row whose physics diverged, at its last finite instant."""
    fell = rows.end[i] != 0
    rows.end[i] = LOST
    if fell:
        return
    row = rows.events[i, 0]
    row[:] = 0.0
    progress = rows.views[i, lk.PLACE] if rows.around[i].kind == acc.CIRCUIT else rows.views[i, lk.PROGRESS]
    row[acc.KIND], row[acc.TIME], row[acc.PROGRESS] = FALL_ROW, time, progress
    row[acc.VALUE] = rows.state[i, st.ROLL]
    rows.event_count[i] = 1


@njit(cache=True)
def _observe_path(
    state: FloatArray, machine: lk.Machine, instant: tuple[float, int], around: Around, ride: Record, out: Observed
) -> int:
    """Observe a row on a path; return the number of events, or -1 where the view is not finite."""
    time, fall = instant
    look, line = out.quantities[: lk.PLACE], around.line
    look[lk.PROGRESS], look[lk.FRONT_PROGRESS] = ride.near[0], ride.near[1]
    fresh = ride.seen == 0
    if not fresh:
        # Where the vehicle has moved farther than usual, as in a long control period, the search reaches farther.
        moved = math.hypot(state[st.X] - ride.rear[0], state[st.Y] - ride.rear[1])
        reach = window(AHEAD, moved, around.line_length)
        if reach > AHEAD:
            s, _, _ = project(line, state[st.X], state[st.Y], look[lk.PROGRESS], reach, reach)
            look[lk.FRONT_PROGRESS] += s - look[lk.PROGRESS]
            look[lk.PROGRESS] = s
    lk.derive_on_path(state, machine, line, around.points, fresh, look, out.preview)
    ride.near[0], ride.near[1] = look[lk.PROGRESS], look[lk.FRONT_PROGRESS]
    ride.rear[0], ride.rear[1], ride.seen = state[st.X], state[st.Y], 1
    if not math.isfinite(look.sum()):
        return -1
    progress, error, speed = look[lk.PROGRESS], look[lk.LATERAL_ERROR], look[lk.SPEED]
    place = acc.Place(time, progress, 0.0, 0.0, speed * (time - ride.account.time))
    count = acc.feed(ride.account, around.lines, place, out.events)
    ride.off_course = 1 if abs(error) > around.limit else 0
    ride.finished = 1 if progress >= ride.goal else 0
    ride.end = fall
    if not fresh:
        if fall != 0 and ride.over == 0:
            _write_fall(state, speed, progress, time, fall if fall != TIP_OVER else 0, out.events[count])
            count += 1
        if ride.off_course != 0 and ride.account.away == 0:
            row = out.events[count]
            row[:] = 0.0
            row[acc.KIND], row[acc.TIME], row[acc.PROGRESS], row[acc.VALUE] = acc.LEFT_TRACK, time, progress, error
            count += 1
        ride.account.away = ride.off_course
    ride.over = 1 if fall != 0 else 0
    return count


@njit(cache=True)
def _observe_circuit(
    state: FloatArray, machine: lk.Machine, instant: tuple[float, int], around: Around, circuit: OnCircuit,
    ride: Record, out: Observed,
) -> int:  # fmt: skip
    """Observe a row on a circuit; return the number of events, or -1 where the view is not finite.

    Args:
        state: minimal state; where a wall holds the vehicle its rates are set to 0.
        machine: where it does not roll, pitch, yaw rate and speed stand in the view.
        instant: time since the reset, s, and code of a fall that the engine reports.
        around: the followed line.
        circuit: around it.
        ride: a record of `RIDE`, advanced.
        out: written.
    """
    time, fall = instant
    view, rows = out.quantities, out.events
    look, place, limits = view[: lk.PLACE], view[lk.PLACE : lk.CIRCUIT], view[lk.CIRCUIT : lk.POINTS]
    heading = _find(state, machine, around, circuit, ride, view)
    if not math.isfinite(look.sum() + place.sum() + heading):
        return -1
    ride.touched = 0
    wall = _measure_limits(state, circuit.road, out.ground, ride, time, view)
    limits[lk.WRONG_WAY] = 1.0 if math.cos(state[st.YAW] - heading) < 0.0 else 0.0
    beyond, lines, spacing = limits[lk.OUTSIDE], around.lines, circuit.lines.centre.spacing
    distance = ideal_distance(circuit.table, spacing, lines.length, place[0], place[1])
    count = acc.feed(ride.account, lines, acc.Place(time, place[0], beyond, distance, 0.0), rows)
    for row in range(count):
        if rows[row, acc.KIND] == acc.LEFT_TRACK:
            rows[row, acc.VALUE] = beyond
    if ride.stopped:
        state[st.ROLL_RATE] = state[st.STEER_RATE] = state[st.FRONT_WHEEL_RATE] = 0.0
    elif fall == 0 and wall >= 0 and _meet(state, look[lk.SPEED], wall, machine, circuit.road, ride):
        _write_touch(SCRAPE_ROW, place[0], time, ride, rows[count])
        count += 1
    limits[lk.OFF_TRACK_TIME], limits[lk.WALL_ENERGY] = ride.off_track_time, ride.wall_energy
    ride.off_course = 1 if beyond > 0.0 else 0
    ride.finished = 1 if look[lk.PROGRESS] >= ride.goal else 0
    ride.end = fall
    if ride.stopped:
        ride.end = _WALL if ride.stopped == WALL_HOLD else _CONTACT
    if ride.end != 0 and not ride.over:
        ride.over = 1
        if time > 0.0:
            if ride.end == _WALL:
                _write_touch(WALL_ROW, place[0], time, ride, rows[count])
            else:
                speed = ride.hit[0] if ride.stopped else look[lk.SPEED]
                _write_fall(state, speed, place[0], time, ride.end, rows[count])
            count += 1
    if machine.rolling:
        lk.preview_line(state, machine, around.line, around.points, look, out.preview)
    else:  # its points stand among the course points
        for k in range(lk.STATIONS):
            out.preview[0, k], out.preview[1, k] = view[lk.POINTS + 3 * k], view[lk.POINTS + 3 * k + 1]
    return count


@njit(cache=True)
def _find(
    state: FloatArray, machine: lk.Machine, around: Around, circuit: OnCircuit, ride: Record, view: FloatArray
) -> float:
    """Find the vehicle on followed line and centre line, fill look and course points; return the centre's heading."""
    look, place = view[: lk.PLACE], view[lk.PLACE : lk.CIRCUIT]
    look[lk.PROGRESS], look[lk.FRONT_PROGRESS] = ride.near[0], ride.near[1]
    for k in range(lk.PLACE_SIZE):
        place[k] = ride.place[k]
    moved = math.hypot(state[st.X] - ride.rear[0], state[st.Y] - ride.rear[1])
    reach = window(REACH, moved, around.lines.length)
    heading = lk.derive_on_circuit(state, machine, around.line, circuit.lines, reach, ride.stopped != 0, view)
    if not ride.seen and abs(place[lk.CENTRE_PROGRESS] - ride.asked) < EXACT:
        place[lk.CENTRE_PROGRESS] = ride.asked  # a start on the line is one
    ride.near[0], ride.near[1] = look[lk.PROGRESS], look[lk.FRONT_PROGRESS]
    ride.rear[0], ride.rear[1] = state[st.X], state[st.Y]
    for k in range(lk.PLACE_SIZE):
        ride.place[k] = place[k]
    return heading


@njit(cache=True)
def _measure_limits(state: FloatArray, road: Road, grounds: Record, ride: Record, time: float, view: FloatArray) -> int:
    """Lay the ground, fill distances to the limits and time outside; return which contact point is at a wall, or -1."""
    look, place, limits = view[: lk.PLACE], view[lk.PLACE : lk.CIRCUIT], view[lk.CIRCUIT : lk.POINTS]
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
def _meet(state: FloatArray, speed: float, contact: int, machine: lk.Machine, road: Road, ride: Record) -> bool:
    """Note the wall that a contact point has reached; return whether it is only scraped.

    A hit holds the vehicle from the next step on, and so does any touch a bicycle, whose rolling nothing can deflect.
    """
    touch = touch_of(state[st.YAW], speed, ride.place, contact, road)
    hit = machine.rolling or touch.approach >= road.facts[0].hit
    if not hit and touch.approach <= 0.0:
        return False
    energy = 0.5 * machine.mass * speed * speed
    ride.hit[0], ride.hit[1], ride.hit[2] = speed, touch.angle, energy
    ride.wall_energy += energy * math.sin(touch.angle) ** 2
    ride.stopped = WALL_HOLD if hit else 0
    if hit:
        return False
    ride.touched = 1
    ride.scrape[0], ride.scrape[1], ride.scrape[2], ride.scrape[3] = touch.turn, touch.share, touch.dx, touch.dy
    return True


@njit(cache=True)
def _write_touch(kind: int, progress: float, time: float, ride: Record, row: FloatArray) -> None:
    """Write the row of a touch of a wall."""
    row[:] = 0.0
    row[acc.KIND], row[acc.TIME], row[acc.PROGRESS], row[acc.VALUE] = kind, time, progress, ride.hit[0]
    row[CAUSE], row[SPEED], row[ANGLE], row[ENERGY] = ride.end, ride.hit[0], ride.hit[1], ride.hit[2]


@njit(cache=True)
def _write_fall(state: FloatArray, speed: float, progress: float, time: float, cause: int, row: FloatArray) -> None:
    """Write the row of a fall."""
    row[:] = 0.0
    row[acc.TIME], row[acc.PROGRESS], row[CAUSE] = time, progress, cause
    row[acc.KIND], row[acc.VALUE], row[SPEED] = FALL_ROW, state[st.ROLL], speed


@njit(cache=True)
def begin_row(i: int, asked: float, near: float, s: float, rows: BatchState) -> None:
    """Set where the search for the nearest points of a row begins; on a circuit as if the vehicle were upright.

    On a circuit the ground is laid there.

    Args:
        i: the row; its first state is where the engines have moved it.
        asked: progress of the start along the centre line, m.
        near: progress near which the rear contact point is, m.
        s: the same along the followed line, m.
        rows: with surroundings and vehicle; the ride is all zeros.
    """
    ride, state, around, machine = rows.ride[i], rows.moved[i], _around(rows, i), _machine(rows, i)
    if around.lines.kind != acc.CIRCUIT:
        ride.near[0] = s
        ride.goal = s + around.line_length if around.line.closed else around.line_length - 1e-9
        return
    circuit = row_circuit(rows, i)
    x, y, yaw, centre = state[st.X], state[st.Y], state[st.YAW], circuit.lines.centre
    for contact in range(2):
        ahead = machine.parameters[_WHEELBASE] * contact
        at = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)
        ride.place[2 * contact], ride.place[2 * contact + 1], _ = project(
            centre, at[0], at[1], near + ahead, REACH, REACH
        )
        ride.near[contact] = s + ahead
    ride.asked, ride.goal, ride.rear[0], ride.rear[1] = asked, s + around.line_length, x, y
    lay_ground(x, y, at[0], at[1], ride.place, 0.0, circuit.road, rows.ground[i : i + 1])
