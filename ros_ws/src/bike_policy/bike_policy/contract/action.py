"""The action contract: meaning, scale and mirror sign of each column of an action."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

STEERING_SET_VALUE: Final = "steering_set_value"
"""Set value of a bicycle's steering angle, positive to the left; its scale is the angle of action 1, rad."""
LEAN_REQUEST: Final = "lean_request"
"""Steering of a superbike in parts of the virtual rider's largest lean, positive to the left; scale 1 is all."""
DRIVE: Final = "throttle_and_brake"
"""Above 0 part of the engine's torque, below 0 part of the brakes' force; scale 1 is all."""

LINE_OFFSET: Final = "line_offset"
"""Target of a guide: distance from the followed line, positive to the left; its scale is in m."""
PACE: Final = "pace"
"""Target of a guide: change of the planned speed as a part of it."""

MEANINGS: Final[Mapping[str, tuple[str, float]]] = {
    STEERING_SET_VALUE: ("steering", -1.0),
    LEAN_REQUEST: ("steering", -1.0),
    DRIVE: ("throttle", 1.0),
    LINE_OFFSET: ("steering", -1.0),
    PACE: ("throttle", 1.0),
}
"""Command that each meaning drives, itself or through a guide, and its sign in the mirrored ride."""
GUIDED: Final = (LINE_OFFSET, PACE)
"""Meanings that are targets of a guide, which makes the commands."""


