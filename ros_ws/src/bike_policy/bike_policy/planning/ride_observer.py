"""An observer of superbikes: position and roll where sensors are noisy or fixes rare, and tyres that are hidden.

It knows what a machine measures in any case: speed, yaw rate, roll rate and lateral acceleration. From these follow

- the **noise** of the lateral error, from its second difference less the one that the acceleration explains, and that
  of the roll, from its difference less the integrated rate; medians over half a second;
- the **delay** of the rider's commands: the one that explains how engine and brakes, which follow with a lag, went on;
- **fixes**: a position that stays the same bit for bit while the machine rolls is an old one;
- the **lateral error and its rate**, by a Kalman filter that the acceleration drives, the **roll** by one that the roll
  rate drives, and between fixes progress and heading by dead reckoning.

- slips, loads, cambers and forces of the **tyres**, where they are hidden: slip angles from the rate of the lateral
  error, the heading and the steering, slips from the wheels' rates, and loads and forces from the accelerations.

Where it finds neither noise nor a delay nor old fixes, and nothing is hidden, the rider is shown what was measured, bit
for bit.

Source of the filters: Simon (2006), Optimal State Estimation, Wiley, Sect. 5.1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.contract.observation import Rows, VehicleRows
from bike_policy.planning.reference import KEPT, LineTable, LineTables, Plans, plan_at
from bike_sim.course.course import Course
from bike_sim.physics.superbike import tyres
from bike_sim.schema import LIMITS, LOOK, SIGNALS, STATE
from bike_sim.sim.disturbances import TYRE_SIGNALS
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]
Record = Any

WINDOW: Final = 24
"""Control periods over which noise is judged."""
LEAST: Final = 3
"""Control periods before it is: a start on strong noise is soon a fall."""
LATERAL_EXACT: Final = 0.004
"""Noise of the lateral error that counts as none, m: as much as an uneven road makes."""
ROLL_EXACT: Final = 1e-3
"""Noise of the roll that counts as none, rad."""
KEPT_NOISE: Final = 0.5
"""Part of these from which noise that was found is noise no more."""
FIX_NOISE: Final = 0.01
"""Least noise of a position that comes in fixes, m."""
ACCELERATION_ERROR: Final = 0.8
"""Standard deviation of the lateral acceleration as the filter takes it, m/s^2: of the model 0.1, the rest of
sensors and of what moves the machine besides."""
FORCE_ERROR: Final = 0.01
"""Standard deviation of the force that the tyre law predicts, by the weight."""
ESTIMATE_ERROR: Final = 0.06
"""The same where slips and loads are estimates, for an exact rate of the lateral error."""
CORNERING: Final = 15.0
"""Force of a tyre by load and slip angle, 1/rad, with which an error of that rate counts."""
MOST_DELAY: Final = 8
"""Control periods."""
FORGET: Final = 0.98
"""Share of the evidence on delays that is kept in a control period."""
CONVINCED: Final = 0.05
"""Difference of the sums of squared errors of commands by which another delay is believed."""
RATE_ERROR: Final = 0.02
"""Standard deviation of the roll rate, rad/s."""
ROLL_DRIFT: Final = 3e-4
"""Standard deviation by which the integrated roll rate is off in a control period, rad: banking and pitching."""
FIRST_RATE: Final = 1.5
"""Standard deviation of the lateral error's rate at the beginning, m/s: side slip."""
_MEDIAN: Final = 0.6745
"""Median of the magnitude of a normal variable, by its standard deviation."""

_SEEN: Final = 11
_LOOK_COLUMNS: Final = tuple(
    LOOK.index(name) for name in ("progress", "lateral_error", "heading_error", "speed", "yaw_rate", "curvature")
)
_STATE_COLUMNS: Final = tuple(STATE.index(name) for name in ("roll", "roll_rate"))
_ACCELERATION: Final = SIGNALS.index("acceleration_lat")
_SIGNAL_COLUMNS: Final = tuple(SIGNALS.index(name) for name in ("acceleration_lat", "drive_share", "brake_share"))
(_PROGRESS, _LATERAL, _HEADING, _SPEED, _YAW_RATE, _CURVATURE, _ROLL, _ROLL_RATE, _SIDEWAYS, _DRIVE_SHARE,
 _BRAKE_SHARE) = range(_SEEN)  # fmt: skip
