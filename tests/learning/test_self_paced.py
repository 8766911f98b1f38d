"""Self-paced learning: divergences in closed form, constrained updates, and the curriculum made of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_training.curricula.spdl import EASIER, HARDER, TOLERANCE, WAITS, Gaussian, divergence, line_of, self_paced


def gaussian(rng, size=3):
    factor = np.tril(0.3 * rng.normal(size=(size, size)))
    factor[np.diag_indices(size)] = rng.uniform(0.2, 1.5, size)
    return Gaussian(rng.normal(size=size), factor)


@given(seed=st.integers(0, 10_000))
def test_divergence_is_the_mean_of_log_densities_and_the_textbook_formula(seed):
    rng = np.random.default_rng(seed)
    p, q = gaussian(rng), gaussian(rng)
    sp, sq = p.factor @ p.factor.T, q.factor @ q.factor.T
    apart = q.mean - p.mean
    expected = 0.5 * (
        np.trace(np.linalg.solve(sq, sp))
        + apart @ np.linalg.solve(sq, apart)
        - 3.0
        + math.log(np.linalg.det(sq) / np.linalg.det(sp))
    )
    assert divergence(p, q) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert divergence(p, p) == pytest.approx(0.0, abs=1e-12)
    back = Gaussian.from_flat(p.to_flat())
    np.testing.assert_allclose(back.mean, p.mean)
    np.testing.assert_allclose(back.factor, p.factor)


def test_density_integrates_to_one():
    p = gaussian(np.random.default_rng(0), 1)
    x = np.linspace(-20.0, 20.0, 20001)
    assert np.trapezoid(np.exp(p.log_density(x[:, None])), x) == pytest.approx(1.0)


TARGET = Gaussian.with_std([1.0, 1.0], [0.05, 0.05])
START = Gaussian.with_std([0.0, 0.0], [0.3, 0.3])


def sampled(distribution, value, count=100, seed=0):
    rng = np.random.default_rng(seed)
    contexts = np.array([distribution.draw(rng) for _ in range(count)])
    return contexts, distribution.log_density(contexts), np.array([value(context) for context in contexts])


def test_a_good_agent_is_led_to_the_target_in_bounded_steps():
    now, apart = START, divergence(START, TARGET)
    for number in range(400):
        update = self_paced(now, TARGET, sampled(now, lambda context: 2.0, seed=number), 1.0, True)
        assert update.stage == HARDER
        assert divergence(now, update.distribution) <= 0.05 * (1.0 + 2.0 * TOLERANCE)
        now = update.distribution
        assert divergence(now, TARGET) <= apart + 1e-9
        apart = divergence(now, TARGET)
        if apart < 0.01:
            break
    assert apart < 0.01


def test_harder_contexts_are_not_drawn_where_they_cost_too_much():
    """Values fall towards the target: the update goes as far as the threshold allows and no farther."""
    episodes = sampled(START, lambda context: 1.2 - context.mean(), 400)
    update = self_paced(START, TARGET, episodes, 1.0, True, step=5.0)
    assert update.stage == HARDER
    assert update.value >= 1.0 - TOLERANCE
    assert update.value < update.before
    assert update.distribution.mean.mean() > 0.0


def test_before_the_threshold_was_met_easier_contexts_are_sought():
    contexts = sampled(START, lambda context: -context.sum(), 200)
    update = self_paced(START, TARGET, contexts, 10.0, False)
    assert update.stage == EASIER
    assert update.value > update.before
    assert divergence(START, update.distribution) <= 0.05 * (1.0 + 2.0 * TOLERANCE)
    waiting = self_paced(START, TARGET, contexts, 10.0, True)
    assert waiting.stage == WAITS
    assert waiting.distribution is START


def test_far_from_the_target_contexts_stay_spread():
    episodes = sampled(START, lambda context: 2.0)
    update = self_paced(START, TARGET, episodes, 1.0, True, 5.0, np.array([0.2, 0.2]), far=1.0)
    assert (np.diag(update.distribution.factor) >= 0.2 - 1e-9).all()


@given(d_median=st.floats(0.0, 1.0), d_ideal=st.floats(0.0, 1.0), v_max=st.floats(20.0, 100.0))
def test_the_line_of_a_context(d_median, d_ideal, v_max):
    lam = line_of(d_median, d_ideal, v_max)
    assert 0.0 <= lam <= 1.0
    assert line_of(min(1.0, d_median + 0.1), d_ideal, v_max) >= lam  # farther from the median
    assert line_of(d_median, min(1.0, d_ideal + 0.1), v_max) <= lam  # farther from the ideal line
    assert line_of(d_median, d_ideal, v_max + 10.0) >= lam


def test_the_line_at_the_ends_of_the_curriculum():
    assert line_of(1.0, 0.0, 90.0) == 1.0
    assert line_of(0.0, 1.0, 0.0) == 0.0
    assert line_of(1.0, 0.0, 45.0) == 0.75  # both terms weigh the same
