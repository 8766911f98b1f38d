"""The ids of this project's environments in Gymnasium; importing this module registers them.

A module of its own, so that riding and its commands load no Gymnasium.
"""

from __future__ import annotations

from typing import Final

import gymnasium as gym

IDS: Final = {
    "bike_training/Whipple-v0": "bike_training.envs.env:BikeEnv",
    "bike_training/Superbike-v0": "bike_training.envs.race_env:RaceEnv",
}
"""Ids, and where the class of each is found; it is imported when one is made."""


def register() -> None:
    """Register the ids, unless they are. Gymnasium 1 looks for no plug-ins, so an import has to do it."""
    for name, place in IDS.items():
        if name not in gym.registry:
            gym.register(name, entry_point=place)


register()
