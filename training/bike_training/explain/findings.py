"""Findings from the SHAP values of a policy: sentences chosen by the sign of a correlation.

Signs: roll is positive leaning right, the steering set point and the preview are positive to the left. So a policy
that steers into the fall has negative correlations of roll with its SHAP values, and one that counter-steers has
negative ones of the preview: the line turns left, and the policy steers right first (Weyrer et al. 2026, Sect. 6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import ObservationLayout
from bike_training.explain.shap_values import Explanation

FloatArray = NDArray[np.float64]

CLEAR: Final = 0.5
"""Magnitude of a correlation from which on its sign counts as clear."""
NEGLIGIBLE: Final = 0.01
"""Share of all magnitudes below which a feature counts as of no weight."""

_SENTENCES: Final[dict[str, tuple[str, str]]] = {
    "roll": (
        "steers into the fall: leaning to one side pulls the steering to that side",
        "steers out of the fall: leaning to one side pulls the steering to the other side",
    ),
    "roll rate": (
        "steers into a beginning fall: falling to one side pulls the steering to that side",
        "steers out of a beginning fall: falling to one side pulls the steering to the other side",
    ),
    "steer": (
        "turns the handlebar back: steering to one side pulls the set point to the other side",
        "keeps the handlebar where it is: steering to one side pulls the set point to that side",
    ),
    "steer rate": (
        "damps the handlebar: turning it to one side pulls the set point to the other side",
        "goes on with the handlebar: turning it to one side pulls the set point to that side",
    ),
    "offset": (
        "counter-steers for a line beside it: a line on one side pulls the steering to the other side",
        "steers towards a line beside it: a line on one side pulls the steering to that side",
    ),
    "direction": (
        "counter-steers for a line that leads away: it pulls the steering to the other side",
        "steers towards a line that leads away: it pulls the steering to that side",
    ),
    "near preview": (
        "counter-steers: a line that turns to one side shortly ahead pulls the steering to the other side",
        "steers directly: a line that turns to one side shortly ahead pulls the steering to that side",
    ),
    "far preview": (
        "counter-steers: a line that turns to one side farther ahead pulls the steering to the other side",
        "steers directly: a line that turns to one side farther ahead pulls the steering to that side",
    ),
    "line ahead": (
        "counter-steers: a line that turns to one side ahead pulls the steering to the other side",
        "steers directly: a line that turns to one side ahead pulls the steering to that side",
    ),
}
"""Meaning of a negative and of a positive correlation."""


@dataclass(frozen=True)
class Finding:
    """Finding about one feature, or about the sum of several neighbouring ones.

    Attributes:
        subject: key of the sentences.
        features: names of the features that it is about.
        correlation: of the feature's value (mean of several) with its SHAP value (sum); NaN if either is constant.
        mean_abs: mean magnitude of that SHAP value, rad.
        share: of the sum of the mean magnitudes of all features.
    """

    subject: str
    features: tuple[str, ...]
    correlation: float
    mean_abs: float
    share: float

    @property
    def sign(self) -> int:
        """-1 or 1 where the correlation is clear and the weight not negligible, else 0."""
        clear = abs(self.correlation) >= CLEAR and self.share >= NEGLIGIBLE
        return int(np.sign(self.correlation)) if clear else 0

    @property
    def sentence(self) -> str:
        """The finding in words, with its numbers."""
        weight = f"{math.degrees(self.mean_abs):.1f}° on average, {self.share:.0%} of all"
        if math.isnan(self.correlation):
            return f"{self.subject}: does not vary here, so nothing is shown ({weight})"
        numbers = f"correlation {self.correlation:+.2f}, {weight}"
        if self.sign:
            negative, positive = _SENTENCES[self.subject]
            return f"{self.subject}: {negative if self.sign < 0 else positive} ({numbers})"
        why = "hardly any weight" if self.share < NEGLIGIBLE else "no clear direction"
        return f"{self.subject}: {why} ({numbers})"


@dataclass(frozen=True)
class Statement:
    """All findings, and their summary.

    Attributes:
        findings: in the order of the sentences.
        limits: of the findings, one sentence each.
    """

    findings: tuple[Finding, ...]
    limits: tuple[str, ...]

    @property
    def steers_into_the_fall(self) -> bool | None:
        """Whether roll and roll rate say so; None where they do not agree or say nothing."""
        return self._verdict("roll", "roll rate")

    @property
    def counter_steers(self) -> bool | None:
        """Whether the line ahead, near and far together, says so; None where it says nothing."""
        return self._verdict("line ahead")

    def _verdict(self, *subjects: str) -> bool | None:
        signs = {finding.sign for finding in self.findings if finding.subject in subjects} - {0}
        return signs == {-1} if len(signs) == 1 else None


def state_findings(explanation: Explanation, answers_differ: float) -> Statement:
    """Return findings from SHAP values, and their limits.

    Args:
        explanation: the values.
        answers_differ: largest difference of the policy's set points to those that were recorded, rad; NaN where none
            were recorded.
    """
    subjects = _subjects(explanation.layout)
    findings = tuple(_find(explanation, subject, places) for subject, places in subjects.items())
    return Statement(findings, _limits(explanation, answers_differ))


def _subjects(layout: ObservationLayout) -> dict[str, list[int]]:
    """Places of the features that each sentence is about."""
    states = {"roll": "roll", "roll rate": "roll_rate", "steer": "steer", "steer rate": "steer_rate"}
    found = {name: [layout.names.index(term)] for name, term in states.items() if term in layout.terms}
    preview = list(range(layout.size - layout.preview_count, layout.size))
    found["offset"], ahead = preview[:1], preview[1:]
    if "preview_lean" in layout.terms:
        found["direction"], ahead = ahead[:1], ahead[1:]
    half = (len(ahead) + 1) // 2
    found["near preview"], found["far preview"], found["line ahead"] = ahead[:half], ahead[half:], ahead
    return {subject: places for subject, places in found.items() if places}


def _find(explanation: Explanation, subject: str, places: list[int]) -> Finding:
    total = explanation.values[:, places].sum(axis=1)
    mean_abs = float(np.abs(total).mean())
    names = explanation.layout.names
    return Finding(
        subject=subject,
        features=tuple(names[place] for place in places),
        correlation=correlation(explanation.features[:, places].mean(axis=1), total),
        mean_abs=mean_abs,
        share=mean_abs / max(float(explanation.mean_abs.sum()), np.finfo(float).tiny),
    )


def correlation(a: FloatArray, b: FloatArray) -> float:
    """Return Pearson's correlation of two columns, NaN where one of them is constant up to rounding."""
    spread = [float(np.std(column)) for column in (a, b)]
    size = [float(np.abs(column).max()) for column in (a, b)]
    if any(s <= 1e-6 * m for s, m in zip(spread, size, strict=True)):
        return math.nan
    return float(np.corrcoef(a, b)[0, 1])


