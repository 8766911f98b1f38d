"""A race: machines on one circuit from a grid to the flag, who passed, touched and fell, and how it ended.

The race knows no riders; whoever runs it hands in commands, so it is the same in process, in an environment of a
learner and in a replay. It begins rolling: all machines stand on the grid with one speed. The flag falls when the first
has finished its laps; the others finish as they next cross the line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.track import Track
from bike_sim.planning.envelope import Envelope
from bike_sim.sim import look as lk
from bike_sim.sim import traffic as tr
from bike_sim.sim.batch import COMPILED_ENGINE, SUPERBIKE_ENGINE, Batch
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import Event, EventKind
from bike_sim.sim.request import IDEAL, ResetRequest
from bike_sim.sim.stewards import Stewards
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

LEAST_MACHINES, MOST_MACHINES = 2, 12
GRID_SPACING: Final = 9.0
"""Distance of the places of a grid along the circuit, m: that of the rows of FIM grids, with one machine in each."""
GRID_OFFSET: Final = 0.45
"""Distance of a place from the centre line as a part of the way to the limit, on the left and on the right in turn."""
GRID_SPEED: Final = 25.0
GRID_SHARE: Final = 0.6
"""Speed of the rolling start, m/s, and the part of the theoretical lap's that it is at most on all places."""
LONGEST: Final = 1.8
"""Longest race, by the theoretical laps of the slowest machine, and one lap more."""
PASSED, TOUCHED, FELL, CLEARED, FINISHED, PENALISED = "pass", "contact", "fall", "cleared", "finish", "penalty"
_NAMES: Final = tr.INCIDENT.names
_NAMESPACE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")


@dataclass(frozen=True)
class Entry:
    """A machine in a race.

    Attributes:
        name: of machine and rider, as it is called in the race.
        vehicle: name or file.
        rider: who rides it; the race does not ask.
    """

    name: str
    vehicle: str
    rider: str = ""


def entries_of(machines: Sequence[str], rider: str = "") -> tuple[Entry, ...]:
    """Return machines given as ``[NAME=]VEHICLE[:RIDER]``; those without a name are numbered.

    Args:
        machines: in the order of the grid.
        rider: of those that name none.
    """
    entries = []
    for number, text in enumerate(machines, start=1):
        name, _, rest = text.rpartition("=")
        vehicle, _, own = rest.partition(":")
        entries.append(Entry(name or f"bike_{number}", vehicle, own or rider))
    return tuple(entries)


def check_names(names: Sequence[str]) -> None:
    """Refuse names that are no ROS namespaces.

    Raises:
        ValueError: naming the first of them.
    """
    for name in names:
        if not _NAMESPACE.fullmatch(name):
            raise ValueError(f"machine {name!r} needs a name of letters, digits and underscores, to be a namespace")


@dataclass(frozen=True)
class RaceSettings:
    """What decides a race but its riders.

    Attributes:
        course: name or file of a circuit.
        laps: number of laps.
        entries: machines in the order of the grid.
        line: of the circuit that riders follow, 0 the median, 1 the ideal line.
    """

    course: str
    laps: int
    entries: tuple[Entry, ...]
    line: float = IDEAL

    def __post_init__(self) -> None:
        """Refuse what is no race.

        Raises:
            ValueError: naming the value.
        """
        names = [entry.name for entry in self.entries]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two machines of a race are called {twice[0]!r}; each needs a name of its own")
        if not LEAST_MACHINES <= len(names) <= MOST_MACHINES:
            raise ValueError(f"a race has {LEAST_MACHINES} to {MOST_MACHINES} machines, got {len(names)}")
        if self.laps < 1:
            raise ValueError(f"a race has at least 1 lap, got {self.laps}")

    def to_card(self) -> dict[str, Any]:
        """Return plain values that :meth:`from_card` reads."""
        return asdict(self)

    @classmethod
    def from_card(cls, card: dict[str, Any]) -> RaceSettings:
        """Read what :meth:`to_card` wrote, also after a round trip through JSON.

        Raises:
            TypeError: an unknown or missing entry. ValueError: a value that is no race.
        """
        return cls(**{**card, "entries": tuple(Entry(**entry) for entry in card["entries"])})


class RaceEvent(NamedTuple):
    """Something that happened in a race.

    Attributes:
        time: s since the start.
        kind: PASSED, TOUCHED, FELL, CLEARED, FINISHED or PENALISED.
        names: of the machines, the acting one first.
        value: distance along the circuit of who acted (m), of a contact the energy that it took (J), of a penalty s.
        text: one sentence for people.
    """

    time: float
    kind: str
    names: tuple[str, ...]
    value: float
    text: str


