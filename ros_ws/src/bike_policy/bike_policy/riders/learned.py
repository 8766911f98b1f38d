"""Learned policies as riders."""

from __future__ import annotations

import numpy as np

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import Rows, rows_of
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class LearnedRider:
    """A policy of paths as a rider, deciding at each snapshot; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        bundle: the policy.
        name: its name.
        preview: that it sees.
    """

    preview: Preview | None

    def __init__(self, bundle: Bundle) -> None:
        """Take a policy, and act once on a made-up observation: the first action of a process takes longest."""
        layout = bundle.layout
        self.bundle, self.name = bundle, bundle.name
        self.preview = Preview(layout.preview_by_time, layout.preview_interval, layout.preview_count)
        self._picked: slice | np.ndarray = slice(None)
        self._max_steer = 1.0
        blank = Rows.of_path(np.zeros((1, 10)), np.zeros((1, 12)), np.zeros((1, layout.preview_count)))
        bundle.actor.act(layout.observe(blank)[0])

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Check that vehicle, control period and preview are those of the policy; see `Rider`."""
        self.bundle.check_fit(vehicle.name, period)
        self._max_steer = vehicle.max_steer
        picked = self.bundle.layout.pick_preview(preview.by_time, preview.interval, preview.count)
        self._picked = slice(None) if len(picked) == preview.count else picked

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the actor's command; None where the observation is not finite."""
        rows, bundle = rows_of(snapshot), self.bundle
        seen = bundle.layout.observe(rows._replace(preview_y=rows.preview_y[:, self._picked]))[0]
        if not np.isfinite(seen).all():
            return None
        return bundle.action.to_command(bundle.actor.act(seen).tolist(), self._max_steer, snapshot.speed)


def learned_rider(bundle: Bundle) -> LearnedRider:
    """Return the rider of a policy of paths or of races."""
    if not bundle.layout.races:
        return LearnedRider(bundle)
    # Late: it takes tyres and lap plans, which the node of a bicycle is spared.
    from bike_policy.riders.racing import RacingRider

    return RacingRider(bundle)
