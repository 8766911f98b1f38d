"""Results of a validation: measured figures with the limits that they must keep, modes, and rows of tables."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple


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


class Mode(NamedTuple):
    """An eigenvalue, beside its published value where there is one.

    Attributes:
        variant: vehicle or variant of it.
        speed: m/s.
        name: weave, wobble or capsize.
        measured: 1/s, of the engine.
        published: 1/s.
    """

    variant: str
    speed: float
    name: str
    measured: complex
    published: complex = complex(math.nan, math.nan)

    def as_dict(self) -> dict[str, Any]:
        """Return the mode as plain values."""
        row: dict[str, Any] = {"variant": self.variant, "speed_m_s": self.speed, "mode": self.name}
        for prefix, value in (("", complex(self.measured)), ("published_", complex(self.published))):
            row |= {f"{prefix}real_1_s": value.real, f"{prefix}hz": value.imag / math.tau}
        return row


@dataclass
class Report:
    """All that was measured of one vehicle or of several.

    Attributes:
        checks: in the order of measurement.
        modes: over speed.
        tables: other figures, rows of plain values by the name of their table.
    """

    checks: list[Check] = field(default_factory=list)
    modes: list[Mode] = field(default_factory=list)
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain values."""
        figures: dict[str, Any] = {check.name: check.measured for check in self.checks}
        modes = {"modes": [mode.as_dict() for mode in self.modes]} if self.modes else {}
        return {
            "ok": all(check.passed for check in self.checks),
            "figures": figures | self.tables | modes,
            "checks": [check.as_dict() for check in self.checks],
        }
