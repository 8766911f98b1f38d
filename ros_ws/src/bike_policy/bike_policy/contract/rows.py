"""One snapshot as a row of blocks, for functions of many vehicles."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import Blocks, FloatArray


class RowBlocks(Blocks, Protocol):
    """Named blocks of vehicles side by side, as a batch has them; one row each, with what circuits and machines add.

    Attributes:
        signals: telemetry, shape (n, signals).
        place: position relative to the centre line of a circuit, m, shape (n, 4); NaN elsewhere.
        circuit: position relative to the limits, shape (n, k); NaN elsewhere.
        points: course points, m, shape (n, 3, stations, 3); NaN where there is no circuit.
        fallen: which rides are over, shape (n,).
    """

    @property
    def signals(self) -> FloatArray: ...  # noqa: D102
    @property
    def place(self) -> FloatArray: ...  # noqa: D102
    @property
    def circuit(self) -> FloatArray: ...  # noqa: D102
    @property
    def points(self) -> FloatArray: ...  # noqa: D102
    @property
    def fallen(self) -> NDArray[np.bool_]: ...  # noqa: D102


class Row(NamedTuple):
    """One row of blocks; see `RowBlocks`."""

    state: FloatArray
    look: FloatArray
    preview_y: FloatArray
    signals: FloatArray
    place: FloatArray
    circuit: FloatArray
    points: FloatArray
    fallen: NDArray[np.bool_]


def row_of(snapshot: Any) -> Row:
    """Return the row of a snapshot (`bike_sim.sim.snapshot.Snapshot`); its arrays are the snapshot's own."""
    circuit = snapshot.circuit
    place = np.full(4, np.nan) if circuit is None else circuit.place
    limits = np.full(8, np.nan) if circuit is None else circuit.limits
    points = np.full((3, 20, 3), np.nan) if circuit is None else circuit.points
    return Row(
        snapshot.state[None],
        snapshot.look[None],
        snapshot.preview_y[None],
        snapshot.signals[None],
        place[None],
        limits[None],
        points[None],
        np.array([snapshot.fallen]),
    )
