"""Beginning of an episode: the request, and the draws of its start.

All draws of an episode come from one seed in one order, so a seed means the same ride wherever it is used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Final

import numpy as np

from bike_sim.course.course import MAX_LENGTH
from bike_sim.course.random_courses import CURRICULUM_PATHS, PathRanges
from bike_sim.physics import state as st

RANDOM_COURSE = "random"
"""Name that requests a random path instead of a file."""

IDEAL = 1.0
"""The ideal line of a circuit; 0 is its median, numbers between them blend the two."""

EPISODE_DURATION = 60.0
"""Longest episode of the training task, s (Weyrer et al. 2026, Sect. 4)."""

SEED_LIMIT = 2**62
"""Largest seed: who counts seeds up from it stays within the 64 bits of a message."""

LARGEST_SHARE = 1.2
"""Largest speed of a start as a share of the theoretical lap's."""

LARGEST_OFFSET = 1000.0
"""Largest distance of a start from the followed line, m."""

STATE_LIMIT = 1e9
"""Largest coordinate of an initial state, in m, rad or rad/s: far above any ride's, far below what overflows when
squared."""

POSITION_RANGE = 10.0
DIRECTION_RANGE = math.radians(5.0)
ROLL_RANGE = 0.01
STEER_RANGE = 0.01
ROLL_RATE_RANGE = 0.05
STEER_RATE_RANGE = 0.01
"""Half widths of the intervals of a perturbed start (Table 3 and Sect. 4.1): m, rad, rad, rad, rad/s, rad/s."""


@dataclass(frozen=True)
class Preview:
    """Points of the line ahead that a snapshot contains.

    Attributes:
        by_time: whether the distance of the points grows with speed.
        interval: distance of the points, s if by_time, else m.
        count: number of points, the nearest one included.
    """

    by_time: bool = True
    interval: float = 0.05
    count: int = 49

    def __post_init__(self) -> None:
        """Refuse intervals that are not positive and counts outside 1 to 1000."""
        if not math.isfinite(self.interval) or self.interval <= 0.0:
            raise ValueError(f"preview interval must be positive and finite, got {self.interval!r}")
        if not 1 <= self.count <= 1000:
            raise ValueError(f"preview count must be 1 to 1000, got {self.count!r}")


IN_MESSAGES: Final = (
    *("seed", "course", "perturb", "line", "progress", "speed_share", "start_offset", "start_heading"),
)
"""Fields of a request that have the same name in its message."""
_OWN: Final = -1.0
"""Line and progress of a message that keep the simulator's own."""

STATIONS: Final = 20
"""Points of each of the three lines of the course points."""

HORIZON: Final = 6.0
"""Time that the course points look ahead, s."""

COURSE_POINTS: Final = Preview(by_time=True, interval=HORIZON / (STATIONS - 1), count=STATIONS)
"""Stations of the course points: the nearest point and then one each interval, at the present speed."""


