"""Which commands reach the physics: finite, within range, and an answer to the state that is waiting for one."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

ANY_EPISODE = 0
"""Episode number of a command that answers no particular state; episodes count from 1."""


class Outcome(StrEnum):
    """Outcome of a command: it reaches the physics, answers an answered state again, an older one, or is not finite.

    One that is out of range is taken as well.
    """

    TAKEN = "taken"
    REPEATED = "repeated"
    STALE = "stale"
    REFUSED = "refused"
    CLIPPED = "clipped"


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        episode: episode of the state that it answers, or ANY_EPISODE.
        step: step of that state.
        steering: [-1, 1], positive to the left.
        throttle: [-1, 1], negative brakes.
    """

    episode: int
    step: int
    steering: float
    throttle: float = 0.0


class CommandGate:
    """Judges commands and counts them.

    Attributes:
        counts: commands so far, by outcome.
    """

    def __init__(self, lockstep: bool) -> None:
        """Open a gate.

        Args:
            lockstep: whether only the answer to the last state is taken; else every recent command is.
        """
        self._lockstep = lockstep
        self.counts = Counter(dict.fromkeys(Outcome, 0))

    def check(self, command: Command, episode: int, step: int, oldest: int = 0) -> tuple[Outcome, Command]:
        """Judge a command against the state that waits for an answer.

        Args:
            command: as received.
            episode: current episode.
            step: current step.
            oldest: oldest step that a command may answer where there is no lockstep.

        Returns:
            The outcome, and the command clipped to [-1, 1].
        """
        outcome = self._outcome(command, episode, step, oldest)
        self.counts[outcome] += 1
        if outcome is not Outcome.TAKEN:
            return outcome, command
        steering, throttle = (min(max(value, -1.0), 1.0) for value in (command.steering, command.throttle))
        if (steering, throttle) != (command.steering, command.throttle):
            self.counts[Outcome.CLIPPED] += 1
            command = Command(command.episode, command.step, steering, throttle)
        return outcome, command

    def _outcome(self, command: Command, episode: int, step: int, oldest: int) -> Outcome:
        if not (math.isfinite(command.steering) and math.isfinite(command.throttle)):
            return Outcome.REFUSED
        if self._lockstep:
            if (command.episode, command.step) == (episode, step):
                return Outcome.TAKEN
            if (command.episode, command.step) == (episode, step - 1):
                return Outcome.REPEATED
            return Outcome.STALE
        if command.episode == ANY_EPISODE:
            return Outcome.TAKEN
        fits = command.episode == episode and oldest <= command.step <= step
        return Outcome.TAKEN if fits else Outcome.STALE
