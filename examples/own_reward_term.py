"""Add a term to the reward of the bicycle's task, and learn with it.

    python examples/own_reward_term.py --out runs/calm --steps 100000

Needs `make setup-training`. 100,000 steps take two to three minutes of one core; the default is a first look. A term
that stays belongs into `REWARD_TERMS` itself: then `bike train --set task.weights.calm=0.3` learns with it.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from bike_sim.physics.state import ROLL
from bike_training.learning.presets import load_preset
from bike_training.learning.process import run
from bike_training.learning.run_settings import RunSettings
from bike_training.tasks.path import REWARD_TERMS


def calm(task, distance, state):
    """Return 1 upright and 0 at 45 degrees of lean: rides that lean less are worth more."""
    return 1.0 - np.clip(np.abs(state[:, ROLL]) / np.radians(45.0), 0.0, 1.0)


def main() -> None:
    """Learn with the term as a third of the reward."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=3000, help="learning steps")
    parser.add_argument("--out", type=Path, help="folder of the run (default: a temporary one)")
    args = parser.parse_args()

    REWARD_TERMS["calm"] = calm
    weights = {"path_linear": 0.35, "path_peak": 0.35, "calm": 0.3}
    preset = load_preset("quick").changed({"task.weights": weights, "learner.steps": args.steps})
    settings = RunSettings(preset=preset)
    with tempfile.TemporaryDirectory() as folder:
        summary = run(settings, args.out or Path(folder) / "run")
    print(f"{summary['steps']} steps, in part {summary['part']} of the curriculum")


if __name__ == "__main__":
    main()