@dataclass(frozen=True)
class ResetRequest:
    """Settings with which an episode begins.

    Attributes:
        seed: seed of all draws, 0 to SEED_LIMIT.
        course: name of a shipped course, path of a YAML or CSV file, or ``"random"``.
        speed_range: forward speed is drawn from it, m/s.
        perturb: draw pose, roll, steer, rates and path direction from Table 3; else upright on the course.
        initial_state: the ten minimal coordinates, overriding speed and perturbation; the position is projected
            onto the whole course.
        path_ranges: intervals of a random path.
        path_length: least length of a random path, at most MAX_LENGTH, m; None for two episodes at the drawn speed,
            the longest ride of the training task without a reset.
        preview: preview settings.
        context: curriculum context, kept for the record only.
        line: circuits: which line is followed, 0 the median, 1 the ideal line.
        progress: circuits: where the ride begins, m along the centre line, below its length.
        speed_share: circuits, superbikes: speed of the start as a share of the theoretical lap's at that place, in
            place of one drawn from the range; 0 for the range.
        start_offset: circuits: distance of the start from the followed line, m, positive to the left.
        start_heading: circuits: yaw of the start relative to the followed line, rad, positive to the left.
    """

    seed: int = 0
    course: str = RANDOM_COURSE
    speed_range: tuple[float, float] = (4.0, 4.0)
    perturb: bool = False
    initial_state: Sequence[float] | None = None
    path_ranges: PathRanges = CURRICULUM_PATHS[-1]
    path_length: float | None = None
    preview: Preview = field(default_factory=Preview)
    context: tuple[float, ...] = ()
    line: float = IDEAL
    progress: float = 0.0
    speed_share: float = 0.0
    start_offset: float = 0.0
    start_heading: float = 0.0

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ValueError: naming the value and what it should be.
        """
        low, high = self.speed_range
        if not (math.isfinite(low) and math.isfinite(high)) or low <= 0.0 or low > high:
            raise ValueError(f"speed range must be 0 < min <= max and finite, got {low!r} to {high!r} m/s")
        if not 0 <= self.seed <= SEED_LIMIT:
            raise ValueError(f"seed must be 0 to {SEED_LIMIT} (2^62), got {self.seed}")
        if self.initial_state is not None:
            values = np.asarray(self.initial_state, dtype=np.float64)
            if values.shape != (st.STATE_SIZE,) or not np.all(np.isfinite(values)):
                raise ValueError(f"initial state must be {st.STATE_SIZE} finite numbers, got {self.initial_state!r}")
            largest = int(np.argmax(np.abs(values)))
            if abs(values[largest]) > STATE_LIMIT:
                raise ValueError(
                    f"initial state: {st.STATE_NAMES[largest]} is {float(values[largest])!r}, beyond {STATE_LIMIT:g}"
                )
        if not 0.0 <= self.line <= 1.0:
            raise ValueError(f"line must be 0 (median) to 1 (ideal line), got {self.line!r}")
        if not (math.isfinite(self.progress) and self.progress >= 0.0):
            raise ValueError(f"progress must be finite and not negative, got {self.progress!r} m")
        if not 0.0 <= self.speed_share <= LARGEST_SHARE:
            raise ValueError(
                f"speed share must be 0 (none) to {LARGEST_SHARE} of the theoretical lap's, got {self.speed_share!r}"
            )
        for name, limit, unit in (("start_offset", LARGEST_OFFSET, "m"), ("start_heading", math.pi, "rad")):
            if not abs(value := getattr(self, name)) <= limit:
                raise ValueError(f"{name} must be within {limit:.6g} {unit} of the followed line, got {value!r} {unit}")
        self._check_path_length()

    def to_card(self) -> dict[str, Any]:
        """Return plain values that :meth:`from_card` reads."""
        card = asdict(self)
        if self.initial_state is not None:
            card["initial_state"] = [float(value) for value in self.initial_state]
        return card

    @classmethod
    def from_message(cls, message: Any, own: ResetRequest | None = None) -> ResetRequest:
        """Read the request in a message of ``bike_msgs``: a reset, or how an episode began.

        Args:
            message: its seed must have been drawn already if it was negative.
            own: serves where the message leaves something open; None for the defaults.

        Raises:
            ValueError: naming the invalid value.
        """
        own = own or cls()
        values = {name: type(getattr(own, name))(getattr(message, name)) for name in IN_MESSAGES}
        values |= {name: getattr(own, name) for name in ("line", "progress") if values[name] == _OWN}
        ranges = {spec.name: float(getattr(message, spec.name)) for spec in fields(PathRanges)}
        speed = float(message.speed_min), float(message.speed_max)
        preview = own.preview
        if message.preview_count:
            preview = Preview(
                bool(message.preview_by_time), float(message.preview_interval), int(message.preview_count)
            )
        return cls(
            **values | {"course": values["course"] or own.course},
            speed_range=own.speed_range if speed == (0.0, 0.0) else speed,
            initial_state=tuple(map(float, message.initial_state)) or None,
            path_ranges=PathRanges(**ranges) if any(ranges.values()) else own.path_ranges,
            path_length=float(message.path_length) or own.path_length,
            preview=preview,
            context=tuple(map(float, message.context)),
        )

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> ResetRequest:
        """Read what :meth:`to_card` wrote, also after a round trip through JSON.

        Raises:
            TypeError: an unknown entry. KeyError: a missing one. ValueError: a value that means nothing.
        """
        low, high = card["speed_range"]
        return cls(
            **{
                **card,
                "speed_range": (low, high),
                "path_ranges": PathRanges(**card["path_ranges"]),
                "preview": Preview(**card["preview"]),
                "context": tuple(card["context"]),
            }
        )

    def _check_path_length(self) -> None:
        """Refuse random paths that would fill time and memory."""
        if self.path_length is None:
            longest = random_length(self.speed_range[1])
            if self.course == RANDOM_COURSE and longest > MAX_LENGTH:
                raise ValueError(
                    f"speed of up to {self.speed_range[1]!r} m/s asks for a random path of {longest:.6g} m, at most "
                    f"{MAX_LENGTH:g} m are possible; give a lower speed or a path length"
                )
            return
        if not math.isfinite(self.path_length) or self.path_length <= 0.0:
            raise ValueError(f"path length must be positive and finite, got {self.path_length!r} m")
        if self.path_length > MAX_LENGTH:
            raise ValueError(f"path length must be at most {MAX_LENGTH:g} m, got {self.path_length!r} m")


def random_length(speed: float) -> float:
    """Return how long a random path is by default, m: two episodes at the drawn speed (m/s)."""
    return 2.0 * EPISODE_DURATION * speed


@dataclass(frozen=True)
class Start:
    """The part of an episode's first state that does not depend on the course.

    Attributes:
        state: upright or perturbed minimal state, for a random path with its pose.
        speed: m/s.
        direction: direction of the course relative to the yaw, rad.
        roll: added to the lean of the start, rad.
    """

    state: st.StateVector
    speed: float
    direction: float = 0.0
    roll: float = 0.0


def draw_start(rng: np.random.Generator, speed: float, front_radius: float) -> Start:
    """Draw the start of a bicycle, perturbed as in Table 3 of Weyrer et al. (2026).

    Args:
        rng: draws.
        speed: m/s.
        front_radius: of the front wheel, m.
    """
    state = st.upright_state(speed, front_radius)
    state[st.X], state[st.Y] = rng.uniform(-POSITION_RANGE, POSITION_RANGE, size=2)
    state[st.YAW] = rng.uniform(-math.pi, math.pi)
    state[st.ROLL] = rng.uniform(-ROLL_RANGE, ROLL_RANGE)
    state[st.STEER] = rng.uniform(-STEER_RANGE, STEER_RANGE)
    state[st.REAR_WHEEL], state[st.FRONT_WHEEL] = rng.uniform(-math.pi, math.pi, size=2)
    state[st.ROLL_RATE] = rng.uniform(-ROLL_RATE_RANGE, ROLL_RATE_RANGE)
    state[st.STEER_RATE] = rng.uniform(-STEER_RATE_RANGE, STEER_RATE_RANGE)
    return Start(state, speed, float(rng.uniform(-DIRECTION_RANGE, DIRECTION_RANGE)))
