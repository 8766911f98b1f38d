"""From the recording of laps to their report: times, traces against the theoretical lap, map, g-g diagram, follow view.

Everything about the ride comes from the recording; the circuit and the theoretical lap are given beside it. Lap timing
is computed again from the recorded contact points and compared with the recorded events.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from bike_analysis.lap_view import lap_view
from bike_analysis.page import key_html, page_shell, table_html
from bike_analysis.reading import Floats, Recording, read_recording
from bike_analysis.rides import Ride, find_rides
from bike_analysis.view import view_html
from bike_sim.course.lap_timing import Lap, Timing, TimingEvent, TimingKind, time_laps
from bike_sim.course.placing import EXACT, samples_of
from bike_sim.course.track import Track

PAGE_NAME: Final = "lap.html"

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
    """

    s: Floats
    speed: Floats
    lateral: Floats
    longitudinal: Floats
    lap_time: float
    sector_times: tuple[float, ...]


@dataclass(frozen=True)
class LapRecording:
    """A recorded ride on a circuit with its timing.

    Attributes:
        recording: What was read.
        ride: Its ride.
        track: The circuit.
        timing: Laps, computed again from the recording.
        events: Timing events, computed again.
        progress: Along the centre line, m, one value a state.
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
        """Laps without the first, which begins rolling."""
        return self.timing.laps[1:]

    @property
    def time(self) -> Floats:
        """Time since the reset, s, one value a state."""
        return self.ride.states.step * self.ride.states.control_period

    def rows(self, lap: Lap) -> slice:
        """States of a lap."""
        first, last = np.searchsorted(self.time, [lap.began, lap.began + lap.duration])
        return slice(int(first), int(last))


def load_laps(path: str | os.PathLike[str], track: Track) -> LapRecording:
    """Read a recording and time its laps anew.

    Args:
        path: The recording; its first ride counts.
        track: The circuit that was ridden.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If it is none.
        ValueError: If its states do not lie on the circuit.
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


def lap_figures(laps: LapRecording, theory: Theory) -> dict[str, Any]:
    """Return the figures of recorded laps, ready for JSON."""
    flying = laps.flying
    best = min(flying, key=lambda lap: lap.duration, default=None)
    kinds = [event.kind for event in laps.ride.events]
    return {
        "vehicle": laps.recording.vehicle,
        "course": laps.track.name,
        "laps_s": [lap.duration for lap in flying],
        "lap_s": None if best is None else best.duration,
        "sectors_s": [] if best is None else list(best.sectors),
        "out_lap_s": laps.timing.laps[0].duration if laps.timing.laps else None,
        "limit_s": theory.lap_time,
        "limit_sectors_s": list(theory.sector_times),
        "excess": None if best is None else max(lap.duration for lap in flying) / theory.lap_time - 1.0,
        "falls": kinds.count("fall"),
        "walls": kinds.count("wall"),
        "valid_laps": sum(lap.valid for lap in flying),
        "off_track_s": laps.timing.off_track,
        "timing_agrees": timing_agrees(laps),
        "lost_steps": int(np.sum(np.diff(laps.ride.states.step) - 1)),
    }


def write_lap_report(laps: LapRecording, theory: Theory, out_dir: Path) -> Path:
    """Write the report page and return its path.

    Raises:
        OSError: If it cannot be written.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    path = out_dir / PAGE_NAME
    path.write_text(render_lap_page(laps, theory), encoding="utf-8")
    return path


def render_lap_page(laps: LapRecording, theory: Theory) -> str:
    """Return the report page: HTML without any reference to the outside."""
    figures = lap_figures(laps, theory)
    title = f"{laps.recording.vehicle} on {laps.track.name}"
    view = lap_view(laps, theory, "laps", title)
    below = f'<p class="soft">{escape(laps.recording.path.name)} · {laps.recording.message_count:,} messages</p>'
    parts = [_key(figures), view_html(view), "<h2>Lap and sector times</h2>", _time_table(laps, theory)]
    return page_shell(title, below, [*parts, _agreement(figures)], [view])


def lap_text(seconds: float) -> str:
    """Return a lap time as people write it."""
    minutes, rest = divmod(seconds, 60.0)
    return f"{int(minutes)}:{rest:06.3f}" if minutes else f"{rest:.3f}"


def _key(figures: dict[str, Any]) -> str:
    excess = figures["excess"]
    off = f"{figures['off_track_s']:.2f}"
    entries = [
        ("best flying lap", "–" if figures["lap_s"] is None else lap_text(figures["lap_s"]), ""),
        ("theoretical lap", lap_text(figures["limit_s"]), ""),
        ("slowest flying lap over it", "–" if excess is None else f"{100 * excess:+.1f}", "%"),
        ("flying laps, valid", f"{len(figures['laps_s'])}, {figures['valid_laps']}", ""),
        ("off the track", off, "s"),
        ("falls, walls", f"{figures['falls']}, {figures['walls']}", ""),
    ]
    return key_html(entries)


def _time_table(laps: LapRecording, theory: Theory) -> str:
    """Lap and sector times; the best flying ones are marked, and what they would add up to."""
    names = [name for name, _ in laps.track.sectors]
    head = "".join(f"<th>{escape(name)}</th>" for name in ("lap", "time", *names, "off track"))
    best = [min(column) for column in zip(*((lap.duration, *lap.sectors) for lap in laps.flying), strict=True)]
    rows = []
    for lap in laps.timing.laps:
        name = "out" if lap.number == 1 else str(lap.number - 1)
        rows.append(
            _time_row(name, (lap.duration, *lap.sectors), best, f"{lap.off_track:.2f} s" if lap.off_track else "")
        )
    if len(laps.flying) > 1:
        rows.append(_time_row("best sectors", (sum(best[1:]), *best[1:]), [], ""))
    rows.append(_time_row("theoretical", (theory.lap_time, *theory.sector_times), [], ""))
    return table_html(head, rows)


def _time_row(name: str, times: Sequence[float], best: Sequence[float], last: str) -> str:
    cells = []
    for column, time in enumerate(times):
        mark = ' class="best"' if column < len(best) and time == best[column] else ""
        cells.append(f"<td{mark}>{lap_text(time)}</td>")
    return f"<tr><td>{escape(name)}</td>{''.join(cells)}<td>{last}</td></tr>"


def _agreement(figures: dict[str, Any]) -> str:
    if figures["timing_agrees"]:
        return '<p class="soft">Computed again from the recorded contact points, all times equal the events.</p>'
    return (
        '<div class="warning" role="status"><p>The times computed from the recording differ from its events; '
        f"{figures['lost_steps']} steps are missing.</p></div>"
    )
