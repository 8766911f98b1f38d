"""The classical rider's law, compiled: from what is observed of machines side by side to their commands.

`bike_policy.riders.classical` says what the law is and why. One compiled function answers for every row, so a single
rider, a guide of a learner's thirty-two machines, and a replay of any of them get the same numbers bit for bit.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.planning.lap_plan import (
    P_CREST,
    P_CURVATURE,
    P_FASTER,
    P_GRADE,
    P_LEFT,
    P_LONGITUDINAL,
    P_RIGHT,
    P_SPEED,
    PLAN,
    LinePlan,
    RiderSettings,
    SteadyLeans,
)
from bike_policy.planning.reference import LineTables, Plans, plan_at
from bike_sim.physics.superbike.statics import engine_force, inertial_mass
from bike_sim.schema import FLAG, LOOK, STATE, Quantity, Schema
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

MAX_GAP: Final = 0.3
"""Time without states after which the last one is not used for the lateral error's rate, s."""

INPUTS: Final = Schema(
    (
        LOOK["speed"],
        STATE["roll"],
        LOOK["progress"],
        LOOK["lateral_error"],
        LOOK["heading_error"],
        STATE["roll_rate"],
    )
)
"""Inputs of the law, in the order of their columns; progress is of any lap."""
MEMORY: Final = Schema(
    (
        *INPUTS,
        Quantity("known", FLAG, 1, "whether there is a state before, whose inputs stand in front"),
        Quantity("error_rate", "m/s", -1, "rate of the lateral error"),
        Quantity("excess", "m/s^2", -1, "of lateral acceleration over that of the line"),
        Quantity("steering", "1", -1, "command"),
        Quantity("throttle", "1", 1, "command"),
        Quantity("offset", "m", -1, "distance from the line that is ridden to, positive to the left"),
        Quantity("pace", "1", 1, "change of the planned speed that is ridden to, as a part of it"),
        Quantity("offset_rate", "m/s", -1, "rate of `offset`"),
        Quantity("missing", "m/s", 1, "speed that is missing to the planned one"),
        Quantity("closing", "m/s^2", 1, "rate at which the machine catches up"),
    )
)
"""Memory of the law for one ride: the inputs before, its commands, and its approach to the targets."""
SPEED, ROLL, PROGRESS = map(INPUTS.index, ("speed", "roll", "progress"))
LATERAL_ERROR, HEADING_ERROR, ROLL_RATE = map(INPUTS.index, ("lateral_error", "heading_error", "roll_rate"))
SEEN: Final = len(INPUTS)
KNOWN, RATE, EXCESS, STEERING, THROTTLE = map(MEMORY.index, ("known", "error_rate", "excess", "steering", "throttle"))
OFFSET, PACE, OFFSET_RATE = map(MEMORY.index, ("offset", "pace", "offset_rate"))
MISSING, CLOSING = map(MEMORY.index, ("missing", "closing"))
LATE: Final = 0.5
"""A command is held for a control period and so acts this part of it late."""


TARGET_TIME: Final = 0.3
"""Time constant with which targets are approached, twice over, s: line and speed then bend without a jump."""
CLEARING: Final = 1.0
"""A target beside the line must be clear of the limits so long ahead, s; it is looked at so many times."""
LOOKS: Final = 5
CLOSING_MEMORY: Final = 0.15
"""Time constant with which the rate of catching up with the plan is measured, s."""
LEAN_ROOM: Final = math.radians(1.3)
"""Lean left to ask for, rad, below which a machine that is slower than planned catches up less; with none, not at all.
That is 5 % of the lateral acceleration in the deepest lean; with 10 % a lap takes 0.1 % longer."""


def seen_of(state: FloatArray, look: FloatArray) -> FloatArray:
    """Return the inputs of the law, shape (n, SEEN), of machines side by side.

    Args:
        state: their minimal states.
        look: their looks.
    """
    observed = np.empty((len(state), SEEN))
    observed[:, _LOOK_INPUTS] = look[:, _LOOK_COLUMNS]
    observed[:, _STATE_INPUTS] = state[:, _STATE_COLUMNS]
    return observed


_LOOK_INPUTS: Final = [place for place, name in enumerate(INPUTS.names) if name in LOOK.names]
_LOOK_COLUMNS: Final = [LOOK.index(INPUTS.names[place]) for place in _LOOK_INPUTS]
_STATE_INPUTS: Final = [place for place, name in enumerate(INPUTS.names) if name in STATE.names]
_STATE_COLUMNS: Final = [STATE.index(INPUTS.names[place]) for place in _STATE_INPUTS]


