"""Decisions of the node without ROS: which commands count."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from bike_sim.ros.command_gate import Command, CommandGate, Outcome

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
COMMANDS = st.builds(Command, st.integers(0, 4), st.integers(0, 6), NUMBERS, NUMBERS)


@given(st.booleans(), st.lists(COMMANDS, max_size=20))
def test_only_finite_commands_within_range_reach_the_physics(lockstep: bool, commands: list[Command]) -> None:
    gate = CommandGate(lockstep)
    for command in commands:
        outcome, passed = gate.check(command, episode=2, step=3, oldest=1)
        if outcome is Outcome.TAKEN:
            assert -1.0 <= passed.steering <= 1.0
            assert -1.0 <= passed.throttle <= 1.0
            assert passed.steering == min(max(command.steering, -1.0), 1.0)
            assert (command.episode, command.step) == (2, 3) if lockstep else command.episode in (0, 2)
        if not (math.isfinite(command.steering) and math.isfinite(command.throttle)):
            assert outcome is Outcome.REFUSED
    counts = gate.counts
    assert counts.total() - counts[Outcome.CLIPPED] == len(commands)
    assert counts[Outcome.CLIPPED] <= counts[Outcome.TAKEN]


def test_free_mode_takes_recent_and_unaddressed_commands() -> None:
    gate = CommandGate(lockstep=False)
    outcomes = [gate.check(Command(2, step, 0.1), 2, 10, oldest=6)[0] for step in (5, 6, 10, 11)]
    assert outcomes == [Outcome.STALE, Outcome.TAKEN, Outcome.TAKEN, Outcome.STALE]
    assert gate.check(Command(0, 0, 0.1), 2, 10, oldest=6)[0] is Outcome.TAKEN
