"""A rider with a clock: how long its answers take."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from bike_policy.riders.rider import Rider
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class TimedRider:
    """Passes everything on to another rider and times its answers; implements `bike_policy.riders.rider.Rider`."""

    def __init__(self, rider: Rider) -> None:
        """Take a rider."""
        self._rider = rider
        self._times: list[float] = []
        self.name, self.preview = rider.name, rider.preview

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare the rider; see `Rider`."""
        self._rider.begin(vehicle, course, period, preview)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the rider's answer."""
        began = time.thread_time()  # processor time: other work on the machine does not count
        answer = self._rider.command(snapshot)
        self._times.append(time.thread_time() - began)
        return answer

    def figures(self) -> dict[str, Any]:
        """Return median and 99th percentile of the processor time of an answer, ms; nothing without answers."""
        if not self._times:
            return {}
        median, high = np.percentile(self._times, (50.0, 99.0)) * 1e3
        return {"answer_median_ms": float(median), "answer_p99_ms": float(high)}
