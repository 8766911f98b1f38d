"""The observation of a rider of circuits, in named blocks, all of it within [-1, 1].

Blocks of the published superbike observation (III-A): ``velocity``, ``angular_velocity``, ``attitude``,
``lean_history``, ``slips``, ``actions``, ``line`` and ``course_points``. Its ranges are not published; the scales here
are ours, chosen so that a lap fills most of [-1, 1]. The other blocks are ours; `COMPACT` says why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.reference import OPEN, Reference, ReferenceRows
from bike_policy.contract.rows import RowBlocks
from bike_sim.schema import GRAVITY

FloatArray = NDArray[np.float64]

RACE_KIND: Final = "race"
"""Value of ``kind`` in the card of such a layout; other layouts have none."""
RACE_VERSION: Final = 1
"""Grows when the meaning of a column changes; older policies are then refused."""

LEAST_SPEED: Final = 5.0
"""Speed below which the look ahead grows no shorter, m/s."""
HORIZON: Final = 6.0
"""Time that the course points look ahead, s; their scale is the way at the present speed."""
STATIONS: Final = 20
CORRIDOR: Final = (0, 1, 2, 3, 4, 6, 8, 11, 15)
"""Stations of the course points at which the compact observation sees width and grade: denser near the machine."""

YAW, ROLL, STEER, ROLL_RATE, STEER_RATE = 2, 3, 4, 7, 8
"""Places in the minimal state."""
PITCH, YAW_RATE, SPEED, PROGRESS, LATERAL_ERROR, HEADING_ERROR = 0, 1, 2, 5, 6, 7
"""Places in the derived quantities."""
REAR_LEFT, REAR_RIGHT = range(2)
"""Places in what relates to the limits: distances of the rear contact point to the left and the right one."""
LINE, LEFT, RIGHT = range(3)
"""Rows of the course points."""

MACHINE_FACTS: Final = (
    "machine_mass", "machine_wheelbase", "machine_com_height", "machine_com_x", "machine_drag",
    "machine_drive_20", "machine_drive_40", "machine_drive_60", "machine_drive_80",
)  # fmt: skip
"""What the block ``machine`` says of the machine, scaled; `bike_policy.riders.vehicle_descriptor` computes it."""


class Column(NamedTuple):
    """One number of the observation.

    Attributes:
        name: of the number. mirror: its sign in the mirrored ride.
        partner: name of the number that takes its place there, as the right limit that of the left one.
    """

    name: str
    mirror: float
    partner: str


class ObservationContext(NamedTuple):
    """What the blocks are made of.

    Attributes:
        blocks: of the vehicles. layout: of the observation. signal: telemetry by name. rolls: of the decisions before,
            newest first, rad, shape (n, history). steers: of the decision before, rad, shape (n,).
        actions: the last one and the one before, shape (n, 2, 2). references: what the vehicles follow.
        speed: at least LEAST_SPEED, m/s. guide: what `Guide.shown` says; zeros without one.
        machine: what is known of the machine, in the order of MACHINE_FACTS; the same for all rows.
    """

    blocks: RowBlocks
    layout: RaceLayout
    signal: Callable[[str], FloatArray]
    rolls: FloatArray
    steers: FloatArray
    actions: FloatArray
    references: ReferenceRows
    speed: FloatArray
    guide: FloatArray
    machine: FloatArray


class Guide(Protocol):
    """Who turns targets of a policy into commands."""

    def shown(self) -> FloatArray:
        """Return its last steering and throttle, and where it is on the way to its targets, shape (n, 4).

        The last two columns are distance from the followed line, m, and change of the planned speed as a part of it.
        """
        ...


class Block(NamedTuple):
    """A named part of the observation.

    Attributes:
        columns: of a layout.
        values: unclipped, shape (n, columns).
        signals: telemetry that it needs.
    """

    columns: Callable[[RaceLayout], list[Column]]
    values: Callable[[ObservationContext], FloatArray]
    signals: tuple[str, ...] = ()


def _own(**mirrors: float) -> Callable[[RaceLayout], list[Column]]:
    """Return columns that are their own partners, by name with the sign in the mirrored ride."""
    found = [Column(name, sign, name) for name, sign in mirrors.items()]
    return lambda layout: found


def _stack(*columns: FloatArray) -> FloatArray:
    return np.stack(columns, axis=-1)


def _signal_block(**scaled: tuple[float, float]) -> Block:
    """Return a block of telemetry: by name its scale and its sign in the mirrored ride."""

    def values(sight: ObservationContext) -> FloatArray:
        return _stack(*(sight.signal(name) / scale for name, (scale, _) in scaled.items()))

    return Block(_own(**{name: sign for name, (_, sign) in scaled.items()}), values, tuple(scaled))


def _velocity(sight: ObservationContext) -> FloatArray:
    return _stack(
        sight.blocks.look[:, SPEED] / 100.0,
        sight.signal("lateral_velocity_m_s") / 10.0,
        sight.signal("vertical_velocity_m_s") / 5.0,
    )


def _angular_velocity(sight: ObservationContext) -> FloatArray:
    return _stack(
        sight.blocks.state[:, ROLL_RATE] / 4.0,
        sight.signal("pitch_rate_rad_s") / 2.0,
        sight.blocks.look[:, YAW_RATE] / 2.0,
    )


def _rates(sight: ObservationContext) -> FloatArray:
    return _stack(sight.blocks.state[:, ROLL_RATE] / 4.0, sight.blocks.look[:, YAW_RATE] / 2.0)


def _attitude(sight: ObservationContext) -> FloatArray:
    state = sight.blocks.state
    return _stack(state[:, ROLL] / 1.2, sight.rolls[:, 0] / 1.2, state[:, STEER] / 0.2, sight.steers / 0.2)


def _history_columns(layout: RaceLayout) -> list[Column]:
    names = [f"roll_before_{k}" for k in range(1, layout.history + 1)]
    names += [f"roll_change_{k}" for k in range(1, layout.history + 1)]
    return [Column(name, -1.0, name) for name in names]


def _history(sight: ObservationContext) -> FloatArray:
    rolls = np.concatenate((sight.blocks.state[:, ROLL, None], sight.rolls), axis=1)
    return np.concatenate((sight.rolls / 1.2, (rolls[:, :-1] - rolls[:, 1:]) / 0.3), axis=1)


def _actions(sight: ObservationContext) -> FloatArray:
    return sight.actions.reshape(len(sight.actions), -1)


def _line(sight: ObservationContext) -> FloatArray:
    heading = sight.blocks.look[:, HEADING_ERROR]
    return _stack(np.sin(heading), np.cos(heading), sight.blocks.look[:, LATERAL_ERROR] / 5.0)


def _point_columns(layout: RaceLayout) -> list[Column]:
    mirrored = {"line": "line", "left": "right", "right": "left"}
    return [
        Column(f"{side}_{k}_{axis}", -1.0 if axis == "y" else 1.0, f"{mirrored[side]}_{k}_{axis}")
        for side in mirrored
        for k in range(STATIONS)
        for axis in "xyz"
    ]


def _points(sight: ObservationContext) -> FloatArray:
    points = sight.blocks.points
    way = (HORIZON * sight.speed)[:, None, None]
    scaled = np.concatenate((points[..., :2] / way[..., None], points[..., 2:] / 30.0), axis=-1)
    return scaled.reshape(len(points), -1)


def _limits_columns(layout: RaceLayout) -> list[Column]:
    return [Column("limit_left", 1.0, "limit_right"), Column("limit_right", 1.0, "limit_left")]


def _limits(sight: ObservationContext) -> FloatArray:
    return sight.blocks.circuit[:, [REAR_LEFT, REAR_RIGHT]] / 15.0


def _corridor_columns(layout: RaceLayout) -> list[Column]:
    found = []
    for k in CORRIDOR:
        found += [
            Column(f"width_left_{k}", 1.0, f"width_right_{k}"),
            Column(f"width_right_{k}", 1.0, f"width_left_{k}"),
        ]
    return found + [Column(f"grade_{k}", 1.0, f"grade_{k}") for k in CORRIDOR]


def _corridor(sight: ObservationContext) -> FloatArray:
    points, places = sight.blocks.points, np.array(CORRIDOR)
    line = points[:, LINE][:, places, :2]
    gaps = [points[:, side][:, places, :2] - line for side in (LEFT, RIGHT)]
    widths = np.stack([np.sqrt(gap[..., 0] ** 2 + gap[..., 1] ** 2) for gap in gaps], axis=-1)
    rise = points[:, LINE][:, places + 1, 2] - points[:, LINE][:, places, 2]
    grade = rise / (HORIZON / (STATIONS - 1) * sight.speed)[:, None]
    return np.concatenate((widths.reshape(len(points), -1) / 15.0, grade / 0.1), axis=1)


def _margin(sight: ObservationContext) -> FloatArray:
    _, asked = sight.references.at(sight.blocks.look[:, PROGRESS])
    return ((asked - sight.blocks.look[:, SPEED]) / 20.0)[:, None]


def _station_columns(layout: RaceLayout) -> list[Column]:
    leans = [Column(f"lean_asked_{j}", -1.0, f"lean_asked_{j}") for j in range(layout.stations)]
    return leans + [Column(f"speed_margin_{j}", 1.0, f"speed_margin_{j}") for j in range(layout.stations)]


def _stations(sight: ObservationContext) -> FloatArray:
    ahead = sight.blocks.look[:, PROGRESS, None] + sight.speed[:, None] * sight.layout.station_times
    curvature, asked = sight.references.at(ahead)
    speed = sight.blocks.look[:, SPEED, None]
    lean = np.arctan(curvature * np.minimum(speed, asked) ** 2 / GRAVITY)
    return np.concatenate((lean / 1.2, (asked - speed) / 20.0), axis=1)


BLOCKS: Final[Mapping[str, Block]] = {
    "velocity": Block(
        _own(velocity_long=1.0, velocity_lat=-1.0, velocity_up=1.0),
        _velocity,
        ("lateral_velocity_m_s", "vertical_velocity_m_s"),
    ),
    "angular_velocity": Block(
        _own(roll_rate=-1.0, pitch_rate=1.0, yaw_rate=-1.0), _angular_velocity, ("pitch_rate_rad_s",)
    ),
    "rates": Block(_own(roll_rate=-1.0, yaw_rate=-1.0), _rates),
    "attitude": Block(_own(roll=-1.0, roll_before=-1.0, steer=-1.0, steer_before=-1.0), _attitude),
    "lean_history": Block(_history_columns, _history),
    "slips": _signal_block(rear_slip=(0.3, 1.0), front_slip=(0.3, 1.0)),
    "actions": Block(_own(steering_1=-1.0, throttle_1=1.0, steering_2=-1.0, throttle_2=1.0), _actions),
    "line": Block(_own(heading_sin=-1.0, heading_cos=1.0, lateral_error=-1.0), _line),
    "course_points": Block(_point_columns, _points),
    "speed": Block(_own(speed=1.0), lambda sight: sight.blocks.look[:, SPEED, None] / 100.0),
    "steer_rate": Block(_own(steer_rate=-1.0), lambda sight: sight.blocks.state[:, STEER_RATE, None] / 5.0),
    "loads": _signal_block(rear_load_n=(4000.0, 1.0), front_load_n=(4000.0, 1.0)),
    "use": _signal_block(
        rear_use=(2.0, 1.0), front_use=(2.0, 1.0), rear_slip_angle_rad=(0.2, -1.0), front_slip_angle_rad=(0.2, -1.0)
    ),
    "accelerations": _signal_block(
        acceleration_long_m_s2=(15.0, 1.0), acceleration_lat_m_s2=(20.0, -1.0), pitch_rad=(0.3, 1.0)
    ),
    "rider": _signal_block(
        lean_reference_rad=(1.2, -1.0), lean_reference_rate_rad_s=(1.5, -1.0), rider_integral_nm=(100.0, -1.0),
        rider_slide_m=(0.3, -1.0), steer_torque_nm=(200.0, -1.0),
    ),
    "actuators": _signal_block(
        drive_torque_nm=(1500.0, 1.0), front_brake_nm=(1200.0, 1.0), rear_brake_nm=(400.0, 1.0),
        drive_share=(1.0, 1.0), brake_share=(1.0, 1.0), traction_cut=(1.0, 1.0), wheelie_cut=(1.0, 1.0),
        front_brake_cut=(1.0, 1.0), rear_brake_cut=(1.0, 1.0),
    ),
    "limits": Block(_limits_columns, _limits),
    "corridor": Block(_corridor_columns, _corridor),
    "speed_margin": Block(_own(speed_margin=1.0), _margin),
    "stations": Block(_station_columns, _stations),
    "guide": Block(
        _own(guide_steering=-1.0, guide_throttle=1.0, guide_offset=-1.0, guide_pace=1.0),
        lambda sight: sight.guide / [1.0, 1.0, 2.0, 0.1],
    ),
    "machine": Block(
        _own(**dict.fromkeys(MACHINE_FACTS, 1.0)),
        lambda sight: np.tile(sight.machine, (len(sight.speed), 1)),
    ),
}  # fmt: skip
"""All blocks by name."""


@dataclass(frozen=True)
class RaceLayout:
    """Which blocks a policy sees, in which order; the counterpart of `ObservationLayout` on circuits.

    Attributes:
        name: of the layout.
        blocks: keys of BLOCKS.
        history: leans of earlier decisions that are seen.
        stations: of the block ``stations``: station j lies ahead by speed times horizon (j / (stations - 1))^exponent.
        horizon: s.
        exponent: above 1 they are denser near the machine.
        repeat: control periods that a decision is held.
        share: part of the planned speed that is asked where nothing else says so: the knob of a finished policy.
        version: RACE_VERSION of the code that made it.
    """

    name: str
    blocks: tuple[str, ...]
    history: int = 3
    stations: int = 16
    horizon: float = 5.0
    exponent: float = 1.6
    repeat: int = 3
    share: float = 1.0
    version: int = RACE_VERSION

    def __post_init__(self) -> None:
        """Check that the layout means something here.

        Raises:
            ValueError: naming the value.
        """
        if self.version != RACE_VERSION:
            raise ValueError(f"layout {self.name!r} has version {self.version}, this software speaks {RACE_VERSION}")
        unknown = [block for block in self.blocks if block not in BLOCKS]
        if unknown or not self.blocks or len(set(self.blocks)) != len(self.blocks):
            raise ValueError(
                f"layout {self.name!r} names blocks {unknown or self.blocks}; there are {', '.join(BLOCKS)}"
            )
        for name, least in (("history", 1), ("stations", 2), ("repeat", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or not least <= value <= 1000:
                raise ValueError(f"layout {self.name!r}: {name} must be {least} to 1000, got {value!r}")
        for name in ("horizon", "exponent", "share"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"layout {self.name!r}: {name} must be positive and finite, got {value!r}")

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """All numbers of the observation, in order."""
        return tuple(column for block in self.blocks for column in BLOCKS[block].columns(self))

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        return len(self.columns)

    @property
    def names(self) -> tuple[str, ...]:
        """One name for each number of the observation."""
        return tuple(column.name for column in self.columns)

    @property
    def signals(self) -> tuple[str, ...]:
        """Telemetry that the blocks need."""
        return tuple(dict.fromkeys(name for block in self.blocks for name in BLOCKS[block].signals))

    @cached_property
    def station_times(self) -> FloatArray:
        """How far ahead the stations lie, s."""
        return np.asarray(self.horizon * (np.arange(self.stations) / (self.stations - 1)) ** self.exponent)

    @property
    def mirror_signs(self) -> NDArray[np.float32]:
        """Signs of the left/right mirrored observation, after :attr:`mirror_places`."""
        return np.array([column.mirror for column in self.columns], dtype=np.float32)

    @property
    def mirror_places(self) -> NDArray[np.intp]:
        """Where each number of the mirrored observation is taken from: limits change sides."""
        place = {name: i for i, name in enumerate(self.names)}
        return np.array([place[column.partner] for column in self.columns], dtype=np.intp)

    @property
    def high(self) -> NDArray[np.float32]:
        """Upper bounds of the observation; lower bounds are their negatives."""
        return np.ones(self.size, dtype=np.float32)

    def to_card(self) -> dict[str, Any]:
        """Return the layout as plain values for a policy card."""
        return {"kind": RACE_KIND, **asdict(self), "blocks": list(self.blocks)}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> RaceLayout:
        """Read a layout from a policy card.

        Raises:
            ValueError: a missing or unknown entry, or a version that this software does not speak.
        """
        values = {name: value for name, value in card.items() if name != "kind"}
        unknown = sorted(set(values) - {spec.name for spec in fields(cls)})
        missing = sorted({"name", "blocks", "version"} - set(values))
        if unknown or missing or not isinstance(values["blocks"], (list, tuple)):
            raise ValueError(f"race layout: unknown entries {unknown}, missing entries {missing}")
        return cls(**{**values, "blocks": tuple(str(block) for block in values["blocks"])})


class ObservationBuilder:
    """Makes the observations of vehicles side by side, and remembers what no single instant shows.

    Attributes:
        layout: of the observation. references: what the vehicles follow. guide: who makes the commands, or None.
        machine: what is known of the machine.
    """

    def __init__(
        self,
        layout: RaceLayout,
        count: int,
        signal_names: Sequence[str],
        guide: Guide | None = None,
        machine: FloatArray | None = None,
    ) -> None:
        """Prepare to see.

        Args:
            layout: of the observation.
            count: number of vehicles.
            signal_names: of the telemetry that they have.
            guide: who turns the policy's targets into commands, if somebody does.
            machine: what is known of the machine, in the order of MACHINE_FACTS.

        Raises:
            ValueError: telemetry that the layout needs is missing, or a guide, or the machine.
        """
        if guide is None and "guide" in layout.blocks:
            raise ValueError(f"layout {layout.name!r} shows what the guide does, and there is none")
        if machine is None and "machine" in layout.blocks:
            raise ValueError(f"layout {layout.name!r} shows what the machine is, and nothing is known of it")
        self.guide = guide
        self.machine = np.zeros(len(MACHINE_FACTS)) if machine is None else machine
        missing = [name for name in layout.signals if name not in signal_names]
        if missing:
            raise ValueError(f"layout {layout.name!r} needs telemetry {missing}, which this vehicle does not have")
        self.layout, self.references = layout, ReferenceRows(count)
        self._places = {name: place for place, name in enumerate(signal_names)}
        self.rolls = np.zeros((count, layout.history))
        self.steers = np.zeros(count)
        self.actions = np.zeros((count, 2, 2))

    def begin(
        self, row: int, blocks: RowBlocks, reference: Reference, share: float | None = None, cap: float = OPEN
    ) -> None:
        """Begin a ride of one vehicle.

        Args:
            row: of the vehicle.
            blocks: of all vehicles, after its reset.
            reference: what it follows.
            share: part of the planned speed that is asked; None for that of the layout.
            cap: speed limit, m/s.
        """
        self.references.begin(row, reference, self.layout.share if share is None else share, cap)
        state = blocks.state[row]
        self.rolls[row], self.steers[row], self.actions[row] = state[ROLL], state[STEER], 0.0

    def observe(self, blocks: RowBlocks) -> NDArray[np.float32]:
        """Return the observations, shape (n, layout.size)."""

        def signal(name: str) -> FloatArray:
            return blocks.signals[:, self._places[name]]

        speed = np.maximum(blocks.look[:, SPEED], LEAST_SPEED)
        guide = np.zeros((len(speed), 4)) if self.guide is None else self.guide.shown()
        remembered = (self.rolls, self.steers, self.actions, self.references)
        sight = ObservationContext(blocks, self.layout, signal, *remembered, speed, guide, self.machine)
        parts = [BLOCKS[block].values(sight) for block in self.layout.blocks]
        return np.clip(np.concatenate(parts, axis=1), -1.0, 1.0).astype(np.float32)

    def act(self, blocks: RowBlocks, actions: NDArray[np.floating]) -> None:
        """Remember a decision.

        Args:
            blocks: that were seen.
            actions: that were chosen, in [-1, 1], shape (n, 2).
        """
        self.rolls[:, 1:] = self.rolls[:, :-1].copy()
        self.rolls[:, 0] = blocks.state[:, ROLL]
        self.steers[:] = blocks.state[:, STEER]
        self.actions[:, 1] = self.actions[:, 0]
        self.actions[:, 0] = actions

    def state_dict(self) -> dict[str, Any]:
        """Return the memory, as arrays."""
        return {name: getattr(self, name).copy() for name in _REMEMBERED}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Take up the memory that :meth:`state_dict` returned."""
        for name in _REMEMBERED:
            getattr(self, name)[...] = stored[name]


