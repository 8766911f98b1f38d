"""Laps of a rider: one machine on one circuit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.base import Rider
from bike_policy.riders.classical import ClassicalRider
from bike_policy.riders.disturbed import DisturbedRider
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.physics.engines import SUPERBIKE_ENGINES
from bike_sim.planning.envelope import Envelope
from bike_sim.planning.line_cache import closest_lap
from bike_sim.planning.passing import Passing, passings, speeds_of_own_path
from bike_sim.sim import look as lk
from bike_sim.sim.config import superbike_config
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.events import EventKind
from bike_sim.sim.followed_line import FollowedLine
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import WALL, Snapshot
from bike_sim.vehicles.files import load_vehicle
from bike_training.rollout.rollout import rollout

FloatArray = NDArray[np.float64]

ALLOWED_EXCESS: Final = 0.06
"""Largest excess of a flying lap over the theoretical lap of the closest line, as a part of it."""

MAX_LAP_RATIO = 3.0
"""Times the theoretical lap, after which a lap counts as never finished."""


def ride_laps(
    vehicle: str,
    circuit: str | Path,
    laps: int = 3,
    *,
    rider: Rider | None = None,
    engine: str = SUPERBIKE_ENGINES[0],
    disturbances: Disturbances | None = None,
    report: Callable[[Snapshot, float], None] | None = None,
) -> tuple[dict[str, Any], tuple[Passing, ...]]:
    """Ride an out-lap and flying laps. The first lap, from a rolling start, is not a flying lap.

    Args:
        vehicle: name or file of a superbike.
        circuit: name or file of a circuit.
        laps: number of flying laps.
        rider: the rider; None for the classical rider.
        engine: that integrates the machine.
        disturbances: of the machine, which the rider knows without them, and of what lies between both.
        report: called every control step with the snapshot and the length of a lap, m.

    Returns:
        Figures, of flying laps that were finished, and the sections in which these were faster than the theoretical
        laps of their own paths. Figures are ok when all flying laps are finished with a small excess of the slowest
        over the theoretical lap of the closest line, under disturbances with any.

    Raises:
        ValueError: a broken file, fewer than one lap, or disturbances that a superbike cannot have.
        FileNotFoundError: an unknown vehicle or circuit.
    """
    if laps < 1:
        raise ValueError(f"number of laps must be at least 1, got {laps}")
    machine = Simulator(replace(superbike_config(vehicle), engine=engine), disturbances)
    try:
        limits = machine.plant.envelope
        if limits is None:
            raise ValueError(f"vehicle {vehicle!r} is no superbike; laps are planned with tyres")
        rider = rider or ClassicalRider()
        acting = rider if disturbances is None else DisturbedRider(rider, disturbances)
        request = machine.at_own_speed(ResetRequest(course=str(circuit)))
        finished, end, error, lean, fastest = 0, "", 0.0, 0.0, 0.0
        trace: list[list[tuple[float, float, float]]] = []
        for snapshot in rollout(machine, acting, request):
            followed = _followed_line(machine)
            limit = followed.limit(limits)
            if report is not None and snapshot.step:
                report(snapshot, followed.track.length)
            begun = sum(event.kind is EventKind.LAP for event in snapshot.events)
            finished += begun
            if begun:
                trace.append([])
            if finished > 0:
                error = max(error, snapshot.distance)
                lean = max(lean, abs(float(snapshot.state[st.ROLL])))
                fastest = max(fastest, snapshot.speed)
                assert snapshot.circuit is not None
                trace[-1].append((*snapshot.circuit.place[: lk.CENTRE_OFFSET + 1], snapshot.speed))
            if snapshot.fallen:
                end = snapshot.fall
            elif finished > laps:
                end = "finished"
            elif snapshot.time > MAX_LAP_RATIO * limit.lap_time * (laps + 1):
                end = "slow"
            if end:
                break
        ridden, track = tuple(machine.batch.log(0).laps), _followed_line(machine).track
        plan = rider.plan.profile if isinstance(rider, ClassicalRider) and rider.plan is not None else None
    finally:
        machine.close()
    flying, closest = ridden[1 : laps + 1], closest_lap(circuit, limits)
    best = min(flying, key=lambda lap: lap.duration, default=None)
    slowest = max((lap.duration for lap in flying), default=None)
    excess = None if slowest is None else slowest / closest - 1.0
    figures = {
        "vehicle": load_vehicle(vehicle).name,
        "course": track.name,
        "ok": end == "finished" and excess is not None and (disturbances is not None or excess <= ALLOWED_EXCESS),
        "end": end,
        "lap_s": None if best is None else best.duration,
        "laps_s": [lap.duration for lap in flying],
        "sectors_s": [] if best is None else list(best.sectors),
        "limit_s": limit.lap_time,
        "excess": None if slowest is None else slowest / limit.lap_time - 1.0,
        "closest_limit_s": closest,
        "closest_excess": excess,
        "rider": rider.name,
        "plan_s": None if plan is None else plan.lap_time,
        "out_lap_s": ridden[0].duration if ridden else None,
        "laps": len(flying),
        "wanted_laps": laps,
        "falls": int(end not in ("finished", "slow", WALL)),
        "walls": int(end == WALL),
        "valid_laps": sum(lap.valid for lap in flying),
        "off_track_s": sum(lap.off_track for lap in flying),
        "line_error_max_m": error,
        "lean_max_deg": math.degrees(lean),
        "speed_max_m_s": fastest,
    }
    return figures, _passings(track, limits, [np.array(lap).T for lap in trace[:-1]])


def _passings(track: Track, limits: Envelope, traces: Sequence[FloatArray]) -> tuple[Passing, ...]:
    """Return the passings of flying laps, given as rows of progress and offset along the centre line and of speed."""
    if not traces:
        return ()
    theoretical = [speeds_of_own_path(track, limits, along, aside) for along, aside, _ in traces]
    progress, _, speed = np.concatenate(traces, axis=1)
    return passings(np.concatenate(theoretical), progress, speed)


def _followed_line(machine: Simulator) -> FollowedLine:
    """Return the followed line of the circuit that is ridden.

    Raises:
        ValueError: the course is a path.
    """
    followed = None if machine.begun is None else machine.begun.followed
    if followed is None:
        raise ValueError(f"course {machine.request.course!r} is a path; laps need limits and a start line")
    return followed
