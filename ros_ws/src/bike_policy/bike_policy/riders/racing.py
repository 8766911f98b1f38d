"""Racing policies: what they see of machines side by side, what their actions command, and riders made of them.

A policy acts on lean and drive itself, or leads a guide: the classical law, to which it says how fast and how far from
the line to ride. With a guide it begins as a rider that laps, and learns what to do otherwise (as in residual policy
learning, Johannink et al. 2019; Silver et al. 2018). Its actions are targets that last, so that each of them shows in
the lap time; what a single command of 20 ms is worth drowns in the noise of a critic.

Before a policy rides a line for the first time its plan is verified: see `bike_policy.planning.plan_verification`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import (
    DESCRIPTOR,
    LATERAL_ERROR,
    LINE,
    ROLL,
    SPEED,
    STEER,
    ObservationLayout,
    RideMemory,
    Rows,
    VehicleRows,
    rows_of,
)
from bike_policy.planning import line_law as ll
from bike_policy.planning.grip import FIRST_ERROR, AdaptiveLaw, GripMemory, GripPlans, ShakeReflex, plans_of
from bike_policy.planning.lap_plan import (
    CLASSICAL_SETTINGS,
    GUIDE,
    UNLIMITED,
    LinePlan,
    Planner,
    plan_line,
    references_of,
)
from bike_policy.planning.plan_verification import Rollouts, verified_margin, verified_plan
from bike_policy.planning.racecraft import guard_targets
from bike_policy.planning.reference import OPEN, ReferenceRows
from bike_policy.planning.ride_observer import RideObserver
from bike_policy.riders.base import LearnedRider
from bike_sim.course.course import Course
from bike_sim.physics.superbike.statics import engine_force
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

PASSING_ROOM: Final = 0.03
"""What who sees others may ask for beyond the speed of a plan that is not verified, in corners and on the brake, as a
part of it."""
UPRIGHT: Final = 3.0
"""Lateral acceleration up to which drive alone limits the speed, m/s^2."""
DRIVE_SPEEDS: Final = (20.0, 40.0, 60.0, 80.0)
"""Speeds at which the descriptor holds the engine's force, m/s."""
FEATURE_MEAN: Final = np.array([280.0, 1.45, 0.63, 0.70, 0.33, 1.2, 1.2, 0.8, 0.6])
"""About the middle of today's superbikes: kg, m, m, m, m^2, and forces by weight."""
FEATURE_SCALE: Final = np.array([20.0, 0.05, 0.05, 0.05, 0.03, 0.4, 0.2, 0.2, 0.15])
"""Deviation that counts as 1, in the same units; more is clipped with the rest of an observation."""


def vehicle_descriptor(vehicle: Superbike) -> FloatArray:
    """Return the scaled numbers that describe a machine to a policy, in the order of DESCRIPTOR.

    Mass with rider, wheelbase, height of the centre of mass and its distance from the rear contact, drag area, and the
    largest force of the engine by weight at DRIVE_SPEEDS.
    """
    weight = vehicle.mass * vehicle.g
    drive = [engine_force(vehicle, speed) / weight for speed in DRIVE_SPEEDS]
    facts = np.array([vehicle.mass, vehicle.w, vehicle.com_height, vehicle.com_x, vehicle.air.drag_area, *drive])
    assert len(facts) == len(DESCRIPTOR)
    return (facts - FEATURE_MEAN) / FEATURE_SCALE


