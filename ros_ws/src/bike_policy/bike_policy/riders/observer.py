"""Observer of a bicycle, and a rider that sees its estimates: delay, noise, offsets of roll and steer, and the state.

A rider knows its bicycle, and so it can compute what each command should have done. From the differences follow

- the **delay** of its commands: the one whose commands explain how the steering angle moved;
- the **noise** of each measurement, by the median of its differences, which single pushes do not change;
- the **state** and **offsets** of the roll (an inclinometer that is mounted askew, or a steady side force) and of the
  steering angle (a handlebar that is mounted askew), by an extended Kalman filter about the nonlinear bicycle, with
  that noise. A difference far beyond what the filter expects is a push and not an error of a sensor: then the rates are
  believed.

Source of the filter: Simon (2006), Optimal State Estimation, Wiley, Sects. 13.2 and 10.4.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.base import Rider
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple import advance
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

MEASURED: Final = ("left", "yaw", "roll", "steer", "roll_rate", "steer_rate")
"""Measured quantities: m to the left of the bicycle, rad, rad/s."""
MAX_DELAY: Final = 4
"""Control periods; later commands are not told apart from a bicycle that is another one."""

_FREE: Final = (st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE)
_SIZE: Final = len(MEASURED)
_ROLL, _STEER, _RATES = 2, 3, (4, 5)
OFFSETS: Final = (_ROLL, _STEER)
"""Measured quantities that may have an offset; the filter has the offsets after the measured quantities."""
_ALL: Final = _SIZE + len(OFFSETS)
_SHOWN: Final = np.hstack([np.eye(_SIZE), np.eye(_SIZE)[:, OFFSETS]])
"""What is measured of the filter's quantities."""

_EXACT: Final = np.array([2e-3, 2e-3, 1e-3, 2e-3, 1.5e-2, 3e-2])
"""Standard deviations below which measurements count as exact: more than wind and another engine make."""
_TRUST: Final = np.array([5e-4, 5e-4, 2e-4, 5e-4, 1e-3, 2e-3])
"""Standard deviations of exact measurements for the filter."""
_UNKNOWN: Final = np.array([5e-4, 5e-4, 5e-4, 1e-3, 8e-3, 2e-2, 7e-4, 2e-4])
"""Standard deviations of what a control period adds that the model does not know; the last ones are the offsets'."""
_FIRST_OFFSET: Final = 0.03
"""Standard deviation of an offset at the begin, rad."""
_PUSHED: Final = 5.0
"""Differences beyond so many standard deviations are pushes."""
_BOTH: Final = np.array([1.0, 1.0, 1.0, math.sqrt(2.0), 1.0, math.sqrt(2.0)]) / math.sqrt(2.0)
"""Part of a difference that is one measurement's: both err, but the drive steers away what the first one erred."""
_WINDOW: Final = 120
"""Control periods over which noise is judged: the median of a third of them may be off by half."""
_LEAST: Final = 3
"""Control periods before it is: a start on strong noise is soon a fall."""
_OFTEN: Final = 12
"""Control periods in which it is judged at each."""
_SELDOM: Final = 4
"""Control periods between two judgements later on: medians cost as much as all the rest."""
_FORGET: Final = 0.98
"""Share of the evidence on delays that is kept in a control period."""
_CONVINCED: Final = 12.0
"""Difference of the squared normalised errors by which another delay is believed."""
_DRIVE: Final = np.array([1e-3, 2e-2])
"""Standard deviations of steer and steer rate by which delays are told apart, besides noise."""
_SPEED_SHARE: Final = 0.1
"""Share of a measured wheel rate that is believed where sensors are noisy."""
_STEP: Final = 1e-4
"""Of the differences that the filter's transition is made of, rad and rad/s."""


_SURE: Final = 3.0
"""Standard deviations by which an offset must differ from none."""
_LEAST_OFFSET: Final = 0.008
"""Offset below which a measurement counts as right, rad."""
_LASTING: Final = 8
"""Control periods that it must have lasted."""
_SLOWLY: Final = 0.1
"""Share by which the correction grows in a control period."""


