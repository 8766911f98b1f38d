"""The best lap of a machine on a circuit, found by riding: improved stretch by stretch on the full model.

One ride goes round and round and keeps its states. From states all around the lap, changes of the stretch ahead of each
are ridden side by side: a smooth bump of the line or of the speed each, then combinations of those that gained. What is
compared is the time to a place well behind the stretch, less what the speed there is worth on the straight that
follows. The next lap is ridden with the best change of every stretch, and kept if it is faster. So what is kept has
been ridden as a flying lap. At times the lap is judged: it is ridden from the start of every ride, and
its time is that of the slower of two flying laps.

It is a local search with random draws: its best lap is an upper bound of the optimum of the model.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_policy.planning.lap_plan import plan_lap
from bike_policy.planning.plan_verification import verified_plan
from bike_policy.riders.optimum import (
    DIGITS,
    KNOT_SPACING,
    SETTINGS,
    BestLap,
    LapLaw,
    check_fit,
    circuit_of,
)
from bike_sim.course import racing_line
from bike_sim.planning import minimum_time
from bike_sim.planning.line_cache import closest_lap, track_with_line
from bike_sim.schema import LIMITS
from bike_sim.sim import look as lk
from bike_sim.sim.batch import SUPERBIKE_ENGINE, Batch
from bike_sim.sim.config import superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import write_whole

FloatArray = NDArray[np.float64]

CANDIDATES: Final = 16
"""Rides from a state: one of the lap as it is, and one of each change."""
COMBINED: Final = 10
"""Rides of combinations of the changes that gained."""
STRETCH: Final = 240.0
"""Length of the stretches that are changed, m."""
TAIL: Final = 170.0
"""Distance behind a stretch up to which it counts, m: the exit of the corner that it leads to."""
STRIDE: Final = 25.0
"""Distance of the states from which stretches are ridden, m."""
LEAD: Final = 0.5
"""Time ahead of the ride in which nothing changes, s: the law has looked there already."""
HALF_WIDTHS: Final = (12.0, 120.0)
"""Half of the width of a bump, m."""
FIRST_SIZES: Final = (0.25, 0.015)
"""Sizes of bumps to begin with: of the line, m, and of the speed, as a part of it."""
SIZES: Final = (0.05, 2.0)
"""Bounds of the factor on these, which grows by `GROWTH` where changes gain and shrinks where few do."""
GROWTH: Final = 1.2
SHRINKAGE: Final = 0.85
SHIFT: Final = 4.0
"""Size of a shift of the speed along the line, m."""
TREND: Final = 0.6
"""Part of the changes of the rounds before that counts in their direction."""
GAIN: Final = 2e-4
"""Least gain that is worth a change, s."""
CLEAR: Final = 0.05
"""Distance that the better contact point keeps inside the limits, m; with it outside, a lap is not valid."""
ANSWER: Final = 0.2
"""Time in which the law rides out an error of speed, s (`RiderSettings.speed_gain`)."""
FULL: Final = 0.98
"""Throttle from which on speed is limited by the engine."""
LONGEST: Final = 900.0
"""Longest ride, s."""
PATIENCE: Final = 0.5
"""Time after the first change of a stretch at its end after which the others are given up, s."""
REPAIRS: Final = 12
"""Times that a lap which is lost is made slower."""
SLOWER: Final = 0.993
BEFORE: Final = 130.0
BEHIND: Final = 10.0
"""Factor on its speed, and distances before and behind the place where it was lost, m; after `PATIENCE_BEFORE` times
from farther ahead."""
PATIENCE_BEFORE: Final = 3
LAP_FILE, WORKING_FILE, CURVE_FILE, SIZES_FILE = "lap.csv", "working.csv", "curve.csv", "sizes.csv"
"""Files of a search: its best lap, the lap that is changed, the curve, and the sizes of changes at the knots."""
BEYOND: Final = 40.0
"""Distance behind the line at which a round begins, m: the lap before is finished there."""
JUDGED_EVERY: Final = 5
"""Rounds between two judgements."""
FAST: Final = replace(SETTINGS, lateral=1.0, brake=1.0, brake_upright=1.0, dip=1.0, bank=1.0, lean_rate=1.1)
"""Settings of the speeds towards which some changes lead: the machine's limits."""
_OUTSIDE: Final = LIMITS.index("outside")

