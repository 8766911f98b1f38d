import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_policy.contract.observation import Rows
from bike_sim.physics.state import ROLL, STATE_SIZE
from bike_sim.sim import look as lk
from bike_training.tasks.base import sum_of
from bike_training.tasks.path import LINEAR, PROP, SHARP, TASKS, PathTask


def at(distance, roll, fallen=False):
    """Return instants at a distance to the path, of both contact points, and a roll angle."""
    distance, roll, fallen = np.broadcast_arrays(*np.atleast_1d(distance, roll, fallen))
    state, look = np.zeros((len(roll), STATE_SIZE)), np.zeros((len(roll), lk.LOOK_SIZE))
    state[:, ROLL] = roll
    look[:, lk.LATERAL_ERROR] = look[:, lk.FRONT_LATERAL_ERROR] = distance
    return Rows.of_path(state, look, np.zeros((len(roll), 2, 5)))._replace(fallen=np.asarray(fallen, dtype=bool))


def reward(task, distance, roll):
    return sum_of(task.reward_terms(at(distance, roll)))


@pytest.mark.parametrize(
    ("task", "distance", "roll", "expected"),
    [
        ("prop", 0.0, 0.3, 1.0),
        ("prop", 0.7, 0.0, 0.8),  # (3.5 - 0.7) / 3.5
        ("prop", 3.5, 0.0, 0.0),
        ("prop", 9.0, 0.0, 0.0),  # the step that leaves the thresholds is not punished
        ("alt4", 1.0, 0.0, math.exp(-0.5)),
        ("alt5", 0.7, math.radians(22.5), 0.5 * 0.8 + 0.5 * 0.5),
    ],
)
def test_rewards_by_hand(task, distance, roll, expected):
    assert reward(TASKS[task], distance, roll) == pytest.approx(expected)


def test_sharp_reward_by_hand():
    task = replace(PROP, weights=SHARP, sharpness=0.2)
    assert reward(task, 0.2, 0.0) == pytest.approx(0.5 * (3.3 / 3.5 + math.exp(-1.0)))


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
@given(distance=st.floats(0, 10), roll=st.floats(-1.5, 1.5), farther=st.floats(0, 1))
def test_rewards_lie_in_0_1_fall_with_distance_and_are_symmetric(task, distance, roll, farther):
    worth = reward(task, distance, roll)
    assert 0.0 <= worth <= 1.0
    assert reward(task, distance + farther, roll) <= worth
    assert reward(task, distance, -roll) == worth
    assert reward(task, -distance, roll) == worth


@pytest.mark.parametrize("path", [LINEAR, {"path_exponential": 1.0}, SHARP])
@given(distance=st.floats(0, 10), roll=st.floats(-1.5, 1.5), share=st.floats(0, 1))
def test_reward_terms_have_their_weights_and_add_up_to_the_reward(path, distance, roll, share):
    weights = {name: share * weight for name, weight in path.items()} | {"upright": 1.0 - share}
    terms = replace(PROP, weights=weights).reward_terms(at(distance, roll))
    assert list(terms) == list(weights)
    for name, term in terms.items():
        assert 0.0 <= term <= weights[name]
        alone = replace(PROP, weights={name: 1.0}).reward_terms(at(distance, roll))
        assert term == weights[name] * alone[name]
    assert sum(replace(PROP, weights=weights).reward_terms(at(0.0, 0.0)).values()) == pytest.approx(1.0)


def test_error_is_that_of_the_contact_point_that_is_held_to_the_path():
    rows = at(np.array([0.3, -0.4]), 0.0)
    rows.look[:, lk.FRONT_LATERAL_ERROR] = [-0.1, 0.2]
    np.testing.assert_array_equal(PROP.error(rows), [0.3, 0.4])
    np.testing.assert_array_equal(TASKS["alt3"].error(rows), [0.1, 0.2])


def test_thresholds():
    assert not PROP.failed(at(3.5, math.radians(45)))
    assert PROP.failed(at(3.51, 0.0))
    assert PROP.failed(at(-3.51, 0.0))
    assert PROP.failed(at(0.0, -math.radians(45.1)))
    assert PROP.failed(at(0.0, 0.0, fallen=True))
    assert PROP.failed(at(np.array([np.nan, 0.0]), np.array([0.0, np.nan]))).all()
    many = at(np.array([0.0, 9.0, 0.0]), 0.0, fallen=np.array([False, False, True]))
    assert PROP.failed(many).tolist() == [False, True, True]


def test_validation_error_leaves_out_the_first_fifth():
    distances = np.array([9.0, 9.0] + [0.35] * 8)
    assert PROP.validation_error(distances, True) == pytest.approx(0.1)
    assert PROP.validation_error(distances, False) == 1.0


def test_table_5():
    """Each alternative differs from the proposed settings in one choice."""
    prop = TASKS["prop"]
    assert prop.layout.size == 16
    assert (prop.layout.preview_by_time, prop.layout.preview_interval, prop.layout.preview_count) == (True, 0.4, 5)
    assert (prop.weights, prop.contact) == ({"path_linear": 1.0}, "rear")
    assert TASKS["alt1"].layout.terms[:3] == ("x", "y", "yaw_wrapped")
    assert TASKS["alt1"].layout.size == 15
    assert (TASKS["alt2"].layout.preview_by_time, TASKS["alt2"].layout.preview_interval) == (False, 2.0)
    assert TASKS["alt3"].contact == "front"
    assert TASKS["alt4"].weights == {"path_exponential": 1.0}
    assert TASKS["alt5"].weights == {"path_linear": 0.5, "upright": 0.5}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": {"praise": 1.0}}, "weights='praise' is not known.*path_linear"),
        ({"weights": 3}, "weights=3 must name reward terms"),
        ({"weights": {"upright": math.nan}}, "weights.upright=nan must be finite"),
        ({"task": "saddle"}, "task='saddle' is not known; there are prop"),
        ({"max_steps": 0}, "max_steps=0 must be at least 1"),
        ({"sharpness": 0.0}, "sharpness=0.0 must be positive"),
        ({"max_steer": -1.0}, "max_steer=-1.0 must be positive"),
    ],
)
def test_wrong_settings_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(PROP, **change)


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_card_round_trip(task):
    card = json.loads(json.dumps(task.to_card()))
    assert PathTask.from_card(card) == task


def test_a_foreign_card_is_refused_by_name():
    with pytest.raises(ValueError, match="colour"):
        PathTask.from_card({**PROP.to_card(), "colour": "red"})
