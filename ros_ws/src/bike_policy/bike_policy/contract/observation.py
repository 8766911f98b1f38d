"""The observation contract: terms as data, and one function for training and for driving.

A term is a named part of an observation: one number or several. An `ObservationLayout` is a tuple of terms with the
settings that they take; it travels with the policy in its card. `PATH_TERMS` and `RACE_TERMS` are all terms that there
are: of bicycles on paths, and of superbikes on circuits, all of whose numbers lie within [-1, 1].

Sources: Weyrer et al. (2026), Eqs. (1) to (6), for ``prop`` and its alternatives; the ``lean`` preview is ours. The
published superbike observation (III-A) has the terms of `PAPER_RACE`; its ranges are not published, so the scales here
are ours, chosen so that a lap fills most of [-1, 1]. The other terms are ours; `COMPACT` says why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_sim.schema import GRAVITY, LIMITS, LOOK, OPPONENT, OPPONENT_SLOTS, SIGNALS, STATE

FloatArray = NDArray[np.float64]

LAYOUT_VERSION: Final = 2
"""Grows when the meaning of a term or the form of a card changes; older policies are then refused."""

LEAST_SPEED: Final = 5.0
"""Speed below which the distance of course points and stations no longer shrinks, m/s."""
UNSEEN: Final = 0.18
"""Grip that careful riders keep in reserve where no lap has been: as much as 60 m with a factor of 0.8 in a long turn
take. With a factor of 0.9 it is 0.12."""
MOST_UNSEEN: Final = 0.3
"""Most grip that may be kept in reserve where no lap has been."""
HORIZON: Final = 6.0
"""Time that the course points look ahead, s; their scale is the distance at the present speed."""
STATIONS: Final = 20
"""Course points of each line."""
CORRIDOR: Final = (0, 1, 2, 3, 4, 6, 8, 11, 15)
"""Course points at which the corridor's width and grade are shown: denser near the vehicle."""

YAW, ROLL, STEER, ROLL_RATE, STEER_RATE = map(STATE.index, ("yaw", "roll", "steer", "roll_rate", "steer_rate"))
YAW_RATE, SPEED, PROGRESS = map(LOOK.index, ("yaw_rate", "speed", "progress"))
LATERAL_ERROR, HEADING_ERROR = map(LOOK.index, ("lateral_error", "heading_error"))
MARGINS: Final = [LIMITS.index("rear_left_margin"), LIMITS.index("rear_right_margin")]
"""Distances of the rear contact point to the left and the right limit."""
LINE, LEFT, RIGHT = 0, 1, 2
"""Rows of the course points."""

DESCRIPTOR: Final = (
    "machine_mass", "machine_wheelbase", "machine_com_height", "machine_com_x", "machine_drag",
    "machine_drive_20", "machine_drive_40", "machine_drive_60", "machine_drive_80",
)  # fmt: skip
"""Numbers of a vehicle's descriptor, scaled; `bike_policy.riders.racing.vehicle_descriptor` computes them."""


class VehicleRows(Protocol):
    """Vehicles side by side, one row each: a batch, or one snapshot as `rows_of` returns it.

    Attributes:
        state: minimal states, shape (n, 10).
        look: derived quantities, shape (n, 12).
        preview_xy: x and y of the preview points in base_footprint, m, shape (n, 2, points).
        signals: telemetry, shape (n, signals).
        circuit: position between the limits, shape (n, 8); zeros without a circuit.
        points: followed line and limits ahead, m, shape (n, 3, STATIONS, 3); zeros without a circuit.
        fallen: whether a ride is over, shape (n,).
        opponents: nearest others in a race, in the order of OPPONENT_SLOTS and OPPONENT, shape (n, 5, 5); zeros alone.
    """

    @property
    def state(self) -> FloatArray: ...  # noqa: D102
    @property
    def look(self) -> FloatArray: ...  # noqa: D102
    @property
    def preview_xy(self) -> FloatArray: ...  # noqa: D102
    @property
    def signals(self) -> FloatArray: ...  # noqa: D102
    @property
    def circuit(self) -> FloatArray: ...  # noqa: D102
    @property
    def points(self) -> FloatArray: ...  # noqa: D102
    @property
    def fallen(self) -> NDArray[np.bool_]: ...  # noqa: D102
    @property
    def opponents(self) -> FloatArray: ...  # noqa: D102


_ALONE: Final = np.zeros((1, len(OPPONENT_SLOTS), len(OPPONENT)))
_ALONE.setflags(write=False)