_SHOWN: Final = (LOOK.index("progress"), LOOK.index("lateral_error"), LOOK.index("heading_error"))
_CURVATURE_SHOWN, _SPACING = map(LOOK.index, ("curvature", "preview_spacing"))
_LEFT: Final = [LIMITS.index("rear_left_margin"), LIMITS.index("front_left_margin")]
_RIGHT: Final = [LIMITS.index("rear_right_margin"), LIMITS.index("front_right_margin")]
_ROLL_STATE, _RATE_STATE = map(STATE.index, ("roll", "roll_rate"))
_SPEED_SHOWN, _TURN = map(LOOK.index, ("speed", "yaw_rate"))

_STEER, _REAR_WHEEL, _FRONT_RATE = map(STATE.index, ("steer", "rear_wheel_angle", "front_wheel_rate"))
_LONG, _BRAKE = map(SIGNALS.index, ("acceleration_long", "front_brake"))
_TYRE_SIGNALS: Final = [SIGNALS.index(name) for name in TYRE_SIGNALS]
_KNOWN: Final = [place for place in range(len(SIGNALS)) if place not in _TYRE_SIGNALS]
_REAR_LOAD: Final = SIGNALS.index("rear_load")

MEMORY: Final = np.dtype(
    [
        ("periods", np.int64),
        ("fresh", np.int64),
        ("differences", np.int64),
        ("roll_differences", np.int64),
        ("fixes", np.int64),
        ("lateral_found", np.int64),
        ("roll_found", np.int64),
        ("delay", np.int64),
        ("answers", np.int64),
        ("seen", np.float64, (_SEEN,)),
        ("against", np.float64, (MOST_DELAY + 1,)),
        ("sent", np.float64, (MOST_DELAY + 1,)),
        ("lateral_before", np.float64),
        ("lateral_residuals", np.float64, (WINDOW,)),
        ("roll_residuals", np.float64, (WINDOW,)),
        *((name, np.float64) for name in ("lateral_noise", "roll_noise", "lateral", "rate", "roll", "progress")),
        *((name, np.float64) for name in ("heading", "variance", "covariance", "rate_variance", "roll_variance")),
        *((name, np.float64) for name in ("ahead", "aside", "turned", "wheel_angle", "wheel_rate")),
    ]
)
"""What is remembered of a ride: control periods; those in a row with a new position; differences that were judged; old
fixes that were seen; what was found; delay in control periods and answers that were given; the last measurements;
evidence against each delay, and throttles sent, newest first; the lateral error before; residuals; noise (m, rad); the
estimate and its variances; motion since the last fix (m, rad); angle of the rear wheel and its rate (rad, rad/s)."""


_CURVATURE_OF, _CREST_OF = 0, 1
"""Columns of a line's table."""


