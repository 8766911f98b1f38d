"""The guide of a racing policy: the classical law, to which the policy says how fast and how far from the line to ride.

A policy with a guide begins as a rider that laps, and learns what to do otherwise (as in residual policy learning,
Johannink et al. 2019; Silver et al. 2018). Its decisions are targets that last, so that each of them tells in lap time;
what a single command of 20 ms is worth drowns in the noise of a critic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.race import ObservationBuilder
from bike_policy.contract.rows import RowBlocks
from bike_policy.riders import line_law as ll
from bike_policy.riders.lap_plan import RiderSettings
from bike_policy.riders.line_law import LineLaw, LinePlan, seen_of
from bike_policy.riders.plan_verification import rehearsed
from bike_policy.riders.planned_lines import PlannedLines
from bike_sim.course.course import Course
from bike_sim.sim import look as lk
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

GUIDE: Final = RiderSettings(
    lateral=0.91,
    brake=0.9,
    drive_exponent=3.0,
    brake_exponent=3.2,
    brake_upright=1.04,
    brake_decline=1.0,
    dip=0.7,
    lean_rate=1.0,
    preview=0.16,
    bandwidth=0.55,
    stencil=0.2,
    smoothing=6.0,
    lateral_trust=2.0,
    speed_gain=5.0,
    speed_preview=0.10,
    period=0.02,
    rate_memory=0.1,
    largest_lean=math.radians(57.3),
)
"""How the guide rides: fixed, so that what a policy answers beside does not change when the classical rider is tuned.
"""

Planner = Callable[[Course], LinePlan]
"""Plans a lap of a closed line."""


class RaceGuide:
    """The guide of machines side by side."""

    def __init__(self, vehicle: Vehicle, period: float, count: int, plan: Planner | None = None) -> None:
        """Prepare to guide a number of machines.

        Args:
            vehicle: the machine.
            period: control period, s.
            count: number of machines.
            plan: plans a lap of a line; None for the guide's own rehearsed plan.

        Raises:
            ValueError: a vehicle that is no superbike.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"the guide of races rides superbikes, and {vehicle.name!r} is none")
        self._law = LineLaw(vehicle, period, GUIDE, count)
        self._planned = PlannedLines(plan or (lambda line: rehearsed(vehicle, line, GUIDE, period)))

    def begin(self, row: int, line: Course) -> None:
        """Let a machine follow a line from now on.

        Raises:
            ValueError: the line is open.
        """
        self._law.begin(row, self._planned.of(line))

    def commands(self, blocks: RowBlocks, targets: FloatArray, share: FloatArray) -> FloatArray:
        """Return steering and throttle in [-1, 1], shape (n, 2); the same ones again for the same blocks.

        Args:
            blocks: of the machines.
            targets: distance from the followed line to ride at, m, positive to the left, and change of the planned
                speed as a part of it, shape (n, 2); of each as much as the limits and the rehearsals leave room for.
            share: part of the planned speed that is asked, shape (n,); what the targets change is the speed asked.
        """
        targets = np.stack((targets[:, 0], share * (1.0 + targets[:, 1]) - 1.0), axis=1)
        return self._law.commands(seen_of(blocks.state, blocks.look), targets)

    def shown(self) -> FloatArray:
        """Return what a policy sees of the guide; see `bike_policy.contract.race.Guide`."""
        return self._law.memory[:, [ll.STEERING, ll.THROTTLE, ll.OFFSET, ll.PACE]]

    def state_dict(self) -> dict[str, Any]:
        """Return what is remembered of the rides."""
        return {"memory": self._law.memory.copy()}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Take up what :meth:`state_dict` returned, after each row has begun again."""
        self._law.memory[...] = stored["memory"]


def commands_of(
    action: ActionLayout, guide: RaceGuide | None, eyes: ObservationBuilder, blocks: RowBlocks, max_steer: float
) -> FloatArray:
    """Return what the last decisions become in a control period: steering and throttle in [-1, 1], shape (n, 2).

    Args:
        action: what the decisions mean.
        guide: who makes the commands, where they are targets.
        eyes: that remember the decisions.
        blocks: of the machines, at the beginning of the control period.
        max_steer: of the vehicle, rad.
    """
    if guide is None:
        return action.to_commands(eyes.actions[:, 0], max_steer, blocks.look[:, lk.SPEED])
    return guide.commands(blocks, action.to_targets(eyes.actions[:, 0]), eyes.references.share)