class _Law(NamedTuple):
    """Constants of the law for one machine, settings and control period; lengths in m, times in s, forces in N."""

    frequency: float
    bandwidth: float
    preview: float
    speed_preview: float
    arms: float
    stencil: float
    trust: float
    largest_lean: float
    max_lean: float
    speed_gain: float
    period: float
    usual_period: float
    rate_memory: float
    mass: float
    drag: float
    gravity: float
    weight: float
    rolling: float
    above: float
    engine_brake: float
    brake_force: float


class LineLaw:
    """The law of one machine for rides side by side, with what it remembers of each.

    Attributes:
        leans: leans of the machine's steady turns.
    """

    def __init__(self, vehicle: Superbike, period: float, settings: RiderSettings, count: int = 1) -> None:
        """Prepare for a number of rides.

        Args:
            vehicle: the machine.
            period: control period, s.
            settings: of the ride.
            count: number of rides.
        """
        self.leans = SteadyLeans(vehicle)
        late = LATE * (period - settings.period)
        arms = 2.0 / vehicle.virtual_rider.arm_frequency
        weight = vehicle.mass * vehicle.g
        self._law = _Law(
            frequency=vehicle.virtual_rider.frequency,
            bandwidth=settings.bandwidth,
            preview=settings.preview + arms + late,
            speed_preview=settings.speed_preview + late,
            arms=arms,
            stencil=settings.stencil,
            trust=settings.lateral_trust,
            largest_lean=settings.largest_lean,
            max_lean=math.radians(vehicle.virtual_rider.max_lean_deg),
            speed_gain=settings.speed_gain,
            period=period,
            usual_period=settings.period,
            rate_memory=settings.rate_memory,
            mass=inertial_mass(vehicle),
            drag=0.5 * vehicle.air.density * vehicle.air.drag_area,
            gravity=vehicle.g,
            weight=weight,
            rolling=vehicle.rear_tyre.rolling * weight,
            above=vehicle.frame.height - vehicle.rear_tyre.crown,
            engine_brake=vehicle.motor.engine_brake,
            brake_force=vehicle.brakes.force,
        )
        engine = np.array([engine_force(vehicle, float(speed)) for speed in self.leans.speeds])
        self._tables: Tables = (self.leans.table, self.leans.speeds, self.leans.leans, engine)
        self._lines = LineTables(count, [0.0] * len(PLAN))
        self.memory = np.zeros((count, len(MEMORY)))

    def begin(self, row: int, plan: LinePlan) -> None:
        """Let a ride follow a plan from now on, without a past."""
        self._lines.begin(row, plan)
        self.memory[row] = 0.0

    def table(self, row: int) -> FloatArray:
        """Return the plan that a ride follows, shape (samples, len(PLAN)); what is written to it is followed.

        Rides that began with the same plan share it, and it holds until a ride begins with another one.
        """
        lines = self._lines
        return lines.samples[lines.offset[row] : lines.offset[row] + lines.last[row] + 2]

    def change(self, row: int, plan: LinePlan, observed: FloatArray) -> None:
        """Go on with another plan of the same line; the difference of speed is made up for as that of a target.

        Args:
            row: of the ride.
            plan: from now on.
            observed: of the ride, shape (SEEN,).
        """
        before = plan_at(self.plans, row, P_SPEED, observed[PROGRESS])
        self._lines.begin(row, plan)
        after = plan_at(self.plans, row, P_SPEED, observed[PROGRESS])
        self.memory[row, PACE] = (1.0 + self.memory[row, PACE]) * before / max(after, 1.0) - 1.0

    def commands(
        self,
        observed: FloatArray,
        targets: FloatArray | None = None,
        leans: FloatArray | None = None,
        rates: FloatArray | None = None,
        delays: FloatArray | None = None,
        pushes: FloatArray | None = None,
    ) -> FloatArray:
        """Return steering and throttle in [-1, 1], shape (n, 2); the same ones again for a repeated state.

        Args:
            observed: of each ride, columns SPEED to ROLL_RATE, shape (n, SEEN).
            targets: distance from the line to ride at, m, and change of the planned speed as a part of it, shape
                (n, 2); None for the line as planned.
            leans: largest lean that each may request, rad, shape (n,); None for that of the settings.
            rates: of the lateral errors, m/s, shape (n,); None or NaN for the differences of states.
            delays: time by which commands are known to act late, s, shape (n,); None for none.
            pushes: lateral accelerations by wind, positive to the left, m/s^2, shape (n,); None for none.
        """
        targets = np.zeros((len(observed), 2)) if targets is None else targets
        leans = np.full(len(observed), self._law.largest_lean) if leans is None else leans
        rates = np.full(len(observed), np.nan) if rates is None else rates
        delays, pushes = (np.zeros(len(observed)) if one is None else one for one in (delays, pushes))
        _answer(observed, targets, leans, rates, delays, pushes, self.memory, self._law, self._tables, self.plans)
        return self.memory[:, STEERING:OFFSET].copy()

    @property
    def plans(self) -> Plans:
        """The plans of all rides as compiled code reads them."""
        return self._lines.plans