class Observer:
    """Follows one ride; see the module.

    Attributes:
        state: estimated minimal state at the last measurement.
        delay: control periods by which commands act late.
        noise: standard deviations of the measurements (MEASURED); 0 where they count as exact.
        offsets: excess of the measured roll and steering angle, rad.
    """

    def __init__(self, vehicle: Vehicle, period: float) -> None:
        """Begin a ride.

        Args:
            vehicle: as the rider knows it.
            period: control period, s.
        """
        self._vehicle, self._period = vehicle, period
        self._substeps = max(math.ceil(period / 0.01 - 1e-9), 1)
        self._sent: deque[float] = deque([0.0] * (MAX_DELAY + 1), maxlen=MAX_DELAY + 1)
        self.delay = 0
        self.noise = np.zeros(_SIZE)
        self._against = np.zeros(MAX_DELAY + 1)
        self._last: st.StateVector | None = None
        self.state = np.zeros(st.STATE_SIZE)

    @property
    def offset_deviations(self) -> FloatArray:
        """Standard deviations of the offsets, rad."""
        return np.sqrt(np.diag(self._spread)[_SIZE:])

    @property
    def noisy(self) -> bool:
        """Whether a measurement does not count as exact."""
        return bool(self.noise.any())

    def answered(self, steer_set: float) -> None:
        """Take the command that was given after the last measurement, rad."""
        self._sent.append(steer_set)

    def measure(self, measured: st.StateVector) -> None:
        """Take the state that is measured one control period after the last one.

        Args:
            measured: minimal state with the errors of sensors.
        """
        if self._last is not None:
            self._predict(self._sent[-1 - self.delay])
        if self._last is None or not _is_covariance(self._spread):
            # In a fall the transition grows without bound; what was known before says nothing any more.
            self._begin(measured)
        else:
            self._judge_delay(measured, self._last)
            known, early = self.noise, self._judged < _OFTEN
            self._judge_noise(measured, self._last)
            changed = not np.array_equal(self.noise, known)
            if early:
                self._since.append((measured.copy(), self._sent[-1 - self.delay]))
            if changed and early:
                self._again()
            elif changed and not known.any():
                self._believe(measured)  # what was made of errors that counted as exact is worth nothing
            else:
                self._filter(measured)
        self._last = measured.copy()

    def ahead(self) -> st.StateVector:
        """Return the state at which the next answer will act: after the commands that are still on their way."""
        state = self.state.copy()
        for late in range(self.delay, 0, -1):
            self._advance(state, self._sent[-late])
        return state

    def _again(self) -> None:
        """Filter all that was measured since the begin once more, with the noise that is known by now."""
        self._beyond[:] = 0.0
        self._believe(self._first)
        for measured, steer_set in self._since:
            self._predict(steer_set)
            if _is_covariance(self._spread):
                self._filter(measured)
            else:
                self._believe(measured)

    def _begin(self, measured: st.StateVector) -> None:
        """Forget all but the delay."""
        self._first = measured.copy()
        self._since: list[tuple[st.StateVector, float]] = []
        self._differences: deque[FloatArray] = deque(maxlen=_WINDOW)
        self._judged, self._noisy = 0, np.zeros(_SIZE, dtype=bool)
        self._beyond = np.zeros(1 + len(_RATES))
        self.noise = np.zeros(_SIZE)
        self._believe(measured)

    def _believe(self, measured: st.StateVector) -> None:
        """Begin the filter with a measurement, as good as its noise."""
        self.state, self.offsets = measured.copy(), np.zeros(len(OFFSETS))
        spread = np.zeros((_ALL, _ALL))
        spread[:_SIZE, :_SIZE] = np.diag(np.maximum(self.noise, _TRUST) ** 2)
        # A quantity is as unsure as the offset that the measured one contains.
        for offset, place in enumerate(OFFSETS, start=_SIZE):
            spread[np.ix_((place, offset), (place, offset))] += _FIRST_OFFSET**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
        self._spread = spread

    def _advance(self, state: st.StateVector, steer_set: float) -> None:
        advance(state, steer_set, self._period / self._substeps, self._substeps, self._vehicle.parameters)

    def _predict(self, steer_set: float) -> None:
        """Go on from the last state to the instant that is measured next, with the command that acts, rad."""
        self._expected = self.state.copy()
        self._advance(self._expected, steer_set)
        moves = self._transition(self.state, self._expected, steer_set)
        self._spread = moves @ self._spread @ moves.T + np.diag(_UNKNOWN**2)

    def _judge_delay(self, measured: st.StateVector, last: st.StateVector) -> None:
        """Compare what the steering did with what commands of each age would have done."""
        if self._judged < _LEAST:
            return  # noise that is not known yet looks like a delay
        places = [_STEER, _RATES[1]]
        unsure = self._spread[places, places] if self.noisy else 0.0
        deviation = np.sqrt(_DRIVE**2 + self.noise[places] ** 2 + unsure)
        known: dict[float, float] = {}
        for late in range(MAX_DELAY + 1):
            steer_set = self._sent[-1 - late]
            if steer_set not in known:
                state = self.state.copy()
                self._advance(state, steer_set)
                errors = ((measured - state)[[st.STEER, st.STEER_RATE]] - [self.offsets[1], 0.0]) / deviation
                known[steer_set] = min(float(errors @ errors), 25.0)
            self._against[late] = _FORGET * self._against[late] + known[steer_set]
        best = int(np.argmin(self._against))
        if self._against[self.delay] - self._against[best] > _CONVINCED:
            self.delay = best
            self._begin(last)
            self._predict(self._sent[-1 - self.delay])

    def _judge_noise(self, measured: st.StateVector, last: st.StateVector) -> None:
        """Judge how far measurements lie from what the measurements before them let expect."""
        expected = last.copy()
        self._advance(expected, self._sent[-1 - self.delay])
        self._differences.append(_difference(measured, expected))
        self._judged += 1
        if self._judged < _LEAST or (self._judged > _OFTEN and self._judged % _SELDOM):
            return
        away = np.abs(self._differences - np.median(self._differences, axis=0))
        # 1.4826 is the normal distribution's.
        deviation = 1.4826 * _BOTH * np.median(away, axis=0)
        noisy = self._noisy = deviation > np.where(self._noisy, 0.5 * _EXACT, _EXACT)
        if self._judged <= _OFTEN:  # the median of a few may be far too small, and then a start is a fall
            deviation = _BOTH * away.max(axis=0)
            noisy = noisy.any() & (deviation > _EXACT)  # nor is one sensor noisy alone
        self.noise = np.where(noisy, deviation, 0.0)

    def _filter(self, measured: st.StateVector) -> None:
        expected, spread, shown = self._expected, self._spread, _SHOWN
        difference = _difference(measured, expected)
        difference[list(OFFSETS)] -= self.offsets
        errors = np.diag(np.maximum(self.noise, _TRUST) ** 2)
        size = np.sqrt(np.diag(shown @ spread @ shown.T + errors))
        if self._is_pushed(difference / size):
            for k in (_ROLL, _STEER, *_RATES):
                spread[k, k] += difference[k] ** 2
        gain = np.linalg.solve(shown @ spread @ shown.T + errors, shown @ spread).T
        change = gain @ difference
        self._spread = (np.eye(_ALL) - gain @ shown) @ spread
        self._spread = 0.5 * (self._spread + self._spread.T)
        self.offsets += change[_SIZE:]
        self.state = _displaced(expected, measured, change, self.noisy)

    def _is_pushed(self, difference: FloatArray) -> bool:
        """Return whether a difference, in standard deviations, is that of a push.

        A noisy measurement may be one in a thousand; a push shows in the next one as well.
        """
        beyond = np.where(np.abs(difference) > _PUSHED, np.sign(difference), 0.0)[[_ROLL, *_RATES]]
        lasts = beyond * self._beyond > 0.0
        self._beyond = beyond
        return bool(lasts.any() if self.noisy else beyond.any())

    def _transition(self, before: st.StateVector, after: st.StateVector, steer_set: float) -> FloatArray:
        """Return how deviations before a control period change those after it, shape (8, 8)."""
        moves = np.eye(_ALL)
        sin, cos = math.sin(after[st.YAW]), math.cos(after[st.YAW])
        moved = after[[st.X, st.Y]] - before[[st.X, st.Y]]
        moves[0, 0] = math.cos(after[st.YAW] - before[st.YAW])
        moves[0, 1] = cos * moved[0] + sin * moved[1]
        # Of the same steps: errors of others, divided by _STEP, would be large where the bicycle moves quickly.
        plain = before.copy()
        advance(plain, steer_set, self._period / 2, 2, self._vehicle.parameters)
        for column, place in enumerate(_FREE, start=2):
            varied = before.copy()
            varied[place] += _STEP
            advance(varied, steer_set, self._period / 2, 2, self._vehicle.parameters)
            moves[:_SIZE, column] = _difference(varied, plain) / _STEP
        return moves


