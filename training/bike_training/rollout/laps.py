"""Laps of a rider: one machine on one circuit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.classical import ClassicalRider
from bike_policy.riders.rider import Rider
from bike_sim.course.lap_timing import Lap
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.physics.engines import SUPERBIKE_ENGINES
from bike_sim.planning.envelope import Envelope
from bike_sim.planning.lap_limit import LapLimit
from bike_sim.planning.line_cache import closest_lap
from bike_sim.planning.passing import Passing, passings, speeds_of_own_path
from bike_sim.sim import look as lk
from bike_sim.sim.config import superbike_config
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


@dataclass(frozen=True)
class LapRide:
    """Laps of one machine on one circuit. The first lap, from a rolling start, is not a flying lap.

    Attributes:
        vehicle: name of the vehicle.
        circuit: name of the circuit.
        limit: the theoretical lap on the followed line.
        closest: theoretical lap on the closest line, s.
        rider: the rider.
        plan: the classical rider's own speed profile; None of others.
        out_lap: the first lap, or None if it was not finished.
        laps: the flying laps that were finished.
        end: ``"finished"``, a fall's name, ``"wall"`` or ``"slow"``.
        largest_error: largest distance to the followed line on flying laps, m.
        largest_lean: rad.
        highest_speed: m/s; both on flying laps.
        off_track: time with both contact points outside the limits on flying laps, s.
        passings: sections in which flying laps were faster than the theoretical laps of their own paths.
    """

    vehicle: str
    circuit: str
    limit: LapLimit
    closest: float
    rider: str
    plan: LapLimit | None
    out_lap: Lap | None
    laps: tuple[Lap, ...]
    end: str
    largest_error: float
    largest_lean: float
    highest_speed: float
    off_track: float
    passings: tuple[Passing, ...]

    @property
    def best(self) -> Lap | None:
        """The fastest flying lap."""
        return min(self.laps, key=lambda lap: lap.duration, default=None)

    @property
    def excess(self) -> float | None:
        """Excess of the slowest flying lap over the theoretical one on the followed line, as a part of it."""
        return self._over(self.limit.lap_time)

    @property
    def closest_excess(self) -> float | None:
        """The same for the closest line."""
        return self._over(self.closest)

    def _over(self, theoretical: float) -> float | None:
        return max(lap.duration for lap in self.laps) / theoretical - 1.0 if self.laps else None


def ride_laps(
    vehicle: str,
    circuit: str | Path,
    laps: int = 3,
    *,
    rider: Rider | None = None,
    engine: str = SUPERBIKE_ENGINES[0],
    report: Callable[[Snapshot, float], None] | None = None,
) -> LapRide:
    """Ride an out-lap and flying laps.

    Args:
        vehicle: name or file of a superbike.
        circuit: name or file of a circuit.
        laps: number of flying laps.
        rider: the rider; None for the classical rider.
        engine: that integrates the machine.
        report: called every control step with the snapshot and the length of a lap, m.

    Raises:
        ValueError: a broken file, or fewer than one lap. FileNotFoundError: an unknown vehicle or circuit.
    """
    if laps < 1:
        raise ValueError(f"number of laps must be at least 1, got {laps}")
    machine = Simulator(replace(superbike_config(vehicle), engine=engine))
    try:
        limits = machine.plant.envelope
        if limits is None:
            raise ValueError(f"vehicle {vehicle!r} is no superbike; laps are planned with tyres")
        rider = rider or ClassicalRider()
        request = machine.at_own_speed(ResetRequest(course=str(circuit)))
        finished, end, error, lean, fastest = 0, "", 0.0, 0.0, 0.0
        trace: list[list[tuple[float, float, float]]] = []
        for snapshot in rollout(machine, rider, request):
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
    flying = ridden[1 : laps + 1]
    return LapRide(
        load_vehicle(vehicle).name,
        track.name,
        limit,
        closest_lap(circuit, limits),
        rider.name,
        plan,
        ridden[0] if ridden else None,
        flying,
        end,
        error,
        lean,
        fastest,
        sum(lap.off_track for lap in flying),
        _passings(track, limits, [np.array(lap).T for lap in trace[:-1]]),
    )


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


def pair_figures(ride: LapRide, laps: int) -> dict[str, Any]:
    """Return the figures of one machine on one circuit.

    They are ok when all flying laps are finished with a small excess over the theoretical lap of the closest line.
    """
    best, excess = ride.best, ride.closest_excess
    fell = ride.end not in ("finished", "slow", WALL)
    return {
        "vehicle": ride.vehicle,
        "course": ride.circuit,
        "ok": ride.end == "finished" and excess is not None and excess <= ALLOWED_EXCESS,
        "end": ride.end,
        "lap_s": None if best is None else best.duration,
        "laps_s": [lap.duration for lap in ride.laps],
        "sectors_s": [] if best is None else list(best.sectors),
        "limit_s": ride.limit.lap_time,
        "excess": ride.excess,
        "closest_limit_s": ride.closest,
        "closest_excess": excess,
        "rider": ride.rider,
        "plan_s": None if ride.plan is None else ride.plan.lap_time,
        "out_lap_s": None if ride.out_lap is None else ride.out_lap.duration,
        "laps": len(ride.laps),
        "wanted_laps": laps,
        "falls": int(fell),
        "walls": int(ride.end == WALL),
        "valid_laps": sum(lap.valid for lap in ride.laps),
        "off_track_s": ride.off_track,
        "line_error_max_m": ride.largest_error,
        "lean_max_deg": math.degrees(ride.largest_lean),
        "speed_max_m_s": ride.highest_speed,
    }
