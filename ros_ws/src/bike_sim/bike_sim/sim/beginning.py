"""From a request to the surroundings and a first state. Every refusal of a request is made here."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.course import Course
from bike_sim.course.files import kind_of, load_course
from bike_sim.course.random_courses import random_course
from bike_sim.physics import state as st
from bike_sim.physics.ground import NO_BUMPS
from bike_sim.sim.disturbances import NO_CHANGES
from bike_sim.sim.observation import address_of, surroundings_of
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import IDEAL, RANDOM_COURSE, ResetRequest, Start, random_length

if TYPE_CHECKING:
    from bike_sim.course.track import Track
    from bike_sim.sim.followed_line import FollowedLine

BICYCLE_SPEED: Final = 4.0
"""Speed at which rides of a bicycle begin by default, m/s."""


@dataclass(frozen=True)
class Beginning:
    """An episode before its first step.

    Attributes:
        state: the first minimal state.
        course: the followed line.
        surroundings: what its row reads but for the preview, a record of `observation.SURROUNDINGS`, shape (1,).
        s: arc length of the followed line near which the rear contact point is, m.
        followed: the same line with its circuit; None on a path.
        asked: progress of the start along the centre line, m.
        near: progress near which the rear contact point is, m.
        marks: arc lengths of a path's sections behind its beginning, m; kept because the record has their address.
        sections: their names.
    """

    state: st.StateVector
    course: Course
    surroundings: NDArray[np.void]
    s: float = 0.0
    followed: FollowedLine | None = None
    asked: float = 0.0
    near: float = 0.0
    marks: NDArray[np.float64] | None = None
    sections: tuple[str, ...] = ()

    @property
    def track(self) -> Track | None:
        """The circuit, or None on a path."""
        return None if self.followed is None else self.followed.track


class PathSurroundings(NamedTuple):
    """A path's arrays as rows read them, as in `Beginning`."""

    course: Course
    surroundings: NDArray[np.void]
    marks: NDArray[np.float64]
    sections: tuple[str, ...]

    @classmethod
    def of(cls, course: Course) -> PathSurroundings:
        """Return the surroundings of a path; its beginning is not a mark."""
        behind = [(name, start) for name, start in course.sections if 0.0 < start < course.length]
        marks = np.array([start for _, start in behind], dtype=np.float64)
        values = {
            "kind": acc.CLOSED_PATH if course.closed else acc.OPEN_PATH, "limit": course.off_course_limit,
            "line": address_of(course.table), "line_samples": len(course.s), "line_spacing": course.spacing,
            "line_length": course.length, "marks": address_of(marks), "mark_count": len(marks),
            "bumps": address_of(NO_BUMPS),
        }  # fmt: skip
        return cls(course, surroundings_of(values), marks, tuple(name for name, _ in behind))


LINES_KEPT: Final = 32
"""Lines of circuits that are kept; one of 4.6 km takes 15 MB."""


class Courses:
    """Courses that a simulator has loaded, so that the next episode on one of them begins without its file.

    Of circuits the lines that were ridden last are kept, `LINES_KEPT` of them.
    """

    def __init__(self) -> None:
        self._path: tuple[str, Course] | None = None
        self._around_path: PathSurroundings | None = None
        self._circuits: dict[str, bool] = {}
        self._lines: dict[tuple[str, float], FollowedLine] = {}
        self._added: dict[str, Track] = {}

    def add(self, name: str, track: Track) -> None:
        """Know a circuit that is in no file by a name."""
        self._added[name], self._circuits[name] = track, True

    def is_circuit(self, plant: Plant, name: str) -> bool:
        """Return whether a vehicle sees a course as a circuit.

        Shipped circuits, random circuits and circuit files are circuits for every vehicle. A CSV file may be both:
        superbikes take a closed line with widths for a circuit, bicycles for a path.

        Raises:
            ValueError: a broken file. FileNotFoundError: no such course.
        """
        if name == RANDOM_COURSE or (plant.rolling and name.lower().endswith(".csv")):
            return False
        if name not in self._circuits:
            self._circuits[name] = kind_of(name) == "circuit"
        return self._circuits[name]

    def path(self, name: str) -> Course:
        """Return a course by name or file.

        Raises:
            ValueError: a broken file. FileNotFoundError: no such course.
        """
        if self._path is None or self._path[0] != name:
            self._path = (name, load_course(name))
        return self._path[1]

    def around_path(self, course: Course) -> PathSurroundings:
        """Return what rows read of a path; that of the last one is kept."""
        if self._around_path is None or self._around_path.course is not course:
            self._around_path = PathSurroundings.of(course)
        return self._around_path

    def line(self, plant: Plant, circuit: str, lam: float) -> FollowedLine:
        """Return a line of a circuit for a vehicle.

        Raises:
            ValueError: a broken file, or no line between its limits. FileNotFoundError: no such circuit.
        """
        # Late, as below: a ride on a path is spared lap theory, which takes a good part of a node's start.
        from bike_sim.planning.line_cache import track_with_line
        from bike_sim.sim.followed_line import FollowedLine

        known = self._lines.get((circuit, lam))
        if known is None:
            same = next((line.track for (name, _), line in self._lines.items() if name == circuit), None)
            same = same or self._added.get(circuit)
            known = FollowedLine(same or track_with_line(circuit, plant.envelope), lam)
        # The last one asked for goes to the end; the first is the one that was not asked for the longest.
        self._lines.pop((circuit, lam), None)
        self._lines[circuit, lam] = known
        if len(self._lines) > LINES_KEPT:
            del self._lines[next(iter(self._lines))]
        return known


