"""What a rider is, and a policy of paths as one; `bike_policy.riders.rider` makes riders by name."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import Rows, rows_of
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class Rider(Protocol):
    """Answers snapshots with commands.

    Attributes:
        name: for people and recordings.
        preview: the preview that it needs; None where it takes any.
    """

    name: str
    preview: Preview | None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare for an episode.

        Args:
            vehicle: to be ridden.
            course: the followed line.
            period: control period, s.
            preview: the preview that snapshots will hold.

        Raises:
            ValueError: this rider cannot ride that, naming the difference.
        """
        ...

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return steering and throttle in [-1, 1], or None for a snapshot that is not finite."""
        ...


class GripEstimate(NamedTuple):
    """Grip of the road that a rider infers, as factors on the friction of the known tyres.

    Attributes:
        grip: here.
        expected: that is planned for, here and shortly ahead.
        deviation: standard deviation of the error of `grip`.
    """

    grip: float
    expected: float
    deviation: float


def grip_of(rider: Rider) -> GripEstimate | None:
    """Return the grip that a rider infers, also one that is observed or disturbed; None where it infers none."""
    memory = getattr(innermost(rider), "grip_memory", None)
    if memory is None:
        return None
    return GripEstimate(float(memory.grip[0]), float(memory.expected[0]), float(memory.variance[0]) ** 0.5)


def bundle_of(rider: Rider) -> Bundle | None:
    """Return the policy of a learned rider, also of one that is observed or disturbed; None where it is not learned."""
    return getattr(innermost(rider), "bundle", None)


def infers_grip(rider: Rider) -> bool:
    """Whether a rider may infer the grip of the road, before it rides."""
    return hasattr(innermost(rider), "grip_memory")


def innermost(rider: Any) -> Any:
    """Return the rider that answers, without what observes or disturbs it."""
    while hasattr(rider, "rider"):
        rider = rider.rider
    return rider


class LearnedRider:
    """A policy of paths as a rider, deciding at each snapshot; implements `Rider`.

    Attributes:
        bundle: the policy.
        name: its name.
        preview: that it sees.
        seen: observation of the last decision, shape (layout size,); None before the first.
    """

    preview: Preview | None
    seen: NDArray[np.float32] | None = None

    def __init__(self, bundle: Bundle) -> None:
        """Take a policy, and act once on a made-up observation: the first action of a process takes longest."""
        layout = bundle.layout
        self.bundle, self.name = bundle, bundle.name
        self.preview = Preview(layout.preview_by_time, layout.preview_interval, layout.preview_count)
        self._picked: slice | np.ndarray = slice(None)
        self._max_steer = 1.0
        blank = Rows.of_path(np.zeros((1, 10)), np.zeros((1, 12)), np.zeros((1, 2, layout.preview_count)))
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
        seen = bundle.layout.observe(rows._replace(preview_xy=rows.preview_xy[:, :, self._picked]))[0]
        if not np.isfinite(seen).all():
            return None
        self.seen = seen
        return bundle.action.to_command(bundle.actor.act(seen).tolist(), self._max_steer, snapshot.speed)
