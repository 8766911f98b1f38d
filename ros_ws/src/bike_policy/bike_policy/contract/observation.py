"""The observation contract: one function for training and for driving.

An :class:`ObservationLayout` names the features that a policy sees, their scale, and the preview points it needs. It
travels with the policy in its card, so that a simulator that shows something else is refused by name.

Source: Weyrer et al. (2026), Eqs. (1) to (6), for ``prop`` and the alternatives; the ``lean`` preview is new.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from typing import Any, Final, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_sim.schema import GRAVITY

FloatArray = NDArray[np.float64]

LAYOUT_VERSION: Final = 1
"""Grows when the meaning of a feature changes; older policies are then refused."""


class Blocks(Protocol):
    """Named blocks from which observations are computed: one snapshot, or many with leading dimensions.

    Attributes:
        state: minimal state (bike_sim.physics.state), shape (..., 10).
        look: derived quantities (bike_sim.sim.look), shape (..., 12).
        preview_y: lateral offsets of the preview points in base_link, m, shape (..., points).
    """

    @property
    def state(self) -> FloatArray: ...  # noqa: D102
    @property
    def look(self) -> FloatArray: ...  # noqa: D102
    @property
    def preview_y(self) -> FloatArray: ...  # noqa: D102


class SeenBlocks(NamedTuple):
    """Blocks that come from neither a simulator nor a batch, as from a recording; see `Blocks`."""

    state: FloatArray
    look: FloatArray
    preview_y: FloatArray


class Feature(NamedTuple):
    """One number of a block.

    Attributes:
        block: name of the block.
        place: index in the block.
        mirror: sign in the mirrored ride.
        bound: largest magnitude. The fork has no stop: when a bicycle falls, its steering angle grows beyond any.
        turn: function that is applied to it, or None.
    """

    block: str
    place: int
    mirror: float
    bound: float = math.inf
    turn: Callable[[FloatArray], FloatArray] | None = None


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return angles within [-pi, pi], odd in the angle."""
    return np.arctan2(np.sin(angle), np.cos(angle))


_FEATURES: Final[Mapping[str, Feature]] = {
    "x": Feature("state", 0, 1.0),
    "y": Feature("state", 1, -1.0),
    "yaw": Feature("state", 2, -1.0),
    # As it comes from a rotation matrix: within half a turn, whatever turns the ride has made
    "yaw_wrapped": Feature("state", 2, -1.0, math.pi, _wrapped),
    "roll": Feature("state", 3, -1.0, math.pi),
    "steer": Feature("state", 4, -1.0),
    "rear_wheel": Feature("state", 5, 1.0),
    "front_wheel": Feature("state", 6, 1.0),
    "roll_rate": Feature("state", 7, -1.0),
    "steer_rate": Feature("state", 8, -1.0),
    "front_wheel_rate": Feature("state", 9, 1.0),
    # The yaw as a unit vector (Eq. 3)
    "yaw_cos": Feature("state", 2, 1.0, 1.0, np.cos),
    "yaw_sin": Feature("state", 2, -1.0, 1.0, np.sin),
    "pitch": Feature("look", 0, 1.0, math.pi),
    "yaw_rate": Feature("look", 1, -1.0),
    "speed": Feature("look", 2, 1.0),
    "lateral_error": Feature("look", 6, -1.0),
    "heading_error": Feature("look", 7, -1.0, math.pi),
    "curvature": Feature("look", 8, -1.0),
    "front_lateral_error": Feature("look", 10, -1.0),
}

FEATURES: Final = tuple(_FEATURES)
"""Names of all features that a layout can hold, before the preview."""


