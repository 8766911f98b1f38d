"""A recording of laps on a circuit with recomputed lap times, and the theoretical lap for comparison.

Everything about the ride comes from the recording; circuit and theoretical lap are arguments. Lap timing
is computed again from the recorded contact points and compared with the recorded events.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.messages import Floats
from bike_analysis.read.reading import Recording, read_recording
from bike_analysis.read.rides import Ride, find_rides
from bike_sim.course.lap_timing import EXACT, Lap, Timing, TimingEvent, TimingKind, samples_of, time_laps
from bike_sim.course.track import Corner, Track

_KINDS: Final = {
    TimingKind.LAP: "lap",
    TimingKind.SECTOR: "sector",
    TimingKind.LEFT_TRACK: "off_course",
    TimingKind.BACK_ON_TRACK: "back_on_course",
}


@dataclass(frozen=True)
class Theory:
    """A theoretical lap on the followed line.

    Attributes:
        s: Arc length of the line, m, from 0 to its length.
        speed: m/s.
        lateral: Lateral acceleration, m/s^2, positive to the left.
        longitudinal: m/s^2.
        lap_time: s.
        sector_times: s.
        machine: Limits and gears of the machine; None leaves out gear, engine speed and the limit of the g-g diagram.
    """

    s: Floats
    speed: Floats
    lateral: Floats
    longitudinal: Floats
    lap_time: float
    sector_times: tuple[float, ...]
    machine: Machine | None = None


@dataclass(frozen=True)
class Machine:
    """Limits and gears of a machine, for reading its telemetry.

    Attributes:
        speeds: m/s, rising.
        lateral: Lateral accelerations of the limit at each speed, m/s^2, positive to the right; shape (n, k). The
            curve is closed: over the driving side from left to right, and back over the braking side.
        along: The longitudinal ones, m/s^2, of the same shape.
        spins: Speeds of the rear wheel, rad/s, rising from 0 in equal steps.
        gears: The gear at each of them, 1 for the first.
        ratios: Turns of the crank for one of the rear wheel, by gear.
    """

    speeds: Floats
    lateral: Floats
    along: Floats
    spins: Floats
    gears: NDArray[np.int64]
    ratios: Floats

    def gear(self, spin: Floats) -> Floats:
        """The gear at speeds of the rear wheel, rad/s; NaN where they are unknown."""
        place = np.rint(np.nan_to_num(spin) / self.spins[1]).astype(int)
        gears = self.gears[np.clip(place, 0, len(self.gears) - 1)].astype(np.float64)
        return np.where(np.isfinite(spin), gears, np.nan)

    def crank_rpm(self, spin: Floats) -> Floats:
        """Speed of the crank at speeds of the rear wheel, rpm, with a closed clutch."""
        gear = self.gear(spin)
        return spin * self.ratios[np.nan_to_num(gear, nan=1.0).astype(int) - 1] * 60.0 / (2.0 * math.pi)


@dataclass(frozen=True)
class LapRecording:
    """A recorded ride on a circuit with its timing.

    Attributes:
        recording: What was read.
        ride: Its ride.
        track: The circuit.
        timing: Laps, computed again from the recording.
        events: Timing events, computed again.
        progress: Along the centre line, m, one value per state.
        outside: How far the contact point less far out lay outside the limits, m; negative on the track.
    """

    recording: Recording
    ride: Ride
    track: Track
    timing: Timing
    events: tuple[TimingEvent, ...]
    progress: Floats
    outside: Floats

    @property
    def flying(self) -> tuple[Lap, ...]:
        """Laps without the out-lap, which begins with the ride itself, from a rolling start."""
        return tuple(lap for lap in self.timing.laps if lap.began > self.time[0])

    @property
    def time(self) -> Floats:
        """Time since the reset, s, one value per state."""
        return self.ride.states.step * self.ride.states.control_period

    def rows(self, lap: Lap) -> slice:
        """States of a lap."""
        first, last = np.searchsorted(self.time, [lap.began, lap.began + lap.duration])
        return slice(int(first), int(last))


def load_laps(path: str | os.PathLike[str], track: Track) -> LapRecording:
    """Read a recording and recompute its lap times.

    Args:
        path: The recording; its first ride counts.
        track: The circuit that was ridden.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If it is not a recording.
        ValueError: If its states are not on the circuit.
    """
    recording = read_recording(path)
    ride = find_rides(recording)[0]
    states = ride.states
    time = states.step * states.control_period
    rear, front = np.stack([states.x, states.y], axis=1), np.stack([states.front_x, states.front_y], axis=1)
    begun = next((event for event in ride.events if event.kind == "reset"), None)
    # A recorder that came after the reset has missed its event; rides begin on the start line or somewhere else.
    begin = begun.progress_m if begun is not None else float(states.progress[0])
    begin = 0.0 if abs(begin) < EXACT else begin
    samples = list(samples_of(track, time, rear, front, begin, begin + math.dist(rear[0], front[0])))
    timing, events = time_laps(track, samples)
    progress = np.array([sample.progress for sample in samples])
    outside = np.minimum(
        track.outside(progress, np.array([sample.offset for sample in samples])),
        track.outside(
            np.array([sample.front_progress for sample in samples]),
            np.array([sample.front_offset for sample in samples]),
        ),
    )
    if np.abs([sample.offset for sample in samples]).max() > 500.0:
        raise ValueError(f"the recording {recording.path} was not ridden on circuit {track.name!r}")
    return LapRecording(recording, ride, track, timing, events, progress, outside)


def timing_agrees(laps: LapRecording) -> bool:
    """Whether the timing computed from the recording equals the recorded events, time by time and bit for bit.

    Left out are the values of the event of leaving the track (a distance there, none here).
    """
    again = [(_KINDS[event.kind], event.time, event.progress) for event in laps.events]
    wanted = set(_KINDS.values())
    recorded = [(event.kind, event.time_s, event.progress_m) for event in laps.ride.events if event.kind in wanted]
    again_values = [event.value for event in laps.events if event.kind is not TimingKind.LEFT_TRACK]
    recorded_values = [e.value for e in laps.ride.events if e.kind in wanted and e.kind != "off_course"]
    return bool(again) and again == recorded and again_values == recorded_values


BRAKING: Final = 5.0
"""Brake from which on a rider counts as braking, %."""
PHASES: Final = ("braking", "entry", "exit", "straight after")
"""Parts of a corner's stretch: up to where it begins, up to its apex, up to its end, and from there on."""


