"""Rides of a recording: one a reset, each with its commands, course, events and latencies, its laps and figures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bike_analysis.read.messages import Floats, Integers, Latency, RecordedCourse, RecordedEvent, Table
from bike_analysis.read.reading import Recording, ride_bounds

if TYPE_CHECKING:  # these modules take rides
    from bike_analysis.figures.laps import Lap
    from bike_analysis.figures.metrics import Figures


@dataclass(frozen=True, eq=False)
class Ride:
    """One ride, from a reset to the next or to the recording's end. Laps and figures are computed when first needed.

    Attributes:
        recording: The recording that it is in.
        label: Name for people: the file's, and the ride's number where the file has several.
        index: Number in the recording, from 1.
        episode: The simulator's number of the episode; it begins again at 1 when the simulator is restarted.
        states: States, each step once, never empty.
        repeated_states: States left out because their step had been recorded already.
        commands: Commands that answer states of this ride.
        course: The course, or None where it was not recorded.
        events: Events of this ride.
        latencies: Reports of the policy's latency during this ride.
        telemetry: What tyres and engine did in this ride; empty where it was not recorded.
        grip: What the rider inferred of the road's grip in this ride; empty where it was not recorded.
    """

    recording: Recording
    label: str
    index: int
    episode: int
    states: Table
    repeated_states: int
    commands: Table
    course: RecordedCourse | None
    events: tuple[RecordedEvent, ...]
    latencies: tuple[Latency, ...]
    telemetry: Table
    grip: Table

    def __repr__(self) -> str:
        return f"<Ride {self.label}: {len(self.states)} states, {len(self.laps)} laps>"

    @cached_property
    def evaluated(self) -> Ride:
        """The ride up to the finish of an open course: what figures, pages and comparisons are about."""
        from bike_analysis.figures.laps import evaluated_ride

        return evaluated_ride(self)

    @cached_property
    def figures(self) -> Figures:
        """Figures of the whole ride and of its laps."""
        from bike_analysis.figures.metrics import ride_figures

        return ride_figures(self)

    @cached_property
    def laps(self) -> tuple[Lap, ...]:
        """Complete laps on a closed course, in order."""
        from bike_analysis.figures.laps import find_laps

        return find_laps(self)

    @property
    def best_lap(self) -> Lap | None:
        """The fastest complete lap, out-laps not counted where there are others; None without one."""
        from bike_analysis.figures.laps import counted_laps

        return min(counted_laps(self.laps), key=lambda lap: lap.duration_s, default=None)

    def table(self) -> pd.DataFrame:
        """The ride as a table, one row per recorded state, with columns as `bike_analysis.figures.metrics` says."""
        from bike_analysis.figures.metrics import ride_table

        return ride_table(self)

    @property
    def distance(self) -> Floats:
        """Distance driven by the rear contact since the ride's first state, m, one value per state.

        Where positions were not recorded it is the speed over time; where neither was, it stays 0.
        """
        states = self.states
        steps = np.hypot(np.diff(states.x), np.diff(states.y))
        by_speed = 0.5 * (states.speed[1:] + states.speed[:-1]) * np.diff(states.time_s)
        steps = np.where(np.isfinite(steps), steps, np.nan_to_num(by_speed))
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def time(self) -> Floats:
        """Simulated time since the ride's first state, s, one value per state."""
        return self.states.time_s - self.states.time_s[0]

    @property
    def ended_by(self) -> str:
        """First of ``finished``, ``fell`` or ``off_course``; else ``stopped``."""
        states = self.states
        lapped = states.course_closed & (states.progress - states.progress[0] >= states.course_length)
        flags = {"fell": states.fallen, "off_course": states.off_course, "finished": states.finished | lapped}
        first = {name: int(np.argmax(rows)) for name, rows in flags.items() if rows.any()}
        if first:
            return min(first, key=lambda name: first[name])
        words = {"fall": "fell", "off_course": "off_course", "finish": "finished"}
        return next((words[event.kind] for event in self.events if event.kind in words), "stopped")

    def reference_line(self) -> tuple[Floats, Floats]:
        """Followed line for drawing.

        Returns:
            x and y in map, m: the recorded course, or else the points of it that the ride came by, computed from the
            lateral and heading errors. A closed course ends with its first point.
        """
        course = self.course
        if course is not None and len(course.x):
            if course.closed:
                return np.append(course.x, course.x[0]), np.append(course.y, course.y[0])
            return course.x, course.y
        heading = self.states.yaw - self.states.heading_error
        return (
            self.states.x + self.states.lateral_error * np.sin(heading),
            self.states.y - self.states.lateral_error * np.cos(heading),
        )

    def section_of(self) -> Integers:
        """Section of the course of each state.

        Returns:
            Index into the course's section names, one a state; -1 before the first section. Empty without sections.
        """
        course = self.course
        if course is None or not course.section_names:
            return np.empty(0, dtype=np.int64)
        progress = self.states.progress
        if course.closed and course.length > 0.0:
            progress = np.mod(progress, course.length)
        return np.searchsorted(course.section_starts, progress, side="right").astype(np.int64) - 1