class RideObserver:
    """Observes rides of superbikes side by side; see the module.

    Attributes:
        rates: estimated rate of each lateral error, m/s; NaN where what was measured is shown, shape (n,).
        delays: by which commands act late, s, shape (n,).
        force_errors: standard deviation of the force that the tyre law predicts by what is shown, by the weight, shape
            (n,): larger where slips and loads are estimates.
    """

    def __init__(self, vehicle: Superbike, period: float, count: int = 1) -> None:
        """Prepare for a number of rides.

        Args:
            vehicle: the machine as its rider knows it.
            period: control period, s.
            count: number of rides.
        """
        self._period = period
        self._machine, self._above = vehicle.machine, vehicle.frame.height - vehicle.rear_tyre.crown
        self._lines, self.force_errors = LineTables(count, (0.0, 0.0)), np.full(count, FORCE_ERROR)
        self._centre = vehicle.com_x, vehicle.com_height
        self._line = lru_cache(maxsize=KEPT)(
            lambda line: LineTable(float(line.s[1]), np.stack((line.curvature, line.crest), axis=1))
        )
        self.memory = np.zeros(count, dtype=MEMORY)
        self.rates, self.delays = np.full(count, np.nan), np.zeros(count)
        self._lags = vehicle.motor.lag, vehicle.brakes.lag

    def begin(self, row: int, line: Course) -> None:
        """Begin a ride of a closed line."""
        self._lines.begin(row, self._line(line))
        self.memory[row] = np.zeros((), dtype=MEMORY)
        self.rates[row], self.delays[row] = np.nan, 0.0

    def observe(self, rows: VehicleRows) -> VehicleRows:
        """Take in a control instant and return what the rider is shown; the same again for the same rows."""
        memory, tables = self.memory, self._lines.plans
        seen = rows.state, rows.look, rows.signals
        found = self.rates, self.delays, self.force_errors
        if not _observe(*seen, memory, self._period, self._lags, self._centre, tables, *found):
            return rows
        hidden = np.isnan(rows.signals[:, _REAR_LOAD])
        old = memory["fixes"] > 1
        shown = self._shown(rows, (memory["lateral_found"] > 0) | old, old)
        if hidden.any():
            estimated = np.where(hidden[:, None], 0.0, rows.signals)
            estimated[:, _KNOWN] = rows.signals[:, _KNOWN]
            _estimate(
                np.flatnonzero(hidden), shown.state, shown.look, estimated, memory, tables, self._machine, self._above
            )
            shown = shown._replace(signals=estimated)
        return shown

    def answered(self, commands: FloatArray) -> None:
        """Take the commands that were sent after what was observed last, shape (n, 2)."""
        memory = self.memory
        fresh = memory["answers"] < memory["periods"]
        memory["sent"][fresh, 1:] = memory["sent"][fresh, :-1]
        memory["sent"][fresh, 0] = commands[fresh, 1]
        memory["answers"][fresh] = memory["periods"][fresh]

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Return all of it, as arrays."""
        return {"memory": self.memory.view(np.uint8).copy(), "rates": self.rates.copy()}

    def restore(self, stored: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what :meth:`state_dict` returned, after each row has begun again."""
        self.memory.view(np.uint8)[...] = stored["memory"]
        self.rates[...] = stored["rates"]
        self.delays = self._period * self.memory["delay"]

    def _shown(self, rows: VehicleRows, unsure: NDArray[np.bool_], old: NDArray[np.bool_]) -> Rows:
        """Return rows with estimates of the roll and, where the position is unsure or old, of that."""
        memory, state, look, circuit = self.memory, rows.state.copy(), rows.look.copy(), rows.circuit.copy()
        leaning = memory["roll_found"] > 0
        state[leaning, _ROLL_STATE] = memory["roll"][leaning]
        for column, name in zip(_SHOWN, ("progress", "lateral", "heading"), strict=True):
            look[unsure, column] = memory[name][unsure]
        moved = look[:, _SHOWN[1]] - rows.look[:, _SHOWN[1]]
        circuit[:, _LEFT] -= moved[:, None]
        circuit[:, _RIGHT] += moved[:, None]
        points, preview = rows.points, rows.preview_xy
        if old.any():
            points, preview = points.copy(), preview.copy()
            table = self._lines.plans
            for row in np.flatnonzero(old).tolist():
                look[row, _CURVATURE_SHOWN] = plan_at(table, row, _CURVATURE_OF, look[row, _SHOWN[0]])
                ahead, aside = memory["ahead"][row], memory["aside"][row]
                cos, sin = math.cos(memory["turned"][row]), math.sin(memory["turned"][row])
                x, y = points[row, :, :, 0] - ahead, points[row, :, :, 1] - aside
                points[row, :, :, 0], points[row, :, :, 1] = cos * x + sin * y, cos * y - sin * x
                passed = (look[row, _SHOWN[0]] - rows.look[row, _SHOWN[0]]) / max(look[row, _SPACING], 1e-3)
                points[row] = _further(points[row], passed)
                if preview.shape[2] == points.shape[2]:
                    preview[row] = points[row, 0, :, :2].T
        return Rows(state, look, preview, rows.signals, circuit, points, rows.fallen, rows.opponents)


