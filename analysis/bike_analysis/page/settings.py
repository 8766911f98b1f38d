"""What pages say about how a ride was computed."""

from __future__ import annotations

import numpy as np

from bike_analysis.read.messages import Simulation
from bike_analysis.read.reading import Recording


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
