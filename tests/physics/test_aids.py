"""The electronics of superbikes: what a turn leaves of the brakes before any slip."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as some

from bike_sim.physics.superbike.drive import AidLimits, aid_limits
from bike_sim.validation.superbike import MACHINES
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike

VEHICLES = [load_superbike(name) for name in MACHINES]


def limits(vehicle: Superbike, lean_deg: float, speed: float) -> AidLimits:
    return aid_limits(math.radians(lean_deg), 0.0, speed**2, vehicle.machine)


@given(some.sampled_from(VEHICLES), some.floats(10.0, 80.0), some.floats(0.0, 60.0), some.floats(0.0, 60.0))
def test_more_lean_leaves_no_more_brake(vehicle: Superbike, speed: float, one: float, other: float) -> None:
    less, more = (limits(vehicle, lean, speed) for lean in sorted((one, other)))
    assert more.braking <= less.braking * (1.0 + 1e-12)
    assert 0.0 <= more.rear <= less.rear <= 1.0
    assert limits(vehicle, -one, speed) == limits(vehicle, one, speed)


@pytest.mark.parametrize("vehicle", VEHICLES, ids=MACHINES)
def test_brakes_fade_between_45_degrees_and_the_deepest_lean(vehicle: Superbike) -> None:
    """Engine braking is eased with the rear brake; near the tyres' limit either makes weave grow."""
    assert limits(vehicle, 45.0, 40.0).rear == 1.0
    assert 0.0 < limits(vehicle, 52.0, 40.0).rear < 1.0
    deepest = limits(vehicle, 58.0, 40.0)
    assert (deepest.rear, deepest.braking) == (0.0, 0.0)


def test_without_brake_control_nothing_is_eased() -> None:
    vehicle = VEHICLES[0]
    bare = replace(vehicle, electronics=replace(vehicle.electronics, brake_control=0.0))
    assert limits(bare, 55.0, 40.0).rear == 1.0
    assert limits(bare, 55.0, 40.0).braking == math.inf
