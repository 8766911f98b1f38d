"""Random worlds by number."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.sim.disturbances import read_disturbances
from bike_sim.sim.worlds import GRIP, JUDGED, PATCH_GRIP, draw_world, load_disturbances, load_worlds
from bike_sim.vehicles.files import load_superbike


@given(number=st.integers(0, 10**6 - 1))
def test_a_world_is_its_number_within_its_bounds_and_survives_a_recording(number):
    world = load_disturbances(f"world:{number}")
    assert world == draw_world(number)
    assert read_disturbances(world.to_text(), "again") == world
    assert GRIP[0] <= world.road.grip <= GRIP[1]
    assert all(PATCH_GRIP[0] <= patch[2] <= PATCH_GRIP[1] for patch in world.road.patches)
    assert world.command_delay_s in (0.0, 0.02, 0.04)


def test_worlds_differ_and_every_superbike_can_be_ridden_in_them():
    worlds = load_worlds([f"world:{JUDGED}-{JUDGED + 19}", "road_090"])
    assert len(worlds) == 21
    assert len({world.road.grip for world in worlds}) == 21
    for name in ("panigale_v4r", "r1_suspended"):
        machine = load_superbike(name)
        masses = {world.wrong(machine).mass for world in worlds[:20]}
        assert len(masses) == 20


@pytest.mark.parametrize("name", ["world:", "world:x", "world:-3", "world:1e3", "world:99999999999", "world:1000000"])
def test_what_names_no_world_is_refused(name):
    with pytest.raises(ValueError, match="world"):
        load_disturbances(name)
