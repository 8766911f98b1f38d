"""The ids of this project's environments in Gymnasium, registered as soon as both packages are imported."""

from __future__ import annotations

from typing import Any, Final

import gymnasium as gym

IDS: Final = {
    "bike_training/Whipple-v0": ("bike_training.envs.env:BikeEnv", "whipple_vector", 1200),
    "bike_training/Superbike-v0": ("bike_training.envs.race_env:RaceEnv", "superbike_vector", 500),
}
"""Ids, where the class of each is found, its vector environment here, and the decisions of an episode."""


def whipple_vector(num_envs: int = 1, seed: int = 0, **kwargs: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return bicycles of the task *prop.* on the compiled engine, side by side; see `_vector`."""
    from bike_sim.sim.batch import COMPILED_ENGINE
    from bike_sim.sim.config import SimulatorConfig
    from bike_training.curricula.parts import PartsCurriculum
    from bike_training.tasks.path import PROP

    config = SimulatorConfig(engine=COMPILED_ENGINE, time_step=0.01)
    return _vector(num_envs, PROP, PartsCurriculum().episodes(0), config, seed, kwargs)


def superbike_vector(
    num_envs: int = 1,
    seed: int = 0,
    vehicle: str = "panigale_v4r",
    circuits: tuple[str, ...] = ("barcelona",),
    **kwargs: Any,
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return superbikes on circuits on the compiled engine, side by side; see `_vector`."""
    from dataclasses import replace

    from bike_sim.sim.batch import SUPERBIKE_ENGINE
    from bike_sim.sim.superbike_plant import superbike_config
    from bike_sim.vehicles.files import load_vehicle
    from bike_training.curricula.race import CircuitSet, RaceCurriculum
    from bike_training.tasks.race import RaceTask

    config = replace(superbike_config(vehicle), engine=SUPERBIKE_ENGINE)
    episodes = RaceCurriculum(CircuitSet(load_vehicle(vehicle), circuits)).episodes(0)
    return _vector(num_envs, RaceTask(), episodes, config, seed, kwargs)


def _vector(
    count: int, task: Any, episodes: Any, config: Any, seed: int, others: dict[str, Any]
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return a vector environment on the compiled batch.

    Raises:
        ValueError: an option that a batch does not have.
    """
    from bike_training.envs.vec_env import BatchVecEnv, BatchVectorEnv

    steps = others.pop("max_episode_steps", None)
    wrong = {name: value for name, value in others.items() if value is not None}
    if wrong:
        name, value = next(iter(wrong.items()))
        raise ValueError(f"a batch of vehicles has no option {name}={value!r}")
    if steps is not None and steps != task.max_steps:
        raise ValueError(f"max_episode_steps={steps} must be {task.max_steps}, that of the task")
    return BatchVectorEnv(BatchVecEnv(count, task, episodes, config, seed))


def register() -> None:
    """Register the ids, unless they are. Gymnasium 1 looks for no plug-ins, so an import has to do it."""
    for name, (place, vector, steps) in IDS.items():
        if name not in gym.registry:
            gym.register(
                name,
                entry_point=place,
                vector_entry_point=f"bike_training.gymnasium_ids:{vector}",
                max_episode_steps=steps,
            )


register()
