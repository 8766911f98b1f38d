"""Rides of unknown worlds, one of each: riders that nobody told of the world, and one that knows all of it.

The one that knows, the oracle, is the classical rider with plans for what is ridden, each corrected by rides of that
world until one is whole. A world that it cannot ride does not count.
"""

from __future__ import annotations

import csv
import hashlib
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_analysis.sweeps.statistics import bootstrap
from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import VehicleRows
from bike_policy.planning.grip import HeldLeans
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, LinePlan, RiderSettings, plan_line
from bike_policy.planning.line_law import LineLaw, seen_of
from bike_policy.planning.plan_verification import ROUNDS, BatchRider, lower_before, sources_digest
from bike_policy.riders.instruments import Instruments
from bike_sim.course.course import Course
from bike_sim.planning.line_cache import cache_folder, read_column, write_column
from bike_sim.sim import look as lk
from bike_sim.sim.batch import SUPERBIKE_ENGINE, Batch
from bike_sim.sim.config import superbike_config
from bike_sim.sim.followed_line import FollowedLine
from bike_sim.sim.plant import ridden_superbike
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.worlds import PREFIX, WorldRide
from bike_sim.vehicles.superbike import Superbike
from bike_training.rollout.races import OFF_TRACK, SLOW, TELL_EVERY, rider_of

FloatArray = NDArray[np.float64]

ORACLE: Final = Path(__file__).with_name("worlds_oracle.csv")
"""Judged laps of the oracle, which those of riders are compared with."""
WORLDS: Final = "worlds"
"""Kind of the random worlds, beside disturbances by name."""
LAPS: Final = 2
"""Flying laps of a ride; the first of them may be spent on finding out."""
TIME: Final = 1.6
"""Longest time of a ride, by the theoretical one of its laps on the known road."""
GRIP_AHEAD: Final = 0.2
"""Time ahead of which the oracle leans no more than the grip there holds, s: leaning takes as long."""
NO_GRIP: Final = (np.array([0.0, 1.0]), np.ones(2))
"""Grip of a line that is not ridden yet."""
WILSON: Final = 1.959964
"""Standard deviations of a 95 % interval."""
RiderOf = Callable[[Batch, Sequence[WorldRide]], BatchRider]
"""Makes a rider for all rows of a batch and their rides."""
Report = Callable[[int], None]
"""Takes the number of worlds that are ridden."""


class Ridden(NamedTuple):
    """How the ride of a world went.

    Attributes:
        cause: why it was not whole: name of the fall, ``wall``, ``off track`` or ``slow``; empty where it was.
        place_m: where it ended along the followed line, m; NaN where it was whole.
        speed_m_s: there, m/s.
        laps_s: times of its flying laps, s.
    """

    cause: str
    place_m: float
    speed_m_s: float
    laps_s: tuple[float, ...]

    @property
    def lap_s(self) -> float:
        """Mean of the laps from the second flying one on, s; NaN where it was not whole."""
        return math.nan if self.cause else float(np.mean(self.laps_s[1:]))


def untold(rider: Bundle | RiderSettings) -> RiderOf:
    """Return what makes riders of a policy that races, or of the settings of a classical rider."""
    return lambda batch, rides: rider_of(rider, batch.vehicle, batch.config.control_period, batch.count)


def ride_worlds(
    rides: Sequence[WorldRide], rider_of: RiderOf, laps: int = LAPS, report: Report = lambda done: None
) -> list[Ridden]:
    """Ride worlds, those of a machine side by side; a ride is the same in any company.

    A ride that falls, or leaves the track with both contact points, ends there.

    Args:
        rides: of worlds.
        rider_of: makes a rider of machines side by side.
        laps: flying laps of each, at least 2.
        report: called at times.

    Raises:
        ValueError: fewer laps, or disturbances that only a bicycle can have.
    """
    if laps < 2:
        raise ValueError(f"laps are judged from the second one on, so worlds need at least 2, got {laps}")
    found: dict[int, Ridden] = {}
    for rows in _by_machine(rides):
        ridden = _ride([rides[row] for row in rows], rider_of, laps, _behind(report, len(found)))
        found.update(zip(rows, ridden, strict=True))
    report(len(found))
    return [found[row] for row in range(len(rides))]