def _is_covariance(matrix: FloatArray) -> bool:
    if not np.isfinite(matrix).all():
        return False
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def _difference(state: st.StateVector, other: st.StateVector) -> FloatArray:
    """Return by how much a state differs from another one in what is measured."""
    sin, cos = math.sin(other[st.YAW]), math.cos(other[st.YAW])
    x, y = state[st.X] - other[st.X], state[st.Y] - other[st.Y]
    return np.array([cos * y - sin * x, state[st.YAW] - other[st.YAW], *(state - other)[list(_FREE)]])


def _displaced(expected: st.StateVector, measured: st.StateVector, change: FloatArray, noisy: bool) -> st.StateVector:
    """Return a state after a change of what is measured; the way along, wheels and speed come from the measured one."""
    state = measured.copy()
    sin, cos = math.sin(expected[st.YAW]), math.cos(expected[st.YAW])
    along = cos * (measured[st.X] - expected[st.X]) + sin * (measured[st.Y] - expected[st.Y])
    state[st.X] = expected[st.X] + along * cos - change[0] * sin
    state[st.Y] = expected[st.Y] + along * sin + change[0] * cos
    state[st.YAW] = expected[st.YAW] + change[1]
    state[list(_FREE)] = expected[list(_FREE)] + change[2:_SIZE]
    if noisy:  # the speed as well is seldom measured exactly then
        last = expected[st.FRONT_WHEEL_RATE]
        state[st.FRONT_WHEEL_RATE] = last + _SPEED_SHARE * (measured[st.FRONT_WHEEL_RATE] - last)
    return state