Tables = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Of a machine: lateral accelerations by speed and lean, the speeds, the leans, and the engine's force by speed."""


@njit(cache=True)
def _answer(
    observed: FloatArray, targets: FloatArray, leans: FloatArray, rates: FloatArray, delays: FloatArray,
    pushes: FloatArray, memory: FloatArray, law: _Law, tables: Tables, plans: Plans,
) -> None:  # fmt: skip
    """Write the answer of each ride into the memory, beside what it was the answer to."""
    for row in range(len(observed)):
        same = memory[row, KNOWN] > 0.0
        for column in range(SEEN):
            same = same and memory[row, column] == observed[row, column]
        if same:
            continue
        _approach(observed[row], memory[row], targets[row], law, plans, row)
        turning = _turning_row(observed[row, SPEED], tables)
        _catch_up(observed[row], memory[row], law, plans, row)
        rate = rates[row] if math.isfinite(rates[row]) else _error_rate(observed[row], memory[row], law)
        delay, lean = delays[row], leans[row]
        steering = _steer(
            observed[row], memory[row], law, tables[2], turning, plans, row, lean, rate, delay, pushes[row]
        )
        margin = min(max((lean - abs(steering) * law.max_lean) / LEAN_ROOM, 0.0), 1.0)
        throttle = _throttle(observed[row], memory[row], margin, law, tables, plans, row, delay)
        memory[row, :SEEN] = observed[row]
        memory[row, KNOWN], memory[row, STEERING], memory[row, THROTTLE] = 1.0, steering, throttle


@njit(cache=True)
def _approach(observed: FloatArray, memory: FloatArray, target: FloatArray, law: _Law, plans: Plans, row: int) -> None:
    """Move towards the targets: critically damped to the line, with one lag to the speed."""
    pace = min(target[1], plan_at(plans, row, P_FASTER, observed[PROGRESS]))
    memory[PACE] += (1.0 - math.exp(-law.period / TARGET_TIME)) * (pace - memory[PACE])
    rate = 1.0 / TARGET_TIME
    aim = _within_limits(observed, target[0], plans, row)
    memory[OFFSET_RATE] += law.period * rate * (rate * (aim - memory[OFFSET]) - 2.0 * memory[OFFSET_RATE])
    memory[OFFSET] += law.period * memory[OFFSET_RATE]


@njit(cache=True)
def _within_limits(observed: FloatArray, offset: float, plans: Plans, row: int) -> float:
    """Return a distance from the line that stays clear of the limits for a while, m."""
    column = P_LEFT if offset > 0.0 else P_RIGHT
    size = abs(offset)
    for look in range(LOOKS + 1):
        distance = observed[SPEED] * CLEARING * look / LOOKS
        size = min(size, plan_at(plans, row, column, observed[PROGRESS] + distance))
    return math.copysign(size, offset)


@njit(cache=True)
def _catch_up(observed: FloatArray, memory: FloatArray, law: _Law, plans: Plans, row: int) -> None:
    """Remember how much speed is missing, and how fast the machine catches up."""
    missing = (1.0 + memory[PACE]) * plan_at(plans, row, P_SPEED, observed[PROGRESS]) - _rolled(
        observed, law, plans, row
    )
    elapsed = _elapsed(observed, memory, law)
    if elapsed == 0.0:
        memory[CLOSING] = 0.0
    else:
        closing = (memory[MISSING] - missing) / elapsed
        memory[CLOSING] += (1.0 - math.exp(-elapsed / CLOSING_MEMORY)) * (closing - memory[CLOSING])
    memory[MISSING] = missing


