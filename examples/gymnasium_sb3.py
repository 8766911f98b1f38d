"""Learn a frozen task with Stable-Baselines3 or sbx, many vehicles at once, and score what was learned.

    python examples/gymnasium_sb3.py --steps 400000 --seed 1
    python examples/gymnasium_sb3.py --library sbx --algorithm SAC --count 8 --steps 10000

Needs `make setup-training`. The default takes less than two minutes of a core. `bike evaluate --verify
out/sb3/results.json` checks the score.
"""

import argparse
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

from bike_training.benchmark.evaluation import record_actions, write_results
from bike_training.benchmark.tasks import benchmark_of
from bike_training.envs.vec_env import BatchVecEnv

LIBRARIES = {"sb3": "stable_baselines3", "sbx": "sbx"}


def settings_of(algorithm: str, count: int) -> dict[str, Any]:
    """Return what differs from the libraries' defaults: they are made for one slow environment."""
    if algorithm == "SAC":
        return {"gradient_steps": max(1, count // 4), "learning_starts": 500}
    # The first actions must be small: a steering angle of 70 degrees fells any bicycle.
    form = {"log_std_init": -1.5}
    return {"n_steps": max(1, 2048 // count), "batch_size": 256, "learning_rate": 1e-3, "policy_kwargs": form}


def learn(library: str, algorithm: str, name: str, count: int, steps: int, seed: int, out: Path) -> dict[str, Any]:
    """Learn a task, ride the episodes of its score with the mean action, and write recordings and results to a folder.

    Args:
        library: a key of LIBRARIES.
        algorithm: ``PPO`` or ``SAC``.
        name: id of the task.
        count: vehicles side by side.
        steps: decisions of all vehicles together.
        seed: of networks, samples and rides.
        out: folder of the results.
    """
    torch.set_num_threads(1)  # these networks are too small to share out
    benchmark = benchmark_of(name)
    envs = BatchVecEnv(count, benchmark.task, benchmark.episodes(), benchmark.config, seed)
    kind = getattr(import_module(LIBRARIES[library]), algorithm)
    model = kind("MlpPolicy", envs, seed=seed, device="cpu", **settings_of(algorithm, count))
    model.learn(steps)
    envs.close()
    commands = record_actions(benchmark, lambda observations: model.predict(observations, deterministic=True)[0])
    return write_results(out, name, f"{library} {algorithm}", commands)


def main() -> None:
    """Learn, and print the score."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", choices=LIBRARIES, default="sb3", help="PyTorch or JAX")
    parser.add_argument("--algorithm", choices=["PPO", "SAC"], default="PPO")
    parser.add_argument("--id", default="two_wheeler/Balance-v0", help="one of the frozen tasks")
    parser.add_argument("--count", type=int, default=64, help="vehicles side by side")
    parser.add_argument("--steps", type=int, default=200000, help="decisions of all vehicles together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/sb3"), help="folder of results and recordings")
    args = parser.parse_args()
    found = learn(args.library, args.algorithm, args.id, args.count, args.steps, args.seed, args.out)
    print(f"{args.id}: error {found['error']:.3f}, {found['failed']} episodes failed, score {found['score']:.2f}")


if __name__ == "__main__":
    main()
