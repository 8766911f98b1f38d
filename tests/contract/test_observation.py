import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bike_policy.contract.observation import (
    COMPACT,
    LAYOUT_VERSION,
    LEAN_LAYOUT,
    PROP_LAYOUT,
    RACE_LAYOUTS,
    TURN_LAYOUT,
    ObservationLayout,
    Rows,
)
from bike_sim.physics.state import MIRROR_SIGNS, STATE_SIZE
from bike_sim.sim import look as lk
from bike_training.tasks.path import TASKS

LAYOUTS = [task.layout for task in TASKS.values()]
finite = st.floats(-20.0, 20.0)


def rows(state, preview_y, preview_x=None):
    """Return rows where a layout takes nothing but state and preview."""
    state, preview_y = np.atleast_2d(state, preview_y)
    preview_x = np.zeros_like(preview_y) if preview_x is None else np.atleast_2d(preview_x)
    return Rows.of_path(state, np.full((len(state), lk.LOOK_SIZE), np.nan), np.stack((preview_x, preview_y), axis=1))


FEATURES = LEAN_LAYOUT.size - LEAN_LAYOUT.preview_count


def test_prop_is_the_papers_q_prime_and_preview():
    state = np.arange(1.0, 11.0) / 10.0
    preview = np.array([0.1, 0.2, 0.4, 0.8, 1.6])
    observation = PROP_LAYOUT.observe(rows(state, preview))[0]
    x, y, yaw, *rest = state
    expected = [x, y, math.cos(yaw), math.sin(yaw), *rest, *preview]
    np.testing.assert_allclose(observation, expected, rtol=1e-6)
    assert observation.dtype == np.float32
    assert PROP_LAYOUT.size == 16


def test_lean_preview_of_a_circle_is_the_steady_lean():
    """On a circle of radius R at speed v the second differences are v^2 / (g R), the tangent of the lean."""
    speed, radius = 5.0, 40.0
    arc = speed * LEAN_LAYOUT.preview_interval * np.arange(LEAN_LAYOUT.preview_count)
    y = radius * (1.0 - np.cos(arc / radius))
    observation = LEAN_LAYOUT.observe(rows(np.zeros(STATE_SIZE), y))[0]
    lean = observation[FEATURES + 2 :]
    # The first of them is seen from the tangent point; the later ones turn away by the angle of the arc.
    angles = arc[1:-1] / radius
    np.testing.assert_allclose(lean, speed**2 / (9.81 * radius) * np.cos(angles), rtol=1e-3)


@given(finite.filter(lambda angle: abs(angle) < 1.5), st.floats(2.0, 7.0), st.floats(3.0, 60.0))
def test_turn_preview_of_a_circle_is_the_steady_lean_from_any_angle(angle, speed, radius):
    """However the machine stands to the line, also where it has turned by more than a quarter."""
    turn = speed * TURN_LAYOUT.preview_interval * np.arange(TURN_LAYOUT.preview_count) / radius
    x, y = radius * np.sin(turn), radius * (1.0 - np.cos(turn))
    cos, sin = math.cos(angle), math.sin(angle)
    seen = TURN_LAYOUT.observe(rows(np.zeros(STATE_SIZE), sin * x + cos * y, cos * x - sin * y))[0]
    lean = seen[TURN_LAYOUT.size - TURN_LAYOUT.preview_count + 2 :]
    np.testing.assert_allclose(lean, speed**2 / (9.81 * radius), rtol=1e-2)


def test_lean_preview_loses_nothing():
    """The preview points can be found again from their lean form."""
    rng = np.random.default_rng(0)
    y = rng.normal(size=LEAN_LAYOUT.preview_count)
    form = LEAN_LAYOUT.observe(rows(np.zeros(STATE_SIZE), y))[0, FEATURES:].astype(float)
    t = LEAN_LAYOUT.preview_interval
    back = [form[0], form[0] + form[1] * t]
    for second in form[2:]:
        back.append(second * 9.81 * t**2 + 2.0 * back[-1] - back[-2])
    np.testing.assert_allclose(back, y, atol=1e-4)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
