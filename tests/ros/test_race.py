"""Races through ROS: the learner sees and is rewarded there as in process, bit for bit; so is a policy that drives."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from bike_policy.contract.bundle import Actor, Bundle
from bike_policy.contract.observation import COMPACT
from bike_policy.riders.racing import RacingRider
from bike_sim.sim.request import ResetRequest
from bike_training.envs.env import BikeEnv
from bike_training.rollout.rollout import rollout
from bike_training.tasks.race import RaceContext, RaceTask

pytestmark = pytest.mark.ros

REQUEST = ResetRequest(
    seed=3,
    course="barcelona",
    speed_range=(30.0, 30.0),
    perturb=True,
    progress=700.0,
    line=0.9,
    context=tuple(RaceContext(0.8, 0.1, 60.0, 0.9)),
)


@pytest.fixture(scope="module")
def environments() -> Iterator[tuple[BikeEnv, BikeEnv]]:
    local = BikeEnv("local", "race")
    through_ros = BikeEnv("ros", "race")
    yield local, through_ros
    local.close()
    through_ros.close()


def test_observations_rewards_and_ends_are_the_same(environments: tuple[BikeEnv, BikeEnv]) -> None:
    rng = np.random.default_rng(0)
    seen = [env.reset(options={"request": REQUEST})[0] for env in environments]
    np.testing.assert_array_equal(*seen)
    ended = False
    for _ in range(60):
        action = np.clip(0.3 * rng.normal(size=2) + [0.0, 0.3], -1.0, 1.0).astype(np.float32)
        local, remote = (env.step(action) for env in environments)
        np.testing.assert_array_equal(local[0], remote[0])
        assert local[1:4] == remote[1:4]
        ended |= local[2]
        if ended:
            break
    assert ended, "such actions leave the track"


def test_a_policy_commands_the_same(environments: tuple[BikeEnv, BikeEnv]) -> None:
    rng = np.random.default_rng(1)
    sizes = (COMPACT.size, 16, 2)
    weights = [rng.normal(scale=0.05, size=(outputs, inputs)).astype(np.float32) for inputs, outputs in pairwise(sizes)]
    actor = Actor(weights, [np.zeros(len(weight), dtype=np.float32) for weight in weights])
    task = RaceTask()
    bundle = Bundle("made_up", actor, task.layout, task.action, "panigale_v4r", 0.02)
    rides = []
    for env in environments:
        commands = []
        for snapshot in rollout(env.client, RacingRider(bundle), REQUEST):
            commands.append((snapshot.steering, snapshot.throttle))
            if snapshot.step == 90:
                break
        rides.append(commands)
    assert rides[0] == rides[1]
    held = rides[0][1:]
    assert held[0] == held[1] == held[2] != held[3]  # a decision is held for three control periods
