"""Learn a frozen task with Stable-Baselines3 or sbx, many vehicles at once, and score what was learned.

    python examples/gymnasium_sb3.py --steps 400000 --seed 1
    python examples/gymnasium_sb3.py --library sbx --algorithm SAC --count 8 --steps 10000

Needs `make setup-training`. The default takes less than two minutes of a core. `bike evaluate --verify
out/sb3/results.json` checks the score.
"""

import argparse
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.noise import NormalActionNoise

from bike_training.benchmark.evaluation import record_actions, write_results
from bike_training.benchmark.tasks import benchmark_of
from bike_training.envs.vec_env import BatchVecEnv

LIBRARIES = {"sb3": "stable_baselines3", "sbx": "sbx"}
ALGORITHMS = "PPO", "SAC", "TD3"


def settings_of(algorithm: str, count: int, actions: int) -> dict[str, Any]:
    """Return what differs from the libraries' defaults: they are made for one slow environment."""
    # The first actions must be small: a steering angle of 70 degrees fells any bicycle.
    if algorithm == "PPO":
        form = {"log_std_init": -1.5}
        return {"n_steps": max(1, 2048 // count), "batch_size": 256, "learning_rate": 1e-3, "policy_kwargs": form}
    settings = {
        "gradient_steps": max(1, count // 4),
        "learning_starts": 2000,
        "gamma": 0.98,
        "learning_rate": 5e-4,
        "batch_size": 256,
        "policy_kwargs": {"net_arch": [64, 64]},
    }
    if algorithm == "SAC":
        return settings | {"target_entropy": -3.0 * actions}
    return settings | {"action_noise": NormalActionNoise(np.zeros(actions), np.full(actions, 0.1))}


def learn(
    library: str, algorithm: str, name: str, count: int, steps: int, seed: int, out: Path, scores: int = 1
) -> list[dict[str, Any]]:
    """Learn a task, and ride the episodes of its score with the mean action.

    Args:
        library: a key of LIBRARIES.
        algorithm: one of ALGORITHMS.
        name: id of the task.
        count: vehicles side by side.
        steps: decisions of all vehicles together.
        seed: of networks, samples and rides.
        out: folder of the last results and recordings.
        scores: how many on the way, at equal distances; the last at the end.

    Returns:
        Results of each score, with ``decisions`` and the ``processor_s`` (s) of learning until then.
    """
    torch.set_num_threads(1)  # these networks are too small to share out
    benchmark = benchmark_of(name)
    envs = BatchVecEnv(count, benchmark.task, benchmark.episodes(), benchmark.config, seed)
    kind = getattr(import_module(LIBRARIES[library]), algorithm)
    settings = settings_of(algorithm, count, benchmark.task.action.size)
    model = kind("MlpPolicy", envs, seed=seed, device="cpu", **settings)
    found, spent = [], 0.0
    for part in range(scores):
        began = time.process_time()
        model.learn(steps // scores, reset_num_timesteps=part == 0)
        spent += time.process_time() - began
        commands = record_actions(benchmark, lambda observations: model.predict(observations, deterministic=True)[0])
        results = write_results(out, name, f"{library} {algorithm}", commands)
        found.append(results | {"decisions": (part + 1) * (steps // scores), "processor_s": spent})
    envs.close()
    return found


def main() -> None:
    """Learn, and print the score."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", choices=LIBRARIES, default="sb3", help="PyTorch or JAX")
    parser.add_argument("--algorithm", choices=ALGORITHMS, default="PPO")
    parser.add_argument("--id", default="two_wheeler/Balance-v0", help="one of the frozen tasks")
    parser.add_argument("--count", type=int, default=64, help="vehicles side by side")
    parser.add_argument("--steps", type=int, default=200000, help="decisions of all vehicles together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/sb3"), help="folder of results and recordings")
    args = parser.parse_args()
    found = learn(args.library, args.algorithm, args.id, args.count, args.steps, args.seed, args.out)[-1]
    print(f"{args.id}: error {found['error']:.3f}, {found['failed']} episodes failed, score {found['score']:.2f}")


if __name__ == "__main__":
    main()
