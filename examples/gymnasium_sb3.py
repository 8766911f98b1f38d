"""Learn to ride with Stable-Baselines3 and nothing else of this project but its environment.

    python examples/gymnasium_sb3.py --steps 100000

Needs `make setup-training`. 100,000 steps take some 20 minutes of one core; the default is a first look. The presets of
`bike train` learn the same task sooner.
"""

import argparse

import gymnasium
import torch
from stable_baselines3 import SAC

import bike_training  # noqa: F401 (registers the ids)


def main() -> None:
    """Learn, then ride one episode with the mean action."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=2000, help="learning steps of 50 ms")
    args = parser.parse_args()

    torch.set_num_threads(1)  # these networks are too small to share out
    env = gymnasium.make("bike_training/Whipple-v0")
    learner = SAC("MlpPolicy", env, seed=0, verbose=0)
    learner.learn(args.steps)

    observation, _ = env.reset(seed=1)
    total, steps, over = 0.0, 0, False
    while not over:
        action, _ = learner.predict(observation, deterministic=True)
        observation, reward, terminated, truncated, _info = env.step(action)
        total, steps, over = total + float(reward), steps + 1, terminated or truncated
    print(f"{steps} of 1200 steps ridden, return {total:.1f}")
    env.close()


if __name__ == "__main__":
    main()