def _further(points: FloatArray, passed: float) -> FloatArray:
    """Return stations of lines, shape (lines, stations, 3), a part of their distance further on; by parabolas."""
    first = np.minimum(np.arange(points.shape[1]), points.shape[1] - 3)
    u = (np.arange(points.shape[1]) - first + passed)[None, :, None]
    near, middle, far = points[:, first], points[:, first + 1], points[:, first + 2]
    return np.asarray(0.5 * (1.0 - u) * (2.0 - u) * near + u * (2.0 - u) * middle - 0.5 * u * (1.0 - u) * far)


@njit(cache=True)
def _observe(
    state: FloatArray, look: FloatArray, signals: FloatArray, memory: Record, period: float,
    lags: tuple[float, float], centre: tuple[float, float], tables: Plans, rates: FloatArray, delays: FloatArray,
    force_errors: FloatArray,
) -> bool:  # fmt: skip
    """Take in a control instant; return whether anything but what was measured is to be shown."""
    other, now = False, np.empty(_SEEN)
    for row in range(len(state)):
        ride = memory[row]
        for place, column in enumerate(_LOOK_COLUMNS):
            now[place] = look[row, column]
        for place, column in enumerate(_STATE_COLUMNS):
            now[_ROLL + place] = state[row, column]
        for place, column in enumerate(_SIGNAL_COLUMNS):
            now[_SIDEWAYS + place] = signals[row, column]
        if math.isfinite(now.sum()):
            _observe_row(ride, now, state[row, _REAR_WHEEL], period, lags, centre, tables, rates, row)
        delays[row], force_errors[row] = period * ride.delay, FORCE_ERROR
        hidden = math.isnan(signals[row, _REAR_LOAD])
        if hidden:
            slip = CORNERING * math.sqrt(ride.rate_variance) / np.maximum(look[row, _SPEED_SHOWN], 1.0)
            force_errors[row] = math.sqrt(ESTIMATE_ERROR**2 + slip**2)
        other |= hidden or ride.lateral_found > 0 or ride.fixes > 1 or ride.roll_found != 0
    return other


@njit(cache=True)
def _observe_row(
    ride: Record, now: FloatArray, wheel: float, period: float, lags: tuple[float, float],
    centre: tuple[float, float], tables: Plans, rates: FloatArray, row: int,
) -> None:  # fmt: skip
    if ride.periods == 0:
        _begin(ride, now)
        ride.wheel_rate = math.nan
    else:
        same = True
        for column in range(_SEEN):
            same = same and ride.seen[column] == now[column]
        if same:
            return
        elapsed = _follow(ride, now, period, centre, tables, row)
        ride.wheel_rate = (wheel - ride.wheel_angle) / elapsed
        if elapsed == period:
            _judge_delay(ride, now, math.exp(-period / lags[0]), math.exp(-period / lags[1]))
    ride.wheel_angle = wheel
    ride.periods += 1
    for column in range(_SEEN):
        ride.seen[column] = now[column]
    found = ride.lateral_found != 0 or ride.fixes > 1
    rates[row] = ride.rate if found else math.nan


@njit(cache=True)
def _begin(ride: Record, now: FloatArray) -> None:
    """Believe the first measurement; the rate is that of the heading, without side slip."""
    ride.lateral, ride.roll, ride.progress, ride.heading = now[_LATERAL], now[_ROLL], now[_PROGRESS], now[_HEADING]
    ride.rate = now[_SPEED] * math.sin(now[_HEADING])
    ride.variance, ride.covariance, ride.rate_variance = FIX_NOISE**2, 0.0, FIRST_RATE**2
    ride.roll_variance = ROLL_EXACT**2
    ride.fresh = 1


