"""Columns of recorded messages: states, commands and telemetry, one row per message, by `bike_sim.schema`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.motion import MOTION_FIELDS
from bike_sim.schema import BIKE_STATE, FLAG, LIMITS, TELEMETRY, Quantity

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

STATE_TYPE: Final = "bike_msgs/msg/BikeState"
COMMAND_TYPE: Final = "bike_msgs/msg/BikeCommand"
TELEMETRY_TYPE: Final = "bike_msgs/msg/Telemetry"

LARGEST: Final = 1e9
"""No place, angle, rate or torque of a ride is larger, in SI units; damaged numbers mostly are."""
STATE_QUANTITIES: Final = tuple(q for q in BIKE_STATE if q.name not in ("preview_spacing", *LIMITS.names))
"""Numbers of a state that are read."""
QUANTITIES: Final[dict[str, tuple[Quantity, ...]]] = {
    STATE_TYPE: STATE_QUANTITIES,
    COMMAND_TYPE: (
        Quantity("steering", "1", -1, "in [-1, 1], positive to the left"),
        Quantity("throttle", "1", 1, "in [-1, 1], positive accelerates"),
    ),
    TELEMETRY_TYPE: TELEMETRY.quantities,
}
"""Numbers that are read, by type of the message."""
COLUMNS: Final[dict[str, tuple[str, ...]]] = {
    **{kind: ("episode", "step", *(q.name for q in quantities)) for kind, quantities in QUANTITIES.items()},
    **MOTION_FIELDS,
}
"""Fields that are read as columns, by type of the message."""


@dataclass(frozen=True)
class Table:
    """Columns of equal length, one row per message, in the order of recording.

    A column of `values` is an attribute, too: ``states.roll``. Of states and commands there are all of `QUANTITIES`,
    those that were not recorded NaN or False. Of telemetry there are the recorded ones.

    Attributes:
        order: Place of each message in the recording, counted over all topics.
        time_s: Simulated time from the message's stamp, s.
        episode: Number of the episode.
        step: Control steps since the episode's reset; of commands and telemetry those of the state they belong to.
        values: Numbers and flags by name of the message's field, in the units and signs of `bike_sim.schema`.
    """

    order: Integers
    time_s: Floats
    episode: Integers
    step: Integers
    values: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.order)

    def __getattr__(self, name: str) -> NDArray[Any]:
        values: dict[str, NDArray[Any]] = self.__dict__.get("values", {})
        if name not in values:
            raise AttributeError(f"no column {name!r}; there are {', '.join(values)}")
        return values[name]

    def take(self, rows: NDArray[Any] | slice) -> Table:
        """Select rows by mask, indices or slice."""
        values = {name: column[rows] for name, column in self.values.items()}
        return Table(self.order[rows], self.time_s[rows], self.episode[rows], self.step[rows], values)

    def with_columns(self, **columns: NDArray[Any]) -> Table:
        """The same with other values in some columns."""
        return replace(self, values=self.values | columns)


def make_table(type_name: str, order: Integers, time_s: Floats, columns: dict[str, NDArray[Any]]) -> Table:
    """A table of the columns of a type's messages, where impossible numbers become NaN; telemetry is kept as it is."""
    count = len(order)
    episode = columns.get("episode", np.ones(count)).astype(np.int64, copy=False)
    step = columns.get("step", np.arange(count)).astype(np.int64, copy=False)
    values: dict[str, NDArray[Any]] = {}
    for quantity in QUANTITIES[type_name]:
        column = columns.get(quantity.name)
        if column is None and type_name == TELEMETRY_TYPE:
            continue
        if quantity.unit == FLAG and type_name != TELEMETRY_TYPE:
            values[quantity.name] = np.zeros(count, np.bool_) if column is None else column.astype(np.bool_, copy=False)
            continue
        numbers = np.full(count, np.nan) if column is None else column.astype(np.float64, copy=False)
        if type_name != TELEMETRY_TYPE:
            numbers[~(np.abs(numbers) <= LARGEST)] = np.nan
        values[quantity.name] = numbers
    return Table(order, time_s, episode, step, values)


def empty_table(type_name: str) -> Table:
    """A table without rows."""
    return make_table(type_name, np.empty(0, np.int64), np.empty(0), {})
