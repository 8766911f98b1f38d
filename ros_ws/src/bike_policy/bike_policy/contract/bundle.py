"""Policies: the actor, a small fully connected network in numpy, and bundles of it on disk.

A policy bundle on disk: ``actor.safetensors`` and ``card.yaml``. No pickle is ever read.

The files are untrusted input: they must be regular files of limited size before anything is parsed, so that none makes
a reader wait or fills its memory.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save_file

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.observation import ObservationLayout
from bike_sim.documents import (
    MAX_YAML_SIZE,
    DocumentError,
    alternatives,
    check_name,
    decode,
    parse_yaml,
    read_bytes,
    shorten,
    show,
)

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


DEFAULT_POLICY: Final = "whipple"
"""The shipped policy that rides a bicycle."""
DEFAULT_RACER: Final = "adaptive"
"""The shipped policy that rides a superbike where no rider is named."""


FORMAT_VERSION: Final = 1
ACTOR_FILE: Final = "actor.safetensors"
CARD_FILE: Final = "card.yaml"
MAX_ACTOR_SIZE: Final = 64_000_000
"""Largest file of an actor, bytes: 16 million numbers; the shipped one has 19 thousand."""
LARGEST_HELD: Final = 1.0 - 1e-6
"""Largest action that a network can hold: its tanh never reaches 1."""
MAX_PERIOD: Final = 10.0
"""Longest control period, s."""
_CARD_ENTRIES: Final = ("format", "name", "vehicle", "control_period_s", "layout", "action", "training", "results")


@dataclass(frozen=True)
class Bundle:
    """An actor with everything that must be known to use it.

    Attributes:
        name: name of the bundle.
        actor: the network.
        layout: of its observation.
        action: layout of its action.
        vehicle: name of the vehicle it was trained on.
        control_period: s.
        training: record of it: commit, seed, steps, preset and so on.
        results: measured results with units in the names.
    """

    name: str
    actor: Actor
    layout: ObservationLayout
    action: ActionLayout
    vehicle: str
    control_period: float
    training: Mapping[str, Any] = field(default_factory=dict)
    results: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse an actor whose input or output is not that of the layouts."""
        if self.actor.inputs != self.layout.size:
            raise ValueError(
                f"policy {self.name!r}: the actor takes {self.actor.inputs} numbers, its layout {self.layout.size}"
            )
        if self.actor.outputs != self.action.size:
            raise ValueError(
                f"policy {self.name!r}: the actor answers {self.actor.outputs} numbers, its action has "
                f"{self.action.size}: {', '.join(self.action.names)}"
            )

    def holding(self, action: Sequence[float]) -> Bundle:
        """Return the policy that holds an action whatever it sees: what is left of this one without learning.

        Args:
            action: in [-1, 1], one number for each column.

        Raises:
            ValueError: another number of columns, or a value outside.
        """
        values = np.array(action, dtype=np.float64)
        if values.shape != (self.action.size,) or not (np.abs(values) <= 1.0).all():
            raise ValueError(
                f"an action of policy {self.name!r} has {self.action.size} numbers in [-1, 1] "
                f"({', '.join(self.action.names)}), got {', '.join(f'{value:g}' for value in values)}"
            )
        bias = np.arctanh(np.clip(values, -LARGEST_HELD, LARGEST_HELD)).astype(np.float32)
        actor = Actor([np.zeros((self.action.size, self.layout.size), dtype=np.float32)], [bias])
        return replace(self, name=f"{self.name} held", actor=actor)

    def check_fit(self, vehicle: str, control_period: float) -> None:
        """Check that a simulator is one that this policy was made for.

        A policy of races rides other superbikes as well: it is shown what each of them can do.

        Raises:
            ValueError: naming the difference.
        """
        if vehicle != self.vehicle and not self.layout.races:
            raise ValueError(
                f"policy {self.name!r} was trained for vehicle {self.vehicle!r}, the simulator rides {vehicle!r}"
            )
        if abs(control_period - self.control_period) > 1e-9:
            purpose = "races superbikes" if self.layout.races else f"rides {self.vehicle!r}"
            raise ValueError(
                f"policy {self.name!r} {purpose} at a control period of {self.control_period} s, "
                f"the simulator rides {vehicle!r} at {control_period} s"
            )

    def speed_warning(self, speed: float) -> str | None:
        """Return a warning where a speed (m/s) lies outside those that the policy was trained for, as its card says."""
        trained = self.training.get("speed_range_m_s")
        if not isinstance(trained, list) or len(trained) != 2 or trained[0] <= speed <= trained[1]:
            return None
        return f"policy {self.name!r} was trained for {trained[0]:g} to {trained[1]:g} m/s, {speed:g} m/s is outside"

    def save(self, folder: Path) -> None:
        """Write the bundle into a folder, which is made if need be."""
        folder.mkdir(parents=True, exist_ok=True)
        save_file(self.actor.tensors(), folder / ACTOR_FILE)
        (folder / ACTOR_FILE).chmod(0o644)  # safetensors makes it readable for its owner only
        card = {
            "format": FORMAT_VERSION,
            "name": self.name,
            "vehicle": self.vehicle,
            "control_period_s": self.control_period,
            "layout": self.layout.to_card(),
            "action": self.action.to_card(),
            "training": dict(self.training),
            "results": dict(self.results),
        }
        # Through JSON: YAML would use an alias for what stands there twice.
        text = yaml.safe_dump(json.loads(json.dumps(card)), sort_keys=False, width=100)
        (folder / CARD_FILE).write_text(text, encoding="utf-8")