@njit(cache=True)
def _follow(
    ride: Record, now: FloatArray, period: float, centre: tuple[float, float], tables: Plans, row: int
) -> float:
    """Go on to a later instant, take in what is measured there, and return the time in between, s.

    The centre of mass, whose acceleration is measured, lies ahead of the rear contact and above it (m): what yaw and
    roll rates change turns it about that.
    """
    before = ride.seen
    held = now[_LATERAL] == before[_LATERAL] and now[_PROGRESS] == before[_PROGRESS] and now[_SPEED] > 2.0
    elapsed = period
    if not held and ride.fixes == 0:
        # States in between may have been lost: the distance shows how many.
        elapsed *= min(max(1.0, np.rint((now[_PROGRESS] - before[_PROGRESS]) / (max(1.0, now[_SPEED]) * period))), 10.0)
    _judge(ride, now, period, held or elapsed > period)
    speed, yaw_rate = 0.5 * (before[_SPEED] + now[_SPEED]), 0.5 * (before[_YAW_RATE] + now[_YAW_RATE])
    curvature = plan_at(tables, row, _CURVATURE_OF, ride.progress)
    _reckon(ride, speed, yaw_rate, curvature, elapsed)
    sideways = 0.5 * (before[_SIDEWAYS] + now[_SIDEWAYS]) - curvature * speed * speed
    turning = centre[1] * math.cos(ride.roll) * (now[_ROLL_RATE] - before[_ROLL_RATE])
    turning -= centre[0] * (now[_YAW_RATE] - before[_YAW_RATE])
    ride.lateral += elapsed * (ride.rate + 0.5 * (elapsed * sideways + turning))
    ride.rate += elapsed * sideways + turning
    error = ACCELERATION_ERROR**2
    ride.variance += elapsed * (2.0 * ride.covariance + elapsed * ride.rate_variance) + 0.25 * elapsed**4 * error
    ride.covariance += elapsed * ride.rate_variance + 0.5 * elapsed**3 * error
    ride.rate_variance += elapsed**2 * error
    ride.roll += 0.5 * elapsed * (before[_ROLL_RATE] + now[_ROLL_RATE])
    ride.roll_variance += 0.5 * (elapsed * RATE_ERROR) ** 2 + ROLL_DRIFT**2
    noise = max(ride.roll_noise, ROLL_EXACT)
    gain = ride.roll_variance / (ride.roll_variance + noise * noise)
    ride.roll += gain * (now[_ROLL] - ride.roll)
    ride.roll_variance *= 1.0 - gain
    if held:
        return elapsed
    noise = max(ride.lateral_noise, FIX_NOISE if ride.fixes else 0.5 * LATERAL_EXACT)
    spread = ride.variance + noise * noise
    gain, rate_gain, missed = ride.variance / spread, ride.covariance / spread, now[_LATERAL] - ride.lateral
    ride.lateral += gain * missed
    ride.rate += rate_gain * missed
    ride.rate_variance -= rate_gain * ride.covariance
    ride.covariance *= 1.0 - gain
    ride.variance *= 1.0 - gain
    ride.progress, ride.heading = now[_PROGRESS], now[_HEADING]
    ride.ahead = ride.aside = ride.turned = 0.0
    return elapsed


@njit(cache=True)
def _reckon(ride: Record, speed: float, yaw_rate: float, curvature: float, elapsed: float) -> None:
    """Move on from the last fix by speed and yaw rate."""
    slip = min(max(ride.rate / max(speed, 1.0) - math.sin(ride.heading), -0.3), 0.3)
    along = speed * math.cos(ride.heading + slip) / max(0.2, 1.0 - curvature * ride.lateral)
    direction = ride.turned + 0.5 * elapsed * yaw_rate + slip
    ride.ahead += elapsed * speed * math.cos(direction)
    ride.aside += elapsed * speed * math.sin(direction)
    ride.turned += elapsed * yaw_rate
    ride.progress += elapsed * along
    ride.heading += elapsed * (yaw_rate - curvature * along)