class RaceInterface:
    """Observations and commands of a racing policy for machines side by side, with the memory that both take.

    A decision is: `observe`, `act`, then `commands` at each control period.

    Attributes:
        memory: of the rides.
        references: followed lines of the machines.
        offsets: distances from the line that a guide is asked for now, m, where they move at a rate, shape (n,).
        observer: of what is measured; observations and commands are made of what it shows.
        wind: observer of the wind; None for policies that keep no grip in reserve.
    """

    def __init__(
        self,
        layout: ObservationLayout,
        action: ActionLayout,
        vehicle: Vehicle,
        period: float,
        count: int,
        plan: Planner | None = None,
    ) -> None:
        """Prepare for a number of machines.

        Args:
            layout: of the observation.
            action: meaning of the actions.
            vehicle: the machine.
            period: control period, s.
            count: number of machines.
            plan: plans the guide's laps; None for its own.

        Raises:
            ValueError: a layout of paths, a vehicle that is no superbike, or a layout with a guide where there is none.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"a race needs a superbike with tyres to plan a lap, and {vehicle.name!r} is none")
        if not layout.races:
            raise ValueError(f"layout {layout.name!r} is of paths; it cannot race")
        if "guide" in layout.terms and not action.guided:
            raise ValueError(f"layout {layout.name!r} shows the guide's commands, and there is no guide")
        self._layout, self._action, self._max_steer = layout, action, vehicle.max_steer
        self._period, self._offset_rate = period, action.columns[0].rate
        self.offsets = np.zeros(count)
        adaptive = "grip" in layout.terms
        self._planned = references_of(vehicle)
        if adaptive:
            self.show(
                plans_of(vehicle, period, CLASSICAL_SETTINGS, partial(plan_line, vehicle, settings=CLASSICAL_SETTINGS))
            )
        self._grip = GripMemory(vehicle, period, count, layout.unseen) if adaptive else None
        self._reflex = ShakeReflex(layout.unseen > 0.0, period, count)
        self._guide, self._room = None, 0.0
        if action.guided and layout.sees_others:  # it rides the plans of the classical riders that it meets
            base = plan or (lambda line: verified_plan(vehicle, line, CLASSICAL_SETTINGS, period))
            self._room = 0.0 if plan is None else PASSING_ROOM  # plans that are verified leave none
            self._guide = AdaptiveLaw(
                vehicle, period, CLASSICAL_SETTINGS, count, lambda line: with_passing_room(base(line), self._room)
            )
        elif action.guided:
            self._guide = AdaptiveLaw(vehicle, period, GUIDE, count, plan)
        self.observer = RideObserver(vehicle, period, count) if self._guide is None else self._guide.observer
        self.references = ReferenceRows(count, adaptive)
        self.memory = RideMemory(
            rolls=np.zeros((count, layout.history)),
            steers=np.zeros(count),
            actions=np.zeros((count, 2, 2)),
            guide=np.zeros((count, 4)),
            vehicle=vehicle_descriptor(vehicle),
            grip=np.ones((count, 3)),
            push=np.zeros(count),
            references=self.references,
        )

    @property
    def grip_memory(self) -> GripMemory | None:
        """What is known of the grip; None where neither policy nor guide infers it."""
        return self._grip if self._guide is None else self._guide.memory

    @property
    def law(self) -> ll.LineLaw:
        """The law of the guide."""
        assert self._guide is not None, "its actions are targets of a guide"
        return self._guide.law

    def show(self, plans: Callable[[Course], GripPlans]) -> None:
        """Take references from plans for roads of different grip; by default from the classical rider's first ones."""
        self._planned = lambda line: plans(line).reference

    def prepare(self, line: Course) -> None:
        """Plan a lap, before the first ride that needs it.

        Raises:
            ValueError: the line is open.
        """
        self._planned(line)
        if self._guide is not None:
            self._guide.plans(line).solve()

    def begin(self, row: int, rows: VehicleRows, line: Course, share: float | None = None, cap: float = OPEN) -> None:
        """Begin the ride of one machine.

        Args:
            row: of the machine.
            rows: of all machines, after its reset.
            line: followed line.
            share: part of the planned speed that is asked; None for that of the layout.
            cap: speed limit, m/s.

        Raises:
            ValueError: the line is open.
        """
        if self._guide is None:
            self.observer.begin(row, line)
        else:
            self._guide.begin(row, rows, line)
        if self._grip is not None:
            self._grip.begin(row, line)
            expected = self._grip.expected[row]
            self.references.grip[row], self.memory.grip[row] = expected, (expected, 1.0, FIRST_ERROR)
        self.references.begin(row, self._planned(line), self._layout.share if share is None else share, cap)
        memory, state = self.memory, rows.state[row]
        memory.rolls[row], memory.steers[row] = state[ROLL], state[STEER]
        memory.actions[row] = memory.push[row] = 0.0
        self._reflex.begin(row)
        if self._offset_rate and self._guide is not None:  # it goes to its line from where it is
            self.offsets[row] = self._guide.law.memory[row, ll.OFFSET] = rows.look[row, LATERAL_ERROR]

    def observe(self, rows: VehicleRows) -> NDArray[np.float32]:
        """Return the observations, shape (n, layout size)."""
        if self._guide is not None:
            self.memory.guide[:] = self._guide.law.memory[:, [ll.STEERING, ll.THROTTLE, ll.OFFSET, ll.PACE]]
        return self._layout.observe(self.observer.observe(rows), self.memory)

    def act(self, rows: VehicleRows, actions: NDArray[np.floating]) -> None:
        """Hold actions from now on.

        Args:
            rows: that were observed.
            actions: in [-1, 1], shape (n, 2).
        """
        memory, rows = self.memory, self.observer.observe(rows)
        memory.rolls[:, 1:] = memory.rolls[:, :-1].copy()
        memory.rolls[:, 0] = rows.state[:, ROLL]
        memory.steers[:] = rows.state[:, STEER]
        memory.actions[:, 1] = memory.actions[:, 0]
        memory.actions[:, 0] = actions

    def commands(self, rows: VehicleRows) -> FloatArray:
        """Return what the actions become in a control period: steering and throttle in [-1, 1], shape (n, 2)."""
        actions = self.memory.actions[:, 0]
        if self._grip is None:
            seen = self.observer.observe(rows)
        else:
            seen = self._grip.update(rows, self.observer)
            self._show(self._grip)
        if self._guide is None:
            commands = self._action.to_commands(actions, self._max_steer, rows.look[:, SPEED])
            return self._reflex.commands(seen, commands)
        targets = self._action.to_targets(actions)
        if self._offset_rate:
            self._move(rows, targets, self._guide.law)
        # What the targets change is the speed that is asked.
        targets[:, 1] = self.references.share * (1.0 + targets[:, 1]) - 1.0
        return self._guide.commands(rows, targets=targets)

    def _move(self, rows: VehicleRows, targets: FloatArray, law: ll.LineLaw) -> None:
        """Move to the targets at their rate, not into who is beside, nor ride into who is ahead."""
        seen, points = np.nan_to_num(ll.seen_of(rows.state, rows.look)), np.ascontiguousarray(rows.points[:, LINE])
        others = np.ascontiguousarray(rows.opponents)
        guard_targets(seen, points, others, law.plans, self._offset_rate, self._period, self.offsets, targets)
        ll.slower_inside(seen, targets, self._room, law.plans)

    def state_dict(self) -> dict[str, Any]:
        """Return the memory, as arrays."""
        law = {"observer": self.observer.state_dict()} if self._guide is None else self._guide.state_dict()
        inferred = {"reflex": self._reflex.state_dict()}
        inferred |= {} if self._grip is None else {"inferred": self._grip.state_dict()}
        own = {"offsets": self.offsets.copy()} if self._offset_rate else {}
        return {name: getattr(self.memory, name).copy() for name in _STORED} | own | law | inferred

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Continue from what :meth:`state_dict` returned, after each row has begun again."""
        for name in _STORED:
            getattr(self.memory, name)[...] = stored[name]
        if self._offset_rate:
            self.offsets[...] = stored["offsets"]
        if self._guide is None:
            self.observer.restore(stored["observer"])
        else:
            self._guide.restore(stored)
        if self._grip is not None:
            self._grip.restore(stored["inferred"])
            self._show(self._grip)
        self._reflex.restore(stored["reflex"])

    def _show(self, inferred: GripMemory) -> None:
        """Plan the reference for the expected grip, and show what is inferred."""
        self.references.grip[:] = inferred.planned
        self.memory.grip[:] = np.stack((inferred.planned, inferred.grip, np.sqrt(inferred.variance)), axis=1)
        if inferred.push is not None:
            self.memory.push[:] = inferred.push


def with_passing_room(plan: LinePlan, room: float) -> LinePlan:
    """Return a plan that bounds what targets may add to its speed, as a part of it, but where drive alone limits it."""
    profile = plan.profile
    driving = (np.abs(profile.lateral) < UPRIGHT) & (profile.longitudinal > 0.0)
    return plan.with_room_above(np.where(driving, UNLIMITED, room)[:-1])


_STORED: Final = ("rolls", "steers", "actions")


class PolicyBatch:
    """A racing policy that rides machines side by side; a `plan_verification.BatchRider`."""

    def __init__(
        self, bundle: Bundle, vehicle: Vehicle, period: float, count: int, plan: Planner | None = None
    ) -> None:
        """Prepare for a number of machines.

        Args:
            bundle: the policy.
            vehicle: the machine.
            period: control period, s.
            count: number of machines.
            plan: plans the guide's laps; None for verified ones, that leave a policy that sees nobody as much room as
                it can ride.

        Raises:
            ValueError: a policy that does not race, or a vehicle that is no superbike.
        """
        if not bundle.layout.races:
            raise ValueError(f"policy {bundle.name!r} follows paths; it cannot race")
        if not bundle.layout.sees_others:
            plan = plan or (lambda line: verified_for(bundle, vehicle, line, period))
        self._actor, self._repeat = bundle.actor, bundle.layout.repeat
        self.interface = RaceInterface(bundle.layout, bundle.action, vehicle, period, count, plan)

    def begin(self, row: int, rows: VehicleRows, line: Course) -> None:
        """Begin the ride of one machine, after its reset.

        Raises:
            ValueError: the line is open.
        """
        self.interface.begin(row, rows, line)

    def commands(self, rows: VehicleRows, step: int) -> FloatArray:
        """Return steering and throttle in [-1, 1] of all machines at a control period, shape (n, 2)."""
        if step % self._repeat == 0:
            self.interface.act(rows, self._actor.act_batch(self.interface.observe(rows)))
        return np.nan_to_num(self.interface.commands(rows))


def verified_for(bundle: Bundle, vehicle: Vehicle, line: Course, period: float) -> LinePlan:
    """Return the guide's verified plan with as much room above its speed as a policy can ride.

    Raises:
        ValueError: the line is open, or a vehicle that is no superbike.
    """
    assert isinstance(vehicle, Superbike), "the interface has refused others"
    settings = repr((bundle.layout, bundle.action, GUIDE, period)).encode()
    rider = b"".join((settings, bundle.actor.digest(), Path(__file__).read_bytes()))
    rollouts = Rollouts(vehicle, line, period)
    plan = verified_plan(vehicle, line, GUIDE, period)

    def policy(tried: LinePlan, count: int) -> PolicyBatch:
        return PolicyBatch(bundle, vehicle, period, count, lambda _: tried)

    return verified_margin(rollouts, plan, policy, bundle.action.pace, rider)


class RacingRider(LearnedRider):
    """A racing policy as the rider of one machine; implements `bike_policy.riders.base.Rider`.

    It decides at the steps that are multiples of the layout's ``repeat``, counted from the reset, and remembers what it
    has decided. Where states are lost, or the rider is started in the middle of a ride, it decides at once: memory
    begins with what it sees then.
    """

    def __init__(self, bundle: Bundle) -> None:
        """Take a policy, and act once on a made-up observation: the first action of a process takes longest."""
        self.bundle, self.name, self.preview = bundle, bundle.name, None
        self._interface: RaceInterface | None = None
        self._vehicle: Vehicle | None = None
        bundle.actor.act(np.zeros(bundle.layout.size, dtype=np.float32))

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Plan the lap; see `Rider`.

        Raises:
            ValueError: another control period, a vehicle that is no superbike, or an open line.
        """
        self.bundle.check_fit(vehicle.name, period)
        if self._interface is None or self._vehicle is not vehicle:
            self._interface, self._vehicle = PolicyBatch(self.bundle, vehicle, period, 1).interface, vehicle
        self._interface.prepare(course)
        self._course, self._decided = course, (-1, -1)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the command of this control period; None where the snapshot is not finite or shows no circuit."""
        assert self._interface is not None, "begin comes first"
        rows = rows_of(snapshot)
        number = snapshot.episode, snapshot.step // self.bundle.layout.repeat
        if number != self._decided and not self._decide(self._interface, snapshot, rows):
            return None
        self._decided = number
        steering, throttle = self._interface.commands(rows)[0].tolist()
        return (steering, throttle) if math.isfinite(steering + throttle) else None

    @property
    def grip_memory(self) -> GripMemory | None:
        """What is known of the grip; None before the first ride, and where the policy infers none."""
        return None if self._interface is None else self._interface.grip_memory

    def _decide(self, interface: RaceInterface, snapshot: Snapshot, rows: Rows) -> bool:
        """Decide anew, where the observation is finite."""
        if self._decided[0] != snapshot.episode:
            interface.begin(0, rows, self._course)
        seen = interface.observe(rows)
        if not np.isfinite(seen).all():
            return False
        self.seen = seen[0]
        interface.act(rows, self.bundle.actor.act_batch(seen))
        return True