class Rows(NamedTuple):
    """Vehicles side by side as arrays; see `VehicleRows`."""

    state: FloatArray
    look: FloatArray
    preview_xy: FloatArray
    signals: FloatArray
    circuit: FloatArray
    points: FloatArray
    fallen: NDArray[np.bool_]
    opponents: FloatArray = _ALONE

    @classmethod
    def of_path(cls, state: FloatArray, look: FloatArray, preview_xy: FloatArray) -> Rows:
        """Return bicycles on paths, which have neither telemetry nor limits."""
        n = len(state)
        limits, points, alone = (np.repeat(array, n, axis=0) for array in (*_NO_CIRCUIT, _ALONE))
        return cls(state, look, preview_xy, np.zeros((n, 0)), limits, points, np.zeros(n, dtype=np.bool_), alone)


_NO_CIRCUIT: Final = (np.zeros((1, 8)), np.zeros((1, 3, STATIONS, 3)))


def rows_of(snapshot: Any) -> Rows:
    """Return a snapshot (`bike_sim.sim.snapshot.Snapshot`) as one row; all arrays but the preview are its own."""
    circuit = snapshot.circuit
    limits, points = _NO_CIRCUIT if circuit is None else (circuit.limits[None], circuit.points[None])
    preview = np.stack((snapshot.preview_x, snapshot.preview_y))
    columns = (snapshot.state[None], snapshot.look[None], preview[None], snapshot.signals[None])
    opponents = _ALONE if snapshot.opponents is None else snapshot.opponents[None]
    return Rows(*columns, limits, points, np.array([snapshot.fallen]), opponents)