_REMEMBERED: Final = ("rolls", "steers", "actions")


PAPER_RACE: Final = RaceLayout(
    "paper_race",
    ("velocity", "angular_velocity", "attitude", "lean_history", "slips", "actions", "line", "course_points"),
)
"""The published superbike observation: what the machine does, what it did, and 60 points of line and limits."""

COMPACT: Final = RaceLayout(
    "compact",
    (
        "speed", "rates", "attitude", "lean_history", "steer_rate", "slips", "use", "loads",
        "accelerations", "rider", "actuators", "actions", "line", "limits", "corridor", "speed_margin",
        "stations",
    ),
)  # fmt: skip
"""What decides the next seconds, in numbers that say it directly.

Lean and speed that the line asks for ahead stand in for 60 points, from which they would have to be learned; loads, use
of the tyres and lags of rider and actuators tell how much is left. Stations are denser near the machine, for a corner
begins to within a tenth of a second.
"""
GUIDED: Final = RaceLayout("guided", (*COMPACT.blocks, "guide"))
"""The same, and what the guide does."""
TOLD: Final = RaceLayout("told", (*GUIDED.blocks, "machine"))
"""The same, and what the machine is: for one policy of many machines."""
RACE_LAYOUTS: Final[Mapping[str, RaceLayout]] = {layout.name: layout for layout in (COMPACT, GUIDED, TOLD, PAPER_RACE)}
"""Shipped layouts by name."""