def ride_told(rides: Sequence[WorldRide], laps: int = LAPS, report: Report = lambda done: None) -> list[Ridden]:
    """Ride worlds as the oracle; see `ride_worlds`. What a correction found is kept beside the lines of circuits."""
    plans: dict[tuple[str, str, str], ToldPlan] = {}
    found: dict[int, Ridden] = {}
    waiting = list(range(len(rides)))
    for number in range(ROUNDS + 1):
        chosen = [rides[row] for row in waiting]
        ridden = ride_worlds(chosen, told(plans), laps, _behind(report, len(found)))
        for row, ride in zip(waiting, ridden, strict=True):
            found[row] = ride
            if ride.cause and number < ROUNDS:
                del found[row]
                plans[rides[row].world].slow_down(ride, number)
        waiting = [row for row in waiting if row not in found]
        report(len(found))
        if not waiting:
            break
    lost = {ride.world for row, ride in enumerate(rides) if found[row].cause}
    for world, plan in plans.items():
        if world not in lost:
            plan.keep()
    return [found[row] for row in range(len(rides))]


def told(plans: dict[tuple[str, str, str], ToldPlan]) -> Callable[[Batch, Sequence[WorldRide]], BatchRider]:
    """Return what makes riders that are told their worlds.

    Args:
        plans: by `WorldRide.world`; those that are missing are made when rides begin.
    """
    return lambda batch, rides: ToldRider(batch, rides, plans)


class ToldPlan:
    """A plan for one true world, slower where rides of it ended.

    Attributes:
        vehicle: as it is.
        delay: of its commands, s.
        grip: arc length of the line, m, and grip there.
        plan: to follow.
    """

    def __init__(self, batch: Batch, row: int, ride: WorldRide) -> None:
        """Plan a row's lap, with the corrections that are kept."""
        self.vehicle = ridden_superbike(_machine(batch, row), ride.disturbances)
        self.delay = ride.disturbances.observation_delay_s + ride.disturbances.command_delay_s
        track = _followed(batch, row).track
        surface = ride.disturbances.road.surface(track.surface)
        self._line: Course = replace(track, surface=surface).line(_followed(batch, row).lam)
        grip = np.ones(len(self._line.s)) if self._line.grip is None else self._line.grip
        self.grip = self._line.s, grip
        digest = hashlib.sha256(sources_digest() + repr((ride.disturbances, self.vehicle)).encode())
        digest.update(np.ascontiguousarray(self._line.table).tobytes())
        self._path = cache_folder() / f"{digest.hexdigest()[:32]}.npy"
        self._fastest = plan_line(self.vehicle, self._line, CLASSICAL_SETTINGS)
        count = len(self._fastest.profile.s) - 1
        kept = read_column(self._path, count)
        self._share = np.ones(count) if kept is None else kept
        self.plan = self._made()

    def _made(self) -> LinePlan:
        if self._share.min() == 1.0:
            return self._fastest
        cap = np.where(self._share < 1.0, self._share * self._fastest.profile.speed[:-1], np.inf)
        return plan_line(self.vehicle, self._line, CLASSICAL_SETTINGS, cap)

    def slow_down(self, ridden: Ridden, number: int) -> None:
        """Plan less speed before the end of a ride.

        Args:
            ridden: that was not whole.
            number: of the round.
        """
        lower_before(self._share, self.plan, np.array([ridden.place_m, ridden.speed_m_s]), number)
        self.plan = self._made()

    def keep(self) -> None:
        """Keep the corrections for the next time."""
        write_column(self._path, self._share)


