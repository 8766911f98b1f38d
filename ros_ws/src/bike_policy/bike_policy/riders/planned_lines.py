"""Plans of lines, each made once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from bike_policy.contract.line_tables import KEPT
from bike_sim.course.course import Course

PlanT = TypeVar("PlanT")


class PlannedLines(Generic[PlanT]):
    """Plans of the lines that were asked for last; those not asked for the longest are forgotten."""

    def __init__(self, plan: Callable[[Course], PlanT]) -> None:
        """Take who plans."""
        self._plan = plan
        self._known: dict[int, tuple[Course, PlanT]] = {}

    def of(self, line: Course) -> PlanT:
        """Return the plan of a line, of the very object that was planned before or a new one.

        Raises:
            ValueError: as who plans does.
        """
        # By identity: whoever hands out lines hands out the same again; keeping one keeps its id from being reused.
        known = self._known.pop(id(line), None) or (line, self._plan(line))
        self._known[id(line)] = known
        if len(self._known) > KEPT:
            del self._known[next(iter(self._known))]
        return known[1]