State = tuple[dict[str, Any], FloatArray]
"""All that a ride needs to go on: of its machine, and the law's memory."""


class Judgement(NamedTuple):
    """A lap as it is ridden from the start of every ride.

    Attributes:
        lap_time: of the slower of two flying laps, s; inf where they were not finished, or not valid.
        change: by which the second is slower than the first, s.
        lost_at: arc length where the ride fell or left the track, m; None where it did not.
    """

    lap_time: float
    change: float
    lost_at: float | None


class Point(NamedTuple):
    """A point of a search's curve.

    Attributes:
        lap_time: of the best lap, s.
        ridden: simulated laps so far, those in pieces counted together.
        seconds: processor time so far, s.
    """

    lap_time: float
    ridden: float
    seconds: float


@dataclass
class Progress:
    """A search so far.

    Attributes:
        lap: that is changed; its time is that of the last round.
        best: fastest lap that was judged valid.
        sizes: factor on the sizes of bumps at the knots.
        curve: a point after each round, the start being round 0.
        ridden: simulated laps so far.
        seconds: processor time so far, s.
    """

    lap: BestLap
    best: BestLap
    sizes: FloatArray
    curve: list[Point]
    ridden: float = 0.0
    seconds: float = 0.0


class _Stretch(NamedTuple):
    """A stretch that is changed.

    Attributes:
        stored: state from which it is ridden.
        first: arc length at which it begins, m.
        end: arc length up to which it counts, m.
        worth: time that speed there saves behind it, by the speed, s^2/m.
    """

    stored: State
    first: float
    end: float
    worth: float