class ObservedRider:
    """Shows its rider the state without noise and offsets, and as late as the answer will act.

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
        self._machine = lk.Machine(vehicle.parameters, True, vehicle.mass)
        self._line, self._form = course.samples, lk.Points(preview.by_time, preview.interval)
        self._lasting, self._share = np.zeros(len(OFFSETS), dtype=int), np.zeros(len(OFFSETS))
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
        sure = np.abs(observer.offsets) > np.maximum(_LEAST_OFFSET, _SURE * observer.offset_deviations)
        self._lasting = np.where(sure, self._lasting + 1, 0)
        found = (self._lasting >= _LASTING) | (self._share > 0.0)
        self._share = np.where(found, np.minimum(self._share + _SLOWLY, 1.0), 0.0)
        if not (found.any() or observer.delay or observer.noisy):
            return snapshot
        state = observer.ahead()
        # As long as an offset is not sure it may be a steady turn of another bicycle: then what is measured counts.
        state[[st.ROLL, st.STEER]] += (1.0 - self._share) * observer.offsets
        return self._seen_from(snapshot, state)

    def _seen_from(self, snapshot: Snapshot, state: st.StateVector) -> Snapshot:
        """Return a snapshot of the same path from another state."""
        look, points = snapshot.look.copy(), np.empty((2, self._points.count))
        lk.derive_on_path(state, self._machine, self._line, self._form, False, look, points)
        return replace(snapshot, state=state, look=look, preview_x=points[0], preview_y=points[1])
