"""What pages say about how a ride was computed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

import numpy as np

from bike_analysis.page.html import html_text
from bike_analysis.read.messages import Simulation
from bike_analysis.read.reading import Recording
from bike_analysis.read.text import LONGEST_SENTENCE

SHORT: Final = 60
"""Most characters of a note that stands in a line with others, as a policy's name; a whole task has more."""


def note_words(notes: Mapping[str, str], left_out: Collection[str]) -> list[str]:
    """Return words for the recorder's notes that fit into a line."""
    return [f"{name} {value}" for name, value in notes.items() if name not in left_out and len(value) <= SHORT]


def long_notes(notes: Mapping[str, str], file: str = "") -> str:
    """Return the notes that fit into no line as HTML, folded; nothing where there are none.

    Args:
        notes: of a recording.
        file: its name, where the page has several.
    """
    listed = "".join(
        f"<dt>{html_text(name)}</dt><dd>{html_text(value, LONGEST_SENTENCE)}</dd>"
        for name, value in notes.items()
        if len(value) > SHORT
    )
    if not listed:
        return ""
    whose = html_text(file or "the recording")
    return f"<details><summary>More notes of {whose}</summary><dl class=keys>{listed}</dl></details>"


def settings_words(period: float, simulation: Simulation | None) -> list[str]:
    """Return words for control period, s, and simulation; nothing for what is not known."""
    words = [f"a command every {1e3 * period:g} ms"] if period > 0.0 else []
    if simulation is not None and simulation.engine:
        words.append(f"engine {simulation.engine}")
    if simulation is not None and simulation.time_step > 0.0:
        words.append(f"steps of {1e3 * simulation.time_step:g} ms")
    return words


def recorded_settings(recording: Recording) -> list[str]:
    """Return the words of all control periods and simulations of a recording, each once."""
    periods = np.unique(np.round(recording.states.control_period, 6))
    words = [word for period in periods for word in settings_words(float(period), None)]
    return list(dict.fromkeys([*words, *(word for one in recording.simulations for word in settings_words(0.0, one))]))