class References(Protocol):
    """References of vehicles side by side, as `bike_policy.planning.reference.ReferenceRows` looks them up."""

    def at(self, progress: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return curvature (1/m) and asked speed (m/s) at arc lengths, m, shape (n,) or (n, k)."""


@dataclass
class RideMemory:
    """Inputs of racing policies besides the rows: what no single instant shows, and what does not change in a ride.

    Attributes:
        rolls: rolls of the decisions before, newest first, rad, shape (n, history).
        steers: steering angle of the decision before, rad, shape (n,).
        actions: the last action and the one before, shape (n, 2, 2).
        guide: last steering and throttle of the guide, its distance from the followed line (m) and its change of the
            planned speed as a part of it, shape (n, 4); zeros without one.
        vehicle: descriptor of the vehicle, in the order of DESCRIPTOR.
        grip: grip expected here and shortly ahead, grip inferred here, and standard deviation of its error, shape
            (n, 3).
        push: lateral acceleration by the wind, as it is inferred, m/s^2 to the left, shape (n,).
        references: followed lines of the vehicles.
    """

    rolls: FloatArray
    steers: FloatArray
    actions: FloatArray
    guide: FloatArray
    vehicle: FloatArray
    grip: FloatArray
    push: FloatArray
    references: References


class TermInputs(NamedTuple):
    """Inputs of a racing term's function.

    Attributes:
        rows: of the vehicles.
        memory: of their rides.
        layout: of the observation.
        speed: at least LEAST_SPEED, m/s, shape (n,).
    """

    rows: VehicleRows
    memory: RideMemory
    layout: ObservationLayout
    speed: FloatArray

    def state(self, column: int) -> FloatArray:
        """Return a column of the states."""
        return self.rows.state[:, column]

    def look(self, column: int) -> FloatArray:
        """Return a column of the derived quantities."""
        return self.rows.look[:, column]

    def signal(self, name: str) -> FloatArray:
        """Return a column of the telemetry by name."""
        return self.rows.signals[:, SIGNALS.index(name)]


Names = tuple[str, ...]
Scales = tuple[float, ...]


@dataclass(frozen=True)
class Term:
    """A named part of an observation.

    In the mirrored ride left and right change places in the names of numbers, and numbers have these signs.

    Attributes:
        unit: of its numbers before scaling, in their order; one for all if it is the same.
        function: from a path's rows and the layout, or from `TermInputs`, to values of shape (n, size).
        mirror: sign in the mirrored ride, of each number or of all. A function takes the layout.
        scale: value that counts as 1, of each number or of all.
        bound: largest magnitude of a scaled number.
        names: names of its numbers; empty for the term's own name. A function takes the layout.
        settings: fields of the layout that it takes.
    """

    unit: str
    function: Callable[..., FloatArray]
    mirror: float | Scales | Callable[[ObservationLayout], Scales] = 1.0
    scale: float | Scales = 1.0
    bound: float = 1.0
    names: Names | Callable[[ObservationLayout], Names] = ()
    settings: Names = ()

    def numbers(self, name: str, layout: ObservationLayout) -> Names:
        """Return the names of its numbers in a layout."""
        names = self.names(layout) if callable(self.names) else self.names
        return names or (name,)


# ------------------------------------------------------------------------------------------------------ terms of paths


def _wrapped(rows: VehicleRows, layout: ObservationLayout) -> FloatArray:
    yaw = rows.state[:, YAW]
    return np.arctan2(np.sin(yaw), np.cos(yaw))[:, None]


def _preview_lean(rows: VehicleRows, layout: ObservationLayout) -> FloatArray:
    """Return offset (m), lateral velocity (m/s) and tangents of the lean of a steady turn along the previewed line.

    The interval is a time, so first differences over it are lateral velocities and second differences are lateral
    accelerations of a point that runs along the line: divided by g, the tangent of a steady lean.
    """
    y, step = rows.preview_xy[:, 1], layout.preview_interval
    lean = np.empty_like(y)
    lean[:, 0] = y[:, 0]
    lean[:, 1] = (y[:, 1] - y[:, 0]) / step
    lean[:, 2:] = (y[:, 2:] - 2.0 * y[:, 1:-1] + y[:, :-2]) / (GRAVITY * step**2)
    return lean


def _preview_turn(rows: VehicleRows, layout: ObservationLayout) -> FloatArray:
    """Return the same, but of the accelerations across the line where it is, instead of across the machine.

    So a bend that the machine meets at an angle counts as what it is: linear-quadratic riders need nothing else.
    """
    turn, step = _preview_lean(rows, layout), layout.preview_interval
    ahead = np.diff(rows.preview_xy, axis=2)
    x, y = ahead[:, 0], ahead[:, 1]
    across = x[:, :-1] * y[:, 1:] - y[:, :-1] * x[:, 1:]
    turn[:, 2:] = across / (np.maximum(np.hypot(x, y)[:, :-1], LEAST_AHEAD) * GRAVITY * step**2)
    return turn


LEAST_AHEAD: Final = 1e-3
"""Distance of two preview points below which a bicycle stands, m."""


def _preview_names(layout: ObservationLayout) -> Names:
    return tuple(f"t_p{k}" for k in range(layout.preview_count))


_PREVIEW: Final = ("preview_by_time", "preview_interval", "preview_count")


def _state(name: str, bound: float = math.inf) -> Term:
    """Return a term that is a number of the state."""
    place = STATE.index(name)
    return Term(STATE[name].unit, lambda rows, _: rows.state[:, place, None], STATE[name].mirror, bound=bound)


PATH_TERMS: Final[Mapping[str, Term]] = {
    "x": _state("x"),
    "y": _state("y"),
    # As it comes from a rotation matrix: within half a turn, whatever turns the ride has made
    "yaw_wrapped": Term("rad", _wrapped, -1.0, bound=math.pi),
    # The yaw as a unit vector (Eq. 3)
    "yaw_cos": Term("1", lambda rows, _: np.cos(rows.state[:, [YAW]]), 1.0),
    "yaw_sin": Term("1", lambda rows, _: np.sin(rows.state[:, [YAW]]), -1.0),
    "roll": _state("roll", math.pi),
    # The fork has no stop: when a bicycle falls, its steering angle grows beyond any bound
    "steer": _state("steer"),
    "rear_wheel": _state("rear_wheel_angle"),
    "front_wheel": _state("front_wheel_angle"),
    "roll_rate": _state("roll_rate"),
    "steer_rate": _state("steer_rate"),
    "front_wheel_rate": _state("front_wheel_rate"),
    # t_p of Eq. (5)
    "preview_points": Term(
        "m", lambda rows, _: rows.preview_xy[:, 1], -1.0, bound=math.inf, names=_preview_names, settings=_PREVIEW
    ),
    "preview_lean": Term(
        "m, m/s, then 1", _preview_lean, -1.0, bound=math.inf, names=_preview_names, settings=_PREVIEW
    ),
    "preview_turn": Term(
        "m, m/s, then 1", _preview_turn, -1.0, bound=math.inf, names=_preview_names, settings=_PREVIEW
    ),
}
"""Terms of bicycles on paths, in SI units; a layout has factors for those that are not of order one."""


# ------------------------------------------------------------------------------------------------------ terms of races


def _numbered(names: Names, count: int, first: int = 0) -> Names:
    return tuple(f"{name}_{k}" for name in names for k in range(first, first + count))


def _stack(*columns: FloatArray) -> FloatArray:
    stacked = np.empty((*columns[0].shape, len(columns)))  # np.stack takes ten times as long
    for place, column in enumerate(columns):
        stacked[..., place] = column
    return stacked


def _telemetry(**scales: float) -> Term:
    """Return a term of signals, by name with the value that counts as 1."""
    signals, places = [SIGNALS[name] for name in scales], [SIGNALS.index(name) for name in scales]
    return Term(
        ", ".join(signal.unit for signal in signals),
        lambda s: s.rows.signals[:, places],
        tuple(float(signal.mirror) for signal in signals),
        tuple(scales.values()),
        names=tuple(signal.column for signal in signals),
    )


def _history(s: TermInputs) -> FloatArray:
    before = s.memory.rolls
    rolls = np.concatenate((s.rows.state[:, ROLL, None], before), axis=1)
    return np.concatenate((before / 1.2, (rolls[:, :-1] - rolls[:, 1:]) / 0.3), axis=1)


_POINT_NAMES: Final = tuple(
    f"{side}_{k}_{axis}" for side in ("line", "left", "right") for k in range(STATIONS) for axis in "xyz"
)


def _points(s: TermInputs) -> FloatArray:
    points, distance = s.rows.points, (HORIZON * s.speed)[:, None, None]
    scaled = np.concatenate((points[..., :2] / distance[..., None], points[..., 2:] / 30.0), axis=-1)
    return scaled.reshape(len(points), -1)


def _corridor(s: TermInputs) -> FloatArray:
    points, places = s.rows.points, np.array(CORRIDOR)
    line = points[:, LINE][:, places, :2]
    gaps = [points[:, side][:, places, :2] - line for side in (LEFT, RIGHT)]
    widths = np.stack([np.sqrt(gap[..., 0] ** 2 + gap[..., 1] ** 2) for gap in gaps], axis=-1)
    rise = points[:, LINE][:, places + 1, 2] - points[:, LINE][:, places, 2]
    grade = rise / (HORIZON / (STATIONS - 1) * s.speed)[:, None]
    return np.concatenate((widths.reshape(len(points), -1) / 15.0, grade / 0.1), axis=1)


def _stations(s: TermInputs) -> FloatArray:
    ahead = s.rows.look[:, PROGRESS, None] + s.speed[:, None] * s.layout.station_times
    curvature, target = s.memory.references.at(ahead)
    speed = s.rows.look[:, SPEED, None]
    lean = np.arctan(curvature * np.minimum(speed, target) ** 2 / GRAVITY)
    return np.concatenate((lean / 1.2, (target - speed) / 20.0), axis=1)


def _opponents(s: TermInputs) -> FloatArray:
    """Return the nearest others; distances d as d / (|d| + 10 m) ahead and d / (|d| + 2 m) across: near ones count."""
    seen = s.rows.opponents.copy()
    seen[:, :, 1:3] /= np.abs(seen[:, :, 1:3]) + np.array([10.0, 2.0])
    return seen.reshape(len(seen), -1)


_OPPONENT_NAMES: Final = tuple(f"{slot}_{name}" for slot in OPPONENT_SLOTS for name in OPPONENT.names)


def _line(s: TermInputs) -> FloatArray:
    heading = s.look(HEADING_ERROR)
    return _stack(np.sin(heading), np.cos(heading), s.look(LATERAL_ERROR))


RACE_TERMS: Final[Mapping[str, Term]] = {
    "velocity": Term(
        "m/s", lambda s: _stack(s.look(SPEED), s.signal("lateral_velocity"), s.signal("vertical_velocity")),
        (1.0, -1.0, 1.0), (100.0, 10.0, 5.0),
        names=("velocity_long", "velocity_lat", "velocity_up"),
    ),
    "angular_velocity": Term(
        "rad/s", lambda s: _stack(s.state(ROLL_RATE), s.signal("pitch_rate"), s.look(YAW_RATE)),
        (-1.0, 1.0, -1.0), (4.0, 2.0, 2.0),
        names=("roll_rate", "pitch_rate", "yaw_rate"),
    ),
    "rates": Term(
        "rad/s", lambda s: _stack(s.state(ROLL_RATE), s.look(YAW_RATE)), -1.0, (4.0, 2.0),
        names=("roll_rate", "yaw_rate"),
    ),
    "attitude": Term(
        "rad", lambda s: _stack(s.state(ROLL), s.memory.rolls[:, 0], s.state(STEER), s.memory.steers),
        -1.0, (1.2, 1.2, 0.2, 0.2), names=("roll", "roll_before", "steer", "steer_before")
    ),
    "lean_history": Term(
        "1.2 rad, then 0.3 rad", _history, -1.0,
        names=lambda layout: _numbered(("roll_before", "roll_change"), layout.history, 1), settings=("history",),
    ),
    "slips": _telemetry(rear_slip=0.3, front_slip=0.3),
    "actions": Term(
        "1", lambda s: s.memory.actions.reshape(len(s.memory.actions), -1), (-1.0, 1.0, -1.0, 1.0),
        names=("steering_1", "throttle_1", "steering_2", "throttle_2"),
    ),
    "line": Term(
        "1, 1, m", _line, (-1.0, 1.0, -1.0), (1.0, 1.0, 5.0), names=("heading_sin", "heading_cos", "lateral_error")
    ),
    "course_points": Term(
        "6 s of travel, height 30 m", _points,
        tuple(-1.0 if name.endswith("y") else 1.0 for name in _POINT_NAMES), names=_POINT_NAMES,
    ),
    "speed": Term("m/s", lambda s: s.rows.look[:, SPEED, None], 1.0, 100.0),
    "steering": Term("rad/s", lambda s: s.rows.state[:, STEER_RATE, None], -1.0, 5.0, names=("steer_rate",)),
    "loads": _telemetry(rear_load=4000.0, front_load=4000.0),
    "use": _telemetry(rear_use=2.0, front_use=2.0, rear_slip_angle=0.2, front_slip_angle=0.2),
    "accelerations": _telemetry(acceleration_long=15.0, acceleration_lat=20.0, pitch=0.3),
    "rider": _telemetry(
        lean_reference=1.2, lean_reference_rate=1.5, rider_integral=100.0, rider_slide=0.3, steer_torque=200.0
    ),
    "actuators": _telemetry(
        drive_torque=1500.0, front_brake=1200.0, rear_brake=400.0, drive_share=1.0, brake_share=1.0,
        traction_cut=1.0, wheelie_cut=1.0, front_brake_cut=1.0, rear_brake_cut=1.0,
    ),
    "limits": Term("m", lambda s: s.rows.circuit[:, MARGINS], 1.0, 15.0, names=("limit_left", "limit_right")),
    "corridor": Term(
        "15 m, then 0.1", _corridor,
        names=(
            *(f"width_{side}_{k}" for k in CORRIDOR for side in ("left", "right")), *(f"grade_{k}" for k in CORRIDOR)
        ),
    ),
    "speed_margin": Term(
        "m/s", lambda s: (s.memory.references.at(s.look(PROGRESS))[1] - s.look(SPEED))[:, None], 1.0, 20.0
    ),
    "stations": Term(
        "1.2 rad, then 20 m/s", _stations, lambda layout: (-1.0,) * layout.stations + (1.0,) * layout.stations,
        names=lambda layout: _numbered(("lean_asked", "speed_margin"), layout.stations),
        settings=("stations", "horizon", "exponent"),
    ),
    "guide": Term(
        "1, 1, m, 1", lambda s: s.memory.guide, (-1.0, 1.0, -1.0, 1.0), (1.0, 1.0, 2.0, 0.1),
        names=("guide_steering", "guide_throttle", "guide_offset", "guide_pace"),
    ),
    "grip": Term(
        "1", lambda s: s.memory.grip - (1.0, 1.0, 0.0), 1.0, (0.2, 0.2, 0.1),
        names=("grip_expected", "grip_inferred", "grip_deviation"), settings=("unseen",),
    ),
    "wind": Term("m/s^2", lambda s: s.memory.push[:, None], -1.0, 0.5, names=("wind_push",)),
    "opponents": Term(
        "1, 10 m, 2 m, m/s, m/s", _opponents, tuple(OPPONENT.mirror_signs.tolist()) * len(OPPONENT_SLOTS),
        (1.0, 1.0, 1.0, 10.0, 5.0) * len(OPPONENT_SLOTS), names=_OPPONENT_NAMES,
    ),
    "machine": Term("1", lambda s: np.tile(s.memory.vehicle, (len(s.speed), 1)), names=DESCRIPTOR),
}  # fmt: skip
"""Terms of superbikes on circuits."""

TERMS: Final[Mapping[str, Term]] = {**PATH_TERMS, **RACE_TERMS}


# ------------------------------------------------------------------------------------------------------------- layouts


@dataclass(frozen=True)
class ObservationLayout:
    """Numbers of an observation in order, their scales, and the period of decisions.

    Attributes:
        name: of the layout.
        terms: names out of PATH_TERMS, the preview the last of them, or out of RACE_TERMS; in order.
        factors: one factor for each term, besides its own scale; empty for 1 throughout.
        preview_by_time: whether the preview distance is speed times interval (Eq. 14), else the interval itself.
        preview_interval: s when by time, else m.
        preview_count: preview points, the nearest one included (n_prev + 1 of the paper).
        history: decisions of ``lean_history``.
        stations: places ahead at which ``stations`` shows the reference.
        horizon: time that they look ahead, s.
        exponent: of their times; above 1 they are denser near the vehicle.
        repeat: control periods that a decision is held.
        share: part of the planned speed that is asked.
        unseen: grip by which ``grip`` expects less where no lap has been.
        version: LAYOUT_VERSION of the code that made it.
    """

    name: str
    terms: tuple[str, ...]
    factors: tuple[float, ...] = ()
    preview_by_time: bool = True
    preview_interval: float = 0.4
    preview_count: int = 5
    history: int = 3
    stations: int = 16
    horizon: float = 5.0
    exponent: float = 1.6
    repeat: int = 1
    share: float = 1.0
    unseen: float = 0.0
    version: int = LAYOUT_VERSION

    def __post_init__(self) -> None:
        """Check that the layout means something here.

        Raises:
            ValueError: naming the value.
        """
        if self.version != LAYOUT_VERSION:
            raise ValueError(
                f"observation layout {self.name!r} has version {self.version}, this software speaks {LAYOUT_VERSION}"
            )
        known = RACE_TERMS if self.races else PATH_TERMS
        unknown = [term for term in self.terms if term not in known]
        if unknown or not self.terms or len(set(self.terms)) != len(self.terms):
            raise ValueError(f"layout {self.name!r} has terms {unknown or self.terms}; there are {', '.join(known)}")
        if self.factors and len(self.factors) != len(self.terms):
            raise ValueError(f"layout {self.name!r}: {len(self.factors)} factors for {len(self.terms)} terms")
        for name, least in (("history", 1), ("stations", 2), ("repeat", 1), ("preview_count", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or not least <= value <= 1000:
                raise ValueError(f"layout {self.name!r}: {name} must be {least} to 1000, got {value!r}")
        for name in ("horizon", "exponent", "share", "preview_interval"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"layout {self.name!r}: {name} must be positive and finite, got {value!r}")
        if not 0.0 <= self.unseen <= MOST_UNSEEN:
            raise ValueError(f"layout {self.name!r}: unseen must be 0 to {MOST_UNSEEN}, got {self.unseen!r}")
        if not self.races and not self.terms[-1].startswith("preview_"):
            raise ValueError(f"layout {self.name!r}: the last term must be a preview, got {self.terms[-1]!r}")
        leans = {"preview_lean", "preview_turn"}.intersection(self.terms)
        if leans and not (self.preview_by_time and self.preview_count >= 3):
            raise ValueError(f"layout {self.name!r}: {leans.pop()} needs a preview by time of at least 3 points")

    @property
    def races(self) -> bool:
        """Whether it is of superbikes on circuits; else of bicycles on paths."""
        return bool(self.terms) and self.terms[0] in RACE_TERMS

    @property
    def sees_others(self) -> bool:
        """Whether it shows the nearest others in a race."""
        return "opponents" in self.terms

    @cached_property
    def places(self) -> dict[str, slice]:
        """Places of each term's numbers in an observation."""
        sizes = [len(TERMS[name].numbers(name, self)) for name in self.terms]
        ends = np.cumsum(sizes).tolist()
        return {name: slice(end - size, end) for name, size, end in zip(self.terms, sizes, ends, strict=True)}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """One name for each number of the observation."""
        return tuple(number for name in self.terms for number in TERMS[name].numbers(name, self))

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        return len(self.names)

    @cached_property
    def station_times(self) -> FloatArray:
        """Times by which the stations lie ahead, s."""
        return np.asarray(self.horizon * (np.arange(self.stations) / (self.stations - 1)) ** self.exponent)

    @cached_property
    def gains(self) -> FloatArray:
        """Factor of each number of the observation, besides the scale of its term."""
        gains = np.ones(self.size)
        for name, factor in zip(self.terms, self.factors, strict=False):
            gains[self.places[name]] = factor
        return gains

    @cached_property
    def mirror_signs(self) -> NDArray[np.float32]:
        """Signs of the left/right mirrored observation, after :attr:`mirror_places`."""
        signs = np.empty(self.size, dtype=np.float32)
        for name in self.terms:
            mirror = TERMS[name].mirror
            signs[self.places[name]] = mirror(self) if callable(mirror) else mirror
        return signs

    @cached_property
    def mirror_places(self) -> NDArray[np.intp]:
        """Place from which each number of the mirrored observation is taken: left and right change places."""
        place = {name: i for i, name in enumerate(self.names)}
        swap = {"left": "right", "right": "left"}
        swapped = ("_".join(swap.get(part, part) for part in name.split("_")) for name in self.names)
        return np.array([place[name] for name in swapped], dtype=np.intp)

    @cached_property
    def high(self) -> NDArray[np.float32]:
        """Upper bounds of the observation; lower bounds are their negatives."""
        return self._bounds.astype(np.float32)

    @cached_property
    def _bounds(self) -> FloatArray:
        bounds = np.empty(self.size)
        for name in self.terms:
            bounds[self.places[name]] = TERMS[name].bound
        return bounds * np.abs(self.gains)

    @cached_property
    def _computed(self) -> tuple[tuple[slice, Callable[..., FloatArray], FloatArray | None], ...]:
        """Of each term its place, function and scales, where they are not all 1."""
        scales = {name: np.asarray(TERMS[name].scale) for name in self.terms}
        return tuple(
            (self.places[name], TERMS[name].function, None if (scale == 1.0).all() else scale)
            for name, scale in scales.items()
        )

    def observe(self, rows: VehicleRows, memory: RideMemory | None = None) -> NDArray[np.float32]:
        """Return the observations of vehicles, within their bounds, shape (n, size).

        Args:
            rows: of the vehicles; of a path with exactly the preview that the layout takes.
            memory: of their rides; None for paths.
        """
        seen = np.empty((len(rows.state), self.size))
        inputs: tuple[Any, ...] = (rows, self)
        if memory is not None:
            inputs = (TermInputs(rows, memory, self, np.maximum(rows.look[:, SPEED], LEAST_SPEED)),)
        for place, function, scale in self._computed:
            values = function(*inputs)
            seen[:, place] = values if scale is None else values / scale
        if self.factors:
            seen *= self.gains
        np.minimum(seen, self._bounds, out=seen)
        np.maximum(seen, -self._bounds, out=seen)
        return seen.astype(np.float32)

    def pick_preview(self, by_time: bool, interval: float, count: int) -> NDArray[np.intp]:
        """Return which of a simulator's preview points this layout needs.

        Args:
            by_time: whether the simulator's preview is by time.
            interval: its interval, s or m.
            count: its number of points.

        Raises:
            ValueError: the simulator's preview cannot serve this layout, naming the difference.
        """
        if not (math.isfinite(interval) and interval > 0.0):
            raise ValueError(f"the simulator's preview interval must be positive and finite, got {interval!r}")
        if by_time != self.preview_by_time:
            raise ValueError(
                f"layout {self.name!r} needs a preview by {_basis(self.preview_by_time)}, "
                f"the simulator shows one by {_basis(by_time)}"
            )
        stride = self.preview_interval / interval
        if round(stride) < 1 or abs(stride - round(stride)) > 1e-6:
            raise ValueError(
                f"layout {self.name!r} needs preview points every {self.preview_interval:g}, "
                f"which is not a multiple of the simulator's {interval:g}"
            )
        index = np.arange(self.preview_count) * round(stride)
        if index[-1] >= count:
            raise ValueError(
                f"layout {self.name!r} needs {index[-1] + 1} preview points every {interval:g}, "
                f"the simulator shows {count}"
            )
        return index

    def to_card(self) -> dict[str, Any]:
        """Return the layout as plain values for a policy card: the settings that its terms take, and no others."""
        card: dict[str, Any] = {"name": self.name, "version": self.version, "terms": list(self.terms)}
        if self.factors:
            card["factors"] = [float(factor) for factor in self.factors]
        return card | {name: getattr(self, name) for name in self._settings}

    @property
    def _settings(self) -> tuple[str, ...]:
        taken = dict.fromkeys(name for term in self.terms for name in TERMS[term].settings)
        return (*taken, "repeat", "share") if self.races else tuple(taken)

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> ObservationLayout:
        """Read a layout from a policy card.

        Raises:
            ValueError: a missing or unknown entry, or a version that this software does not speak.
        """
        version = card.get("version", LAYOUT_VERSION)
        if version != LAYOUT_VERSION:
            raise ValueError(f"observation layout has version {version!r:.20}, this software speaks {LAYOUT_VERSION}")
        unknown = sorted(set(card) - {spec.name for spec in fields(cls)})
        missing = sorted({"name", "terms", "version"} - set(card))
        lists = [name for name in ("terms", "factors") if not isinstance(card.get(name, []), (list, tuple))]
        if unknown or missing or lists:
            raise ValueError(
                f"observation layout: unknown entries {unknown}, missing entries {missing}, no lists {lists}"
            )
        terms, factors = (str(term) for term in card["terms"]), (float(factor) for factor in card.get("factors", ()))
        return cls(**{**card, "terms": tuple(terms), "factors": tuple(factors)})


def _basis(by_time: bool) -> str:
    return "time" if by_time else "distance"


_LATERAL: Final = ("roll", "steer", "roll_rate", "steer_rate", "front_wheel_rate")

PROP_LAYOUT: Final = ObservationLayout(
    "prop",
    (
        "x", "y", "yaw_cos", "yaw_sin", "roll", "steer", "rear_wheel", "front_wheel", "roll_rate", "steer_rate",
        "front_wheel_rate", "preview_points",
    ),
)  # fmt: skip
"""q' and t_p of the paper's proposed settings (Eqs. 4 to 6): 16 values, unscaled."""

LEAN_LAYOUT: Final = ObservationLayout(
    "lean",
    (*_LATERAL, "preview_lean"),
    (2.0, 2.0, 1.0, 0.5, 0.1, 1.0),
    preview_interval=0.2,
    preview_count=11,
)
"""The lateral state, speed, and the preview as offset, lateral velocity and lean: 16 values of order one.

It leaves out what steering cannot depend on: absolute position, yaw and wheel angles.
"""

FINE_LAYOUT: Final = replace(LEAN_LAYOUT, name="fine", preview_interval=0.1, preview_count=25)
"""The same with a preview of 2.4 s every 0.1 s, which shows where a bend begins: 30 values of order one."""

TURN_LAYOUT: Final = ObservationLayout(
    "turn", (*_LATERAL, "preview_turn"), LEAN_LAYOUT.factors, preview_interval=0.05, preview_count=41
)
"""The lateral state and the bends of the next 2 s in each control period: 46 values of order one."""

PAPER_RACE: Final = ObservationLayout(
    "paper_race",
    ("velocity", "angular_velocity", "attitude", "lean_history", "slips", "actions", "line", "course_points"),
    repeat=3,
)
"""The published superbike observation: motion of the vehicle now and before, and 60 points of line and limits."""

COMPACT: Final = ObservationLayout(
    "compact",
    (
        "speed", "rates", "attitude", "lean_history", "steering", "slips", "use", "loads", "accelerations", "rider",
        "actuators", "actions", "line", "limits", "corridor", "speed_margin", "stations",
    ),
    repeat=3,
)  # fmt: skip
"""Quantities that decide the next seconds, in numbers that say it directly.

Lean and speed that the line requires ahead stand in for 60 points, from which they would have to be learned; loads, use
of the tyres and lags of rider and actuators say how much is left. Stations are denser near the vehicle, for a corner
begins to within a tenth of a second.
"""

NO_LEAN_HISTORY: Final = replace(
    COMPACT, name="no_lean_history", terms=tuple(name for name in COMPACT.terms if name != "lean_history")
)
"""The same without the leans of earlier decisions: what they are worth is the difference."""

POINTS_AHEAD: Final = replace(
    COMPACT,
    name="points_ahead",
    terms=(*(name for name in COMPACT.terms if name not in ("speed_margin", "stations")), "course_points"),
)
"""The same with the published points of line and limits in place of lean and speed that the line requires."""

ADAPTIVE: Final = replace(COMPACT, name="adaptive", terms=(*COMPACT.terms, "grip", "wind", "machine"), unseen=UNSEEN)
"""Those of `COMPACT`, the inferred grip of the road, for which the reference is planned, wind, and the machine's
descriptor.

Where no lap has been, grip is kept in reserve for patches of which nobody tells."""

GUIDED: Final = replace(COMPACT, name="guided", terms=(*COMPACT.terms, "guide"))
"""Those of `COMPACT`, and the guide's commands and targets."""

CONDITIONED: Final = replace(GUIDED, name="conditioned", terms=(*GUIDED.terms, "machine"))
"""The same, and the descriptor of the vehicle: for one policy of many vehicles."""

WHEEL_TO_WHEEL: Final = replace(GUIDED, name="wheel_to_wheel", terms=(*GUIDED.terms, "opponents"))
"""Those of guided policies, and the nearest others: for races with them."""

RACE_LAYOUTS: Final[Mapping[str, ObservationLayout]] = {
    layout.name: layout
    for layout in (COMPACT, NO_LEAN_HISTORY, POINTS_AHEAD, ADAPTIVE, GUIDED, CONDITIONED, WHEEL_TO_WHEEL, PAPER_RACE)
}
"""Layouts of races by name."""
