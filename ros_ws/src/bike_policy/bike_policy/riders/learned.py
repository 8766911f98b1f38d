"""A learned policy as a rider."""

from __future__ import annotations

import numpy as np

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import SeenBlocks
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class LearnedRider:
    """The actor of a bundle; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        bundle: the policy.
    """

    def __init__(self, bundle: Bundle) -> None:
        """Answer a made-up observation once: the first answer of a process takes longer than all others."""
        layout = bundle.layout
        self.bundle = bundle
        self.name = bundle.name
        self.preview: Preview | None = Preview(layout.preview_by_time, layout.preview_interval, layout.preview_count)
        self._picked: np.ndarray | None = None
        self._max_steer = 1.0
        bundle.actor.act(layout.observe(SeenBlocks(np.zeros(10), np.zeros(12), np.zeros(layout.preview_count))))

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Check that vehicle, control period and preview are those of the policy; see `Rider`."""
        self.bundle.check_fit(vehicle.name, period)
        self._max_steer = vehicle.max_steer
        picked = self.bundle.layout.pick_preview(preview.by_time, preview.interval, preview.count)
        whole = len(picked) == preview.count and bool((picked == np.arange(preview.count)).all())
        self._picked = None if whole else picked

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the actor's answer; None where the observation is not finite."""
        try:
            action = self.bundle.actor.act(self.bundle.layout.observe(snapshot, self._picked))
        except ValueError:  # an observation that is not finite
            return None
        return self.bundle.action.to_command(action.tolist(), self._max_steer)