def _limits(explanation: Explanation, answers_differ: float) -> tuple[str, ...]:
    """Return the limits of the findings, from the numbers themselves."""
    limits = [*_bound_features(explanation), *_idle_features(explanation)]
    if math.isnan(answers_differ):
        limits.append("No commands were recorded, so it is not known whether this policy drove the ride.")
    elif answers_differ > 1e-3:
        limits.append(
            f"This policy did not drive the ride: its set points differ from the recorded ones by up to "
            f"{math.degrees(answers_differ):.2f}°. It is explained on what another one got to see."
        )
    limits.append(
        f"The values hold for these {len(explanation.outputs)} observations against {explanation.background} of their "
        "own, so for this section at this speed. Another ride may weigh the features differently."
    )
    return tuple(limits)


def _bound_features(explanation: Explanation) -> list[str]:
    """Name the two features of weight that go together most."""
    weighty = explanation.mean_abs >= NEGLIGIBLE * explanation.mean_abs.sum()
    places = np.flatnonzero(weighty & (np.std(explanation.features, axis=0) > 0.0))
    if len(places) < 2:
        return []
    matrix = np.triu(np.abs(np.corrcoef(explanation.features[:, places], rowvar=False)), 1)
    a, b = np.unravel_index(int(np.argmax(matrix)), matrix.shape)
    names = explanation.layout.names
    return [
        f"Features go together ({names[places[a]]} and {names[places[b]]} with a correlation of {matrix[a, b]:.2f} in "
        "magnitude), but the explainer varies each on its own: it also asks the policy about states that no ride has, "
        "and large values of opposite sign may cancel."
    ]


def _idle_features(explanation: Explanation) -> list[str]:
    """Name the features of no weight, with how much they vary."""
    share = explanation.shares
    spread, size = np.std(explanation.features, axis=0), np.abs(explanation.features).mean(axis=0)
    return [
        f"{name} has {part:.1%} of the weight here, but varies by {s / m:.1%} of its size only: nothing is said about "
        "what it would do elsewhere."
        for name, part, s, m in zip(explanation.layout.names, share, spread, size, strict=True)
        if part < NEGLIGIBLE and m > 0.0 and s / m < 0.1
    ]
