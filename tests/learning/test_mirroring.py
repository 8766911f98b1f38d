"""Mirrored replay: each column of observation and action flips as its meaning says."""

import gymnasium as gym
import numpy as np
import pytest

from bike_policy.contract.action import DRIVE, LEAN_REQUEST, ActionColumn, ActionLayout
from bike_policy.contract.observation import COMPACT, LEAN_LAYOUT
from bike_training.learning.learner import MirrorReplayBuffer

ACTION = ActionLayout((ActionColumn(LEAN_REQUEST), ActionColumn(DRIVE)))


@pytest.mark.parametrize("layout", [LEAN_LAYOUT, COMPACT], ids=lambda layout: layout.name)
def test_throttle_keeps_its_sign_steering_flips_and_limits_change_sides(layout):
    signs, places = layout.mirror_signs, layout.mirror_places
    buffer = MirrorReplayBuffer(
        1,
        gym.spaces.Box(-np.inf, np.inf, (layout.size,), np.float32),
        gym.spaces.Box(-1.0, 1.0, (2,), np.float32),
        device="cpu",
        mirror_signs=signs,
        mirror_places=places,
        action_signs=ACTION.mirror_signs,
    )
    observation = np.arange(1.0, layout.size + 1.0, dtype=np.float32)
    buffer.add(
        observation[None],
        2.0 * observation[None],
        np.array([[0.25, 0.75]], dtype=np.float32),
        np.array([3.0]),
        np.array([False]),
        [{}],
    )
    np.random.seed(0)
    drawn = buffer.sample(400)
    flipped = drawn.actions[:, 0].numpy() < 0.0
    assert 100 < flipped.sum() < 300  # about half
    np.testing.assert_array_equal(np.abs(drawn.actions[:, 0].numpy()), np.full(400, 0.25, dtype=np.float32))
    np.testing.assert_array_equal(drawn.actions[:, 1].numpy(), np.full(400, 0.75, dtype=np.float32))
    for seen, factor in ((drawn.observations, 1.0), (drawn.next_observations, 2.0)):
        expected = np.where(flipped[:, None], factor * observation[places] * signs, factor * observation)
        np.testing.assert_array_equal(seen.numpy(), expected.astype(np.float32))
    np.testing.assert_array_equal(drawn.rewards.numpy(), np.full((400, 1), 3.0, dtype=np.float32))