@dataclass(frozen=True)
class LapTrace:
    """A lap over arc length along the centre line; columns of equal length.

    Attributes:
        distance_m: Since the start line, never falling.
        time_s: Since the start line.
        speed: In any unit; speeds of corners have the same.
        lean_deg: Either sign; empty for a theory.
        brake: 0 to 100 %; empty for a theory.
    """

    distance_m: Floats
    time_s: Floats
    speed: Floats
    lean_deg: Floats
    brake: Floats

    def at(self, values: Floats, place_m: float) -> float:
        """A column's value at a place."""
        return float(np.interp(place_m, self.distance_m, values))


@dataclass(frozen=True)
class CornerFigures:
    """One corner of a lap.

    Attributes:
        name: Of the corner.
        direction: ``left`` or ``right``.
        braking_m: Where braking for it began, m from the start line; None if it was not braked for.
        before_apex_m: The same as a distance before the apex.
        entry_speed: At the corner's beginning.
        least_speed: The lowest in it.
        exit_speed: At its end.
        lean_deg: The largest lean in it, without sign.
        lost_s: Time lost on the reference over the corner's stretch, which reaches to the middle of the straights
            before and after it, so that all corners together make up the lap; negative where time was won.
        lost_in: The one of `PHASES` in which most was lost; empty if nothing was.
    """

    name: str
    direction: str
    braking_m: float | None
    before_apex_m: float | None
    entry_speed: float
    least_speed: float
    exit_speed: float
    lean_deg: float
    lost_s: float
    lost_in: str


def corner_figures(
    corners: Sequence[Corner], length_m: float, lap: LapTrace, reference: LapTrace
) -> tuple[CornerFigures, ...]:
    """Compute the figures of each corner.

    Args:
        corners: In the order of the lap.
        length_m: Length of the circuit.
        lap: The lap.
        reference: What it is measured against, over the same arc length.

    Returns:
        One record per corner.
    """
    middles = [0.5 * (before.end + after.begin) for before, after in pairwise(corners)]
    bounds = [0.0, *middles, length_m]
    found = []
    for corner, (first, last) in zip(corners, pairwise(bounds), strict=True):
        end = min(corner.end, length_m)
        inside = (lap.distance_m >= corner.begin) & (lap.distance_m <= end)
        if not inside.any():
            inside[np.argmin(np.abs(lap.distance_m - corner.apex))] = True
        braking = _braking_point(lap, first, corner.apex)
        losses = [_lost(lap, reference, a, b) for a, b in pairwise((first, corner.begin, corner.apex, end, last))]
        found.append(
            CornerFigures(
                name=corner.name,
                direction=corner.direction,
                braking_m=braking,
                before_apex_m=None if braking is None else corner.apex - braking,
                entry_speed=lap.at(lap.speed, corner.begin),
                least_speed=float(np.min(lap.speed[inside])),
                exit_speed=lap.at(lap.speed, end),
                lean_deg=float(np.max(np.abs(lap.lean_deg[inside]))),
                lost_s=sum(losses),
                lost_in=PHASES[int(np.argmax(losses))] if max(losses) > 0.0 else "",
            )
        )
    return tuple(found)


def _lost(lap: LapTrace, reference: LapTrace, begin_m: float, end_m: float) -> float:
    """Time lost between two places, s; none where they are in the wrong order, as corners may overlap."""
    if end_m <= begin_m:
        return 0.0
    own = lap.at(lap.time_s, end_m) - lap.at(lap.time_s, begin_m)
    return own - (reference.at(reference.time_s, end_m) - reference.at(reference.time_s, begin_m))


def _braking_point(lap: LapTrace, first_m: float, apex_m: float) -> float | None:
    """Place where the last stretch of braking before the apex began, m; None without any between the two places."""
    rows = np.flatnonzero((lap.distance_m >= first_m) & (lap.distance_m <= apex_m) & (lap.brake >= BRAKING))
    if not len(rows):
        return None
    row = int(rows[-1])
    while row > 0 and lap.brake[row - 1] >= BRAKING:
        row -= 1
    return float(lap.distance_m[row])
