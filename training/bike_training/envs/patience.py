"""How long nodes are waited for: a limit counts their silence, not their work.

The first start on a machine compiles the physics, for minutes where others keep its processors busy. That is no reason
to give up, and neither is a machine on which everything takes its time.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final, Protocol

LONGEST_LOOK: Final = 1.0
"""Longest time between two looks that counts as silence, s: beyond it, this process itself was held up."""


class Worker(Protocol):
    """A process that may be at work."""

    def is_working(self) -> bool:
        """Return whether it runs, or waits for the processor or the disk."""


class InactivityTimeout:
    """Counts the time without messages in which no process works, and reports when it is too long."""

    def __init__(self, limit: float, workers: Sequence[Worker]) -> None:
        """Begin to count.

        Args:
            limit: longest silence, s.
            workers: processes whose work is no silence.
        """
        self._limit = limit
        self._workers = workers
        self.heard()

    def heard(self) -> None:
        """Start again: a message has arrived."""
        self._silence = 0.0
        self._looked = time.monotonic()

    def is_out(self) -> bool:
        """Check the processes, and return whether the silence is too long. To be called about ten times a second."""
        now = time.monotonic()
        if not any(worker.is_working() for worker in self._workers):
            self._silence += min(now - self._looked, LONGEST_LOOK)
        self._looked = now
        return self._silence > self._limit