@given(data=st.data())
def test_mirrored_state_gives_mirrored_observation(layout, data):
    state = data.draw(arrays(np.float64, STATE_SIZE, elements=finite))
    preview = data.draw(arrays(np.float64, layout.preview_count, elements=finite))
    observation = layout.observe(rows(state, preview))
    mirrored = layout.observe(rows(state * MIRROR_SIGNS, -preview))
    np.testing.assert_array_equal(mirrored, observation * layout.mirror_signs)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_batch_is_the_same_as_one_by_one(layout):
    rng = np.random.default_rng(1)
    states, previews = rng.normal(size=(7, STATE_SIZE)), rng.normal(size=(7, layout.preview_count))
    batch = layout.observe(rows(states, previews))
    for row, state, preview in zip(batch, states, previews, strict=True):
        np.testing.assert_array_equal(row, layout.observe(rows(state, preview))[0])
    assert batch.shape == (7, layout.size) == (7, len(layout.names))


@pytest.mark.parametrize("layout", [*LAYOUTS, *RACE_LAYOUTS.values()], ids=lambda layout: layout.name)
def test_card_round_trip(layout):
    changed = replace(layout, repeat=2, share=1.05) if layout.races else layout
    assert ObservationLayout.from_card(json.loads(json.dumps(changed.to_card()))) == changed


@pytest.mark.parametrize(
    ("layout", "change", "message"),
    [
        (LEAN_LAYOUT, {"version": LAYOUT_VERSION + 1}, "version"),
        (LEAN_LAYOUT, {"version": 1}, "version 1, this software speaks 2"),
        (LEAN_LAYOUT, {"terms": ["roll", "mood", "preview_lean"]}, "mood"),
        (LEAN_LAYOUT, {"terms": ["roll", "speed_margin", "preview_lean"]}, "speed_margin"),
        (LEAN_LAYOUT, {"terms": ["preview_lean", "roll"], "factors": []}, "last term must be a preview"),
        (LEAN_LAYOUT, {"factors": [1.0]}, "factors"),
        (LEAN_LAYOUT, {"terms": 3}, "no lists"),
        (LEAN_LAYOUT, {"colour": "red"}, "colour"),
        (LEAN_LAYOUT, {"preview_interval": float("nan")}, "interval must be positive"),
        (LEAN_LAYOUT, {"preview_by_time": False}, "preview_lean needs"),
        (COMPACT, {"terms": ["speed", "mood"]}, "mood"),
        (COMPACT, {"terms": ["speed", "preview_points"]}, "preview_points"),
        (COMPACT, {"terms": []}, "has terms"),
        (COMPACT, {"repeat": 0}, "repeat must be 1"),
        (COMPACT, {"share": float("nan")}, "share must be positive"),
    ],
)
def test_foreign_layout_is_refused_by_name(layout, change, message):
    with pytest.raises(ValueError, match=message):
        ObservationLayout.from_card({**layout.to_card(), **change})


def test_preview_is_picked_from_a_finer_one():
    index = PROP_LAYOUT.pick_preview(by_time=True, interval=0.1, count=25)
    np.testing.assert_array_equal(index, [0, 4, 8, 12, 16])


@pytest.mark.parametrize(
    ("by_time", "interval", "count", "message"),
    [
        (False, 0.1, 25, "by time"),
        (True, 0.3, 25, "multiple"),
        (True, 0.1, 16, "17 preview points"),
        (True, 0.0, 25, "positive"),
        (True, math.nan, 25, "positive"),
    ],
)
def test_preview_that_does_not_serve_is_refused(by_time, interval, count, message):
    with pytest.raises(ValueError, match=message):
        PROP_LAYOUT.pick_preview(by_time, interval, count)


def test_bounds_hold_angles():
    layout = replace(PROP_LAYOUT, factors=(2.0,) * len(PROP_LAYOUT.terms))
    assert layout.high[layout.names.index("roll")] == pytest.approx(2.0 * math.pi)
    assert layout.high[layout.names.index("yaw_cos")] == pytest.approx(2.0)
    assert math.isinf(layout.high[0])
    assert math.isinf(layout.high[layout.names.index("steer")])


def test_a_wrapped_yaw_forgets_whole_turns_and_mirrors():
    layout = ObservationLayout("turns", ("yaw_wrapped", "preview_points"), preview_count=1)

    def shown(yaw: float) -> float:
        state = np.zeros(10)
        state[2] = yaw
        return float(layout.observe(rows(state, np.zeros(1)))[0, 0])

    for yaw in (-3.0, -0.2, 0.0, 1.5, 3.1):
        assert shown(yaw) == pytest.approx(yaw, abs=1e-6)
        assert shown(yaw + 14.0 * math.pi) == pytest.approx(yaw, abs=1e-5)
        assert shown(-yaw - 6.0 * math.pi) == pytest.approx(-yaw, abs=1e-5)
