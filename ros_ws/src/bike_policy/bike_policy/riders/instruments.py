"""What riders of superbikes side by side are shown in place of what is, and when their commands act.

Sensors err, a position comes in fixes, all that is seen may be late, and commands act late and change no faster than
they may. One implementation serves rows of a batch, training and the single rider of a node, with the same bits: the
draws of a row depend on its seed, its first state and the number of the control period alone.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.contract.observation import Rows, VehicleRows
from bike_sim.schema import LIMITS, LOOK, SIGNALS, STATE
from bike_sim.sim.disturbances import MACHINE_CHANNELS, TYRE_SIGNALS, Disturbances
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

SENSORS: Final = 1
"""Branch of the draws."""
_BLOCK: Final = 64
"""Control periods whose errors are drawn at once."""

_CHANNELS: Final = len(MACHINE_CHANNELS)
(_ROLL, _STEER, _ROLL_RATE, _STEER_RATE, _LATERAL, _HEADING, _SPEED, _PROGRESS, _YAW_RATE, _ACCELERATION_LONG,
 _ACCELERATION_LAT, _WHEEL_SPEED) = range(_CHANNELS)  # fmt: skip
_X, _Y, _YAW = map(STATE.index, ("x", "y", "yaw"))
_S_ROLL, _S_STEER, _S_ROLL_RATE = map(STATE.index, ("roll", "steer", "roll_rate"))
_S_STEER_RATE, _S_WHEEL_RATE = map(STATE.index, ("steer_rate", "front_wheel_rate"))
_L_SPEED, _L_PROGRESS, _L_LATERAL = map(LOOK.index, ("speed", "progress", "lateral_error"))
_L_HEADING, _L_YAW_RATE = map(LOOK.index, ("heading_error", "yaw_rate"))
_L_FRONT_X, _L_FRONT_Y = map(LOOK.index, ("front_x", "front_y"))
_L_FRONT_PROGRESS, _L_FRONT_LATERAL = map(LOOK.index, ("front_progress", "front_lateral_error"))
_G_SPEED, _G_YAW_RATE = map(SIGNALS.index, ("speed", "yaw_rate"))
_G_LONG, _G_LAT = map(SIGNALS.index, ("acceleration_long", "acceleration_lat"))
_REAR_LEFT, _REAR_RIGHT, _FRONT_LEFT, _FRONT_RIGHT, _OUTSIDE = map(LIMITS.index, LIMITS.names[:5])

_FIXED_STATE: Final = [_X, _Y, _YAW]
_FIXED_LOOK: Final = [
    place for place, name in enumerate(LOOK.names) if name not in ("pitch", "yaw_rate", "speed", "preview_spacing")
]
"""Columns of state and look that come with a fix of the position."""

_TYRE_SIGNALS: Final = [SIGNALS.index(name) for name in TYRE_SIGNALS]


class CommandQueue:
    """Commands on their way to vehicles side by side: late, and changing no faster than they may.

    Until the first has arrived, they are straight ahead.
    """

    def __init__(self, late: Sequence[int], changes: Sequence[float]) -> None:
        """Prepare for as many vehicles as there are delays.

        Args:
            late: control periods until a command acts.
            changes: largest change of steering and throttle in a control period.
        """
        self._late, self._every = np.array(late), np.arange(len(late))
        self._changes = np.array(changes)[:, None]
        self._limits = bool(np.isfinite(self._changes).any())
        self._sent = np.zeros((max(late) + 1, len(late), 2))
        self._acting = np.zeros((len(late), 2))

    @classmethod
    def of(cls, disturbances: Sequence[Disturbances], period: float) -> CommandQueue:
        """Return the one of vehicles under disturbances, with a control period, s.

        Raises:
            ValueError: a delay that is not a whole number of control periods.
        """
        late = [known.periods(known.command_delay_s, period) for known in disturbances]
        return cls(late, [known.command_rate * period for known in disturbances])

    def begin(self, row: int) -> None:
        """Begin a ride."""
        self._sent[:, row], self._acting[row] = 0.0, 0.0

    def send(self, commands: FloatArray) -> FloatArray:
        """Send the commands of a control period and return those that act in it, shape (n, 2)."""
        self._sent[1:] = self._sent[:-1].copy()
        self._sent[0] = commands
        arrived = np.asarray(self._sent[self._late, self._every])
        if self._limits:
            change = np.clip(arrived - self._acting, -self._changes, self._changes)
            arrived = np.where(np.isinf(self._changes), arrived, self._acting + change)
        self._acting = arrived
        return arrived.copy()

    def hold(self) -> FloatArray:
        """Return as `send` for a control period in which nothing new is sent."""
        return self.send(self._sent[0].copy())

    def state_dict(self) -> dict[str, FloatArray]:
        """Return what is on its way."""
        return {"sent": self._sent.copy(), "acting": self._acting.copy()}

    def restore(self, stored: Mapping[str, FloatArray]) -> None:
        """Continue from what :meth:`state_dict` returned."""
        self._sent[...], self._acting = stored["sent"], stored["acting"].copy()


class Instruments:
    """Everything between superbikes side by side and their riders; a control period is `shown`, then `acting`.

    Attributes:
        queue: of the commands.
        active: whether anything is shown otherwise than it is.

    Rows that nothing disturbs are shown as they are, bit for bit.
    """

    def __init__(self, disturbances: Sequence[Disturbances], vehicles: Sequence[Vehicle], period: float) -> None:
        """Prepare for a number of rides.

        Args:
            disturbances: of each row.
            vehicles: of each row, as its rider knows it.
            period: control period, s.

        Raises:
            ValueError: a delay or a time between fixes that is not a whole number of control periods, or errors of
                sensors that the vehicle does not have.
        """
        count = len(disturbances)
        for known, vehicle in zip(disturbances, vehicles, strict=True):
            known.check_sensors(vehicle)
            if known.acts_on_sensors and not isinstance(vehicle, Superbike):
                raise ValueError(
                    f"disturbances {known.name!r} have errors of sensors, and beside others only superbikes have "
                    f"instruments, not {vehicle.name!r}"
                )
        self._disturbances = list(disturbances)
        self.queue = CommandQueue.of(disturbances, period)
        self._noise = np.array([known.errors(known.noise) for known in disturbances])
        self._bias = np.array([known.errors(known.bias) for known in disturbances])
        self._between = np.array([known.fix_periods(period) for known in disturbances])
        self._late = np.array([known.periods(known.observation_delay_s, period) for known in disturbances])
        self._errs = (self._noise != 0.0).any(axis=1) | (self._bias != 0.0).any(axis=1)
        self._hidden = np.array([known.tyres_hidden for known in disturbances])
        self.active = bool(self._errs.any() or self._hidden.any() or self._late.any() or (self._between > 1).any())
        self._radius = np.array([vehicle.rF for vehicle in vehicles])
        self._every = np.arange(count)
        self._keys, self._age = np.zeros(count, dtype=np.int64), np.full(count, -1)
        self._measured = np.zeros(count, dtype=np.bool_)
        self._drawn: dict[int, tuple[int, FloatArray]] = {}
        self._now: Rows | None = None
        self._fix: Rows | None = None
        self._past: list[NDArray[Any]] = []

    def begin(self, row: int, rows: VehicleRows) -> VehicleRows:
        """Begin a ride and return what is shown of its first instant.

        Args:
            row: of the ride.
            rows: of all, after its reset.
        """
        self.queue.begin(row)
        if not self.active:
            return rows
        self._keys[row], self._age[row] = zlib.crc32(np.ascontiguousarray(rows.state[row]).tobytes()), -1
        self._measured[row] = False
        self._drawn.pop(row, None)
        self._measure(rows, [row])
        now = self._now
        assert now is not None, "it has been measured"
        for past, fresh in zip(self._past, now, strict=False):
            past[:, row] = fresh[row]
        return self._shown(rows)

    def shown(self, rows: VehicleRows) -> VehicleRows:
        """Return what riders are shown at this control instant; the same again until commands are sent."""
        if not self.active:
            return rows
        self._measure(rows, np.flatnonzero(~self._measured & (self._age >= -1)).tolist())
        return self._shown(rows)

    def acting(self, commands: FloatArray) -> FloatArray:
        """Take the commands of a control period and return those that act in it, shape (n, 2)."""
        self.go_on()
        return self.queue.send(commands)

    def go_on(self) -> None:
        """Measure anew when next something is shown."""
        self._measured[:] = False

    def miss(self) -> None:
        """Let a control period pass that the rider has not seen; what it saw before is shown on."""
        self.go_on()
        self.queue.hold()
        if self.active:
            self._age += 1
            self._pass(self._every)

    def state_dict(self) -> dict[str, Any]:
        """Return all of it, as arrays."""
        stored: dict[str, Any] = {"queue": self.queue.state_dict()}
        if self.active and self._now is not None and self._fix is not None:
            stored |= {"keys": self._keys.copy(), "age": self._age.copy(), "measured": self._measured.copy()}
            stored |= {name: [array.copy() for array in rows] for name, rows in self._arrays()}
        return stored

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Continue from what :meth:`state_dict` returned, after each row has begun again."""
        self.queue.restore(stored["queue"])
        if "keys" not in stored:
            return
        self._keys[...], self._age[...] = stored["keys"], stored["age"]
        self._measured[...] = stored["measured"]
        self._drawn.clear()
        for name, rows in self._arrays():
            for array, kept in zip(rows, stored[name], strict=True):
                array[...] = kept

    def _arrays(self) -> tuple[tuple[str, Sequence[NDArray[Any]]], ...]:
        assert self._now is not None, "rides have begun"
        assert self._fix is not None, "rides have begun"
        return ("now", self._now), ("fix", self._fix), ("past", self._past)

    def _errors(self, row: int, period: int) -> FloatArray:
        """Return the errors of a row in a control period of its ride, in the order of MACHINE_CHANNELS."""
        block, place = divmod(period, _BLOCK)
        known = self._drawn.get(row)
        if known is None or known[0] != block:
            seed = [self._disturbances[row].seed, int(self._keys[row]), SENSORS, block]
            known = self._drawn[row] = block, np.random.default_rng(seed).standard_normal((_BLOCK, _CHANNELS))
        errors: FloatArray = self._bias[row] + self._noise[row] * known[1][place]
        return errors

    def _measure(self, rows: VehicleRows, fresh: list[int]) -> None:
        """Measure rows that have not been measured at this instant."""
        if self._now is None:
            copies = [np.array(getattr(rows, name)) for name in Rows._fields]
            self._now, self._fix = Rows(*copies), Rows(*(array.copy() for array in copies))
            depth = int(self._late.max()) + 1
            self._past = [np.repeat(array[None], depth, axis=0) for array in copies] if depth > 1 else []
        if not fresh:
            return
        now, fix = self._now, self._fix
        assert fix is not None, "made together"
        self._age[fresh] += 1
        self._measured[fresh] = True
        for mine, true in zip(now, (getattr(rows, name) for name in Rows._fields), strict=True):
            mine[fresh] = true[fresh]
        for row in fresh:
            if self._errs[row]:
                errors = self._errors(row, int(self._age[row]))
                arrays = now.state[row], now.look[row], now.preview_xy[row], now.signals[row], now.circuit[row]
                _err(errors, float(self._radius[row]), *arrays, now.points[row])
            if self._hidden[row]:
                now.signals[row, _TYRE_SIGNALS] = np.nan
            if self._between[row] <= 1:
                continue
            if self._age[row] % self._between[row] == 0:
                for kept, mine in zip(fix, now, strict=True):
                    kept[row] = mine[row]
            else:
                now.state[row, _FIXED_STATE] = fix.state[row, _FIXED_STATE]
                now.look[row, _FIXED_LOOK] = fix.look[row, _FIXED_LOOK]
                for name in ("preview_xy", "circuit", "points"):
                    getattr(now, name)[row] = getattr(fix, name)[row]
        self._pass(np.array(fresh))

    def _pass(self, fresh: NDArray[np.int64]) -> None:
        """Put what has been measured of some rows before what was."""
        assert self._now is not None, "rides have begun"
        for past, mine in zip(self._past, self._now, strict=False):
            past[1:, fresh] = past[:-1, fresh]
            past[0, fresh] = mine[fresh]

    def _shown(self, rows: VehicleRows) -> Rows:
        """Return what was measured as late as each row sees it; who has fallen is known at once."""
        now = self._now
        assert now is not None, "it has been measured"
        if self._past:
            now = Rows(*(past[self._late, self._every] for past in self._past))
        return now._replace(fallen=rows.fallen)


