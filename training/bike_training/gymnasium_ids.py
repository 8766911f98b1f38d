"""The ids of this project's environments in Gymnasium, registered as soon as both packages are imported."""

from __future__ import annotations

from typing import Any, Final

import gymnasium as gym

IDS: Final = {"bike_training/Whipple-v0": ("prop", 1200), "bike_training/Superbike-v0": ("race", 500)}
"""Ids whose task may be changed by options, with the task of each and the decisions of an episode."""
BENCHMARK_STEPS: Final = {
    "two_wheeler/Balance-v0": 400,
    "two_wheeler/Path-v0": 600,
    "two_wheeler/Junction-v0": 160,
    "two_wheeler/Pushes-v0": 200,
    "two_wheeler/LateCommands-v0": 600,
    "two_wheeler/Lap-v0": 2000,
    "two_wheeler/UnseenCircuits-v0": 1000,
    "two_wheeler/UnknownWorlds-v0": 2000,
}
"""Ids of frozen tasks with the decisions of an episode; `bike_training.benchmark.tasks` has the rest of each row."""


def make_vector(
    num_envs: int = 1,
    seed: int = 0,
    task: str = "prop",
    vehicle: str | None = None,
    circuits: tuple[str, ...] = ("barcelona",),
    **others: Any,
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return vehicles side by side in one compiled batch.

    Args:
        num_envs: number of vehicles.
        seed: of all rides.
        task: name of the task.
        vehicle: name or file of the vehicles.
        circuits: of races.
        others: options of Gymnasium, of which a batch has none.

    Raises:
        ValueError: an option that a batch does not have.
    """
    from dataclasses import replace

    from bike_sim.sim.batch import COMPILED_ENGINE
    from bike_sim.vehicles.files import load_vehicle
    from bike_training.envs.env import config_of, episodes_of, task_of
    from bike_training.envs.vec_env import BatchVecEnv, BatchVectorEnv
    from bike_training.tasks.race import RaceTask

    ridden = task_of(task)
    check_options(others, ridden.max_steps)
    config = config_of(ridden, vehicle)
    if not isinstance(ridden, RaceTask):
        config = replace(config, engine=COMPILED_ENGINE, time_step=0.01)
    episodes = episodes_of(ridden, load_vehicle(config.vehicle), circuits)
    return BatchVectorEnv(BatchVecEnv(num_envs, ridden, episodes, config, seed))


def check_options(others: dict[str, Any], max_steps: int) -> None:
    """Refuse options of Gymnasium that a batch does not have.

    Args:
        others: options by name.
        max_steps: decisions of an episode.

    Raises:
        ValueError: naming the option.
    """
    steps = others.pop("max_episode_steps", None)
    wrong = next(((name, value) for name, value in others.items() if value is not None), None)
    if wrong:
        raise ValueError(f"a batch of vehicles has no option {wrong[0]}={wrong[1]!r}")
    if steps not in (None, max_steps):
        raise ValueError(f"max_episode_steps={steps} must be {max_steps}, that of the task")


def register() -> None:
    """Register the ids, unless they are. Gymnasium 1 looks for no plug-ins, so an import has to do it."""
    tasks = "bike_training.benchmark.tasks"
    own = ("bike_training.envs.env:BikeEnv", "bike_training.gymnasium_ids:make_vector")
    frozen = (f"{tasks}:make_env", f"{tasks}:make_vector")
    rows = [(name, steps, own, {"task": task}) for name, (task, steps) in IDS.items()]
    rows += [(name, steps, frozen, {"name": name}) for name, steps in BENCHMARK_STEPS.items()]
    for name, steps, (single, vector), arguments in rows:
        if name not in gym.registry:
            gym.register(name, entry_point=single, vector_entry_point=vector, max_episode_steps=steps, kwargs=arguments)


register()