@dataclass(frozen=True, eq=False)
class RideRecording(Recording):
    """A recording whose rides are found.

    Attributes:
        rides: In order, at least one.
    """

    rides: tuple[Ride, ...] = ()

    def __repr__(self) -> str:
        return f"<RideRecording {self.path.name}: {len(self.rides)} rides, {len(self.states)} states>"


def find_rides(recording: Recording) -> tuple[Ride, ...]:
    """Split a recording into rides.

    A ride begins where the episode changes or the step goes back (a simulator that was restarted counts its episodes
    from 1 again). A step that was recorded twice counts once.

    Args:
        recording: What was read.

    Returns:
        The rides, in order; at least one.
    """
    states, name = recording.states, recording.path.stem
    bounds, rides = ride_bounds(states.episode, states.step), []
    begins = np.array(bounds[:-1])
    for index, (first, last) in enumerate(pairwise(bounds), start=1):
        whole = states.take(slice(first, last))
        fresh = np.append(True, np.diff(whole.step) > 0)
        episode, (begin, end) = int(whole.episode[0]), whole.order[[0, -1]]
        same = begins[states.episode[begins] == episode]

        commands, telemetry, grip = (
            table.take((table.episode == episode) & (_owner(states, same, table.order) == first))
            for table in (recording.commands, recording.telemetry, recording.grip)
        )
        courses = [c for c in recording.courses if c.episode == episode]
        courses = [c for c in courses if _owner(states, same, c.order, True) == first]
        events = (e for e in recording.events if e.episode == episode)
        rides.append(
            Ride(
                recording=recording,
                label=name if len(bounds) == 2 else f"{name}, ride {index}",
                index=index,
                episode=episode,
                states=whole if fresh.all() else whole.take(fresh),
                repeated_states=int((~fresh).sum()),
                commands=commands,
                course=courses[-1] if courses else None,
                events=tuple(e for e in events if _owner(states, same, e.order, e.step == 0) == first),
                latencies=tuple(x for x in recording.latencies if begin <= x.order <= end),
                telemetry=telemetry,
                grip=grip,
            )
        )
    return tuple(rides)


def _owner(states: Table, begins: Integers, order: Any, reset: Any = False) -> Any:
    """Return the first row of the ride that messages belong to, of rides of one episode number.

    Topics are recorded side by side, and a course or command may stand before its ride's first state. So what lies
    between two rides is the later one's where it belongs to a reset (a course, an event of step 0), else the earlier's.

    Args:
        states: Of the recording.
        begins: First rows of those rides.
        order: Places of the messages in the recording.
        reset: Whether they belong to a reset.
    """
    later = np.searchsorted(states.order[begins[1:]], order, side="right")
    return begins[np.where(reset, np.searchsorted(states.order[begins[1:] - 1], order), later)]
