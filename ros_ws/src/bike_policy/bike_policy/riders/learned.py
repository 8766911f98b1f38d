"""A learned policy as a rider."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import ObservationLayout, SeenBlocks
from bike_policy.contract.race import RaceLayout
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class PolicyAdapter(Protocol):
    """How a rider comes from snapshots to commands."""

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare for a ride; see `Rider`."""
        ...

    def command(self, snapshot: Snapshot) -> tuple[float, float]:
        """Return steering and throttle for a snapshot, in [-1, 1].

        Raises:
            ValueError: an observation that is not finite.
        """
        ...


class StatelessPolicy:
    """Decides anew at each snapshot, from it alone."""

    def __init__(self, bundle: Bundle, layout: ObservationLayout) -> None:
        """Answer a made-up observation once: the first answer of a process takes longer than all others."""
        self._actor, self._layout, self._action = bundle.actor, layout, bundle.action
        self._max_steer = 1.0
        self._picked: NDArray[np.intp] | None = None
        self._actor.act(layout.observe(SeenBlocks(np.zeros(10), np.zeros(12), np.zeros(layout.preview_count))))

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Pick the preview points; see `PolicyAdapter`."""
        self._max_steer = vehicle.max_steer
        picked = self._layout.pick_preview(preview.by_time, preview.interval, preview.count)
        whole = len(picked) == preview.count and bool((picked == np.arange(preview.count)).all())
        self._picked = None if whole else picked

    def command(self, snapshot: Snapshot) -> tuple[float, float]:
        """Return the command for a snapshot; see `PolicyAdapter`."""
        action = self._actor.act(self._layout.observe(snapshot, self._picked))
        return self._action.to_command(action.tolist(), self._max_steer, snapshot.speed)


class LearnedRider:
    """The actor of a bundle; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        bundle: the policy.
    """

    def __init__(self, bundle: Bundle) -> None:
        """Take a policy and prepare its first answer."""
        layout = bundle.layout
        self.bundle = bundle
        self.name = bundle.name
        self.preview: Preview | None = None
        self._sight: PolicyAdapter
        if isinstance(layout, RaceLayout):
            # Late: it takes tyres and lap theory, which the node of a bicycle is spared.
            from bike_policy.riders.race_policy import RacePolicy

            self._sight = RacePolicy(bundle, layout)
        else:
            self.preview = Preview(layout.preview_by_time, layout.preview_interval, layout.preview_count)
            self._sight = StatelessPolicy(bundle, layout)

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Check that vehicle, control period and preview are those of the policy; see `Rider`."""
        self.bundle.check_fit(vehicle.name, period)
        self._sight.begin(vehicle, course, period, preview)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the actor's answer; None where the observation is not finite."""
        try:
            return self._sight.command(snapshot)
        except ValueError:  # an observation that is not finite
            return None
