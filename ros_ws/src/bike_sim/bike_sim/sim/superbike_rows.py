"""Control steps of many superbikes, compiled: motion, then all that is seen, timed and judged, row by row.

Each row is advanced and looked at on copies, which are kept where all is finite; a row whose physics diverge shows its
last finite instant and is lost.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.projection import AHEAD, project, window
from bike_sim.physics import state as st
from bike_sim.physics.ground import GROUND
from bike_sim.physics.multibody import articulated
from bike_sim.physics.superbike.engine import advance
from bike_sim.physics.superbike.forces import TELEMETRY, TELEMETRY_NAMES
from bike_sim.physics.superbike.pose import deflect
from bike_sim.physics.superbike.records import MEMORY, discretise_command
from bike_sim.sim import circuit_look as cl
from bike_sim.sim import look as lk
from bike_sim.sim.ground import Road
from bike_sim.sim.request import COURSE_POINTS

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_BODIES: Final = 5
_INTERVAL: Final = COURSE_POINTS.interval

SIGNALS: Final = len(TELEMETRY_NAMES)
"""Columns of the telemetry."""


class VehicleTables(NamedTuple):
    """What machines are, one row each.

    Attributes:
        constants: records of `records.CONSTANTS`. trees: records of `articulated.tree_record`.
        parameters: flat vehicle parameters, shape (m, k).
    """

    constants: Any
    trees: Any
    parameters: FloatArray


class TrackTables(NamedTuple):
    """What is ridden on, one place for each.

    Attributes:
        tracks: `Track.table`. marks: `Track.marks`. lines: `Course.table`.
        stations: `FollowedLine.stations`, in the places of the lines.
        roads: tables of `ground.Road`, in the places of the circuits. road_facts: their facts, shape (n,).
        bumps: their profiles of bumps. gusts: of their wind.
    """

    tracks: Any
    marks: Any
    lines: Any
    stations: Any
    roads: Any
    road_facts: Any
    bumps: Any
    gusts: Any


class BatchState(NamedTuple):
    """What rides, one row each.

    Attributes:
        state: minimal states. motion: of the bodies. memory: of the forces. signals: telemetry.
        ground: under the wheels.
        ride: records of `circuit_look.RIDE`.
        facts: records of `circuit_look.SCENE_CONSTANTS`.
        measured: telemetry as numbers, the same memory. views: as `circuit_look` lays it out.
        preview: points of the followed line, shape (n, 2, STATIONS).
        machine: place of the machine. track: place of the circuit. line: place of the followed line.
        steps: control steps since the reset; -1 before the first. end: code of the end, see `circuit_look.ENDS`.
        events: rows of what happened in the last step, shape (n, most, ROW_SIZE). told: how many of them count.
    """

    state: FloatArray
    motion: Any
    memory: Any
    signals: Any
    ground: Any
    ride: Any
    facts: Any
    measured: FloatArray
    views: FloatArray
    preview: FloatArray
    machine: IntArray
    track: IntArray
    line: IntArray
    steps: IntArray
    end: IntArray
    events: FloatArray
    told: IntArray


def make_rows(count: int) -> BatchState:
    """Return rows in which nothing rides yet."""
    signals = np.zeros(count, dtype=TELEMETRY)
    return BatchState(
        state=np.zeros((count, st.STATE_SIZE)),
        motion=np.zeros(count, dtype=articulated.motion_record(_BODIES)),
        memory=np.zeros(count, dtype=MEMORY),
        signals=signals,
        ground=np.zeros(count, dtype=GROUND),
        ride=np.zeros(count, dtype=cl.RIDE),
        facts=np.zeros(count, dtype=cl.SCENE_CONSTANTS),
        measured=signals.view(np.float64).reshape(count, SIGNALS),
        views=np.full((count, cl.VIEW_SIZE), np.nan),
        preview=np.zeros((count, 2, lk.STATIONS)),
        machine=np.zeros(count, dtype=np.int64),
        track=np.zeros(count, dtype=np.int64),
        line=np.zeros(count, dtype=np.int64),
        steps=np.full(count, -1),
        end=np.zeros(count, dtype=np.int64),
        events=np.zeros((count, 8, acc.ROW_SIZE)),
        told=np.zeros(count, dtype=np.int64),
    )


class Scratch(NamedTuple):
    """Copies of a row at work, shape (1,) or (1, k), and the memory of the dynamics."""

    state: FloatArray
    signals: Any
    measured: FloatArray
    ride: Any
    views: FloatArray
    work: Any


def make_scratch() -> Scratch:
    """Return memory to work with."""
    one = make_rows(1)
    return Scratch(one.state, one.signals, one.measured, one.ride, one.views, articulated.workspace(_BODIES))


@njit(cache=True)
def step_rows(
    commands: FloatArray, dt: float, substeps: int, period: float, machines: VehicleTables, grounds: TrackTables,
    rows: BatchState, scratch: Scratch,
) -> None:  # fmt: skip
    """Hold commands for a control period.

    Args:
        commands: steering and throttle in [-1, 1], shape (n, 2).
        dt: integration step, s.
        substeps: steps of a control period.
        period: the same, s.
        machines: see there.
        grounds: see there.
        rows: advanced.
        scratch: overwritten.
    """
    for i in range(len(commands)):
        rows.told[i] = 0
        if rows.steps[i] < 0:
            continue
        rows.steps[i] += 1
        if rows.end[i] != cl.LOST:
            _step(i, commands[i, 0], commands[i, 1], dt, substeps, period, machines, grounds, rows, scratch)


@njit(cache=True)
def _step(
    i: int, steering: float, throttle: float, dt: float, substeps: int, period: float, machines: VehicleTables,
    grounds: TrackTables, rows: BatchState, scratch: Scratch,
) -> None:  # fmt: skip
    """Advance and see one row."""
    state, view = scratch.state[0], scratch.views[0]
    state[:] = rows.state[i]
    scratch.signals[0] = rows.signals[i]
    scratch.ride[0] = rows.ride[i]
    ride, signals = scratch.ride[0], scratch.signals[0]
    machine, track, line = rows.machine[i], rows.track[i], rows.line[i]
    time = rows.steps[i] * period
    if not ride.stopped:
        advance(
            state, rows.motion[i], rows.memory[i], signals, machines.constants[machine], machines.trees[machine],
            scratch.work[0], discretise_command((steering, throttle, dt), machines.constants[machine]), rows.ground[i],
            grounds.bumps[track], substeps,
        )  # fmt: skip
    count = -1
    if math.isfinite(state.sum() + scratch.measured.sum()):
        view[lk.PITCH], view[lk.YAW_RATE] = signals.pitch_rad, signals.yaw_rate_rad_s
        view[lk.SPEED] = signals.speed_m_s
        if rows.facts[i].path > 0.0:
            count = _look_at_path(i, machines.parameters[machine], grounds.lines[line], ride, state, view, rows)
        else:
            count = _look_at_circuit(i, time, machines.parameters[machine], grounds, ride, state, view, rows)
    if count < 0:
        _lose(i, time, rows)
        return
    rows.state[i] = state
    rows.signals[i] = scratch.signals[0]
    rows.ride[i] = scratch.ride[0]
    rows.views[i] = view
    rows.told[i], rows.end[i] = count, ride.end
    if ride.touched:
        scrape = ride.scrape
        deflect(rows.motion[i : i + 1], state[st.X], state[st.Y], scrape[0], scrape[1], scrape[2], scrape[3])


@njit(cache=True)
def _look_at_circuit(
    i: int, time: float, parameters: FloatArray, grounds: TrackTables, ride: Any, state: FloatArray, view: FloatArray,
    rows: BatchState,
) -> int:  # fmt: skip
    """See a row on a circuit; the preview of the followed line stands among the course points."""
    track, line = rows.track[i], rows.line[i]
    road = Road(grounds.roads[track], grounds.road_facts[track : track + 1], grounds.bumps[track], grounds.gusts[track])
    count = cl.observe_circuit(
        state, parameters, False, int(rows.memory[i].fall), time, grounds.tracks[track], grounds.lines[line],
        grounds.stations[line], grounds.marks[track], rows.facts[i], road, rows.ground[i : i + 1], ride, view,
        rows.events[i],
    )  # fmt: skip
    if count >= 0:
        for k in range(lk.STATIONS):
            rows.preview[i, 0, k] = view[cl.POINTS + 3 * k]
            rows.preview[i, 1, k] = view[cl.POINTS + 3 * k + 1]
    return count


@njit(cache=True)
def _look_at_path(
    i: int, parameters: FloatArray, line: FloatArray, ride: Any, state: FloatArray, view: FloatArray, rows: BatchState
) -> int:
    """See a row on a path, as `scene.PathScene` does; sectors and laps of paths are counted outside."""
    look, facts = view[: cl.PLACE], rows.facts[i]
    x, y, heading, closed = line[0], line[1], line[2], facts.closed > 0.0
    look[lk.PROGRESS], look[lk.FRONT_PROGRESS] = ride.near[0], ride.near[1]
    moved = math.sqrt((state[st.X] - ride.rear[0]) ** 2 + (state[st.Y] - ride.rear[1]) ** 2)
    reach = window(AHEAD, moved, facts.line_length)
    if reach > AHEAD:
        s, _, _ = project(
            x, y, heading, facts.line_spacing, closed, state[st.X], state[st.Y], look[lk.PROGRESS], reach, reach
        )
        look[lk.FRONT_PROGRESS] += s - look[lk.PROGRESS]
        look[lk.PROGRESS] = s
    seen = np.empty((2, lk.STATIONS))
    lk.look_at_path(
        state, parameters, False, (x, y, heading, line[3]), facts.line_spacing, closed, True, _INTERVAL, False, look,
        seen[0], seen[1],
    )  # fmt: skip
    if not math.isfinite(look.sum()):
        return -1
    view[cl.PLACE :] = math.nan
    rows.preview[i] = seen
    ride.near[0], ride.near[1] = look[lk.PROGRESS], look[lk.FRONT_PROGRESS]
    ride.rear[0], ride.rear[1] = state[st.X], state[st.Y]
    ride.end = int(rows.memory[i].fall)
    return 0


@njit(cache=True)
def _lose(i: int, time: float, rows: BatchState) -> None:
    """End a row whose physics diverged, at its last finite instant."""
    fell = rows.end[i] != 0
    rows.end[i] = cl.LOST
    if fell:
        return
    row = rows.events[i, 0]
    row[:] = 0.0
    progress = rows.views[i, lk.PROGRESS] if rows.facts[i].path > 0.0 else rows.views[i, cl.PLACE]
    row[acc.KIND], row[acc.TIME], row[acc.PROGRESS] = cl.FALL_ROW, time, progress
    row[acc.VALUE], row[cl.CAUSE] = rows.state[i, st.ROLL], cl.LOST
    rows.told[i] = 1