def own_speed(request: ResetRequest, plant: Plant, courses: Courses) -> float:
    """Return the speed at which a vehicle begins by default, m/s.

    Bicycles begin at BICYCLE_SPEED, superbikes at START_SPEED or at START_SHARE of what they could ride: on a circuit
    at this place, on a path in its sharpest bend.

    Raises:
        ValueError: an invalid course or position. FileNotFoundError: an unknown course.
    """
    if plant.rolling or plant.envelope is None:
        return BICYCLE_SPEED
    from bike_sim.sim.followed_line import START_SHARE, START_SPEED, start_speed

    if courses.is_circuit(plant, request.course):
        followed = courses.line(plant, request.course, request.line)
        return start_speed(followed, plant.envelope, request.progress)
    if request.course == RANDOM_COURSE:
        bend = 1.0 / request.path_ranges.radius_min
    else:
        bend = float(np.abs(courses.path(request.course).curvature).max())
    most = math.sqrt(float(plant.envelope.lateral_max.min()) / bend) if bend > 0.0 else math.inf
    return min(START_SPEED, START_SHARE * most)


def begin(request: ResetRequest, plant: Plant, courses: Courses) -> Beginning:
    """Draw the course and the first state of an episode.

    Args:
        request: of the episode.
        plant: the vehicle.
        courses: source of courses.

    Raises:
        ValueError: a course that cannot be read, or an invalid start. FileNotFoundError: no such course.
    """
    if courses.is_circuit(plant, request.course):
        return _begin_on_circuit(request, plant, courses)
    if plant.road != NO_CHANGES:
        raise ValueError(f"the disturbances change the road of a circuit, and course {request.course!r} is a path")
    _check_for_path(request)
    if request.course == RANDOM_COURSE:
        rng = np.random.default_rng(request.seed)
        start = _start(request, plant, rng)
        state = start.state
        length = request.path_length or random_length(start.speed)
        pose = (state[st.X], state[st.Y], state[st.YAW] + start.direction)
        course = random_course(rng, request.path_ranges, length, pose)
        if not plant.rolling:
            state = plant.place(start, course, 0.0)
    else:
        course = courses.path(request.course)
        state = plant.place(_start(request, plant), course, 0.0)
    s = 0.0
    if request.initial_state is not None:
        state = np.array(request.initial_state, dtype=np.float64)
        s = course.nearest(*(float(state[k]) for k in (st.X, st.Y, st.YAW)))
    around = courses.around_path(course)
    return Beginning(state, course, around.surroundings, s, marks=around.marks, sections=around.sections)


def _check_for_path(request: ResetRequest) -> None:
    """Refuse what only a circuit has."""
    if request.line != IDEAL or request.progress != 0.0:
        raise ValueError(
            f"line {request.line!r} and progress {request.progress!r} m are for circuits; course {request.course!r} is "
            "a path, which is ridden from its beginning"
        )
    for name in ("speed_share", "start_offset", "start_heading"):
        if getattr(request, name) != 0.0:
            raise ValueError(f"{name} {getattr(request, name)!r} is for circuits; course {request.course!r} is a path")


def _start(request: ResetRequest, plant: Plant, rng: np.random.Generator | None = None) -> Start:
    """Return the part of a start that does not depend on the course, drawn from a generator or the request's own."""
    low, high = request.speed_range
    # A generator takes a quarter of a reset, and a learner's starts mostly leave nothing to draw.
    if rng is None and (request.perturb or low < high):
        rng = np.random.default_rng(request.seed)
    speed = float(low if rng is None else rng.uniform(low, high))
    if rng is not None and request.perturb:
        return plant.draw(rng, speed)
    return Start(st.upright_state(speed, plant.vehicle.rF), speed)


def _shared_speed(request: ResetRequest, plant: Plant, followed: FollowedLine, s: float) -> float:
    """Return the speed of a start at an arc length (m) as the asked share of the theoretical lap's, m/s."""
    if plant.envelope is None:
        raise ValueError(
            f"speed share {request.speed_share!r} is for superbikes: vehicle '{plant.vehicle.name}' has no theoretical "
            "lap; give a range of speeds"
        )
    return request.speed_share * float(followed.limit(plant.envelope).speed_at(s))


def _begin_on_circuit(request: ResetRequest, plant: Plant, courses: Courses) -> Beginning:
    followed = courses.line(plant, request.course, request.line).changed(plant.road)
    s = followed.place(request.progress)
    if request.initial_state is not None:
        state = np.array(request.initial_state, dtype=np.float64)
    else:
        start = _start(request, plant)
        if request.speed_share > 0.0:
            start = replace(start, speed=_shared_speed(request, plant, followed, s))
        state = plant.place(start, followed.line, s)
        along = followed.line.heading_at(s)
        state[st.X] -= request.start_offset * math.sin(along)
        state[st.Y] += request.start_offset * math.cos(along)
        state[st.YAW] += request.start_heading
    near, track = request.progress, followed.track
    if request.initial_state is not None:  # it may be anywhere on the circuit
        s = followed.line.nearest(state[st.X], state[st.Y], state[st.YAW], s)
        near = track.centre.nearest(state[st.X], state[st.Y], state[st.YAW], request.progress)
    return Beginning(state, followed.line, followed.surroundings, s, followed, request.progress, near)
