"""Soft actor-critic that begins with an actor and stays near it.

Critics know nothing at the beginning, and an actor that follows them forgets what it could. So critics learn alone
first, on rides of the actor as it is, and later the distance of its mean action from that of the first actor costs:
regularisation towards a policy that was learned from demonstrations, as in Fujimoto and Gu (2021) towards the data.
"""

from __future__ import annotations

import math
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from sbx import SAC

from bike_policy.contract.bundle import Actor
from bike_training.learning.networks import forward, weights_of
from bike_training.learning.preconditioning import given_out

UNIT_ENTROPY: Final = 0.5 * math.log(2.0 * math.pi * math.e)
"""Entropy of a normal distribution whose standard deviation is 1, nat."""
_NEVER: Final = 10**9


class AnchoredSAC(SAC):
    """SAC of sbx whose actor begins as another one; see `anchored_to`."""

    critic_steps: int = 0
    policy_delay: int
    target_entropy: float
    _n_updates: int

    def begin_as(self, actor: Actor) -> None:
        """Take over the weights of an actor, which takes observations as they are, with noise of the target entropy.

        Raises:
            ValueError: it has other layers.
        """
        params = jax.tree.map(lambda part: part, self.policy.actor_state.params)
        dense = params["params"]
        names = sorted(dense, key=lambda name: int(name.split("_")[1]))
        shapes = [dense[name]["kernel"].shape for name in names[:-1]]
        if [weights.shape for weights in actor.weights] != shapes:
            raise ValueError(f"an actor with layers {[w.shape for w in actor.weights]} cannot begin one of {shapes}")
        for name, (kernel, bias) in zip(names, weights_of(actor), strict=False):
            dense[name] = {"kernel": kernel, "bias": bias}
        dense[names[0]]["kernel"] = jnp.asarray(given_out(dense[names[0]]["kernel"], self.policy.actor))
        noise = dense[names[-1]]
        spread = jnp.full_like(noise["bias"], self.target_entropy / len(noise["bias"]) - UNIT_ENTROPY)
        dense[names[-1]] = {"kernel": jnp.zeros_like(noise["kernel"]), "bias": spread}
        self.policy.actor_state = self.policy.actor_state.replace(params=params)

    def train(self, gradient_steps: int, batch_size: int) -> None:
        """Update; the critics alone in the first `critic_steps`."""
        if self.num_timesteps >= self.critic_steps:
            super().train(gradient_steps, batch_size)
            return
        # The actor's turn is counted from the updates so far; a count of none keeps the compiled update the same.
        delay, made, self.policy_delay, self._n_updates = self.policy_delay, self._n_updates, _NEVER, 0
        super().train(gradient_steps, batch_size)
        self.policy_delay, self._n_updates = delay, made + gradient_steps

    def _sample_action(self, learning_starts: int, *args: Any, **kwargs: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return actions of the actor, also before the first update."""
        return super()._sample_action(0, *args, **kwargs)


def anchored_to(actor: Actor, weight: float) -> type[AnchoredSAC]:
    """Return a learner whose actor pays for its distance from another one.

    Args:
        actor: the other one.
        weight: of the squared distance of the mean actions, in units of reward.
    """
    layers = weights_of(actor)

    class Anchored(AnchoredSAC):
        @staticmethod
        @jax.jit
        def update_actor(actor_state: Any, qf_state: Any, ent_coef_state: Any, observations: Any, key: Any) -> Any:
            key, dropout_key, noise_key = jax.random.split(key, 3)
            wanted = jnp.tanh(forward(layers, observations))

            def actor_loss(params: Any) -> tuple[jax.Array, jax.Array]:
                dist = actor_state.apply_fn(params, observations)
                actions = dist.sample(seed=noise_key)
                log_prob = dist.log_prob(actions).reshape(-1, 1)
                values = qf_state.apply_fn(qf_state.params, observations, actions, rngs={"dropout": dropout_key})
                entropy = ent_coef_state.apply_fn({"params": ent_coef_state.params})
                away = jnp.sum((dist.mode() - wanted) ** 2, axis=1, keepdims=True)
                return (entropy * log_prob - jnp.min(values, axis=0) + weight * away).mean(), -log_prob.mean()

            (loss, entropy), grads = jax.value_and_grad(actor_loss, has_aux=True)(actor_state.params)
            return actor_state.apply_gradients(grads=grads), qf_state, loss, key, entropy

    return Anchored
