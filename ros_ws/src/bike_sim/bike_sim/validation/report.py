"""Results of a validation: measured figures with the limits that they must keep."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Self


@dataclass(frozen=True, slots=True)
class Check:
    """One figure measured, and its limits.

    Attributes:
        name: figure's name with its unit as suffix.
        title: description for people.
        measured: the figure; errors are the largest in magnitude.
        low: smallest value that passes.
        high: largest value that passes.
        reference: published or independent value, where there is one.
    """

    name: str
    title: str
    measured: float
    low: float
    high: float
    reference: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the figure lies within its limits; nan does not."""
        return bool(self.low <= self.measured <= self.high)

    def as_dict(self) -> dict[str, Any]:
        """Return the check as plain values."""
        numbers = {name: getattr(self, name) for name in ("measured", "reference", "low", "high")}
        return {"name": self.name, "title": self.title, **numbers, "ok": self.passed}


@dataclass
class Report:
    """All checks of one vehicle or of several.

    Attributes:
        time_step: integration step, s.
        checks: in the order of measurement.
    """

    time_step: float
    checks: list[Check] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    def measure(
        self, parts: Sequence[tuple[str, Callable[[Self], Iterable[Check]]]], progress: Callable[[str], None]
    ) -> Self:
        """Measure parts one after another.

        Args:
            parts: title and function of each.
            progress: called with the title before each part.
        """
        for title, part in parts:
            progress(title)
            self.checks.extend(part(self))
        return self

    def as_dict(self, figures: dict[str, Any]) -> dict[str, Any]:
        """Return the report as plain values.

        Args:
            figures: others than those of the checks.
        """
        measured = {check.name: check.measured for check in self.checks}
        return {
            "ok": self.passed,
            "time_step_s": self.time_step,
            "figures": measured | figures,
            "checks": [check.as_dict() for check in self.checks],
        }