class ToldRider:
    """The classical law on plans for the true worlds, with their delays; implements `BatchRider`."""

    def __init__(self, batch: Batch, rides: Sequence[WorldRide], plans: dict[tuple[str, str, str], ToldPlan]) -> None:
        """Take plans, see `told`."""
        self._batch, self._rides, self._plans = batch, rides, plans
        self._law = LineLaw(_machine(batch), batch.config.control_period, CLASSICAL_SETTINGS, batch.count)
        self._leans = HeldLeans(_machine(batch), CLASSICAL_SETTINGS, self._law.leans)
        self._delays, self._rows = np.zeros(batch.count), [NO_GRIP] * batch.count

    def begin(self, row: int, rows: VehicleRows, line: Course) -> None:
        """Begin a ride; see `BatchRider`."""
        ride = self._rides[row]
        if ride.world not in self._plans:
            self._plans[ride.world] = ToldPlan(self._batch, row, ride)
        plan = self._plans[ride.world]
        self._law.begin(row, plan.plan)
        self._delays[row], self._rows[row] = plan.delay, plan.grip

    def commands(self, rows: VehicleRows, step: int) -> FloatArray:
        """Return the law's commands; see `BatchRider`."""
        speed, progress = np.nan_to_num(rows.look[:, [lk.SPEED, lk.PROGRESS]]).T
        places = np.stack((progress, progress + GRIP_AHEAD * speed))
        grip = [_least_grip(table, places[:, row]) for row, table in enumerate(self._rows)]
        leans = self._leans.at(speed, np.array(grip))
        return self._law.commands(np.nan_to_num(seen_of(rows.state, rows.look)), leans=leans, delays=self._delays)


def _least_grip(table: tuple[FloatArray, FloatArray], places: FloatArray) -> float:
    """Return the least grip at places of a closed line, m, from its arc length and grip."""
    s, grip = table
    return float(np.interp(places % s[-1], s, grip).min())


def record_of(ride: WorldRide, ridden: Ridden) -> dict[str, Any]:
    """Return a ride as a row of a table: what was ridden, why and where it ended, and its judged lap."""
    known = {"world": ride.disturbances.name, "start": ride.number, "vehicle": ride.vehicle, "circuit": ride.circuit}
    place, lap = (None if math.isnan(value) else round(value, 3) for value in (ridden.place_m, ridden.lap_s))
    return {**known, "cause": ridden.cause, "place_m": place, "laps": len(ridden.laps_s), "lap_s": lap}


def read_records(path: Path) -> list[dict[str, Any]]:
    """Return the rows of `record_of` from a table; lines that begin with ``#`` are its head.

    Raises:
        OSError: there is no such file.
    """
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    numbers = {"start": int, "laps": int, "place_m": float, "lap_s": float}
    return [
        row | {name: kind(row[name]) if row[name] else None for name, kind in numbers.items()}
        for row in csv.DictReader(lines)
    ]


def summary(records: Sequence[Mapping[str, Any]], oracle: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return a rider's figures beside the oracle's, for each kind of world: the random ones, and named disturbances.

    Args:
        records: rows of `record_of`.
        oracle: the same of the oracle; worlds that it lost do not count.

    Returns:
        ``rides``, those of them that are ``counted``, how many of these were ``whole``, its ``share`` with Wilson's
        95 % interval, how many were lost before their first flying lap ended (``lost_first``), the median ``excess`` of
        the judged lap over the oracle's with a bootstrap interval, of the rides that are ``compared`` since both
        finished, and ``causes`` with their numbers.
    """
    known = {(row["world"], row["start"]): row for row in oracle}
    kinds: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for row in records:
        kinds[WORLDS if row["world"].startswith(PREFIX) else row["world"]].append(row)
    return {kind: _figures(rows, known) for kind, rows in kinds.items()}


def _figures(rows: Sequence[Mapping[str, Any]], oracle: Mapping[tuple[str, int], Mapping[str, Any]]) -> dict[str, Any]:
    unknown: dict[str, Any] = {"cause": "", "lap_s": None}
    pairs = [(row, oracle.get((row["world"], row["start"]), unknown)) for row in rows]
    pairs = [(row, beside) for row, beside in pairs if not beside["cause"]]
    whole = [(row, beside) for row, beside in pairs if not row["cause"]]
    excess = [row["lap_s"] / beside["lap_s"] - 1.0 for row, beside in whole if beside["lap_s"]]
    middle = bootstrap(excess, lambda drawn: np.median(drawn, axis=-1)) if excess else (None, None, None)
    low, high = wilson(len(whole), len(pairs)) if pairs else (None, None)
    lost = [row for row, _ in pairs if row["cause"]]
    return {
        "rides": len(rows),
        "counted": len(pairs),
        "whole": len(whole),
        "share": len(whole) / len(pairs) if pairs else None,
        "share_low": low,
        "share_high": high,
        "lost_first": sum(row["laps"] == 0 for row in lost),
        "compared": len(excess),
        "excess": middle[0],
        "excess_low": middle[1],
        "excess_high": middle[2],
        "causes": dict(Counter(row["cause"] for row in lost).most_common()),
    }


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share (Wilson 1927, J. Am. Stat. Assoc. 22)."""
    share, z = successes / count, WILSON
    middle = (share + z * z / (2.0 * count)) / (1.0 + z * z / count)
    half = z / (1.0 + z * z / count) * math.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count * count))
    return max(0.0, middle - half), min(1.0, middle + half)


