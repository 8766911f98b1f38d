"""The learners: Stable-Baselines3's SAC, its JAX sibling, PPO and A2C, mirrored replay, and the actor of each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv

from bike_policy.contract.bundle import Actor
from bike_training.learning.presets import SacSettings
from bike_training.tasks.base import Task


class MirrorReplayBuffer(ReplayBuffer):
    """Replay buffer that mirrors a random half of each sample left to right.

    Vehicle and task are mirror-symmetric, so a mirrored transition is as true as the one that happened.
    """

    def __init__(
        self,
        *args: Any,
        mirror_signs: NDArray[np.float32],
        mirror_places: NDArray[np.intp],
        action_signs: NDArray[np.float32],
        **kwargs: Any,
    ) -> None:
        """Take what turns columns into mirrored ones, beside the usual arguments.

        Args:
            *args: of `ReplayBuffer`.
            mirror_signs: signs of the observation's columns.
            mirror_places: which column each of them is taken from before, as the right limit for the left one.
            action_signs: signs of the action's columns; throttle keeps its own.
            **kwargs: of `ReplayBuffer`.
        """
        super().__init__(*args, **kwargs)
        self.mirror_signs = torch.as_tensor(mirror_signs)
        self.mirror_places = torch.as_tensor(mirror_places)
        self.action_signs = torch.as_tensor(action_signs)

    def _get_samples(self, batch_inds: NDArray[np.int64], env: Any = None) -> ReplayBufferSamples:
        data = super()._get_samples(batch_inds, env)
        flipped = torch.as_tensor(np.flatnonzero(np.random.random(len(batch_inds)) < 0.5))
        for observations in (data.observations, data.next_observations):  # copies of what the buffer holds
            taken = observations.index_select(0, flipped).index_select(1, self.mirror_places)
            observations.index_copy_(0, flipped, taken * self.mirror_signs)
        data.actions[flipped] *= self.action_signs
        return data


ON_POLICY: Final[Mapping[str, tuple[type[BaseAlgorithm], int]]] = {"ppo": (PPO, 2048), "a2c": (A2C, 5)}
"""Learners without a replay buffer, with the steps between two updates of Stable-Baselines3: of all vehicles of PPO, of
each of A2C."""


class BoundedPolicy(ActorCriticPolicy):
    """Policy of PPO and A2C whose mean action passes through tanh, as that of a deployed actor."""

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net: torch.nn.Module = torch.nn.Sequential(self.action_net, torch.nn.Tanh())


def build_model(
    algorithm: SacSettings, task: Task, env: VecEnv, seed: int, start: Actor | None = None
) -> BaseAlgorithm:
    """Make a learner.

    Args:
        algorithm: its settings.
        task: task to learn.
        env: vector environment.
        seed: seed of networks and samples.
        start: actor that it begins with and stays near (sbx only).

    Raises:
        ValueError: a setting that this learner or this task has not.
    """
    if algorithm.precondition and algorithm.learner != "sbx":
        raise ValueError(f"setting learner.precondition=True needs the learner sbx, not {algorithm.learner}")
    first, last = algorithm.learning_rate, algorithm.final_learning_rate

    def rate(remaining: float) -> float:
        return last + (first - last) * remaining

    torch.set_num_threads(1)  # samples are small: more threads wait for each other, and for programs beside them
    if algorithm.learner in ON_POLICY:
        kind, steps = ON_POLICY[algorithm.learner]
        steps = max(steps // env.num_envs, 1) if kind is PPO else steps
        form = {"net_arch": list(algorithm.layers), "activation_fn": torch.nn.ReLU}
        own: dict[str, Any] = {"learning_rate": rate, "n_steps": steps, "gamma": algorithm.gamma, "seed": seed}
        return kind(BoundedPolicy, env, device="cpu", policy_kwargs=form, **own)
    buffer: dict[str, Any] = {}
    if algorithm.mirror:
        buffer = {
            "replay_buffer_class": MirrorReplayBuffer,
            "replay_buffer_kwargs": {
                "mirror_signs": task.layout.mirror_signs,
                "mirror_places": task.layout.mirror_places,
                "action_signs": task.action.mirror_signs,
            },
        }
    # One update a step is SB3's own pace; with many bicycles a step counts for all of them.
    common: dict[str, Any] = {
        "learning_rate": rate,
        "buffer_size": algorithm.buffer_size,
        "learning_starts": algorithm.learning_starts,
        "batch_size": algorithm.batch_size,
        "tau": algorithm.tau,
        "gamma": algorithm.gamma,
        "train_freq": 1,
        "gradient_steps": algorithm.updates,
        "target_entropy": algorithm.target_entropy,
        "ent_coef": f"auto_{algorithm.temperature}",
        "policy_kwargs": {"net_arch": list(algorithm.layers)},
        "seed": seed,
        **buffer,
    }
    if algorithm.learner == "sb3":
        return SAC("MlpPolicy", env, device="cpu", **common)
    from sbx import SAC as JaxSAC

    from bike_training.learning.preconditioning import networks

    common["policy_kwargs"]["layer_norm"] = algorithm.layer_norm
    if algorithm.precondition:
        common["policy_kwargs"] |= networks(task.layout, task.action)
    if start is None:
        return JaxSAC("MlpPolicy", env, policy_delay=algorithm.policy_delay, **common)
    from bike_training.learning.anchored import anchored_to

    model = anchored_to(start, algorithm.anchor)("MlpPolicy", env, policy_delay=algorithm.policy_delay, **common)
    model.critic_steps = algorithm.critic_steps
    model.begin_as(start)
    return model


def actor_tensors(model: BaseAlgorithm) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
    """Return weights (outputs, inputs) and biases of the mean action's network, layer by layer."""
    if isinstance(model, SAC | A2C | PPO):
        if isinstance(model, SAC):
            parts = [*model.actor.latent_pi, model.actor.mu]
        else:
            parts = [*model.policy.mlp_extractor.policy_net, *model.policy.action_net]
        layers = [part for part in parts if isinstance(part, torch.nn.Linear)]
        return (
            [layer.weight.detach().numpy().copy() for layer in layers],
            [layer.bias.detach().numpy().copy() for layer in layers],
        )
    dense = model.policy.actor_state.params["params"]  # type: ignore[union-attr]
    # The last two layers are heads on the same hidden layer: mean, then log standard deviation.
    names = sorted(dense, key=lambda name: int(name.split("_")[1]))[:-1]
    from bike_training.learning.preconditioning import taken_in

    kernels = [np.asarray(dense[name]["kernel"]).T.copy() for name in names]
    return (
        [taken_in(kernels[0], model.policy.actor), *kernels[1:]],  # type: ignore[union-attr]
        [np.asarray(dense[name]["bias"]).copy() for name in names],
    )


