"""Step many vehicles in one compiled loop, as Gymnasium's vector environment.

    python examples/vector_environment.py --count 64

Needs `make setup-training`. Takes some ten seconds, most of it loading.
"""

import argparse
import time

import gymnasium
import numpy as np

import bike_training  # noqa: F401 (registers the ids)


def main() -> None:
    """Ride with random actions, and print how many control steps a second that is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--id", default="bike_training/Whipple-v0", help="or bike_training/Superbike-v0")
    parser.add_argument("--count", type=int, default=64, help="vehicles")
    parser.add_argument("--steps", type=int, default=200, help="steps of all of them")
    args = parser.parse_args()

    envs = gymnasium.make_vec(args.id, num_envs=args.count, vectorization_mode="vector_entry_point")
    envs.reset(seed=0)
    random = np.random.default_rng(0)
    actions = random.uniform(-0.1, 0.1, (args.steps, *envs.action_space.shape)).astype(np.float32)
    began, over = time.perf_counter(), 0
    for action in actions:
        _, _, terminated, truncated, _ = envs.step(action)
        over += int(np.count_nonzero(terminated | truncated))
    rate = args.count * args.steps / (time.perf_counter() - began)
    print(f"{args.count} vehicles, {rate:,.0f} control steps a second, {over} episodes over")
    envs.close()


if __name__ == "__main__":
    main()
