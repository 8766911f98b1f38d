"""Plans of lines: each made once, the oldest forgotten."""

from __future__ import annotations

import numpy as np

from bike_policy.contract.line_tables import KEPT
from bike_policy.riders.planned_lines import PlannedLines
from bike_sim.course.course import Course
from bike_sim.course.elements import Arc


def test_a_line_is_planned_once_and_forgotten_when_others_have_come() -> None:
    asked: list[Course] = []

    def plan(line: Course) -> float:
        asked.append(line)
        return line.length

    plans = PlannedLines(plan)
    lines = [Course.from_elements("ring", [Arc(5.0 + k, 2.0 * np.pi)], closed=True) for k in range(KEPT + 1)]
    for line in lines[:KEPT]:
        assert plans.of(line) == line.length
    assert plans.of(lines[0]) == lines[0].length
    assert len(asked) == KEPT, "once"
    assert plans.of(lines[KEPT]) == lines[KEPT].length
    assert [plans.of(lines[k]) for k in (0, 2)] == [lines[k].length for k in (0, 2)]
    assert len(asked) == KEPT + 1, "what was asked for lately is kept"
    plans.of(lines[1])
    assert len(asked) == KEPT + 2, "what was not asked for the longest went"
