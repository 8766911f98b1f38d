"""Events of a ride on a circuit, from the rows that the compiled look writes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.lap_timing import LapLog
from bike_sim.sim import circuit_look as cl
from bike_sim.sim.events import Event, EventKind, WallHit, fall_event, scrape_event, wall_event


def circuit_events(rows: NDArray[np.float64], log: LapLog) -> tuple[Event, ...]:
    """Return the rows of a look as events, and keep the laps that they finish.

    Args:
        rows: as `circuit_look.observe_circuit` wrote them.
        log: finished laps of the ride.
    """
    return tuple(_event(row, log) for row in rows.tolist())


def _event(row: list[float], log: LapLog) -> Event:
    kind, time, progress, value = EventKind(int(row[acc.KIND])), *row[acc.TIME : acc.NUMBER]
    if kind in (EventKind.WALL, EventKind.SCRAPE):
        tell = wall_event if kind is EventKind.WALL else scrape_event
        return tell(time, progress, WallHit(row[cl.SPEED], row[cl.ANGLE], row[cl.ENERGY]))
    if kind is EventKind.FALL:
        cause = int(row[cl.CAUSE])
        return fall_event(time, progress, value, cl.ENDS[cause] if cause != cl.LOST else "", row[cl.SPEED])
    return Event(kind, time, progress, value, log.take(row).text)