@njit(cache=True)
def _elapsed(observed: FloatArray, memory: FloatArray, law: _Law) -> float:
    """Return the time since the state before, s; 0 where there is none, or one too old to compare with.

    States in between may have been lost: the distance shows how many periods ago the previous one was.
    """
    distance = observed[PROGRESS] - memory[PROGRESS]
    longest = max(MAX_GAP, 4.0 * law.period)
    if memory[KNOWN] == 0.0 or abs(distance) > longest * observed[SPEED] + 1.0:
        return 0.0
    return float(law.period * max(1.0, np.rint(distance / (max(1.0, observed[SPEED]) * law.period))))


@njit(cache=True)
def _caught(memory: FloatArray, ahead: float) -> float:
    """Return how much of the missing speed the machine will have caught up after a time (s), m/s."""
    caught, missing = memory[CLOSING] * ahead, memory[MISSING]
    return min(max(caught, min(missing, 0.0)), max(missing, 0.0))


@njit(cache=True)
def _bend(memory: FloatArray, plans: Plans, row: int, s: float) -> float:
    """Return the curvature of the line that lies beside the planned one, 1/m."""
    curvature = plan_at(plans, row, P_CURVATURE, s)
    return curvature / max(0.5, 1.0 - curvature * memory[OFFSET])


@njit(cache=True)
def inside_pace(plans: Plans, row: int, s: float, speed: float, offset: float) -> float:
    """Return the change of the planned speed that a distance from the line asks: inside it the corner is tighter."""
    pace = 0.0
    for look in range(LOOKS + 1):
        bend = plan_at(plans, row, P_CURVATURE, s + 0.3 * look * speed)
        pace = min(pace, -0.5 * min(max(bend * offset, 0.0), 0.5))
    return pace


@njit(cache=True)
def slower_inside(observed: FloatArray, targets: FloatArray, room: float, plans: Plans) -> None:
    """Bound the paces of targets by those of their distances from the line, in place, see `inside_pace`.

    Args:
        observed: inputs of the law, shape (n, columns of INPUTS).
        targets: in and out, shape (n, 2).
        room: pace that the line itself leaves in corners.
        plans: of the law.
    """
    for row in range(len(observed)):
        bound = inside_pace(plans, row, observed[row, PROGRESS], max(observed[row, SPEED], 1.0), targets[row, 0])
        if bound < 0.0:
            targets[row, 1] = min(targets[row, 1], room + bound)


@njit(cache=True)
def _between(x: float, xs: FloatArray, ys: FloatArray) -> float:
    """Return `numpy.interp` of one value in a growing table."""
    if x <= xs[0]:
        return float(ys[0])
    if x >= xs[-1]:
        return float(ys[-1])
    i = np.searchsorted(xs, x, side="right") - 1
    return float(ys[i] + (x - xs[i]) * ((ys[i + 1] - ys[i]) / (xs[i + 1] - xs[i])))


@njit(cache=True)
def _turning_row(speed: float, tables: Tables) -> FloatArray:
    """Return the lateral accelerations of the leans at a speed, m/s^2."""
    table, speeds = tables[0], tables[1]
    step = speeds[1] - speeds[0]
    u = min(max((speed - speeds[0]) / step, 0.0), float(len(speeds) - 1))
    i = min(int(u), len(speeds) - 2)
    return table[i] + (u - i) * (table[i + 1] - table[i])


@njit(cache=True)
def _wanted(observed: FloatArray, memory: FloatArray, plans: Plans, row: int, ahead: float) -> float:
    """Return the lateral acceleration that the line requires after a time, m/s^2."""
    here = plan_at(plans, row, P_SPEED, observed[PROGRESS])
    s = observed[PROGRESS] + observed[SPEED] * ahead
    planned = (1.0 + memory[PACE]) * (plan_at(plans, row, P_SPEED, s) - here)
    speed = max(1.0, observed[SPEED] + planned + _caught(memory, ahead))
    return _bend(memory, plans, row, s) * speed**2


@njit(cache=True)
def _load(observed: FloatArray, law: _Law, plans: Plans, row: int, ahead: float) -> float:
    """Return the load after a time by that on level ground: less over a crest, more in a dip."""
    s = observed[PROGRESS] + observed[SPEED] * ahead
    return max(0.3, 1.0 + plan_at(plans, row, P_CREST, s) * observed[SPEED] ** 2 / law.gravity)


@njit(cache=True)
def _error_rate(observed: FloatArray, memory: FloatArray, law: _Law) -> float:
    """Return the rate of the lateral error, m/s: measured, or of the heading at the first step.

    The heading alone is a poor measure: it knows nothing of the side slip.
    """
    elapsed = _elapsed(observed, memory, law)
    if elapsed == 0.0:
        return observed[SPEED] * math.sin(observed[HEADING_ERROR])
    measured = (observed[LATERAL_ERROR] - memory[LATERAL_ERROR]) / elapsed
    if elapsed <= law.usual_period:
        return measured
    predicted = memory[RATE] + elapsed * memory[EXCESS]
    return measured + math.exp(-elapsed / law.rate_memory) * (predicted - measured)


