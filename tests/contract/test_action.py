"""What the columns of an action mean: commands, scales and the mirrored ride."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_policy.contract.action import (
    DRIVE,
    LEAN_REQUEST,
    LINE_OFFSET,
    MEANINGS,
    PACE,
    STEERING_SET_VALUE,
    ActionColumn,
    ActionLayout,
)

SUPERBIKE = ActionLayout((ActionColumn(LEAN_REQUEST), ActionColumn(DRIVE, 0.8)))
HELD = ActionLayout.steering(1.2, within=((3.0, 1.2), (4.0, 0.9)))
GUIDED = ActionLayout((ActionColumn(LINE_OFFSET, 1.5), ActionColumn(PACE, 0.06)))
LAYOUTS = (ActionLayout.steering(math.radians(70.0)), SUPERBIKE, ActionLayout(SUPERBIKE.columns[::-1]))
finite = st.floats(-1.0, 1.0)


def test_columns_drive_the_commands_that_they_name():
    assert SUPERBIKE.to_command([0.5, -0.5], 1.2, 5.0) == (0.5, -0.4)
    assert ActionLayout(SUPERBIKE.columns[::-1]).to_command([-0.5, 0.5], 1.2, 5.0) == (0.5, -0.4)
    assert ActionLayout((ActionColumn(DRIVE),)).to_command([0.3], 1.2, 5.0) == (0.0, 0.3)
    assert ActionLayout.steering(0.6).to_command([0.5], 1.2, 5.0) == (0.25, 0.0)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: "+".join(layout.names))
@given(data=st.data())
def test_the_mirrored_action_steers_the_other_way_and_drives_the_same(layout, data):
    action = np.array(data.draw(st.lists(finite, min_size=layout.size, max_size=layout.size)))
    steering, throttle = layout.to_command(action, 1.2, 5.0)
    assert layout.to_command(action * layout.mirror_signs, 1.2, 5.0) == (-steering, throttle)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: "+".join(layout.names))
def test_many_actions_become_the_commands_that_each_of_them_would(layout):
    actions = np.random.default_rng(0).uniform(-1.5, 1.5, (500, layout.size)).astype("f4")
    commands = layout.to_commands(actions, 1.2, np.full(len(actions), 5.0))
    np.testing.assert_array_equal(commands, [layout.to_command(action, 1.2, 5.0) for action in actions])
    assert np.abs(commands).max() == 1.0


@pytest.mark.parametrize("layout", [*LAYOUTS, GUIDED, HELD], ids=lambda layout: "+".join(layout.names))
def test_card_round_trip(layout):
    assert ActionLayout.from_card(layout.to_card()) == layout


@pytest.mark.parametrize(
    ("card", "message"),
    [
        ({}, "must hold a list of columns"),
        ({"columns": "steering"}, "must hold a list of columns"),
        ({"columns": [{"meaning": DRIVE}]}, "each with meaning, scale"),
        ({"columns": [{"meaning": "levitate", "scale": 1.0}]}, "unknown action meaning 'levitate'"),
        ({"columns": [{"meaning": DRIVE, "scale": math.nan}]}, "must be positive and finite, got nan"),
        ({"columns": []}, "one column for each command"),
        (
            {"columns": [{"meaning": name, "scale": 1.0} for name in (STEERING_SET_VALUE, LEAN_REQUEST)]},
            "one column for each command",
        ),
    ],
)
def test_foreign_cards_are_refused_by_name(card, message):
    with pytest.raises(ValueError, match=message):
        ActionLayout.from_card(card)


def test_every_meaning_has_a_command_and_a_sign():
    assert {command for command, _ in MEANINGS.values()} == {"steering", "throttle"}
    driving = {name: sign for name, (command, sign) in MEANINGS.items() if command == "throttle"}
    assert driving == {DRIVE: 1.0, PACE: 1.0}
    assert {sign for command, sign in MEANINGS.values() if command == "steering"} == {-1.0}


def test_targets_of_a_guide_are_scaled_and_mirror():
    actions = np.array([[0.5, -1.0], [1.0, 0.25]], dtype=np.float32)
    np.testing.assert_allclose(GUIDED.to_targets(actions), [[0.75, -0.06], [1.5, 0.015]])
    np.testing.assert_array_equal(GUIDED.mirror_signs, [-1.0, 1.0])
    assert GUIDED.guided
    assert not SUPERBIKE.guided


@pytest.mark.parametrize("meanings", [(LINE_OFFSET,), (LEAN_REQUEST, PACE), (PACE, LINE_OFFSET)])
def test_targets_come_in_pairs(meanings):
    with pytest.raises(ValueError, match="an action for a guide needs the columns line_offset, pace"):
        ActionLayout(tuple(ActionColumn(meaning) for meaning in meanings))


def test_set_points_are_held_within_limits_that_depend_on_the_speed():
    speeds = np.array([1.0, 3.0, 3.5, 4.0, 7.0])
    largest = np.array([1.2, 1.2, 1.05, 0.9, 0.9]) / 1.2
    for action in (-1.0, 1.0):
        found = [HELD.to_command([action], 1.2, speed) for speed in speeds]
        assert found == pytest.approx(np.column_stack([action * largest, np.zeros(5)]))
        np.testing.assert_array_equal(HELD.to_commands(np.full((5, 1), action), 1.2, speeds), found)
    # what lies within them is as it was
    assert HELD.to_command([0.5], 1.2, 7.0) == ActionLayout.steering(1.2).to_command([0.5], 1.2, 7.0)
    # and a vehicle that cannot steer as far takes all that it can
    assert HELD.to_command([1.0], 0.8, 7.0) == (1.0, 0.0)


def test_limits_stand_in_the_card_and_stay_where_a_layout_is_narrowed():
    assert HELD.to_card()["columns"][0]["within"] == [[3.0, 1.2], [4.0, 0.9]]
    assert HELD.narrowed([0.5]).columns[0].within == HELD.columns[0].within


@pytest.mark.parametrize(
    ("within", "why"),
    [
        (((4.0, 0.9), (3.0, 1.2)), "growing speed"),
        (((3.0, 0.9), (3.0, 1.2)), "growing speed"),
        (((3.0, 0.0),), "above 0"),
        (((3.0, float("nan")),), "above 0"),
    ],
)
def test_limits_that_mean_nothing_are_refused(within, why):
    with pytest.raises(ValueError, match=why):
        ActionLayout.steering(1.2, within=within)


@pytest.mark.parametrize("within", ["wide", [3.0, 1.2], [[3.0]], [[3.0, "far"]]])
def test_limits_of_a_card_that_are_none_are_refused(within):
    with pytest.raises(ValueError, match="perhaps within, pairs of"):
        ActionLayout.from_card({"columns": [{"meaning": STEERING_SET_VALUE, "scale": 1.2, "within": within}]})


def test_the_rate_of_a_target_stands_in_the_card():
    offset = ActionColumn(LINE_OFFSET, 3.0, rate=2.5)
    layout = ActionLayout((offset, ActionColumn(PACE, 0.08)))
    assert ActionLayout.from_card(layout.to_card()) == layout
    assert "rate" not in GUIDED.to_card()["columns"][0]
    with pytest.raises(ValueError, match="rate of line_offset"):
        ActionColumn(LINE_OFFSET, 3.0, rate=-1.0)
