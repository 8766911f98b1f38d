"""Rides from starts all around a circuit, side by side: whole laps, times, falls, distances."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from bike_policy.contract.bundle import Bundle
from bike_policy.planning.grip import AdaptiveLaw
from bike_policy.planning.lap_plan import RiderSettings
from bike_policy.planning.plan_verification import BatchRider
from bike_policy.riders.instruments import Instruments
from bike_policy.riders.racing import PolicyBatch
from bike_sim.course.lap_timing import Lap
from bike_sim.physics.engines import check_superbike_engine
from bike_sim.planning.line_cache import closest_lap
from bike_sim.sim import look as lk
from bike_sim.sim.batch import SUPERBIKE_ENGINE, Batch
from bike_sim.sim.config import superbike_config
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.snapshot import WALL
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike
from bike_training.curricula.race import CircuitSet

SPEED_SHARES: Final = (0.5, 0.9)
"""Starts are at shares of the theoretical speed from this interval."""
OFF_TRACK, SLOW = "off track", "slow"
"""Causes of lost rides beside falls and walls."""
TELL_EVERY: Final = 50
"""Control steps between calls with the progress."""
Report = Callable[[int, int], None]
"""Takes what is done and all that is to be done."""
TIME: Final = 1.4
"""Longest time of a lap, as a part of the theoretical one."""


def ride_races(
    rider: Bundle | RiderSettings,
    vehicle: str,
    circuit: str,
    starts: int = 100,
    laps: int = 1,
    share: float | None = None,
    report: Report = lambda done, total: None,
    disturbances: Disturbances | None = None,
    engine: str = SUPERBIKE_ENGINE,
    time_step: float | None = None,
) -> dict[str, Any]:
    """Ride from starts all around a circuit.

    Args:
        rider: a policy that races, or the settings of a classical rider.
        vehicle: name or file of the machine.
        circuit: name or file of the circuit.
        starts: number of rides; they begin evenly around the circuit, at different speeds.
        laps: flying laps that each of them is to finish.
        share: part of the planned speed that is asked; None for the policy's own.
        report: called at times with the simulated time so far and the expected one, s.
        disturbances: of the machine, which the rider knows without them, and of what lies between both.
        engine: that simulates the rides; what riders plan and verify is of the compiled one at its own step.
        time_step: integration step, s; None for that of the superbike's engines.

    Returns:
        Figures. ``whole`` are the rides that finished their laps with never both contact points outside the limits,
        ``times_s`` the laps of these, sorted, ``later_s`` the median of those after their first flying laps (None of a
        single lap), and ``finished`` counts the flying laps of all rides. ``off_track_s`` is the time with both contact
        points outside over all flying laps, ``outside_s`` that over all of the rides; ``line_distance_m`` is the mean
        distance to the followed line, ``steering_change`` and ``throttle_change`` the mean changes from one control
        period to the next. ``lost`` are the rides that were not whole: number of the start, cause (name of the fall,
        ``wall``, ``off track`` or ``slow``), and arc length at which it fell or first left the track, m, None of a slow
        ride.

    Raises:
        ValueError: a policy that does not race, a vehicle that is no superbike, a course that is a path, or
            disturbances that a superbike cannot have.
        FileNotFoundError: an unknown vehicle or circuit.
    """
    config = replace(superbike_config(vehicle, time_step), engine=engine)
    machine = load_superbike(vehicle)
    check_superbike_engine(engine, machine)
    circuits = CircuitSet(machine, [circuit])
    known = disturbances or Disturbances()
    instruments = Instruments([known] * starts, [machine] * starts, config.control_period)
    batch = Batch(starts, config, disturbances=known)
    if share is not None and isinstance(rider, Bundle):
        rider = replace(rider, layout=replace(rider.layout, share=share))
    riders = rider_of(rider, batch.vehicle, config.control_period, starts)
    for row in range(starts):
        request = _start(circuits, circuit, row, starts)
        batch.reset(row, request)
        riders.begin(row, instruments.begin(row, batch), batch.course(row))
    limits = batch.plant(0).envelope
    assert limits is not None, "superbikes have limits"
    theory = closest_lap(circuit, limits)
    whole = np.ones(starts, dtype=bool)
    distance, activity, moments, outside = 0.0, np.zeros(2), 0, 0
    before, places = np.zeros((starts, 2)), np.full(starts, np.nan)
    for step in range(round(TIME * theory * (laps + 1) / config.control_period)):
        if step % TELL_EVERY == 0:
            report(round(step * config.control_period), round(theory * (laps + 1)))
        commands = instruments.acting(riders.commands(instruments.shown(batch), step))
        riding = ~batch.fallen & (_finished(batch) < laps)
        if not riding.any():
            break
        batch.halt(~riding)
        batch.step(np.where(riding[:, None], commands, 0.0))
        failed = riding & (batch.fallen | batch.off_course)
        here = failed & (whole | batch.fallen)
        places[here] = batch.look[here, lk.PROGRESS]
        whole &= ~failed
        distance += float(np.abs(batch.look[riding, lk.LATERAL_ERROR]).sum())
        activity += np.abs(commands - before)[riding].sum(axis=0)
        moments += int(riding.sum())
        outside += int((riding & batch.off_course).sum())
        before = commands
    finished: list[list[Lap]] = [batch.log(row).laps[:laps] for row in range(starts)]
    whole &= np.array([len(done) == laps for done in finished])
    fallen = batch.fallen & (_finished(batch) < laps)
    ends = [batch.fall(int(row)) for row in np.flatnonzero(fallen)]
    length = circuits.length(circuit)
    lost = [
        _lost(row, batch.fall(row) if fallen[row] else "", float(places[row]), length)
        for row in np.flatnonzero(~whole).tolist()
    ]
    times = sorted(lap.duration for row, done in enumerate(finished) if whole[row] for lap in done)
    median = float(np.median(times)) if times else None
    later = [lap.duration for row, done in enumerate(finished) if whole[row] for lap in done[1:]]
    steering, throttle = (float(change) / max(1, moments) for change in activity)
    figures = {
        "vehicle": batch.vehicle.name,
        "circuit": circuit,
        "rides": starts,
        "laps": laps,
        "whole": int(whole.sum()),
        "falls": sum(end != WALL for end in ends),
        "walls": sum(end == WALL for end in ends),
        "best_s": times[0] if times else None,
        "median_s": median,
        "slowest_s": times[-1] if times else None,
        "later_s": float(np.median(later)) if later else None,
        "theory_s": theory,
        "median_excess": None if median is None else median / theory - 1.0,
        "off_track_s": float(sum(lap.off_track for done in finished for lap in done)),
        "outside_s": outside * config.control_period,
        "line_distance_m": distance / max(1, moments),
        "steering_change": steering,
        "throttle_change": throttle,
        "disturbances": known.name,
        "times_s": times,
        "finished": sum(map(len, finished)),
        "lost": lost,
    }
    batch.close()
    return figures


def rider_of(rider: Bundle | RiderSettings, machine: Vehicle, period: float, count: int) -> BatchRider:
    """Return a rider of machines side by side.

    Args:
        rider: a policy that races, or the settings of a classical rider.
        machine: a superbike.
        period: control period, s.
        count: number of machines.
    """
    if isinstance(rider, Bundle):
        return PolicyBatch(rider, machine, period, count)
    assert isinstance(machine, Superbike), "laps are ridden on superbikes"
    return AdaptiveLaw(machine, period, rider, count)


def _lost(start: int, fall: str, arc_length: float, length: float) -> dict[str, Any]:
    """Return a lost ride from its fall, if it fell, and from where it failed, m; NaN where it was only slow."""
    slow = math.isnan(arc_length)
    place = None if slow else round(arc_length % length, 1)
    return {"start": start, "cause": fall or (SLOW if slow else OFF_TRACK), "arc_length_m": place}


def _finished(batch: Batch) -> np.ndarray:
    return np.array([len(batch.log(row).laps) for row in range(batch.count)])


def _start(circuits: CircuitSet, circuit: str, row: int, starts: int) -> ResetRequest:
    """Return a start; none lies on the start line, so that all laps are flying ones."""
    progress = (row + 0.5) / starts * circuits.length(circuit)
    low, high = SPEED_SHARES
    part = low + (high - low) * ((row * 0.6180339887) % 1.0)  # the golden ratio spreads them evenly
    speed = max(circuits.start(circuit, 1.0, progress, part), 5.0)
    return ResetRequest(seed=row, course=circuit, speed_range=(speed, speed), perturb=True, progress=progress)
