"""Learn a frozen task with PPO of rsl_rl, many bicycles in one compiled batch, and score what was learned.

    .venv/bin/pip install rsl-rl-lib
    python examples/rsl_rl_ppo.py --id two_wheeler/Balance-v0 --updates 60

Needs `make setup-training`. The default takes a minute or two of one core. `bike evaluate --verify
out/rsl_rl/results.json` checks the score.
"""

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from bike_training.benchmark.evaluation import record_actions, write_results
from bike_training.benchmark.tasks import benchmark_of
from bike_training.gymnasium_ids import BENCHMARK_STEPS

NETWORK = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "elu"}
# The first actions must be small: a steering angle of 70 degrees fells any bicycle.
NOISE = {"class_name": "GaussianDistribution", "init_std": 0.2, "std_type": "log"}
SETTINGS = {
    "num_steps_per_env": 64,
    "save_interval": 10_000,
    "obs_groups": {"actor": ["seen"], "critic": ["seen"]},
    "actor": NETWORK | {"distribution_cfg": NOISE},
    "critic": NETWORK,
    "algorithm": {"class_name": "PPO", "entropy_coef": 0.0, "learning_rate": 1e-3},
}


class Batch(VecEnv):
    """A vector environment of Gymnasium as rsl_rl has them: tensors, and episodes that begin again by themselves."""

    def __init__(self, name: str, count: int, seed: int) -> None:
        """Begin all rides of a task."""
        self.envs = gymnasium.make_vec(name, num_envs=count, vectorization_mode="vector_entry_point")
        self.cfg: dict[str, Any] = {}
        self.device, self.num_envs, self.num_actions = "cpu", count, self.envs.single_action_space.shape[0]
        self.max_episode_length = BENCHMARK_STEPS[name]
        self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.long)
        self._seen = self.envs.reset(seed=seed)[0]

    def get_observations(self) -> TensorDict:
        """Return what is seen, as one group."""
        return TensorDict({"seen": torch.as_tensor(self._seen)}, batch_size=self.num_envs)

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Step all rides."""
        self._seen, rewards, terminated, truncated, _ = self.envs.step(actions.clamp(-1.0, 1.0).numpy())
        ended = torch.as_tensor(terminated | truncated)
        self.episode_length_buf = torch.where(ended, 0, self.episode_length_buf + 1)
        extras = {"time_outs": torch.as_tensor(truncated).float()}
        return self.get_observations(), torch.as_tensor(rewards).float(), ended.float(), extras


def main() -> None:
    """Learn, and print the score."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--id", default="two_wheeler/Pushes-v0", help="one of the frozen tasks")
    parser.add_argument("--count", type=int, default=64, help="vehicles side by side")
    parser.add_argument("--updates", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/rsl_rl"), help="folder of results and recordings")
    args = parser.parse_args()
    torch.set_num_threads(1)  # these networks are too small to share out
    torch.manual_seed(args.seed)
    runner = OnPolicyRunner(Batch(args.id, args.count, args.seed), SETTINGS, log_dir=str(args.out), device="cpu")
    runner.learn(args.updates)
    policy = runner.get_inference_policy()

    def act(observations: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            seen = TensorDict({"seen": torch.as_tensor(observations)}, batch_size=len(observations))
            return np.asarray(policy(seen).clamp(-1.0, 1.0).numpy())

    results = write_results(args.out, args.id, "rsl_rl PPO", record_actions(benchmark_of(args.id), act))
    print(f"{args.id}: error {results['error']:.3f}, {results['failed']} episodes failed, score {results['score']:.2f}")


if __name__ == "__main__":
    main()