def _behind(report: Report, before: int) -> Report:
    """Return a report of what is ridden behind others."""
    return lambda done: report(before + done)


def _by_machine(rides: Sequence[WorldRide]) -> list[list[int]]:
    """Return the places of rides of the same machine, machine by machine."""
    places: dict[str, list[int]] = defaultdict(list)
    for place, ride in enumerate(rides):
        places[ride.vehicle].append(place)
    return list(places.values())


def _machine(batch: Batch, row: int = 0) -> Superbike:
    machine = batch.vehicles[row]
    assert isinstance(machine, Superbike), "worlds are of superbikes"
    return machine


def _ride(rides: Sequence[WorldRide], rider_of: RiderOf, laps: int, report: Report) -> list[Ridden]:
    """Ride worlds of one machine."""
    config = replace(superbike_config(rides[0].vehicle), engine=SUPERBIKE_ENGINE)
    count = len(rides)
    worlds = [ride.disturbances for ride in rides]
    batch = Batch(count, config, disturbances=worlds)
    instruments = Instruments(worlds, batch.vehicles, config.control_period)
    rider = rider_of(batch, rides)
    longest = np.empty(count)
    for row, ride in enumerate(rides):
        batch.reset(row, _start(batch, row, ride))
        rider.begin(row, instruments.begin(row, batch), batch.course(row))
        longest[row] = TIME * (laps + 1) * _theory(batch, row)
    riding = np.ones(count, dtype=bool)
    ended: dict[int, Ridden] = {}
    step = 0
    while riding.any():
        if step % TELL_EVERY == 0:
            report(len(ended))
        acting = instruments.acting(rider.commands(instruments.shown(batch), step))
        batch.halt(~riding)
        batch.step(np.where(riding[:, None], acting, 0.0))
        step += 1
        lost = batch.fallen | batch.off_course | (step * config.control_period > longest)
        for row in np.flatnonzero(riding).tolist():
            flying = tuple(lap.duration for lap in batch.log(row).laps[:laps])
            if len(flying) == laps:
                ended[row] = Ridden("", math.nan, math.nan, flying)
            elif lost[row]:
                cause = batch.fall(row) if batch.fallen[row] else OFF_TRACK if batch.off_course[row] else SLOW
                place, speed = (float(batch.look[row, column]) for column in (lk.PROGRESS, lk.SPEED))
                ended[row] = Ridden(cause, place % batch.course(row).length, speed, flying)
            riding[row] = row not in ended
    batch.close()
    return [ended[row] for row in range(count)]


def _followed(batch: Batch, row: int) -> FollowedLine:
    begun = batch.begun(row)
    assert begun is not None
    assert begun.followed is not None, "worlds are of circuits"
    return begun.followed


def _theory(batch: Batch, row: int) -> float:
    """Return the theoretical lap of a row on its line on the known road, s."""
    limits = batch.plant(row).envelope
    assert limits is not None, "superbikes have limits"
    return _followed(batch, row).limit(limits).lap_time


def _start(batch: Batch, row: int, ride: WorldRide) -> ResetRequest:
    """Return the start of a ride."""
    length = batch.courses(row).line(batch.plant(row), ride.circuit, 1.0).track.length
    return ResetRequest(
        seed=ride.number, course=ride.circuit, perturb=True, progress=ride.place * length, speed_share=ride.share
    )