@njit(cache=True)
def _judge(ride: Record, now: FloatArray, period: float, odd: bool) -> None:
    """Judge the noise of lateral error and roll; an instant is odd where its position is old, or others were lost."""
    before = ride.seen
    if odd:
        ride.fixes += 1 if now[_LATERAL] == before[_LATERAL] else 0
        ride.fresh = 0
    elif ride.fixes == 0:
        explained = before[_SIDEWAYS] - before[_CURVATURE] * before[_SPEED] * before[_SPEED]
        if ride.fresh > 1:
            residual = now[_LATERAL] - 2.0 * before[_LATERAL] + ride.lateral_before - period * period * explained
            ride.lateral_residuals[ride.differences % WINDOW] = abs(residual)
            ride.differences += 1
            noise = _spread(ride.lateral_residuals, ride.differences) / math.sqrt(6.0)
            found = noise > LATERAL_EXACT * (KEPT_NOISE if ride.lateral_found else 1.0)
            if found and not ride.lateral_found:
                ride.variance = max(ride.variance, noise * noise)
                ride.rate_variance = max(ride.rate_variance, FIRST_RATE**2)
            ride.lateral_found, ride.lateral_noise = 1 if found else 0, noise if found else 0.0
        ride.fresh += 1
    ride.lateral_before = before[_LATERAL]
    if odd and now[_LATERAL] != before[_LATERAL]:
        return
    residual = now[_ROLL] - before[_ROLL] - 0.5 * period * (before[_ROLL_RATE] + now[_ROLL_RATE])
    ride.roll_residuals[ride.roll_differences % WINDOW] = abs(residual)
    ride.roll_differences += 1
    noise = _spread(ride.roll_residuals, ride.roll_differences) / math.sqrt(2.0)
    found = noise > ROLL_EXACT * (KEPT_NOISE if ride.roll_found else 1.0)
    ride.roll_found, ride.roll_noise = 1 if found else 0, noise if found else 0.0


@njit(cache=True)
def _judge_delay(ride: Record, now: FloatArray, drive_left: float, brake_left: float) -> None:
    """Compare the throttle that acted in the last control period with those that were sent.

    Args:
        ride: what is remembered; its last command is the one before this instant.
        now: what is measured.
        drive_left: part of a difference that the engine's lag leaves in a control period.
        brake_left: the same of the brakes.
    """
    drive = (now[_DRIVE_SHARE] - drive_left * ride.seen[_DRIVE_SHARE]) / (1.0 - drive_left)
    brake = (now[_BRAKE_SHARE] - brake_left * ride.seen[_BRAKE_SHARE]) / (1.0 - brake_left)
    for late in range(len(ride.against)):
        sent = ride.sent[late] if late < ride.answers else 0.0
        error = (drive - max(sent, 0.0)) ** 2 + (brake - max(-sent, 0.0)) ** 2
        ride.against[late] = FORGET * ride.against[late] + error
    best = np.argmin(ride.against)
    known = ride.against[ride.delay]
    if known - ride.against[best] > CONVINCED and ride.against[best] < 0.1 * known:
        ride.delay = best


@njit(cache=True)
def _spread(residuals: FloatArray, count: int) -> float:
    """Return the standard deviation of residuals by the median of their magnitudes; 0 while there are too few."""
    if count < LEAST:
        return 0.0
    return float(np.median(residuals[: min(count, WINDOW)]) / _MEDIAN)


(_R_LOAD, _R_SLIP, _R_ANGLE, _R_CAMBER, _R_USE, _F_LOAD, _F_SLIP, _F_ANGLE, _F_CAMBER, _F_USE, _R_LONG, _R_LAT,
 _F_LONG, _F_LAT, _ASIDE, _UPWARDS) = _TYRE_SIGNALS  # fmt: skip


