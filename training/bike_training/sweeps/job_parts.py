"""What all kinds of runs share: the end of one, and the check of its entries."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from bike_sim.documents import show

Tell = Callable[[float, float, str], None]
"""Called with the work done, all of it in the same unit, and words for people."""


@dataclass(frozen=True)
class JobEnd:
    """How a run ended.

    Attributes:
        figures: plain values, names ending in units.
        interrupted: whether a signal ended it before its end; it can go on.
    """

    figures: dict[str, Any]
    interrupted: bool = False


def check_kinds(task: str, entries: Mapping[str, Any], kinds: Mapping[str, tuple[type, ...]]) -> None:
    """Check names and kinds of the entries of a run.

    Args:
        task: its task.
        entries: as the file has them.
        kinds: what each may be.

    Raises:
        ValueError: naming the entry and its value.
    """
    for name, value in entries.items():
        if name not in kinds:
            raise ValueError(f"task {task} has no entry {name!r}; it has {', '.join(sorted(kinds))}")
        wanted = kinds[name]
        if not isinstance(value, wanted) or (isinstance(value, bool) and bool not in wanted):
            named = " or ".join(kind.__name__ for kind in wanted)
            raise ValueError(f"{name} must be {named}, got {show(value)}")