@njit(cache=True)
def _err(
    errors: FloatArray, radius: float, state: FloatArray, look: FloatArray, preview: FloatArray, signals: FloatArray,
    circuit: FloatArray, points: FloatArray,
) -> None:  # fmt: skip
    """Add errors, of MACHINE_CHANNELS, to a row: limits and points of the course move with the position."""
    lateral, heading, along = errors[_LATERAL], errors[_HEADING], errors[_PROGRESS]
    base = look[_L_HEADING]
    yaw = state[_YAW] - base
    ahead = math.hypot(look[_L_FRONT_X] - state[_X], look[_L_FRONT_Y] - state[_Y])
    east = along * math.cos(yaw) - lateral * math.sin(yaw)
    north = along * math.sin(yaw) + lateral * math.cos(yaw)
    state[_X] += east
    state[_Y] += north
    state[_YAW] += heading
    look[_L_FRONT_X] += east
    look[_L_FRONT_Y] += north
    # The points of the course ahead lie as a machine sees them that is displaced and turned by the errors.
    aside_x = along * math.cos(base) + lateral * math.sin(base)
    aside_y = lateral * math.cos(base) - along * math.sin(base)
    cos, sin = math.cos(heading), math.sin(heading)
    for line in range(points.shape[0]):
        for k in range(points.shape[1]):
            x, y = points[line, k, 0] - aside_x, points[line, k, 1] - aside_y
            points[line, k, 0], points[line, k, 1] = cos * x + sin * y, cos * y - sin * x
    if preview.shape[1] == points.shape[1]:
        for k in range(preview.shape[1]):
            preview[0, k], preview[1, k] = points[0, k, 0], points[0, k, 1]
    look[_L_LATERAL] += lateral
    look[_L_HEADING] += heading
    look[_L_PROGRESS] += along
    look[_L_FRONT_PROGRESS] += along
    look[_L_FRONT_LATERAL] += lateral + ahead * math.sin(heading)
    turned = lateral + ahead * math.sin(heading)
    circuit[_REAR_LEFT] -= lateral
    circuit[_REAR_RIGHT] += lateral
    circuit[_FRONT_LEFT] -= turned
    circuit[_FRONT_RIGHT] += turned
    rear = max(-circuit[_REAR_LEFT], -circuit[_REAR_RIGHT])
    circuit[_OUTSIDE] = min(rear, max(-circuit[_FRONT_LEFT], -circuit[_FRONT_RIGHT]))
    state[_S_ROLL] += errors[_ROLL]
    state[_S_STEER] += errors[_STEER]
    state[_S_ROLL_RATE] += errors[_ROLL_RATE]
    state[_S_STEER_RATE] += errors[_STEER_RATE]
    state[_S_WHEEL_RATE] += errors[_WHEEL_SPEED] / radius
    look[_L_SPEED] += errors[_SPEED]
    look[_L_YAW_RATE] += errors[_YAW_RATE]
    signals[_G_SPEED] += errors[_SPEED]
    signals[_G_YAW_RATE] += errors[_YAW_RATE]
    signals[_G_LONG] += errors[_ACCELERATION_LONG]
    signals[_G_LAT] += errors[_ACCELERATION_LAT]
