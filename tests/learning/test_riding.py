import numpy as np
import pytest

from bike_training.rollout.evaluation import evaluate
from bike_training.rollout.rollout import RideResult


def ride(error, progress, completed=True):
    n = len(error)
    zero = np.zeros(n)
    return RideResult(4.0, completed, np.array(progress, float), np.array(error, float), zero, zero, zero)


def test_figures_by_hand():
    figures = ride([0.0, -0.3, 0.4, 0.0], [0, 1, 2, 3]).figures([("a", 0.0), ("b", 2.0)])
    assert figures["mean_m"] == pytest.approx(0.175)
    assert figures["max_m"] == pytest.approx(0.4)
    assert figures["rms_m"] == pytest.approx(0.25)
    assert figures["sections"] == [
        {"section": "a", "mean_m": pytest.approx(0.15), "max_m": pytest.approx(0.3)},
        {"section": "b", "mean_m": pytest.approx(0.2), "max_m": pytest.approx(0.4)},
    ]


def test_evaluation_asks_for_all_rides_and_sums_them_up():
    asked = []

    def rider(request, longest):
        asked.append((request.course, request.speed_range[0], longest))
        return ride([0.0, request.speed_range[0] / 10.0], [0, 1], completed=request.speed_range[0] < 7)

    figures = evaluate(rider, speeds=(2.0, 7.0), random_rides=2)
    assert [(course, speed) for course, speed, _ in asked] == [
        ("benchmark", 2.0),
        ("benchmark", 7.0),
        *[("random", 2.0), ("random", 7.0)] * 2,
    ]
    assert all(longest == 30.0 for course, _, longest in asked if course == "random")
    assert figures["completed_count"] == 1
    assert figures["worst_mean_m"] == pytest.approx(0.35)
    assert figures["worst_max_m"] == pytest.approx(0.7)
    assert figures["average_mean_m"] == pytest.approx(0.225)
    assert figures["random_rides_count"] == 4
