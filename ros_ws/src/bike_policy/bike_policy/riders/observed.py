"""A rider of a bicycle that sees what an observer makes of its measurements, where they need it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bike_policy.riders.observer import Observer
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle

if TYPE_CHECKING:
    from bike_policy.riders.rider import Rider

_SURE: Final = 3.0
"""Standard deviations by which an offset must differ from none."""
_LEAST_OFFSET: Final = 0.008
"""Offset below which a roll counts as right, rad."""
_LASTING: Final = 8
"""Control periods that it must have lasted."""
_SLOWLY: Final = 0.1
"""Share by which the correction grows in a control period."""


class ObservedRider:
    """Shows its rider the state without noise and offset, and as late as the answer will act.

    Where an observer finds neither delay nor noise nor an offset, the rider is shown what was measured, bit for bit.

    Attributes:
        rider: the one that answers.
        observer: of the present ride.
    """

    observer: Observer

    def __init__(self, rider: Rider) -> None:
        """Take the rider of a bicycle."""
        self.rider = rider
        self.name, self.preview = rider.name, rider.preview

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare for an episode; see `Rider`."""
        self.rider.begin(vehicle, course, period, preview)
        self.observer = Observer(vehicle, period)
        self._vehicle, self._course, self._points = vehicle, course, preview
        self._line = lk.columns(course)
        self._lasting, self._share = 0, 0.0
        self._step: int | None = None
        self._answer: tuple[float, float] | None = None

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the rider's answer to what the observer makes of a snapshot; the same again for the same step."""
        if self._step == snapshot.step:
            return self._answer
        if snapshot.fallen or not np.isfinite(snapshot.state).all():
            return self.rider.command(snapshot)
        if self._step is not None:
            for _ in range(snapshot.step - self._step - 1):  # missed: the last command was held
                self.observer.answered(self._steer_set())
        self.observer.measure(snapshot.state)
        self._step = snapshot.step
        self._answer = self.rider.command(self._shown(snapshot))
        self.observer.answered(self._steer_set())
        return self._answer

    def _steer_set(self) -> float:
        """Return the set point of the last answer, rad."""
        return 0.0 if self._answer is None else self._answer[0] * self._vehicle.max_steer

    def _shown(self, snapshot: Snapshot) -> Snapshot:
        observer = self.observer
        sure = abs(observer.offset) > max(_LEAST_OFFSET, _SURE * observer.offset_deviation)
        self._lasting = self._lasting + 1 if sure else 0
        if self._lasting >= _LASTING or self._share > 0.0:
            self._share = min(self._share + _SLOWLY, 1.0)
        if not (self._share or observer.delay or observer.noisy):
            return snapshot
        state = observer.ahead()
        # As long as the offset is not sure it may be a steady turn of another bicycle: then the measured roll counts.
        state[st.ROLL] += (1.0 - self._share) * observer.offset
        return self._seen_from(snapshot, state)

    def _seen_from(self, snapshot: Snapshot, state: st.StateVector) -> Snapshot:
        """Return a snapshot of the same path from another state."""
        course, preview = self._course, self._points
        look, points = snapshot.look.copy(), np.empty((2, preview.count))
        lk.look_at_path(
            state,
            self._vehicle.parameters,
            True,
            self._line,
            course.spacing,
            course.closed,
            preview.by_time,
            preview.interval,
            False,
            look,
            points[0],
            points[1],
        )
        return replace(snapshot, state=state, look=look, preview_x=points[0], preview_y=points[1])
