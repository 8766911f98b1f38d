import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_training.tasks.path import PROP, TASKS, failed, validation_error


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
    assert TASKS[task].rewards(np.float64(distance), np.float64(roll)) == pytest.approx(expected)


def test_sharp_reward_by_hand():
    task = replace(PROP, reward="sharp", sharpness=0.2)
    assert task.rewards(np.float64(0.2), np.float64(0.0)) == pytest.approx(0.5 * (3.3 / 3.5 + math.exp(-1.0)))


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
@given(distance=st.floats(0, 10), roll=st.floats(-1.5, 1.5), farther=st.floats(0, 1))
def test_rewards_lie_in_0_1_fall_with_distance_and_are_symmetric(task, distance, roll, farther):
    reward = task.rewards(np.float64(distance), np.float64(roll))
    assert 0.0 <= reward <= 1.0
    assert task.rewards(np.float64(distance + farther), np.float64(roll)) <= reward
    assert task.rewards(np.float64(distance), np.float64(-roll)) == reward


@pytest.mark.parametrize("reward", ["linear", "exponential", "sharp"])
@given(distance=st.floats(0, 10), roll=st.floats(-1.5, 1.5), weight=st.floats(0, 1))
def test_reward_terms_add_up_to_the_reward(reward, distance, roll, weight):
    task = replace(PROP, reward=reward, path_weight=weight)
    terms = task.reward_terms(np.float64(distance), np.float64(roll))
    assert all(term >= 0.0 for term in terms.values())
    assert sum(terms.values()) == pytest.approx(task.rewards(np.float64(distance), np.float64(roll)), abs=1e-15)
    assert ("upright" in terms) == (weight < 1.0)
    assert sum(task.reward_terms(np.float64(0.0), np.float64(0.0)).values()) == pytest.approx(1.0)


def test_thresholds():
    assert not failed(np.float64(3.5), np.float64(math.radians(45)), False)
    assert failed(np.float64(3.51), np.float64(0), False)
    assert failed(np.float64(0), np.float64(-math.radians(45.1)), False)
    assert failed(np.float64(0), np.float64(0), True)
    assert failed(np.array([np.nan, 0.0]), np.array([0.0, np.nan]), False).all()


def test_validation_error_leaves_out_the_first_fifth():
    distances = np.array([9.0, 9.0] + [0.35] * 8)
    assert validation_error(distances, True) == pytest.approx(0.1)
    assert validation_error(distances, False) == 1.0


def test_table_5():
    """Each alternative differs from the proposed settings in one choice."""
    prop = TASKS["prop"]
    assert prop.layout.size == 16
    assert (prop.layout.preview_by_time, prop.layout.preview_interval, prop.layout.preview_count) == (True, 0.4, 5)
    assert (prop.reward, prop.path_weight, prop.contact) == ("linear", 1.0, "rear")
    assert TASKS["alt1"].layout.features[:3] == ("x", "y", "yaw")
    assert TASKS["alt1"].layout.size == 15
    assert (TASKS["alt2"].layout.preview_by_time, TASKS["alt2"].layout.preview_interval) == (False, 2.0)
    assert TASKS["alt3"].contact == "front"
    assert TASKS["alt4"].reward == "exponential"
    assert TASKS["alt5"].path_weight == 0.5


@pytest.mark.parametrize(
    "change", [{"reward": "praise"}, {"contact": "saddle"}, {"path_weight": 1.5}, {"max_steps": 0}, {"sharpness": 0.0}]
)
def test_wrong_settings_are_refused(change):
    with pytest.raises(ValueError, match=r"."):
        replace(PROP, **change)
