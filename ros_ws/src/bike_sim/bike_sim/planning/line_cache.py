"""Circuits with a machine's ideal line, computed once and kept on disk.

The line depends on the circuit, the machine's limits and the method; a file's name is a hash over all of that, so a
changed circuit, machine or method never meets an old line.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.files import load_track
from bike_sim.course.track import Track
from bike_sim.planning import lap_limit
from bike_sim.planning.envelope import Envelope

FOLDER_VARIABLE = "BIKE_CACHE"
"""Environment variable that names another folder for computed lines."""

METHOD = 3
"""Version of the method; a change of the solver that gives other lines raises it."""

MARGIN = 0.9
"""Distance that a line to be ridden keeps from the limits, m: what a good rider strays from it."""

ROLL_COST = 0.02
"""Cost of rolling on a line to be ridden, see `minimum_time.ROLL_COST`; more gives chicanes that are easier to
follow and slower."""


def cache_folder() -> Path:
    """Return the folder of computed lines: $BIKE_CACHE, else ``bike/lines`` in the user's cache folder."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "bike" / "lines"


def track_with_line(
    circuit: str | Path, envelope: Envelope | None, margin: float = MARGIN, roll_cost: float = ROLL_COST
) -> Track:
    """Load a circuit and give it the machine's fastest line.

    Args:
        circuit: name of a shipped circuit, or path of a YAML or CSV file.
        envelope: the machine's limits; None for a vehicle without, whose ideal line is the one of least curvature.
        margin: distance that the line keeps from the limits, m.
        roll_cost: what rolling costs on it.

    Raises:
        FileNotFoundError: no such circuit.
        ValueError: a broken file, or no line between its limits.
    """
    track = load_track(circuit)
    path = cache_folder() / f"{content_key(track, envelope, margin, roll_cost)}.npy"
    offset = read_column(path, len(track.centre.s))
    if offset is not None:
        return track.with_ideal(offset)
    # Late: a start that finds its line is spared the solvers.
    if envelope is None:
        from bike_sim.course import racing_line

        track = racing_line.with_ideal_line(track, margin=margin)
    else:
        from bike_sim.planning.minimum_time import with_fastest_line

        track = with_fastest_line(track, envelope, margin=margin, roll_cost=roll_cost)
    assert track.ideal is not None
    write_column(path, track.ideal)
    return track


def closest_lap(circuit: str | Path, envelope: Envelope) -> float:
    """Return the theoretical lap on the closest line, s: nearer to the limits than one rides, whatever rolling it asks.

    Args:
        circuit: name of a shipped circuit, or path of a YAML or CSV file.
        envelope: the machine's limits.

    Raises:
        FileNotFoundError: no such circuit.
        ValueError: a broken file, or no line between its limits.
    """
    from bike_sim.course import racing_line
    from bike_sim.planning import minimum_time

    track = track_with_line(circuit, envelope, racing_line.MARGIN, minimum_time.ROLL_COST)
    return lap_limit.lap_limit(envelope, track.line(1.0)).lap_time


def content_key(track: Track, envelope: Envelope | None, margin: float = MARGIN, roll_cost: float = ROLL_COST) -> str:
    """Return the hash over everything that a line depends on."""
    digest = hashlib.sha256(f"method {METHOD}".encode())
    centre = track.centre
    columns = [centre.x, centre.y, centre.heading, centre.curvature, track.width_left, track.width_right]
    if envelope is None:
        columns.append(np.array([margin]))
    else:
        columns.append(np.array([margin, roll_cost]))
        digest.update(envelope.digest())
    for column in columns:
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()[:32]


def read_column(path: Path, count: int) -> NDArray[np.float64] | None:
    """Return the values of a line's samples in a file, or None if there are none that could be right."""
    try:
        values = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    sound = isinstance(values, np.ndarray) and values.shape == (count,) and bool(np.isfinite(values).all())
    return values if sound else None


def write_column(path: Path, values: NDArray[np.float64]) -> None:
    """Keep values; where nothing can be written the next call computes them again."""
    scratch = path.with_name(f"{path.stem}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch.open("wb") as stream:
            np.save(stream, values)
        scratch.replace(path)
    except OSError:
        with contextlib.suppress(OSError):  # the folder itself may be what cannot be made
            scratch.unlink(missing_ok=True)
