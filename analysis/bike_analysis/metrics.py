"""Figures of a ride. All of them come from every recorded state; nothing is thinned out.

Distances to the path are those of the rear contact point, t_0 = d(P, P_P0) in the bicycle paper, which evaluates their
mean and maximum along a ride (Weyrer et al. 2026, Sect. 5.3 and Eq. 15). Names end in their units; what cannot be
computed from the recording is None.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bike_analysis.reading import Floats, Integers, Latency
from bike_analysis.rides import Ride


@dataclass(frozen=True)
class SectionFigures:
    """Distance to the path within one section of the course, over all laps.

    Attributes:
        name: The section's name.
        start_m: Where it begins, as arc length.
        samples: States in it.
        mean_error_m: Mean distance.
        max_error_m: Maximum distance.
        rms_error_m: Root of the mean squared distance.
    """

    name: str
    start_m: float
    samples: int
    mean_error_m: float | None
    max_error_m: float | None
    rms_error_m: float | None


@dataclass(frozen=True)
class RideFigures:
    """Figures of one ride.

    Attributes:
        ride: Number in the recording, from 1.
        episode: The simulator's number.
        course: Name of the course, or None where it was not recorded.
        ended_by: ``finished``, ``fell``, ``off_course`` or ``stopped``.
        completed: Whether the end of the course, or a full lap of a closed one, was reached without fault.
        falls: Falls in this ride.
        off_course: Times that it left the course.
        duration_s: Simulated time from the first to the last state.
        distance_m: Way of the rear contact point.
        laps: Full laps of a closed course.
        speed_min_m_s: Lowest speed.
        speed_mean_m_s: Mean speed.
        speed_max_m_s: Highest speed.
        mean_error_m: Mean distance of the rear contact to the path.
        max_error_m: Maximum distance.
        rms_error_m: Root of the mean squared distance.
        max_error_at_m: Progress at which the maximum was met.
        roll_min_deg: Farthest lean to the left (negative).
        roll_max_deg: Farthest lean to the right.
        steer_min_deg: Farthest steer to the right (negative).
        steer_max_deg: Farthest steer to the left.
        roll_rate_rms_deg_s: Root mean square of the roll rate.
        steer_rate_rms_deg_s: Root mean square of the steer rate: the steering activity.
        steer_torque_rms_nm: Root mean square of the steering drive's torque.
        command_change_mean: Mean absolute change of the steering command from step to step, of [-1, 1].
        steps: Recorded steps.
        lost_steps: Steps missing between the first and the last.
        repeated_states: States recorded more than once.
        unanswered_states: States without a command, the last state not counted; None if commands were not recorded.
        command_delay_mean_steps: Mean age of the applied command, see `command_delay`.
        command_delay_max_steps: Largest age.
        command_delay_mean_s: Mean age in simulated time.
        command_delay_max_s: Largest age in simulated time.
        latency_median_s: Median wall-clock time of the policy's answer, the median of its reports.
        latency_p99_s: 99th percentile of the same, the largest of its reports.
        sections: The distance to the path by section of the course.
    """

    ride: int
    episode: int
    course: str | None
    ended_by: str
    completed: bool
    falls: int
    off_course: int
    duration_s: float
    distance_m: float
    laps: int | None
    speed_min_m_s: float | None
    speed_mean_m_s: float | None
    speed_max_m_s: float | None
    mean_error_m: float | None
    max_error_m: float | None
    rms_error_m: float | None
    max_error_at_m: float | None
    roll_min_deg: float | None
    roll_max_deg: float | None
    steer_min_deg: float | None
    steer_max_deg: float | None
    roll_rate_rms_deg_s: float | None
    steer_rate_rms_deg_s: float | None
    steer_torque_rms_nm: float | None
    command_change_mean: float | None
    steps: int
    lost_steps: int
    repeated_states: int
    unanswered_states: int | None
    command_delay_mean_steps: float | None
    command_delay_max_steps: int | None
    command_delay_mean_s: float | None
    command_delay_max_s: float | None
    latency_median_s: float | None
    latency_p99_s: float | None
    sections: tuple[SectionFigures, ...]

    def as_dict(self) -> dict[str, Any]:
        """The figures as plain types, ready for JSON."""
        return {**asdict(self), "sections": [asdict(section) for section in self.sections]}


@dataclass(frozen=True)
class CommandDelay:
    """Age of the command that was applied in each step.

    Attributes:
        rows: Rows of the ride's states (those after a step) for which it is known.
        steps: Age in control steps: 0 if the command answers the very state from which the step began.
        time_s: The same in simulated time, s.
    """

    rows: Integers
    steps: Integers
    time_s: Floats


def ride_figures(ride: Ride) -> RideFigures:
    """Compute the figures of a ride.

    Args:
        ride: A ride.

    Returns:
        Its figures.
    """
    states = ride.states
    error = np.abs(states.lateral_error)
    mean, largest, rms = _error_figures(error)
    ended_by = ride.ended_by
    delay = command_delay(ride)
    return RideFigures(
        ride=ride.index,
        episode=ride.episode,
        course=ride.course.name if ride.course else None,
        ended_by=ended_by,
        completed=ended_by == "finished",
        falls=_times(states.fallen, sum(e.kind == "fall" for e in ride.events)),
        off_course=_times(states.off_course, sum(e.kind == "off_course" for e in ride.events)),
        duration_s=float(ride.time[-1]),
        distance_m=float(ride.distance[-1]),
        laps=_laps(ride),
        speed_min_m_s=_of(np.min, states.speed),
        speed_mean_m_s=_of(np.mean, states.speed),
        speed_max_m_s=_of(np.max, states.speed),
        mean_error_m=mean,
        max_error_m=largest,
        rms_error_m=rms,
        max_error_at_m=_at_maximum(error, states.progress),
        roll_min_deg=_of(np.min, np.degrees(states.roll)),
        roll_max_deg=_of(np.max, np.degrees(states.roll)),
        steer_min_deg=_of(np.min, np.degrees(states.steer)),
        steer_max_deg=_of(np.max, np.degrees(states.steer)),
        roll_rate_rms_deg_s=_of(_rms, np.degrees(states.roll_rate)),
        steer_rate_rms_deg_s=_of(_rms, np.degrees(states.steer_rate)),
        steer_torque_rms_nm=_of(_rms, states.steer_torque),
        command_change_mean=_of(np.mean, np.abs(np.diff(states.steering_command[1:]))),
        steps=len(states),
        lost_steps=int(states.step[-1] - states.step[0] + 1 - len(states)),
        repeated_states=ride.repeated_states,
        unanswered_states=_unanswered(ride),
        command_delay_mean_steps=_of(np.mean, delay.steps),
        command_delay_max_steps=int(delay.steps.max()) if len(delay.steps) else None,
        command_delay_mean_s=_of(np.mean, delay.time_s),
        command_delay_max_s=_of(np.max, delay.time_s),
        latency_median_s=latency_figures(ride.latencies)[0],
        latency_p99_s=latency_figures(ride.latencies)[1],
        sections=section_figures(ride),
    )


def section_figures(ride: Ride) -> tuple[SectionFigures, ...]:
    """Compute the distance to the path for each section of the course.

    Args:
        ride: A ride.

    Returns:
        One entry a section, in order, over all laps; empty if the course or its sections were not recorded.
    """
    course = ride.course
    section = ride.section_of()
    if course is None or not len(section):
        return ()
    error = np.abs(ride.states.lateral_error)
    figures = []
    for index, (name, start) in enumerate(zip(course.section_names, course.section_starts, strict=False)):
        inside = error[section == index]
        figures.append(SectionFigures(name, float(start), len(inside), *_error_figures(inside)))
    return tuple(figures)


def command_delay(ride: Ride) -> CommandDelay:
    """Find out how old the applied commands were.

    A state tells the command that was applied in the step that led to it. That command is looked up among the recorded
    ones: the newest one with this value that answers a state from before the step. Its age is the number of steps (and
    the simulated time) between the state that it answers and the state from which the step began. In lockstep it is 0;
    in free running it tells how late the policy's answers came, a held command growing older with each step.

    Args:
        ride: A ride.

    Returns:
        The delay of each step for which the command was found; empty if commands were not recorded.
    """
    states, commands = ride.states, ride.commands
    rows, steps, times = [], [], []
    newest: dict[float, int] = {}  # row of the newest command of each value, among those given before the step
    order = np.argsort(commands.step, kind="stable")
    given = 0
    for row in range(1, len(states)):
        begin = states.step[row] - 1
        while given < len(order) and commands.step[order[given]] <= begin:
            newest[float(np.clip(commands.steering[order[given]], -1.0, 1.0))] = int(order[given])
            given += 1
        match = newest.get(float(states.steering_command[row]))
        if match is None:
            continue
        begin_time = states.time_s[row - 1] if states.step[row - 1] == begin else np.nan
        rows.append(row)
        steps.append(int(begin - commands.step[match]))
        times.append(begin_time - commands.time_s[match])
    return CommandDelay(
        np.array(rows, dtype=np.int64), np.array(steps, dtype=np.int64), np.array(times, dtype=np.float64)
    )


def latency_figures(latencies: tuple[Latency, ...]) -> tuple[float | None, float | None]:
    """Summarise reports of the policy's latency.

    Args:
        latencies: Reports, each over its own stretch of time.

    Returns:
        Median of the reported medians and largest of the reported 99th percentiles, s; None without reports.
    """
    median = np.array([x.median_s for x in latencies])
    p99 = np.array([x.p99_s for x in latencies])
    return _of(np.median, median), _of(np.max, p99)


def _error_figures(error: Floats) -> tuple[float | None, float | None, float | None]:
    """Mean, maximum and root mean square."""
    return _of(np.mean, error), _of(np.max, error), _of(_rms, error)


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _of(function: Any, values: NDArray[Any]) -> float | None:
    """Apply to the finite values; None if there are none (the field was not recorded)."""
    finite = values[np.isfinite(values)]
    return float(function(finite)) if len(finite) else None


def _at_maximum(values: Floats, places: Floats) -> float | None:
    if not np.isfinite(values).any():
        return None
    place = float(places[int(np.nanargmax(values))])
    return place if np.isfinite(place) else None


def _times(flags: NDArray[np.bool_], events: int) -> int:
    """How often something happened: rises of its flag, or events where the flag was not recorded in time."""
    rises = int(flags[0]) + int(np.sum(flags[1:] & ~flags[:-1]))
    return max(rises, events)


def _laps(ride: Ride) -> int | None:
    states = ride.states
    length = states.course_length[-1]
    if not (states.course_closed[-1] and length > 0.0):
        return None
    return int((states.progress[-1] - states.progress[0]) // length)


def _unanswered(ride: Ride) -> int | None:
    if not len(ride.commands):
        return None
    return int(np.sum(~np.isin(ride.states.step[:-1], ride.commands.step)))
