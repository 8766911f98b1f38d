"""A network ridden as the odd part of itself: a mirrored observation gives the mirrored command.

So it rides a straight without an offset.
"""

from __future__ import annotations

import math
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

from bike_policy.contract.actor import Actor
from bike_policy.contract.observation import ObservationLayout

Weights = list[tuple[jax.Array, jax.Array]]
"""Kernel (inputs, outputs) and bias of each layer."""


class MirrorSymmetricActor:
    """A network ridden as the odd part of itself about the mirror of its observations."""

    def __init__(self, layout: ObservationLayout, reach: float = 1.0) -> None:
        """Take the layout that says how observations are mirrored, and the command of the largest answer."""
        self._signs = layout.mirror_signs
        self._inputs = layout.size
        self._reach = reach

    def draw(self, layers: tuple[int, ...], seed: int) -> Weights:
        """Return weights of a new network, whose commands are small."""
        key, weights = jax.random.PRNGKey(seed), []
        sizes = (self._inputs, *layers, 1)
        for place, (inputs, outputs) in enumerate(pairwise(sizes)):
            key, drawn = jax.random.split(key)
            gain = 0.01 if place == len(layers) else 1.0
            kernel = jax.random.normal(drawn, (inputs, outputs)) * (gain * math.sqrt(2.0 / inputs))
            weights.append((kernel, jnp.zeros(outputs)))
        return weights

    def take(self, actor: Actor, reach: float = 1.0) -> Weights:
        """Return the weights of an actor, whose small commands stay the same.

        Args:
            actor: taken.
            reach: command of its largest answer.

        Raises:
            ValueError: it sees something else, or answers more than a set point.
        """
        if (actor.inputs, actor.outputs) != (self._inputs, 1):
            raise ValueError(
                f"an actor of {actor.inputs} inputs and {actor.outputs} outputs cannot begin a refinement that sees "
                f"{self._inputs} numbers and steers"
            )
        whole = [(jnp.asarray(w), jnp.asarray(b)) for w, b in zip(actor.weights, actor.biases, strict=True)]
        half = self._unfolded(whole)
        again = self.folded(half).tensors()
        # One that was learned like this is taken as what it was folded from, lest it grow twice as wide.
        taken = half if all(np.array_equal(again[name], old) for name, old in actor.tensors().items()) else whole
        kernel, bias = taken[-1]
        return [*taken[:-1], (kernel * (reach / self._reach), bias * (reach / self._reach))]

    @staticmethod
    def _unfolded(weights: Weights) -> Weights:
        """Return what :meth:`folded` made weights of, if it did."""
        last = len(weights) - 1
        found = []
        for place, (kernel, bias) in enumerate(weights):
            rows = kernel.shape[0] // (1 if place == 0 else 2)
            columns = kernel.shape[1] // (1 if place == last else 2)
            scale = 2.0 if place == last else 1.0
            found.append((scale * kernel[:rows, :columns], bias[:columns]))
        return found

    def act(self, weights: Weights, seen: jax.Array) -> jax.Array:
        """Return commands, at most the reach, for observations of shape (..., inputs)."""
        return self._reach * jnp.tanh(0.5 * (_network(weights, seen) - _network(weights, seen * self._signs)))

    def folded(self, weights: Weights) -> Actor:
        """Return the same as one network, of layers twice as wide."""
        kernels, biases = [], []
        for place, (kernel, bias) in enumerate((np.asarray(k), np.asarray(b)) for k, b in weights):
            none = np.zeros_like(kernel)
            if place == 0:
                kernel = np.hstack([kernel, self._signs[:, None] * kernel])
            elif place < len(weights) - 1:
                kernel = np.block([[kernel, none], [none, kernel]])
            if place < len(weights) - 1:
                kernels.append(kernel.T)
                biases.append(np.concatenate([bias, bias]))
            else:
                kernels.append(0.5 * np.vstack([kernel, -kernel]).T)
                biases.append(np.zeros_like(bias))
        return Actor([k.astype(np.float32) for k in kernels], [b.astype(np.float32) for b in biases])


def _network(weights: Weights, hidden: jax.Array) -> jax.Array:
    for kernel, bias in weights[:-1]:
        hidden = jax.nn.relu(hidden @ kernel + bias)
    return (hidden @ weights[-1][0] + weights[-1][1])[..., 0]
