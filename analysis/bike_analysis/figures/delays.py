"""How old the commands were that the vehicle rode by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bike_analysis.read.rides import Ride
from bike_analysis.read.tables import Floats, Integers


@dataclass(frozen=True)
class CommandDelay:
    """Age of the command that was applied in each step.

    Attributes:
        rows: Rows of the ride's states (those after a step) for which it is known.
        steps: Age in control steps: 0 if the command answers the very state from which the step began.
        time_s: The same in simulated time, s.
    """

    rows: Integers
    steps: Integers
    time_s: Floats


def command_delay(ride: Ride) -> CommandDelay:
    """Return the age of the applied commands.

    A state contains the command that was applied in the step that led to it. That command is looked up among the
    recorded ones: the newest one with this value that answers a state from before the step. Its age is the number of
    steps (and the simulated time) between the state that it answers and the state from which the step began. In
    lockstep it is 0; in free running it shows how late the commands were, a held command ageing with each step.

    Args:
        ride: A ride.

    Returns:
        The delay of each step for which the command was found; empty if commands were not recorded.
    """
    states, commands = ride.states, ride.commands
    steering = np.clip(commands.steering, -1.0, 1.0)
    values, value = np.unique(steering[np.isfinite(steering)], return_inverse=True)
    if not len(values) or len(states) < 2:
        return CommandDelay(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    finite = np.flatnonzero(np.isfinite(steering))
    span = int(max(states.step[-1], commands.step.max())) + 2
    # One number for value and step: the newest command of a value is found by one search.
    key = value * span + commands.step[finite]
    order = np.argsort(key, kind="stable")
    applied, begin = states.steering_command[1:], states.step[1:] - 1
    place = np.minimum(np.searchsorted(values, applied), len(values) - 1)
    found = np.searchsorted(key[order], place * span + begin, side="right") - 1
    match = finite[order[np.maximum(found, 0)]]
    known = (found >= 0) & (values[place] == applied) & (steering[match] == applied) & (begin >= 0)
    rows, match, begin = np.flatnonzero(known) + 1, match[known], begin[known]
    begin_time = np.where(states.step[rows - 1] == begin, states.time_s[rows - 1], np.nan)
    return CommandDelay(rows, begin - commands.step[match], begin_time - _answered_time(ride)[match])


def _answered_time(ride: Ride) -> Floats:
    """Time of the state that each command answers, s: the command's own stamp only where that state is not there."""
    states, commands = ride.states, ride.commands
    row = np.minimum(np.searchsorted(states.step, commands.step), len(states) - 1)
    return np.where(states.step[row] == commands.step, states.time_s[row], commands.time_s)


def command_ages(ride: Ride) -> tuple[Floats, Floats]:
    """Age of the command applied in the step that led to each state, in steps and in s; NaN where it is not known."""
    delay = command_delay(ride)
    steps, seconds = np.full(len(ride.states), np.nan), np.full(len(ride.states), np.nan)
    steps[delay.rows], seconds[delay.rows] = delay.steps, delay.time_s
    return steps, seconds
