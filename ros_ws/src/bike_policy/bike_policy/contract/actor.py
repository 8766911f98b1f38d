"""The actor: a small fully connected network that returns the mean action, in numpy."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]

MAX_WEIGHT: Final = 1e6
"""Largest magnitude of a weight or bias: far above any that learning gives, and far below what overflows in a layer."""


class Actor:
    """Deterministic SAC actor: ReLU layers and tanh of the mean (Haarnoja et al. 2018).

    numpy answers one observation about as fast as ONNX Runtime and needs nothing else at run time.
    """

    def __init__(self, weights: Sequence[Float32Array], biases: Sequence[Float32Array]) -> None:
        """Take the layers in order.

        Args:
            weights: matrices of shape (outputs, inputs).
            biases: vectors of shape (outputs,).

        Raises:
            ValueError: shapes that do not chain, or values that are not finite or beyond MAX_WEIGHT.
        """
        if not weights or len(weights) != len(biases):
            raise ValueError(f"actor has {len(weights)} weight matrices and {len(biases)} bias vectors")
        for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            if weight.ndim != 2 or bias.shape != (weight.shape[0],):
                raise ValueError(f"actor layer {i}: weight {weight.shape} does not fit bias {bias.shape}")
            if i and weight.shape[1] != weights[i - 1].shape[0]:
                raise ValueError(
                    f"actor layer {i} takes {weight.shape[1]} inputs, layer {i - 1} gives {weights[i - 1].shape[0]}"
                )
            if not (np.all(np.isfinite(weight)) and np.all(np.isfinite(bias))):
                raise ValueError(f"actor layer {i} holds values that are not finite")
            largest = float(max(np.abs(weight).max(initial=0.0), np.abs(bias).max(initial=0.0)))
            if largest > MAX_WEIGHT:
                raise ValueError(f"actor layer {i} holds a weight of {largest:.3g}, beyond {MAX_WEIGHT:g}")
        self.weights = [np.ascontiguousarray(w.T, dtype=np.float32) for w in weights]
        self.biases = [np.ascontiguousarray(b, dtype=np.float32) for b in biases]

    @property
    def inputs(self) -> int:
        """Numbers in an observation."""
        return int(self.weights[0].shape[0])

    @property
    def outputs(self) -> int:
        """Numbers in an action."""
        return int(self.weights[-1].shape[1])

    def act_batch(self, observations: Float32Array) -> Float32Array:
        """Return the actions of a batch.

        Args:
            observations: shape (n, inputs).

        Returns:
            Actions in [-1, 1], shape (n, outputs).
        """
        hidden = observations
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = np.maximum(hidden @ weight + bias, 0.0)
        return np.tanh(hidden @ self.weights[-1] + self.biases[-1])

    def act(self, observation: Float32Array) -> Float32Array:
        """Return the action in [-1, 1], shape (outputs,), for one observation of shape (inputs,).

        Raises:
            ValueError: a wrong size or a value that is not finite.
        """
        if observation.shape != (self.inputs,):
            raise ValueError(f"observation has shape {observation.shape}, the actor takes ({self.inputs},)")
        action = self.act_batch(observation[None, :])[0]
        if not np.isfinite(action).all():
            raise ValueError("observation holds a value that is not finite")
        return action

    def digest(self) -> bytes:
        """Return a hash over all layers."""
        digest = hashlib.sha256()
        for name, values in self.tensors().items():
            digest.update(f"{name} {values.shape}".encode())
            digest.update(values.tobytes())
        return digest.digest()

    def tensors(self) -> dict[str, Float32Array]:
        """Return the layers under the names that a bundle stores."""
        named: dict[str, Float32Array] = {}
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            named[f"layers.{i}.weight"] = np.ascontiguousarray(weight.T)
            named[f"layers.{i}.bias"] = bias
        return named

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Float32Array]) -> Actor:
        """Build an actor from named layers.

        Raises:
            ValueError: names that are not ``layers.<i>.weight`` and ``layers.<i>.bias`` without gaps.
        """
        count = len(tensors) // 2
        expected = {f"layers.{i}.{part}" for i in range(count) for part in ("weight", "bias")}
        if not tensors or set(tensors) != expected:
            raise ValueError(
                f"not an actor of this project: tensors {sorted(tensors)[:6]}, expected layers.0.weight, ..."
            )
        weights = [tensors[f"layers.{i}.weight"] for i in range(count)]
        return cls(weights, [tensors[f"layers.{i}.bias"] for i in range(count)])