@dataclass(frozen=True)
class ObservationLayout:
    """Which numbers a policy sees, in which order and scale.

    Attributes:
        name: name of the layout.
        features: names out of FEATURES, in order.
        scales: one factor a feature; the observation holds feature times scale.
        preview_by_time: preview distance is speed times interval (Eq. 14), else the interval itself.
        preview_interval: s when by time, else m.
        preview_count: preview values, the nearest point included (n_prev + 1 of the paper).
        preview_kind: ``points`` is t_p of Eq. (5), lateral offsets in m. ``lean`` is their linear transform into
            offset (m), lateral velocity (m/s) and, from second differences, the tangent of the lean that a steady
            turn along the previewed line requires. It needs a
            preview by time.
        preview_scale: factor of ``points``.
        version: LAYOUT_VERSION of the code that made it.
    """

    name: str
    features: tuple[str, ...]
    scales: tuple[float, ...]
    preview_by_time: bool = True
    preview_interval: float = 0.4
    preview_count: int = 5
    preview_kind: Literal["points", "lean"] = "points"
    preview_scale: float = 1.0
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
        unknown = [feature for feature in self.features if feature not in FEATURES]
        if unknown:
            raise ValueError(f"observation layout {self.name!r} names unknown features {unknown}")
        if len(self.scales) != len(self.features):
            raise ValueError(f"layout {self.name!r}: {len(self.scales)} scales for {len(self.features)} features")
        if not (math.isfinite(self.preview_interval) and self.preview_interval > 0.0 and self.preview_count >= 1):
            raise ValueError(
                f"layout {self.name!r}: preview interval {self.preview_interval!r} and count {self.preview_count!r} "
                "must be positive"
            )
        if self.preview_kind not in ("points", "lean"):
            raise ValueError(f"layout {self.name!r}: preview kind must be points or lean, got {self.preview_kind!r}")
        if self.preview_kind == "lean" and not (self.preview_by_time and self.preview_count >= 3):
            raise ValueError(f"layout {self.name!r}: a lean preview needs a preview by time of at least 3 points")

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        return len(self.features) + self.preview_count

    @property
    def names(self) -> tuple[str, ...]:
        """One name for each number of the observation."""
        return self.features + tuple(f"t_p{k}" for k in range(self.preview_count))

    @cached_property
    def _gathered(self) -> tuple[tuple[str, NDArray[np.intp], NDArray[np.intp]], ...]:
        """For each block in use: its name, the source indices and the target indices, for one gather per step."""
        used = [_FEATURES[name] for name in self.features]
        blocks = dict.fromkeys(feature.block for feature in used)
        found = []
        for block in blocks:
            rows = [i for i, feature in enumerate(used) if feature.block == block]
            places = np.array([used[i].place for i in rows], dtype=np.intp)
            found.append((block, places, np.array(rows, dtype=np.intp)))
        return tuple(found)

    @cached_property
    def _factors(self) -> FloatArray:
        return np.array(self.scales, dtype=np.float64)

    @cached_property
    def _turns(self) -> tuple[tuple[int, Callable[[FloatArray], FloatArray]], ...]:
        turns = ((i, _FEATURES[name].turn) for i, name in enumerate(self.features))
        return tuple((i, turn) for i, turn in turns if turn is not None)

    def observe(self, blocks: Blocks, picked: NDArray[np.intp] | None = None) -> NDArray[np.float32]:
        """Make the observation of one vehicle or of a batch.

        Args:
            blocks: of a snapshot or a batch.
            picked: which of its preview points this layout takes, from :meth:`pick_preview`; None where they are
                exactly those.

        Returns:
            float32 array of shape (..., size).
        """
        state, preview_y = blocks.state, blocks.preview_y
        if picked is not None:
            preview_y = preview_y[..., picked]
        count = len(self.features)
        out = np.empty((*state.shape[:-1], self.size), dtype=np.float32)
        if len(self._gathered) == 1 and self._gathered[0][0] == "state":
            values = state[..., self._gathered[0][1]]
        else:
            values = np.empty((*state.shape[:-1], count))
            for block, places, rows in self._gathered:
                values[..., rows] = getattr(blocks, block)[..., places]
        for i, turn in self._turns:
            values[..., i] = turn(values[..., i])
        out[..., :count] = values * self._factors
        preview = out[..., count:]
        if self.preview_kind == "points":
            preview[...] = preview_y * self.preview_scale
        else:
            # The interval is a time, so first differences over it are lateral velocities and second differences are
            # lateral accelerations of a point that runs along the line: divided by g, the tangent of a steady lean.
            step = self.preview_interval
            preview[..., 0] = preview_y[..., 0]
            preview[..., 1] = (preview_y[..., 1] - preview_y[..., 0]) / step
            second = preview_y[..., 2:] - 2.0 * preview_y[..., 1:-1] + preview_y[..., :-2]
            preview[..., 2:] = second / (GRAVITY * step**2)
        return out

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

    @property
    def mirror_signs(self) -> NDArray[np.float32]:
        """Signs that turn an observation into the one of the left/right mirrored ride about the map's x axis."""
        signs = [_FEATURES[name].mirror for name in self.features]
        return np.array(signs + [-1.0] * self.preview_count, dtype=np.float32)

    @property
    def mirror_places(self) -> NDArray[np.intp]:
        """Where each number of the mirrored observation is taken from: its own place."""
        return np.arange(self.size, dtype=np.intp)

    @property
    def high(self) -> NDArray[np.float32]:
        """Upper bounds of the observation; lower bounds are their negatives."""
        bounds = [_FEATURES[name].bound for name in self.features]
        scaled = [bound * abs(scale) for bound, scale in zip(bounds, self.scales, strict=True)]
        return np.array(scaled + [math.inf] * self.preview_count, dtype=np.float32)

    def to_card(self) -> dict[str, Any]:
        """Return the layout as plain values for a policy card."""
        card = asdict(self)
        card["features"] = list(self.features)
        card["scales"] = [float(scale) for scale in self.scales]
        return card

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> ObservationLayout:
        """Read a layout from a policy card.

        Raises:
            ValueError: a missing or unknown entry, or a version that this software does not speak.
        """
        known = {spec.name for spec in fields(cls)}
        unknown = sorted(set(card) - known)
        missing = sorted({"name", "features", "scales", "version"} - set(card))
        if unknown or missing:
            raise ValueError(f"observation layout: unknown entries {unknown}, missing entries {missing}")
        values = dict(card)
        values["features"] = tuple(values["features"])
        values["scales"] = tuple(float(scale) for scale in values["scales"])
        return cls(**values)


