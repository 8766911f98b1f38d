"""Engines by name. Each is imported on demand: PyBullet is loaded only where it is used."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from bike_sim.physics.engine import BicycleEngine, Engine
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

if TYPE_CHECKING:
    from bike_sim.physics.superbike.engine import SuperbikeEngine

BICYCLE_ENGINES: Final = ("pybullet", "whipple")
SUPERBIKE_ENGINES: Final = ("pybullet", "compiled")
ENGINE_KINDS: Final = tuple(dict.fromkeys(BICYCLE_ENGINES + SUPERBIKE_ENGINES))


def make_engine(kind: str, vehicle: Vehicle, time_step: float) -> Engine:
    """Return a new engine, independent of all others in the process.

    Args:
        kind: "pybullet" (bodies in Bullet: a bicycle on Bullet's contacts, a superbike on its tyres) or "whipple"
            (the nonlinear equations of the ideal bicycle in minimal coordinates, compiled) or "compiled" (a superbike's
            bodies without Bullet, compiled: an independent check of it, and twenty times as fast).
        vehicle: the vehicle to simulate.
        time_step: integration step, s.

    Raises:
        ValueError: unknown kind, one that cannot simulate this vehicle, or a time step that is not positive.
    """
    make = make_superbike_engine if isinstance(vehicle, Superbike) else make_bicycle_engine
    return make(kind, vehicle, time_step)  # type: ignore[arg-type]


def check_superbike_engine(kind: str, vehicle: Vehicle) -> None:
    """Refuse an engine that cannot simulate superbikes.

    Raises:
        ValueError: naming it.
    """
    if kind not in SUPERBIKE_ENGINES:
        raise ValueError(
            f"engine '{kind}' has no tyres for the superbike '{vehicle.name}'; choose pybullet or compiled"
        )


def make_superbike_engine(kind: str, vehicle: Superbike, time_step: float) -> SuperbikeEngine:
    """Return a new engine of a superbike; see `make_engine`."""
    check_superbike_engine(kind, vehicle)
    if kind == "pybullet":
        from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine

        return BulletSuperbikeEngine(vehicle, time_step)
    from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine

    return CompiledSuperbikeEngine(vehicle, time_step)


def make_bicycle_engine(kind: str, vehicle: Vehicle, time_step: float) -> BicycleEngine:
    """Return a new engine of a bicycle; see `make_engine`."""
    if kind == "compiled":
        raise ValueError(f"engine 'compiled' is for superbikes; for the bicycle '{vehicle.name}' choose whipple")
    if kind == "pybullet":
        from bike_sim.physics.bicycle.bullet import PyBulletEngine

        return PyBulletEngine(vehicle, time_step)
    if kind == "whipple":
        from bike_sim.physics.bicycle.whipple import WhippleEngine

        return WhippleEngine(vehicle, time_step)
    raise ValueError(f"unknown engine '{kind}'; choose one of {', '.join(ENGINE_KINDS)}")