def shipped_policies() -> list[str]:
    """Return the names of the bundles that come with this package."""
    root = resources.files("bike_policy") / "policies"
    return sorted(entry.name for entry in root.iterdir() if (entry / CARD_FILE).is_file())


def load_bundle(name_or_path: str | Path, others: Iterable[str] = ()) -> Bundle:
    """Load a shipped bundle by name, or any bundle by its folder.

    Args:
        name_or_path: name or folder.
        others: names of riders that are not learned, where those are possible as well, for the error.

    Raises:
        FileNotFoundError: there is no such bundle.
        ValueError: a file that is not one of this project's, or a version that this software does not speak.
    """
    folder = Path(name_or_path)
    if not os.path.isdir(folder):  # unlike Path.is_dir it answers for a name that is too long as well
        shipped = shipped_policies()
        if str(name_or_path) not in shipped:
            known = alternatives(str(name_or_path), (*shipped, *others))
            raise FileNotFoundError(f"no policy {show(str(name_or_path))}, and no folder of that name; {known}")
        folder = Path(str(resources.files("bike_policy") / "policies")) / str(name_or_path)
    card = _read(folder, CARD_FILE, MAX_YAML_SIZE, lambda data: parse_yaml(decode(data)))
    version = card.get("format") if isinstance(card, dict) else type(card).__name__
    if version != FORMAT_VERSION:
        raise ValueError(f"{folder}: policy format {show(version)}, this software reads format {FORMAT_VERSION}")
    missing = [entry for entry in _CARD_ENTRIES if entry not in card]
    if missing:
        raise ValueError(f"{folder}: the card lacks {missing}")
    tensors = _read(folder, ACTOR_FILE, MAX_ACTOR_SIZE, load)
    try:
        for entry in ("layout", "action", "training", "results"):
            if not isinstance(card[entry], dict):
                raise ValueError(f"{entry} of the card must be a mapping, got {show(card[entry])}")
        period = card["control_period_s"]
        if isinstance(period, bool) or not isinstance(period, int | float) or not 0.0 < period <= MAX_PERIOD:
            raise ValueError(
                "control_period_s of the card must be a number above 0 and at most "
                f"{MAX_PERIOD:g} s, got {show(period)}"
            )
        with np.errstate(over="ignore"):  # beyond single precision is infinite, and the actor refuses that
            actor = Actor.from_tensors({key: np.asarray(value, dtype=np.float32) for key, value in tensors.items()})
        return Bundle(
            check_name(card["name"], "name of the card"),
            actor,
            ObservationLayout.from_card(card["layout"]),
            ActionLayout.from_card(card["action"]),
            check_name(card["vehicle"], "vehicle of the card"),
            float(period),
            card["training"],
            card["results"],
        )
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{folder}: {shorten(str(error))}") from error


def _read(folder: Path, name: str, limit: int, parse: Callable[[bytes], Any]) -> Any:
    """Return what a file of a bundle holds; every error names the file."""
    try:
        return parse(read_bytes(folder / name, limit))
    except FileNotFoundError:
        raise FileNotFoundError(f"{folder} is not a policy bundle: it has no {name}") from None
    except DocumentError as error:
        raise ValueError(f"{folder / name} {error}") from None
    except (SafetensorError, KeyError, TypeError) as error:  # KeyError: a type of numbers that NumPy lacks
        raise ValueError(f"{folder / name}: not a safetensors file of an actor ({shorten(str(error))})") from None
