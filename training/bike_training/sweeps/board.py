"""How far the runs of a sweep have come, told across processes. A module of its own: its process imports no more."""

from __future__ import annotations


class Board:
    """Where runs write how far they have come; an actor of Ray."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._lines: dict[str, tuple[float, float, str]] = {}

    def tell(self, name: str, done: float, total: float, words: str) -> None:
        """Write down how far a run has come."""
        self._lines[name] = (done, total, words)

    def take(self) -> dict[str, tuple[float, float, str]]:
        """Return what is new."""
        lines, self._lines = self._lines, {}
        return lines
