"""Progress of a ride on the terminal."""

from __future__ import annotations

from typing import Any

from tqdm import tqdm

_FORMAT = "{l_bar}{bar}| {n_fmt}/{total_fmt} m [{elapsed}<{remaining}{postfix}]"
"""Without tqdm's own rate, in metres a second of wall-clock time: it would stand beside the speed of the vehicle."""


def distance_progress_bar(title: str, way: float | None = None, *, quiet: bool = False, leave: bool = True) -> Any:
    """Return a bar of the way ridden. It shows only at a terminal, so that logs stay short.

    Args:
        title: what is ridden.
        way: length of the ride, m; None while it is not known.
        quiet: whether nothing is shown at a terminal either.
        leave: whether the bar stays when the ride is over.
    """
    total = None if way is None else round(way)
    return tqdm(desc=title, total=total, unit="m", bar_format=_FORMAT, disable=True if quiet else None, leave=leave)