@njit(cache=True)
def _turning(
    observed: FloatArray,
    memory: FloatArray,
    law: _Law,
    leans: FloatArray,
    turning: FloatArray,
    plans: Plans,
    row: int,
    ahead: float,
) -> float:
    """Return the lateral acceleration in excess of the line's after a time at the present roll rate, m/s^2."""
    roll = observed[ROLL] + ahead * observed[ROLL_RATE]
    steady = _load(observed, law, plans, row, ahead) * _between(abs(roll), leans, turning)
    return -math.copysign(steady, roll) - _wanted(observed, memory, plans, row, ahead)


@njit(cache=True)
def _steer(
    observed: FloatArray, memory: FloatArray, law: _Law, leans: FloatArray, turning: FloatArray, plans: Plans, row: int,
    largest: float, error_rate: float, delay: float, push: float,
) -> float:  # fmt: skip
    """Return the steering: the lean that the line will require, and feedback of what is expected by then."""
    w, h, middle, late = law.frequency, law.stencil, law.preview + delay, law.arms + delay
    before = _wanted(observed, memory, plans, row, middle - h)
    now = _wanted(observed, memory, plans, row, middle)
    after = _wanted(observed, memory, plans, row, middle + h)
    ahead = now + (after - before) / (h * w) + (after - 2.0 * now + before) / (h * w) ** 2
    excess = _turning(observed, memory, law, leans, turning, plans, row, 0.0) + push
    then = _turning(observed, memory, law, leans, turning, plans, row, late) + push
    memory[RATE], memory[EXCESS] = error_rate, excess
    # lateral error and its rate when the arms will have answered
    error = observed[LATERAL_ERROR] + late * memory[RATE] + late**2 * (excess / 3.0 + then / 6.0)
    error -= memory[OFFSET] + late * memory[OFFSET_RATE]
    rate = memory[RATE] + 0.5 * late * (excess + then) - memory[OFFSET_RATE]
    error = min(max(error, -law.trust), law.trust)
    rate = min(max(rate, -3.0 * law.trust), 3.0 * law.trust)
    p = law.bandwidth * w
    back = -(p**4 * error + 4.0 * p**3 * rate) / w**2 - (6.0 * p**2 / w**2 - 1.0) * then
    lateral = (ahead + back - push) / _load(observed, law, plans, row, middle)
    lean = min(_between(abs(lateral), turning, leans), largest)
    return min(max(math.copysign(lean, lateral) / law.max_lean, -1.0), 1.0)


@njit(cache=True)
def _rolled(observed: FloatArray, law: _Law, plans: Plans, row: int) -> float:
    """Return the speed of the contacts, m/s: the frame leans inwards and is slower on a tight line."""
    inside = -law.above * math.sin(observed[ROLL])
    return observed[SPEED] / max(0.5, 1.0 - plan_at(plans, row, P_CURVATURE, observed[PROGRESS]) * inside)


@njit(cache=True)
def _throttle(
    observed: FloatArray, memory: FloatArray, margin: float, law: _Law, tables: Tables, plans: Plans, row: int,
    delay: float,
) -> float:  # fmt: skip
    """Return throttle or brake: the force of the plan's acceleration, and of the error of speed.

    Of the speed that is missing it asks for a part `margin`: a machine that leans as far as it may would run wide.
    """
    s = observed[PROGRESS] + observed[SPEED] * (law.speed_preview + delay)
    pace = 1.0 + memory[PACE]
    missing = memory[MISSING]
    missing *= margin if missing > 0.0 else 1.0
    acceleration = pace**2 * plan_at(plans, row, P_LONGITUDINAL, s) + law.speed_gain * missing
    hill = law.weight * plan_at(plans, row, P_GRADE, s)
    force = law.mass * acceleration + law.drag * observed[SPEED] ** 2 + law.rolling + hill
    if force >= 0.0:
        most = _between(observed[SPEED], tables[1], tables[3])
        # A closed throttle drags by the engine's brake, which fades as the throttle opens.
        return min(1.0, (force + law.engine_brake) / max(most + law.engine_brake, 1.0))
    return -min(1.0, max(0.0, (-force - law.engine_brake) / law.brake_force))
