"""Statements of a paper, and what the tables say of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

YES, NO, OPEN = "yes", "no", "open"
"""Whether it agrees; open where the runs do not say."""
LEAST_RUNS: Final = 3
"""Runs of a setting from which on intervals decide; the bootstrap interval of two values is only their range."""
DRAWS: Final = 10_000
"""Of a bootstrap."""
BOOTSTRAP_SEED: Final = 0


class Found(NamedTuple):
    """What was found, and whether the paper agrees."""

    text: str
    agrees: str


@dataclass(frozen=True)
class Statement:
    """A statement of the paper.

    Attributes:
        source: section, figure or table. paper: what it says. find: what the tables of that paper say.
    """

    source: str
    paper: str
    find: Callable[[Any], Found]


def interval(*samples: FloatArray, rule: Callable[..., Any] = lambda mean: mean) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of a mean, or of what a rule makes of several means.

    Args:
        samples: values, one sample for each mean; NaN comes back where one has fewer than two.
        rule: takes the means.
    """
    if min(map(len, samples)) < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    draws = [rng.choice(values, (DRAWS, len(values))).mean(axis=1) for values in samples]
    low, high = np.percentile(rule(*draws), [2.5, 97.5])
    return float(low), float(high)


def with_interval(values: FloatArray, form: str) -> str:
    """Return the mean of some values with its interval as text, each number in a format."""
    if not len(values):
        return "-"
    low, high = interval(values)
    if not np.isfinite(low):
        return f"{values.mean():{form}}"
    return f"{values.mean():{form}} ({low:{form}} to {high:{form}})"


def verdict_table(statements: Sequence[Statement], data: Any) -> str:
    """Return the table "paper says, found, agrees" as Markdown."""
    lines = ["| source | the paper says | found here | agrees |", "|---|---|---|---|"]
    for statement in statements:
        found = statement.find(data)
        lines.append(f"| {statement.source} | {statement.paper} | {found.text} | {found.agrees} |")
    return "\n".join(lines) + "\n"
