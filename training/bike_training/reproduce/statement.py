"""Statements of a paper as rows of a table, and their verdicts by the tables of its experiments."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_analysis.figures.cells import markdown

FloatArray = NDArray[np.float64]
Verdict = tuple[str, bool | None]
"""Text of what was found, and whether the paper agrees; None where the runs do not say."""

YES, NO, OPEN = "yes", "no", "open"
MIN_RUNS: Final = 5
"""Runs of a setting from which on intervals decide; that of few values is hardly more than their range."""
DRAWS: Final = 10_000
"""Samples of a bootstrap."""
BOOTSTRAP_SEED: Final = 0


class NothingFound(Exception):
    """The tables hold nothing that a statement is about; its text says what is missing."""


class Found(NamedTuple):
    """Text of what was found, and `YES`, `NO` or `OPEN`."""

    text: str
    agrees: str


@dataclass(frozen=True)
class Statement:
    """A statement of the paper.

    Attributes:
        source: section, figure or table.
        paper: its text.
        rule: returns the verdict of the tables; raises `NothingFound`.
        arguments: of the rule, after the tables.
        objection: the strongest one to a verdict of this test.
        unlike: whether the test differs from the paper's in a way that could cause a no, which then is open.
    """

    source: str
    paper: str
    rule: Callable[..., Verdict]
    arguments: tuple[Any, ...] = ()
    objection: str = ""
    unlike: bool = False

    def find(self, data: Any) -> Found:
        """Return what the tables say."""
        try:
            text, agrees = self.rule(data, *self.arguments)
        except NothingFound as missing:
            return Found(str(missing), OPEN)
        if agrees is None or (self.unlike and not agrees):
            return Found(text, OPEN)
        return Found(text, YES if agrees else NO)


def statements_of(paper: Mapping[str, Any], rules: Mapping[str, Any]) -> tuple[Statement, ...]:
    """Return the statements of a paper, in their order.

    Args:
        paper: from `read_paper`.
        rules: functions by name, with a first underscore that statements leave out.
    """
    objections = paper["objections"]
    return tuple(
        Statement(
            row["source"],
            row["paper"],
            rules[f"_{row['rule']}"],
            tuple(row.get("arguments", ())),
            objections[row["objection"]]["text"],
            objections[row["objection"]]["unlike"],
        )
        for row in paper["statements"]
    )


def some(values: Any, missing: str) -> Any:
    """Return values, of which there must be some.

    Raises:
        NothingFound: with the text `missing`.
    """
    if not len(values):
        raise NothingFound(missing)
    return values


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


def compare(
    pair: Iterable[FloatArray], rule: Callable[..., Any] = operator.sub, neutral: float = 0.0
) -> tuple[float, float, bool | None]:
    """Compare the means of two settings.

    Args:
        pair: values of the first and of the second, one a run.
        rule: takes both means.
        neutral: its value where the means are equal.

    Returns:
        The 95 % interval of what the rule makes of the means, and whether it lies below its neutral value; None where
        that is inside, or a setting has too few runs.
    """
    first, second = pair
    low, high = interval(first, second, rule=rule)
    decided = min(len(first), len(second)) >= MIN_RUNS and not low <= neutral <= high
    return low, high, high < neutral if decided else None


def with_interval(values: FloatArray, form: str | Callable[[float], str]) -> str:
    """Return the mean of some values with its interval as text.

    Args:
        values: one a run.
        form: format of a number, or a function that writes one.
    """
    if not len(values):
        return "-"

    def write(value: float) -> str:
        return f"{value:{form}}" if isinstance(form, str) else form(value)

    low, high = interval(values)
    mean = write(float(values.mean()))
    return f"{mean} ({write(low)} to {write(high)})" if np.isfinite(low) else mean


def verdict_table(rows: Sequence[Statement], data: Any) -> str:
    """Return the table "paper says, found, agrees" as Markdown."""
    head = ("source", "the paper says", "found here", "agrees", "strongest objection")
    return markdown([head, *((row.source, row.paper, *row.find(data), row.objection) for row in rows)])