@njit(cache=True)
def _estimate(
    rows: NDArray[np.int64], states: FloatArray, looks: FloatArray, signals: FloatArray, memory: Record,
    tables: Plans, machine: Record, above: float,
) -> None:  # fmt: skip
    """Write what the tyres do by accelerations, wheel rates and the motion of the rear contact.

    Args:
        rows: of which.
        states: as they are shown.
        looks: as they are shown.
        signals: written where they are hidden.
        memory: of the rides.
        tables: of their lines.
        machine: as its rider knows it.
        above: height of the point whose speed is measured over the centre of the rear tyre's cross-section, m.
    """
    air, rear, front = machine.air, machine.rear_tyre, machine.front_tyre
    for row in rows:
        state, look, signal, ride = states[row], looks[row], signals[row], memory[row]
        roll, steer, speed, turn = state[_ROLL_STATE], state[_STEER], max(look[_SPEED_SHOWN], 1.0), look[_TURN]
        sin, cos = math.sin(roll), math.cos(roll)
        # Sideways motion of the rear contact, which the tyre's crown rolls aside as the machine leans.
        slide = (ride.rate + rear.crown * state[_RATE_STATE]) / speed - math.sin(look[_SHOWN[2]])
        tilt = math.sin(steer) * math.sin(machine.lam)
        steered = math.atan2(math.sin(steer) * math.cos(machine.lam), cos * math.cos(steer) + sin * tilt)
        signal[_R_CAMBER], signal[_R_ANGLE] = roll, slide
        signal[_F_CAMBER] = math.asin(min(max(math.cos(steer) * sin - tilt * cos, -1.0), 1.0))
        signal[_F_ANGLE] = slide + machine.w * turn / speed - steered
        contact = max(speed - turn * above * sin, 1.0)
        radius = machine.rR - rear.crown * (1.0 - cos)
        rate = ride.wheel_rate
        signal[_R_SLIP] = rate * radius / contact - 1.0 if math.isfinite(rate) else 0.0
        radius = machine.rF - front.crown * (1.0 - math.cos(signal[_F_CAMBER]))
        signal[_F_SLIP] = state[_FRONT_RATE] * radius * math.cos(machine.w * turn / contact) / contact - 1.0
        drag = 0.5 * air.density * air.drag_area * speed * speed
        along, aside = machine.mass * signal[_LONG] + drag, machine.mass * signal[_ACCELERATION]
        crest = plan_at(tables, row, _CREST_OF, look[_SHOWN[0]])
        load = machine.mass * (machine.g + crest * speed * speed)
        load = max(load + 0.5 * air.density * air.down_area * speed * speed * cos, 0.0)
        height = machine.com_height * cos
        lever = load * machine.com_x - along * height - drag * (air.height * cos - height)
        signal[_F_LOAD] = min(max(lever / machine.w, 0.0), load)
        signal[_R_LOAD] = load - signal[_F_LOAD]
        signal[_F_LONG] = -signal[_BRAKE] / machine.rF
        signal[_R_LONG] = along - signal[_F_LONG]
        signal[_F_LAT] = (machine.com_x * aside + machine.com_height * sin * along) / machine.w
        signal[_R_LAT] = aside - signal[_F_LAT]
        signal[_R_USE] = tyres.forces(
            signal[_R_SLIP], math.tan(signal[_R_ANGLE]), signal[_R_CAMBER], signal[_R_LOAD], 1.0, rear
        )[3]
        signal[_F_USE] = tyres.forces(
            signal[_F_SLIP], math.tan(signal[_F_ANGLE]), signal[_F_CAMBER], signal[_F_LOAD], 1.0, front
        )[3]
        signal[_ASIDE] = speed * slide - height * state[_RATE_STATE]
        signal[_UPWARDS] = -machine.com_height * sin * state[_RATE_STATE]