class AveragedActor:
    """Exponential moving average of the actor's weights, which wanders less than the actor itself.

    The average is bias-corrected, so it is the actor itself at the start.
    """

    def __init__(self, keep: float) -> None:
        """Average with a share `keep` of the old value in each update."""
        self.keep = keep
        self.weights: list[NDArray[np.float32]] = []
        self.biases: list[NDArray[np.float32]] = []
        self.count = 0

    def update(self, model: BaseAlgorithm, times: int = 1) -> None:
        """Take in the present weights as if they had been seen a number of times."""
        weights, biases = actor_tensors(model)
        self.count += times
        if not self.weights:
            self.weights, self.biases = weights, biases
            return
        # Early on the plain mean of all weights so far, later an exponential window.
        keep = min(self.keep**times, 1.0 - times / self.count)
        for mean, new in zip(self.weights + self.biases, weights + biases, strict=True):
            mean *= keep
            mean += (1.0 - keep) * new

    def state_dict(self) -> dict[str, Any]:
        """Return all that :meth:`restore` needs, as plain values and arrays."""
        return {"keep": self.keep, "count": self.count, "weights": self.weights, "biases": self.biases}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Go on from where :meth:`state_dict` was taken."""
        self.keep, self.count = stored["keep"], stored["count"]
        self.weights, self.biases = (
            [np.array(part, dtype=np.float32) for part in stored[name]] for name in ("weights", "biases")
        )

    def actor(self) -> Actor:
        """Return the averaged actor as it is now; later updates leave it alone."""
        return Actor([part.copy() for part in self.weights], [part.copy() for part in self.biases])
