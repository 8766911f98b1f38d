"""The door to the physics: what every engine can do, and how to get one."""

from __future__ import annotations

from typing import Final, Protocol, runtime_checkable

from bike_sim.physics.state import StateVector
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

BICYCLE_ENGINES: Final = ("pybullet", "whipple")
SUPERBIKE_ENGINES: Final = ("pybullet", "compiled")
ENGINE_KINDS: Final = tuple(dict.fromkeys(BICYCLE_ENGINES + SUPERBIKE_ENGINES))


class Engine(Protocol):
    """One vehicle on flat ground, stepped with a fixed integration step.

    Attributes:
        time_step: integration step, s.
    """

    time_step: float

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle's parameters, the steering drive included."""
        ...

    def reset(self, state: StateVector) -> None:
        """Set any minimal state exactly, positions and velocities; nothing of the earlier ride remains.

        Raises:
            ValueError: the state has the wrong shape, is not finite, or no such configuration exists.
        """
        ...

    def advance(self, steer_set: float, steps: int) -> None:
        """Integrate with the steering drive's set point held.

        The drive's torque, ``-P (steer - steer_set) - D steer_rate`` on the fork and its opposite on
        the rear frame, is evaluated anew at every step (Weyrer et al. 2026, Eq. 2).

        Args:
            steer_set: set point of the steering angle, rad, positive to the left.
            steps: number of integration steps of `time_step`.
        """
        ...

    def state(self) -> StateVector:
        """Return the minimal state as a fresh vector of ten (see `bike_sim.physics.state`)."""
        ...

    def close(self) -> None:
        """Release what the engine holds; a second call does nothing."""
        ...


@runtime_checkable
class BicycleEngine(Engine, Protocol):
    """An engine of bicycles, which can also be pushed."""

    def push(self, along: float, left: float, ahead: float, height: float) -> None:
        """Push a bicycle's rear frame with a horizontal force during the next step only.

        Args:
            along: component along its yaw, N.
            left: component to the left of it, N.
            ahead: place of the point ahead of the rear contact, m.
            height: of the point above the rear contact, in the plane of the frame, m.
        """
        ...


def make_engine(kind: str, vehicle: Vehicle, time_step: float) -> Engine:
    """Return a new engine, independent of all others in the process.

    Args:
        kind: "pybullet" (bodies in Bullet: a bicycle on Bullet's contacts, a superbike on its tyres) or "whipple"
            (the nonlinear equations of the ideal bicycle in minimal coordinates, compiled) or "compiled" (a superbike's
            bodies without Bullet, compiled: an independent check of it, and ten times as fast).
        vehicle: the vehicle to simulate.
        time_step: integration step, s.

    Raises:
        ValueError: unknown kind, one that cannot simulate this vehicle, or a time step that is not positive.
    """
    # Imported on demand: who asks for one engine does not pay for loading the other.
    if isinstance(vehicle, Superbike):
        if kind == "pybullet":
            from bike_sim.physics.superbike_engine import SuperbikeEngine

            return SuperbikeEngine(vehicle, time_step)
        if kind == "compiled":
            from bike_sim.physics.compiled_superbike_engine import CompiledSuperbikeEngine

            return CompiledSuperbikeEngine(vehicle, time_step)
        raise ValueError(
            f"engine '{kind}' has no tyres for the superbike '{vehicle.name}'; choose pybullet or compiled"
        )
    if kind == "compiled":
        raise ValueError(f"engine 'compiled' is for superbikes; for the bicycle '{vehicle.name}' choose whipple")
    if kind == "pybullet":
        from bike_sim.physics.pybullet_engine import PyBulletEngine

        return PyBulletEngine(vehicle, time_step)
    if kind == "whipple":
        from bike_sim.physics.whipple_engine import WhippleEngine

        return WhippleEngine(vehicle, time_step)
    raise ValueError(f"unknown engine '{kind}'; choose one of {', '.join(ENGINE_KINDS)}")