class Result(NamedTuple):
    """A line of the classification.

    Attributes:
        position: from 1.
        name: of the machine.
        vehicle: its kind.
        rider: who rode it.
        grid: place on the grid, from 1.
        laps: finished.
        time_s: of the race with penalties; None of who did not finish.
        penalty_s: of these.
        best_lap_s: None without a flying lap.
        passes: machines that it passed, less those that passed it, on the road.
        contacts: incidents that it was part of.
        avoidable: penalties for contact.
        end: ``finished``, ``running`` when the race was stopped, or how it fell.
    """

    position: int
    name: str
    vehicle: str
    rider: str
    grid: int
    laps: int
    time_s: float | None
    penalty_s: float
    best_lap_s: float | None
    passes: int
    contacts: int
    avoidable: int
    end: str


class Crossing(NamedTuple):
    """A machine at a line across the circuit.

    Attributes:
        lap: from 1; the line ends a part of it.
        sector: from 1.
        row: of the machine.
        time: s since the start.
    """

    lap: int
    sector: int
    row: int
    time: float


class Race:
    """A race on a batch whose rows meet.

    Attributes:
        settings: of the race.
        track: the circuit.
        theory: theoretical lap of the slowest machine, s.
        limit: time after which the race is stopped, s.
        batch: of the machines, in the order of the entries.
        grid: place of each row on the grid, from 1.
        time: s since the start.
        log: what happened, in order.
        stewards: who judge it.
        crossings: of sector lines and the start line, in order.
        energy: kinetic energy that contacts took, J.
        over: whether all machines have finished or are out.
    """

    def __init__(self, settings: RaceSettings, report: Callable[[str], None] = lambda part: None) -> None:
        """Place the machines on the grid.

        Args:
            settings: of the race.
            report: gets a text for each machine before its line is computed or looked up.

        Raises:
            ValueError: a grid longer than the circuit, machines that cannot race each other, or a course that is none.
            FileNotFoundError: an unknown vehicle or circuit.
        """
        self.settings = settings
        machines = [load_vehicle(entry.vehicle) for entry in settings.entries]
        bicycles = [machine.name for machine in machines if not isinstance(machine, Superbike)]
        if bicycles and len(bicycles) < len(machines):
            raise ValueError(f"bicycles and superbikes do not race each other; {bicycles[0]!r} is a bicycle")
        self.batch = Batch(len(machines), race_config(settings), vehicles=machines, together=True)
        self._names = tuple(entry.name for entry in settings.entries)
        try:
            for row, machine in enumerate(machines):
                if machine.name not in [known.name for known in machines[:row]]:
                    report(f"line of {machine.name} on {settings.course}")
                self.batch.courses(row).line(self.batch.plant(row), settings.course, settings.line)
            self.begin()
        except BaseException:
            self.batch.close()
            raise

    def begin(self, order: Sequence[int] | None = None) -> None:
        """Place the machines on the grid, again.

        Args:
            order: row of the machine on each place from the first; None for the order of the entries.

        Raises:
            ValueError: a grid longer than the circuit, or an order that is none.
        """
        count = self.count
        order = list(range(count)) if order is None else [int(row) for row in order]
        if sorted(order) != list(range(count)):
            raise ValueError(f"the order of a grid of {count} machines names each row once, got {order}")
        self.log: list[RaceEvent] = []
        self.stewards, self.crossings, self.energy = Stewards(), list[Crossing](), 0.0
        self._finished: dict[int, float] = {}
        self._flag, self._step = False, 0
        self._passes, self._contacts = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self._out = np.zeros(count, dtype=np.bool_)
        self.grid = {row: place for place, row in enumerate(order, start=1)}
        self._line_up()

    def _line_up(self) -> None:
        batch, settings = self.batch, self.settings
        lines = [
            batch.courses(row).line(batch.plant(row), settings.course, settings.line) for row in range(batch.count)
        ]
        self.track = track = lines[0].track
        need = GRID_SPACING * (batch.count + 1)
        if need >= track.length:
            raise ValueError(
                f"a grid of {batch.count} machines is {need:.0f} m long, circuit {track.name!r} {track.length:.0f} m"
            )
        places = [track.length - GRID_SPACING * self.grid[row] for row in range(batch.count)]
        limits = [batch.plant(row).envelope for row in range(batch.count)]
        speed, self.theory = _start_speed(lines, limits, places, track)
        self.limit = LONGEST * self.theory * (settings.laps + 1)
        for row, place in enumerate(places):
            offset = grid_offset(track, place, self.grid[row], settings.line)
            start = ResetRequest(
                course=settings.course, line=settings.line, speed_range=(speed, speed), progress=place,
                start_offset=offset,
            )  # fmt: skip
            batch.reset(row, start)
        assert batch.traffic is not None
        batch.traffic.racing[:] = 1
        batch.meet()

    @property
    def count(self) -> int:
        """Number of machines."""
        return self.batch.count

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self._step * self.batch.config.control_period

    @property
    def step_number(self) -> int:
        """Control steps since the start."""
        return self._step

    @property
    def riding(self) -> NDArray[np.bool_]:
        """Which machines are in the race: neither finished nor out, shape (n,)."""
        done = self._out.copy()
        done[list(self._finished)] = True
        return ~done

    @property
    def over(self) -> bool:
        """Whether the race has ended."""
        return not self.riding.any() or self.time >= self.limit

    def step(self, commands: FloatArray) -> list[RaceEvent]:
        """Hold the commands of all machines for a control period, and return what happened.

        Args:
            commands: see `Batch.step`; those of machines that are out do not matter.
        """
        batch, before = self.batch, len(self.log)
        batch.step(commands)
        self._step += 1
        for incident in batch.incidents.tolist():
            self._incident(dict(zip(_NAMES, incident, strict=True)))
        for row in range(batch.count):
            for event in batch.events(row):
                self._ride_event(row, event)
        for row in np.flatnonzero(batch.fallen & ~self._out).tolist():
            self._out[row] = True
            if row not in self._finished:
                how, where = batch.fall(row).replace("_", " "), batch.place[row, lk.CENTRE_PROGRESS]
                self._write(FELL, (row,), float(where), f"{self._names[row]} is out: {how}")
        return self.log[before:]

    def _incident(self, incident: dict[str, float]) -> None:
        """Take in what happened between two machines."""
        kind, row, other = incident["kind"], int(incident["row"]), int(incident["other"])
        if kind == tr.PASS:
            self._passes[row] += 1
            self._passes[other] -= 1
            place = float(self.batch.place[row, lk.CENTRE_PROGRESS])
            self._write(PASSED, (row, other), place, f"{self._names[row]} passes {self._names[other]}")
        elif kind == tr.CLEARED:
            self._write(CLEARED, (row,), 0.0, f"{self._names[row]} is cleared from the track")
        else:
            self.energy += incident["energy"]
            known = len(self.stewards.penalties)
            if self.stewards.contact(self.time, incident) or incident["thrown"] or incident["other_thrown"]:
                self._contacts[[row, other]] += 1
                what = "hit" if incident["thrown"] or incident["other_thrown"] else "touch"
                text = f"{self._names[row]} and {self._names[other]} {what} at {incident['approach']:.1f} m/s"
                self._write(TOUCHED, (row, other), incident["energy"], text)
            self._announce(known)

    def _ride_event(self, row: int, event: Event) -> None:
        """Take in what happened to one machine."""
        laps = len(self.batch.log(row).laps)
        if event.kind is EventKind.OFF_COURSE and row not in self._finished:
            known = len(self.stewards.penalties)
            self.stewards.off_track(event.time, row)
            self._announce(known)
        elif event.kind is EventKind.SECTOR:
            lap = [crossing for crossing in self.crossings if crossing.row == row]
            sectors = len(self.batch.begun(row).followed.track.marks) + 1  # type: ignore[union-attr]
            self.crossings.append(Crossing(len(lap) // sectors + 1, len(lap) % sectors + 1, row, event.time))
        elif event.kind is EventKind.LAP and row not in self._finished and (self._flag or laps >= self.settings.laps):
            self._flag = True
            self._finished[row] = event.time
            assert self.batch.traffic is not None
            self.batch.traffic.racing[row] = 0  # it leaves the others alone from now on
            self._write(FINISHED, (row,), float(laps), f"{self._names[row]} finishes after {event.time:.3f} s")

    def _announce(self, known: int) -> None:
        """Log the penalties behind the known ones."""
        for penalty in self.stewards.penalties[known:]:
            text = f"{self._names[penalty.row]}: {penalty.reason}"
            if penalty.seconds:
                text += f", {penalty.seconds:g} s"
            self._write(PENALISED, (penalty.row,), penalty.seconds, text)

    def _write(self, kind: str, rows: Sequence[int], value: float, text: str) -> None:
        self.log.append(RaceEvent(self.time, kind, tuple(self._names[row] for row in rows), value, text))

    def positions(self) -> list[int]:
        """Return the rows in their order on the road: finished ones by time, then the others by distance."""
        distance = self.batch.place[:, lk.CENTRE_PROGRESS]
        laps = [len(self.batch.log(row).laps) for row in range(self.count)]

        def key(row: int) -> tuple[float, ...]:
            if row in self._finished:
                return (0.0, -laps[row], self._finished[row])
            return (1.0, float(self._out[row]), -float(distance[row]))

        return sorted(range(self.count), key=key)

    def classification(self) -> list[Result]:
        """Return the result: who finished by laps and time with penalties, then the others by distance."""
        distance = self.batch.place[:, lk.CENTRE_PROGRESS]
        logs = [self.batch.log(row) for row in range(self.count)]

        def key(row: int) -> tuple[float, ...]:
            if row in self._finished:
                return (0.0, -len(logs[row].laps), self._finished[row] + self.stewards.seconds(row))
            return (1.0, -float(distance[row]), 0.0)

        results = []
        for position, row in enumerate(sorted(range(self.count), key=key), start=1):
            entry, seconds = self.settings.entries[row], self.stewards.seconds(row)
            finished = self._finished.get(row)
            laps = min(len(logs[row].laps), self.settings.laps)
            avoidable = sum(
                penalty.row == row and penalty.reason.startswith("avoidable") for penalty in self.stewards.penalties
            )
            results.append(
                Result(
                    position, entry.name, self.batch.vehicles[row].name, entry.rider, self.grid[row], laps,
                    None if finished is None else finished + seconds, seconds,
                    min((lap.duration for lap in logs[row].laps), default=None), int(self._passes[row]),
                    int(self._contacts[row]), avoidable, "finished" if finished is not None else self._end(row),
                )
            )  # fmt: skip
        return results

    def _end(self, row: int) -> str:
        return self.batch.fall(row) if self._out[row] else "running"

    def gaps(self) -> list[tuple[int, int, str, float]]:
        """Return lap, sector, machine and how long after the first it crossed each line of the race, s."""
        first: dict[tuple[int, int], float] = {}
        for crossing in self.crossings:
            key = crossing.lap, crossing.sector
            first[key] = min(first.get(key, math.inf), crossing.time)
        return [
            (found.lap, found.sector, self._names[found.row], found.time - first[found.lap, found.sector])
            for found in self.crossings
        ]

    def close(self) -> None:
        """Release the engines."""
        self.batch.close()


def race_config(settings: RaceSettings) -> SimulatorConfig:
    """Return the simulator of a race: the compiled engine of its kind of machines.

    Raises:
        ValueError: a broken file. FileNotFoundError: an unknown vehicle.
    """
    vehicle = settings.entries[0].vehicle
    if isinstance(load_vehicle(vehicle), Superbike):
        return replace(superbike_config(vehicle), engine=SUPERBIKE_ENGINE)
    return SimulatorConfig(vehicle=vehicle, engine=COMPILED_ENGINE, time_step=0.01)


def grid_offset(track: Track, progress: float, number: int, line: float) -> float:
    """Return how far beside the followed line a place of the grid lies, m, positive to the left.

    Args:
        track: the circuit.
        progress: of the place along the centre line, m.
        number: of the place, from 1.
        line: that is followed, 0 the median, 1 the ideal line.
    """
    side = 1.0 if number % 2 else -1.0
    width = np.interp(progress, track.centre.s, track.width_left if side > 0.0 else track.width_right)
    at = 0.0 if track.ideal is None else line * float(np.interp(progress, track.centre.s, track.ideal))
    return side * GRID_OFFSET * float(width) - at


def _start_speed(
    lines: Sequence[Any], limits: Sequence[Envelope | None], places: Sequence[float], track: Any
) -> tuple[float, float]:
    """Return the speed of the grid (m/s), and the longest theoretical lap (s)."""
    speed, longest = GRID_SPEED, 0.0
    for line, limit, place in zip(lines, limits, places, strict=True):
        if limit is None:  # a bicycle
            return 5.0, track.length / 5.0
        lap = line.limit(limit)
        speed = min(speed, GRID_SHARE * float(lap.speed_at(line.place(place))))
        longest = max(longest, lap.lap_time)
    return speed, longest