class LapSearch:
    """Search of the best lap of a machine on a circuit."""

    def __init__(self, vehicle: str, circuit: str | Path, seed: int = 0) -> None:
        """Prepare a search.

        Args:
            vehicle: name or file of a superbike.
            circuit: name or file of a circuit.
            seed: of its draws.

        Raises:
            ValueError: a vehicle that is no superbike, or a course that is a path.
            FileNotFoundError: an unknown vehicle or circuit.
        """
        config = replace(superbike_config(vehicle), engine=SUPERBIKE_ENGINE)
        self.seed, self._period = seed, config.control_period
        self._one = Batch(1, config)
        self._start = self._one.at_own_speed(0, ResetRequest(course=str(circuit)))
        self._one.reset(0, self._start)
        begun, machine = self._one.begun(0), self._one.vehicle
        if not isinstance(machine, Superbike) or begun is None or begun.followed is None:
            raise ValueError(f"best laps are those of superbikes on circuits, not of {vehicle} on {circuit}")
        self.machine, self.line = machine, begun.course
        self._length = self.line.length
        self._stretches = max(1, int(self._length / (STRETCH + TAIL)))
        self._law = LapLaw(machine, self.line, self._period)
        limits = self._one.plant(0).envelope
        assert limits is not None, "superbikes have limits"
        self._count = round(self._length / KNOT_SPACING)
        self._s = np.arange(self._count) * (self._length / self._count)
        fast = plan_lap(machine, self.line, FAST)
        self._fast = np.interp(self._s, fast.s, fast.speed)
        self._theory = closest_lap(circuit, limits)
        closest, followed = track_with_line(circuit, limits, racing_line.MARGIN, minimum_time.ROLL_COST), begun.followed
        ideals = [track.ideal for track in (closest, followed.track) if track.ideal is not None]
        beside = np.interp(followed.to_centre, closest.centre.s, np.subtract(*ideals))
        self._closest = np.interp(self._s, self.line.s, beside)
        self._trend = np.zeros((2, self._count))
        self._speed, self._full = np.zeros(self._count), np.zeros(self._count, dtype=bool)

    @cached_property
    def _many(self) -> Batch:
        """Machines that ride changes side by side."""
        batch = Batch(self._stretches * CANDIDATES, self._one.config)
        for row in range(batch.count):
            batch.reset(row, self._start)
        return batch

    @cached_property
    def _laws(self) -> LapLaw:
        """Their law."""
        return LapLaw(self.machine, self.line, self._period, self._many.count)

    def close(self) -> None:
        """Release the engines."""
        self._many.close()
        self._one.close()

    @property
    def theory_s(self) -> float:
        """Theoretical lap on the closest line, s."""
        return self._theory

    def first(self, start: BestLap | None = None) -> Progress:
        """Return the beginning: the classical rider's verified plan, or another lap that is ridden where it can be.

        Args:
            start: the lap, also of another machine on this circuit; where it is lost it is slower.

        Raises:
            ValueError: it is of another circuit, or cannot be ridden.
        """
        if start is None:
            plan = verified_plan(self.machine, self.line, SETTINGS, self._period).profile
            lap = self._rounded(np.zeros(self._count), np.interp(self._s, plan.s, plan.speed))
        else:
            if start.circuit != circuit_of(self.line):
                raise ValueError(f"the lap is of {start.circuit}, not of {circuit_of(self.line)}")
            places, s = self._s / self._length, start.s / start.length
            offset, speed = (np.interp(places, s, values, period=1.0) for values in (start.offset, start.speed))
            lap = self._rounded(offset, speed)
        lap, judged = self._made_whole(lap)
        if not math.isfinite(judged.lap_time):
            raise ValueError(f"the lap of {self.machine.name} on {lap.circuit} cannot be ridden")
        return Progress(lap, lap, np.ones(self._count), [Point(judged.lap_time, 0.0, 0.0)])

    def store(self, progress: Progress, folder: Path) -> None:
        """Write a search, so that `stored` can go on with it."""
        point = progress.curve[-1]
        head = {"seed": self.seed, "rounds": len(progress.curve) - 1, "ridden_laps": f"{point.ridden:.0f}"}
        for name, lap in ((LAP_FILE, progress.best), (WORKING_FILE, progress.lap)):
            unfinished = folder / f"{name}.part"
            lap.write(unfinished, **head)
            unfinished.replace(folder / name)
        lines = [",".join(Point._fields), *(",".join(f"{value:.4f}" for value in point) for point in progress.curve)]
        write_whole(folder / CURVE_FILE, "\n".join(lines) + "\n")
        write_whole(folder / SIZES_FILE, "\n".join(f"{size:.6f}" for size in progress.sizes) + "\n")

    def stored(self, folder: Path) -> Progress | None:
        """Return the search in a folder; None where there is none.

        Raises:
            ValueError: it is of another machine or circuit, or damaged.
        """
        if not (folder / LAP_FILE).is_file():
            return None
        best, lap = (BestLap.read(folder / name) for name in (LAP_FILE, WORKING_FILE))
        check_fit(best, self.machine, self.line)
        rows = np.loadtxt(folder / CURVE_FILE, delimiter=",", skiprows=1, ndmin=2)
        sizes = np.loadtxt(folder / SIZES_FILE, ndmin=1)
        if len(sizes) != self._count or len(best.offset) != self._count:
            raise ValueError(f"{folder} holds a search of {len(sizes)} knots, and this line has {self._count}")
        curve = [Point(*map(float, row)) for row in rows]
        return Progress(lap, best, sizes, curve, curve[-1].ridden, curve[-1].seconds)

    def _rounded(self, offset: FloatArray, speed: FloatArray) -> BestLap:
        offset, speed = np.round(offset, DIGITS), np.round(speed, DIGITS)
        return BestLap(self.machine.name, circuit_of(self.line), self._length, math.inf, offset, speed)

    def _changed(self, lap: BestLap, change: FloatArray) -> BestLap:
        """Return a lap with changes of offset (m) and of the logarithm of speed, shape (2, knots)."""
        return self._rounded(lap.offset + change[0], lap.speed * np.exp(change[1]))

    # ------------------------------------------------------------------------------------------------ the single ride

    def judge(self, lap: BestLap) -> Judgement:
        """Ride a lap from the start of every ride: an out-lap and two flying laps."""
        self._begin(lap)
        if not self._ride_until(lambda: len(self._one.log(0).laps) > 2):
            return Judgement(math.inf, math.inf, self._place())
        _, before, last = self._one.log(0).laps
        return Judgement(max(before.duration, last.duration), last.duration - before.duration, None)

    def _made_whole(self, lap: BestLap) -> tuple[BestLap, Judgement]:
        """Judge a lap, and lower its speed before places where it is lost, as verified plans do."""
        judged = self.judge(lap)
        for attempt in range(REPAIRS):
            if judged.lost_at is None:
                break
            before = (judged.lost_at + BEHIND - self._s) % self._length / (BEFORE * (1.0 + attempt // PATIENCE_BEFORE))
            slower = np.where(before < 1.0, SLOWER, 1.0)
            lap = self._rounded(lap.offset, lap.speed * slower)
            judged = self.judge(lap)
        return replace(lap, lap_time=judged.lap_time), judged

    def _begin(self, lap: BestLap) -> None:
        self._one.reset(0, self._start)
        self._law.follow(0, lap)
        self._law.begin(0, None, self.line)

    def _ride_until(self, reached: Callable[[], bool]) -> bool:
        """Ride the single machine; return whether it reached a place without falling or leaving the track."""
        batch = self._one
        for _ in range(round(LONGEST / self._period)):
            commands = self._law.commands(batch)
            batch.step(commands)
            here = int(batch.look[0, lk.PROGRESS] % self._length / self._length * self._count)
            self._speed[here], self._full[here] = batch.look[0, lk.SPEED], commands[0, 1] > FULL
            if batch.fallen[0] or batch.circuit[0, _OUTSIDE] > 0.0:
                return False
            if reached():
                return True
        return False

    def _ride_lap(self, lap: BestLap) -> list[State] | None:
        """Ride on for a lap; return states at every `STRIDE` of it, None of a lap that was not whole."""
        self._law.follow(0, lap)
        begin, states = self._place(), [self._state()]
        for number in range(1, math.ceil(self._length / STRIDE)):
            place = begin + number * STRIDE
            if not self._ride_until(partial(self._is_beyond, place)):
                return None
            states.append(self._state())
        return states if self._ride_until(partial(self._is_beyond, begin + self._length)) else None

    def _is_beyond(self, place: float) -> bool:
        return self._place() >= place

    def _place(self) -> float:
        return float(self._one.look[0, lk.PROGRESS])

    def _state(self) -> State:
        stored = self._one.state_dict()
        assert stored is not None, "the compiled engine can go on"
        return stored, self._law.law.memory.copy()

    # ------------------------------------------------------------------------------------------------------ improving

    def improve(
        self, progress: Progress, rounds: int, report: Callable[[Progress], None] = lambda progress: None
    ) -> None:
        """Improve a lap, in place, up to a number of rounds in all.

        Args:
            progress: so far.
            rounds: in all, earlier ones counted.
            report: called after each round.

        Raises:
            ValueError: the lap that it begins with cannot be ridden.
        """
        states: list[State] | None = None
        began, before = time.process_time(), progress.seconds
        while (number := len(progress.curve)) <= rounds:
            if states is None:
                states = self._ride_in(progress)
            states = self._round(progress, states, np.random.default_rng((self.seed, number)))
            if number % JUDGED_EVERY == 0 or number == rounds:
                here = self._state()
                lap, judged = self._made_whole(progress.lap)
                if judged.lap_time < progress.best.lap_time:
                    progress.best = lap
                if lap.lap_time == judged.lap_time and np.array_equal(lap.speed, progress.lap.speed):
                    self._restore(self._one, self._law, [here])
                else:
                    progress.lap, states = (lap if math.isfinite(judged.lap_time) else progress.best), None
                progress.ridden += 3.0
            progress.seconds = before + time.process_time() - began
            progress.curve.append(Point(progress.best.lap_time, progress.ridden, progress.seconds))
            report(progress)

    def _ride_in(self, progress: Progress) -> list[State]:
        """Return states of a flying lap of the lap that is changed; of the best one where that cannot be ridden.

        Raises:
            ValueError: neither can.
        """
        for lap in (progress.lap, progress.best):
            self._begin(lap)
            if self._ride_until(partial(self._is_beyond, self._length + BEYOND)):
                states = self._ride_lap(lap)
                if states is not None:
                    progress.lap = replace(lap, lap_time=self._one.log(0).laps[-1].duration)
                    return states
        raise ValueError(f"the lap of {self.machine.name} on {progress.lap.circuit} cannot be ridden")

    def _round(self, progress: Progress, states: list[State], random: np.random.Generator) -> list[State]:
        """Change stretches all around the lap, and ride a lap with what gained; return states of it."""
        stretches = self._places(states, random)
        changes = self._search(progress, stretches, random)
        while changes:
            here = self._state()
            lap = self._changed(progress.lap, np.sum(list(changes.values()), axis=0))
            ridden = self._ride_lap(lap)
            progress.ridden += 1.0
            if ridden is not None:
                lap_time = self._one.log(0).laps[-1].duration
                if lap_time < progress.lap.lap_time:
                    progress.lap = replace(lap, lap_time=lap_time)
                    self._trend = TREND * self._trend + np.sum(list(changes.values()), axis=0)
                    return ridden
                self._restore(self._one, self._law, [here])
                break
            # without the last change before the place where it was lost
            place = self._place()
            self._restore(self._one, self._law, [here])
            begun = [k for k in changes if (place - stretches[k].first) % self._length < self._length - TAIL]
            nearest = min(begun or changes, key=lambda k: (place - stretches[k].first) % self._length)
            del changes[nearest]
        self._law.follow(0, progress.lap)
        return states

    def _places(self, states: list[State], random: np.random.Generator) -> list[_Stretch]:
        """Return stretches that do not touch each other, at a random place."""
        apart = len(states) / self._stretches
        shift = random.uniform(0.0, apart)
        found = []
        for k in range(self._stretches):
            stored = states[int(k * apart + shift) % len(states)]
            look = stored[0]["rows"]["views"].view(np.float64)[0]
            first = look[lk.PROGRESS] + LEAD * look[lk.SPEED]
            end = first + STRETCH + TAIL
            found.append(_Stretch(stored, float(first), float(end), self._worth(float(end))))
        return found

    def _search(
        self, progress: Progress, stretches: list[_Stretch], random: np.random.Generator
    ) -> dict[int, FloatArray]:
        """Return the best change of each stretch that gained, by its place in the list."""
        lap, sizes, none = progress.lap, progress.sizes, np.zeros((2, self._count))
        near = [np.mod(self._s - stretch.first, self._length) < STRETCH for stretch in stretches]
        drawn = []
        for inside, stretch in zip(near, stretches, strict=True):
            factor = float(np.exp(np.log(sizes[inside]).mean()))
            drawn.append([none, *(self._draw(lap, random, stretch.first, factor) for _ in range(CANDIDATES - 1))])
        costs, spent = self._try(stretches, lap, drawn)
        mixed = [_combinations(each, cost[0] - cost) for each, cost in zip(drawn, costs, strict=True)]
        found, more = self._try(stretches, lap, mixed)
        progress.ridden += (spent + more) * self._period / lap.lap_time
        best: dict[int, FloatArray] = {}
        for k, inside in enumerate(near):
            several, cost = [*drawn[k], *mixed[k]], np.concatenate((costs[k], found[k]))
            least = int(np.argmin(cost))
            if cost[least] < cost[0] - GAIN:
                best[k] = several[least]
            gained = np.count_nonzero(costs[k] < costs[k][0] - GAIN)
            sizes[inside] *= GROWTH if gained >= CANDIDATES // 5 else SHRINKAGE
        np.clip(sizes, *SIZES, out=sizes)
        return best

    def _draw(self, lap: BestLap, random: np.random.Generator, first: float, factor: float) -> FloatArray:
        """Return a random change: of the offset, m, and of the logarithm of the speed, shape (2, knots)."""
        low, high = np.log(HALF_WIDTHS)
        half = math.exp(random.uniform(low, high))
        centre = first + random.uniform(0.0, STRETCH)
        apart = np.mod(self._s - centre + 0.5 * self._length, self._length) - 0.5 * self._length
        bump = 0.5 * (1.0 + np.cos(np.pi * np.clip(apart / half, -1.0, 1.0)))
        ahead = np.mod(self._s - first, self._length)
        taper = np.clip(ahead / 20.0, 0.0, 1.0) * np.clip((STRETCH - ahead) / 20.0, 0.0, 1.0)
        bump *= taper
        change, size = np.zeros((2, self._count)), factor * random.standard_normal()
        kind = random.choice(6, p=(0.28, 0.33, 0.1, 0.07, 0.14, 0.08))
        if kind == 0:
            change[0] = FIRST_SIZES[0] * size * bump
        elif kind == 1:
            change[1] = FIRST_SIZES[1] * size * bump
        elif kind == 2:  # towards the machine's limits
            change[1] = 0.4 * abs(size) * bump * np.log(self._fast / lap.speed)
        elif kind == 3:  # towards the closest line
            change[0] = 0.5 * abs(size) * bump * (self._closest - lap.offset)
        elif kind == 5:  # on in the direction of the rounds before
            change = random.uniform(0.3, 1.2) * taper * self._trend
        else:  # earlier or later, as where braking begins
            moved = np.interp(self._s - SHIFT * size * bump, self._s, lap.speed, period=self._length)
            change[1] = np.log(moved / lap.speed)
        return change

    def _worth(self, place: float) -> float:
        """Return the time that a higher speed at a place saves behind it, by that speed, s^2/m."""
        step = self._length / self._count
        i = int(place % self._length / step) % self._count
        begin = max(float(self._speed[i]), 5.0)
        saved, left = ANSWER / begin, 1.0
        for k in range(i, i + self._count // 2):
            speed, after = (max(float(self._speed[j % self._count]), 5.0) for j in (k, k + 1))
            if not self._full[k % self._count] or left < 0.05:
                break
            saved += left * step / speed**2
            # the engine's power gives less force at more speed, and drag is more
            left *= math.exp(-2.0 * max(after - speed, 0.0) / speed - 2e-4 * step)
        return saved

    # -------------------------------------------------------------------------------------------------------- trying

    def _try(
        self, stretches: Sequence[_Stretch], lap: BestLap, changes: Sequence[Sequence[FloatArray]]
    ) -> tuple[list[FloatArray], int]:
        """Ride changes of stretches side by side.

        Args:
            stretches: where they are.
            lap: that is changed.
            changes: of each stretch.

        Returns:
            Of each change the time less what the speed at its end is worth, s, inf where the ride did not get there;
            and all control periods ridden.
        """
        batch, laws = self._many, self._laws
        place = [k for k, several in enumerate(changes) for _ in several]
        count = len(place)
        filled = [*place, *([0] * (batch.count - count))]
        self._restore(batch, laws, [stretches[k].stored for k in filled])
        for row, change in enumerate(change for several in changes for change in several):
            laws.follow(row, self._changed(lap, change))
        end, worth = (np.array([getattr(stretches[k], name) for k in filled]) for name in ("end", "worth"))
        steps = batch.rows.steps
        steps[count:] = -1  # rows that stay where they are
        riding = np.arange(batch.count) < count
        costs, spent = np.full(batch.count, math.inf), 0
        latest = np.full(len(stretches), math.inf)
        for step in range(1, round(LONGEST / self._period)):
            batch.step(np.where(riding[:, None], laws.commands(batch), 0.0))
            spent += int(riding.sum())
            progress, speed = batch.look[:, lk.PROGRESS], batch.look[:, lk.SPEED]
            lost = riding & (batch.fallen | (batch.circuit[:, _OUTSIDE] > -CLEAR))
            there = riding & ~lost & (progress >= end)
            costs[there] = step * self._period - ((progress - end) / speed + worth * speed)[there]
            for row in np.flatnonzero(there).tolist():
                latest[filled[row]] = min(latest[filled[row]], step + PATIENCE / self._period)
            lost |= riding & (step > latest[filled])
            riding &= ~(lost | there)
            steps[lost | there] = -1
            if not riding.any():
                break
        parts = np.cumsum([len(several) for several in changes])[:-1]
        return np.split(costs[:count], parts), spent

    def _restore(self, batch: Batch, laws: LapLaw, stored: Sequence[State]) -> None:
        """Put each machine of a batch into a state."""
        states = [state for state, _ in stored]
        several: dict[str, Any] = {}
        for key, value in states[0].items():
            if isinstance(value, dict):
                several[key] = {name: np.concatenate([state[key][name] for state in states]) for name in value}
            else:
                several[key] = [state[key][0] for state in states]
        batch.restore(several)
        laws.law.memory[...] = np.concatenate([memory for _, memory in stored])


def _combinations(changes: Sequence[FloatArray], gains: FloatArray) -> list[FloatArray]:
    """Return combinations of changes of a stretch, by what each gained (s); not finite where it could not be ridden."""
    gains = np.where(np.isfinite(gains), gains, 0.0)
    order = [k for k in np.argsort(-gains) if gains[k] > 0.0]
    if not order:
        return []
    best, several = changes[order[0]], np.array(changes)
    signed = np.clip(gains / gains[order[0]], -1.0, 1.0)
    gained, gradient = (np.tensordot(weight, several, 1) for weight in (np.maximum(signed, 0.0), signed))
    found = [0.5 * best, 1.6 * best, 2.5 * best, 0.5 * gained, gained, 1.5 * gained]
    found += [0.3 * gradient, 0.7 * gradient, several[order[:2]].sum(axis=0), several[order[:3]].sum(axis=0)]
    return found[:COMBINED]