def _basis(by_time: bool) -> str:
    return "time" if by_time else "distance"


_MINIMAL = (
    "x",
    "y",
    "yaw",
    "roll",
    "steer",
    "rear_wheel",
    "front_wheel",
    "roll_rate",
    "steer_rate",
    "front_wheel_rate",
)
_REDUNDANT = ("x", "y", "yaw_cos", "yaw_sin", *_MINIMAL[3:])
_LATERAL = ("roll", "steer", "roll_rate", "steer_rate", "front_wheel_rate")

PROP_LAYOUT: Final = ObservationLayout("prop", _REDUNDANT, (1.0,) * len(_REDUNDANT))
"""q' and t_p of the paper's proposed settings (Eqs. 4 to 6): 16 values, unscaled."""

LEAN_LAYOUT: Final = ObservationLayout(
    "lean",
    _LATERAL,
    (2.0, 2.0, 1.0, 0.5, 0.1),
    preview_interval=0.2,
    preview_count=11,
    preview_kind="lean",
)
"""The lateral state, speed, and the preview as offset, lateral velocity and lean: 16 values of order one.

It leaves out what steering cannot depend on: absolute position, yaw and wheel angles.
"""

FINE_LAYOUT: Final = replace(LEAN_LAYOUT, name="fine", preview_interval=0.1, preview_count=25)
"""The same with a preview of 2.4 s every 0.1 s, which shows where a bend begins: 30 values of order one."""
