"""Who answers states: a learned policy from a bundle, or the classical rider."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
from bike_msgs.msg import BikeState, Course

from bike_policy.contract.bundle import Bundle, load_bundle
from bike_policy.riders.classical import ClassicalRider, Seen
from bike_sim.ros.messages import course_from_message, minimal_state
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

CLASSICAL: Final = "classical"
"""Name of the policy that is no bundle."""


class Pilot(Protocol):
    """Answers states with commands."""

    name: str

    def on_course(self, message: Course) -> None:
        """Take the course of an episode."""
        ...

    def fit(self, state: BikeState) -> bool:
        """Prepare for the episode of a state; false while something is missing that will come.

        Raises:
            ValueError: this pilot cannot ride what the simulator offers.
            FileNotFoundError: the vehicle is not known here.
        """
        ...

    def command(self, state: BikeState) -> tuple[float, float] | None:
        """Return steering and throttle in [-1, 1], or None for a state that is not finite."""
        ...


def make_pilot(policy: str, vehicle: str = "") -> Pilot:
    """Return the pilot of a name.

    Args:
        policy: ``"classical"``, a shipped bundle, or the path of one.
        vehicle: for the classical rider: file of the vehicle, where it is none of the shipped ones.

    Raises:
        ValueError: a bundle that cannot be. FileNotFoundError: no such bundle or vehicle.
    """
    return ClassicalPilot(vehicle) if policy == CLASSICAL else BundlePilot(load_bundle(policy))


class BundlePilot:
    """A learned policy; steers only."""

    def __init__(self, bundle: Bundle) -> None:
        """Answer a made-up observation once: the first answer of a process takes longer than all others."""
        self.name = bundle.name
        self._bundle = bundle
        self._preview = np.arange(0)
        layout = bundle.layout
        bundle.actor.act(layout.observe(np.zeros(10), np.zeros(layout.preview_count)))

    def on_course(self, message: Course) -> None:
        """Need nothing of it: states carry the preview."""

    def fit(self, state: BikeState) -> bool:
        """Check vehicle, control period and preview; see `Pilot`."""
        self._bundle.check_fit(vehicle=state.vehicle, control_period=state.control_period)
        self._preview = self._bundle.layout.pick_preview(
            state.preview_by_time, state.preview_interval, len(state.preview_y)
        )
        return True

    def command(self, state: BikeState) -> tuple[float, float] | None:
        """Return the actor's answer; see `Pilot`."""
        layout = self._bundle.layout
        preview = np.frombuffer(state.preview_y)[self._preview]
        try:
            action = self._bundle.actor.act(layout.observe(minimal_state(state), preview))
        except ValueError:  # an observation that is not finite
            return None
        return self._bundle.action.to_command(action, state.steering_limit), 0.0


class ClassicalPilot:
    """The classical rider on the course that the simulator publishes."""

    def __init__(self, vehicle: str = "") -> None:
        """Load the vehicle if it is told; else the states tell it."""
        self.name = CLASSICAL
        self._told = load_vehicle(vehicle) if vehicle else None
        self._course: Course | None = None
        self._rider: ClassicalRider | None = None

    def on_course(self, message: Course) -> None:
        """Keep the line that is followed."""
        self._course = message

    def fit(self, state: BikeState) -> bool:
        """Plan the lap once its course has come; see `Pilot`."""
        if self._course is None or self._course.episode != state.episode:
            return False
        vehicle = self._told or load_vehicle(state.vehicle)
        if vehicle.name != state.vehicle:
            raise ValueError(f"the simulator rides {state.vehicle!r}, the classical rider was given {vehicle.name!r}")
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"the classical rider rides superbikes, and {vehicle.name!r} is none")
        self._rider = ClassicalRider(vehicle, course_from_message(self._course), state.control_period)
        return True

    def command(self, state: BikeState) -> tuple[float, float] | None:
        """Return the rider's answer; see `Pilot`."""
        assert self._rider is not None
        seen = Seen(state.speed, state.roll, state.progress, state.lateral_error, state.heading_error)
        if not np.isfinite([seen.speed, seen.roll, seen.progress, seen.lateral_error, seen.heading_error]).all():
            return None
        return self._rider.command(seen)