@dataclass(frozen=True)
class ActionColumn:
    """One number of an action.

    Attributes:
        meaning: a key of MEANINGS.
        scale: value of action 1, in the unit of the meaning.
        within: pairs of a speed (m/s, growing) and the largest value there on either side, in the unit of the meaning;
            linear between them, constant beyond them. Empty for no limit but the scale.
        rate: largest rate at which a guide's target moves, in the unit of the meaning by s; 0 for no limit.
    """

    meaning: str
    scale: float = 1.0
    within: tuple[tuple[float, float], ...] = ()
    rate: float = 0.0

    def __post_init__(self) -> None:
        """Refuse an unknown meaning, and a scale or limits that are not positive.

        Raises:
            ValueError: naming the value.
        """
        if self.meaning not in MEANINGS:
            raise ValueError(f"unknown action meaning {self.meaning!r}, this software knows {', '.join(MEANINGS)}")
        if not math.isfinite(self.scale) or self.scale <= 0.0:
            raise ValueError(f"action scale of {self.meaning} must be positive and finite, got {self.scale!r}")
        if not (math.isfinite(self.rate) and self.rate >= 0.0):
            raise ValueError(f"rate of {self.meaning} must be finite and at least 0, got {self.rate!r}")
        speeds = [speed for speed, _ in self.within]
        numbers = [number for pair in self.within for number in pair]
        if not all(math.isfinite(number) and number > 0.0 for number in numbers) or speeds != sorted(set(speeds)):
            raise ValueError(
                f"limits of {self.meaning} must be pairs of a growing speed and a value, all above 0, got {self.within}"
            )

    def factor(self, max_steer: float) -> float:
        """Return the command in [-1, 1] for action 1, before clipping.

        Args:
            max_steer: steering set point of the vehicle's command 1, rad.
        """
        return self.scale / max_steer if self.meaning == STEERING_SET_VALUE else self.scale

    def largest(self, max_steer: float, speed: NDArray[np.float64] | float) -> NDArray[np.float64] | float:
        """Return the largest command at a speed, at most 1.

        Args:
            max_steer: steering set point of the vehicle's command 1, rad.
            speed: m/s.
        """
        if not self.within:
            return 1.0
        limit = np.interp(speed, *self._limits) * (self.factor(max_steer) / self.scale)
        return np.minimum(limit, 1.0)

    @cached_property
    def _limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Speeds and limits as arrays, for a command asks for them in each control period."""
        speeds, values = np.array(self.within).T
        return speeds, values


@dataclass(frozen=True)
class ActionLayout:
    """The columns of an action in [-1, 1] and how they become commands.

    Attributes:
        columns: in order; at most one for each command.
    """

    columns: tuple[ActionColumn, ...]

    def __post_init__(self) -> None:
        """Refuse an empty layout and two columns for one command."""
        commands = [MEANINGS[column.meaning][0] for column in self.columns]
        if not commands or len(set(commands)) != len(commands):
            raise ValueError(f"an action needs one column for each command that it gives, got {commands}")
        if any(name in GUIDED for name in self.names) and self.names != GUIDED:
            raise ValueError(f"an action for a guide needs the columns {', '.join(GUIDED)}, got {self.names}")

    @classmethod
    def steering(cls, max_steer: float, within: tuple[tuple[float, float], ...] = ()) -> ActionLayout:
        """Return the layout of a bicycle: one set point of the steering angle, action 1 for `max_steer` (rad)."""
        return cls((ActionColumn(STEERING_SET_VALUE, max_steer, within),))

    @property
    def size(self) -> int:
        """Numbers in an action."""
        return len(self.columns)

    @property
    def names(self) -> tuple[str, ...]:
        """Meaning of each column."""
        return tuple(column.meaning for column in self.columns)

    @property
    def guided(self) -> bool:
        """Whether a guide makes the commands, and actions are its targets."""
        return self.names == GUIDED

    @property
    def pace(self) -> float:
        """Largest change of the planned speed that an action can ask of a guide, as a part of it; 0 without a guide."""
        return self.columns[1].scale if self.guided else 0.0

    def narrowed(self, parts: Sequence[float]) -> ActionLayout:
        """Return a layout whose actions ask for less.

        Args:
            parts: of each column's scale that remains.
        """
        pairs = zip(self.columns, parts, strict=True)
        return ActionLayout(tuple(replace(column, scale=part * column.scale) for column, part in pairs))

    def to_targets(self, actions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the targets of a guide for actions in [-1, 1], shape (n, 2).

        Returns:
            Distance from the followed line, m, positive to the left, and change of the planned speed as a part of it.
        """
        return np.asarray(actions, dtype=np.float64) * [column.scale for column in self.columns]

    @cached_property
    def mirror_signs(self) -> NDArray[np.float32]:
        """Signs that turn an action into the one of the left/right mirrored ride."""
        return np.array([MEANINGS[column.meaning][1] for column in self.columns], dtype=np.float32)

    def to_command(
        self, action: Sequence[float] | NDArray[np.floating], max_steer: float, speed: float
    ) -> tuple[float, float]:
        """Return steering and throttle in [-1, 1] for an action; 0 where no column drives the command.

        Args:
            action: in [-1, 1], shape (size,).
            max_steer: steering set point of the vehicle's command 1, rad.
            speed: of the vehicle, m/s.
        """
        commands = self.to_commands(np.asarray(action, dtype=np.float64)[None], max_steer, np.array([speed]))
        steering, throttle = commands[0].tolist()
        return steering, throttle

    def to_commands(
        self, actions: NDArray[np.floating], max_steer: float, speed: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return steering and throttle in [-1, 1] for many actions.

        Args:
            actions: in [-1, 1], shape (n, size).
            max_steer: rad.
            speed: of each vehicle, m/s, shape (n,).

        Returns:
            Steering and throttle, shape (n, 2).
        """
        commands = np.zeros((len(actions), 2))
        for i, column in enumerate(self.columns):
            place = 0 if MEANINGS[column.meaning][0] == "steering" else 1
            values = np.asarray(actions[:, i], dtype=np.float64)
            most = column.largest(max_steer, speed)
            commands[:, place] = np.clip(values * column.factor(max_steer), -most, most)
        return commands

    def to_card(self) -> dict[str, Any]:
        """Return plain values for a policy card."""
        columns = []
        for column in self.columns:
            within = {"within": [list(pair) for pair in column.within]} if column.within else {}
            rate = {"rate": float(column.rate)} if column.rate else {}
            columns.append({"meaning": column.meaning, "scale": float(column.scale), **within, **rate})
        return {"columns": columns}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> ActionLayout:
        """Read from a policy card.

        Raises:
            ValueError: a missing or unknown entry.
        """
        try:
            if set(card) != {"columns"} or any(
                set(c) - {"meaning", "scale", "within", "rate"} for c in card["columns"]
            ):
                raise KeyError
            columns = [
                (
                    str(c["meaning"]),
                    float(c["scale"]),
                    tuple((float(v), float(most)) for v, most in c.get("within", ())),
                    float(c.get("rate", 0.0)),
                )
                for c in card["columns"]
            ]
        except (KeyError, TypeError, ValueError, AttributeError):
            raise ValueError(
                "action of the card must hold a list of columns, each with meaning, scale and perhaps within, pairs of "
                f"a speed and a limit, and rate, got {card!r:.200}"
            ) from None
        return cls(tuple(ActionColumn(*column) for column in columns))
