"""Networks of actors in JAX, for learners that differentiate them: kernels and biases of ReLU layers."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from bike_policy.contract.bundle import Actor

Weights = list[tuple[jax.Array, jax.Array]]
"""Kernel (inputs, outputs) and bias of each layer."""


def forward(weights: Weights, seen: jax.Array) -> jax.Array:
    """Return the answers before tanh for observations of shape (..., inputs), shape (..., outputs)."""
    for kernel, bias in weights[:-1]:
        seen = jax.nn.relu(seen @ kernel + bias)
    return seen @ weights[-1][0] + weights[-1][1]


def weights_of(actor: Actor) -> Weights:
    """Return the weights of an actor."""
    return [(jnp.asarray(w), jnp.asarray(b)) for w, b in zip(actor.weights, actor.biases, strict=True)]


def actor_of(weights: Weights) -> Actor:
    """Return the actor of weights."""
    return Actor([np.array(kernel).T.copy() for kernel, _ in weights], [np.array(bias) for _, bias in weights])
