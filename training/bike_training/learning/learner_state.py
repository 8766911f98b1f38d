"""The state of a learner as plain values and arrays: networks, optimisers, counters and random generators.

Nothing here is pickled. A learner is made anew from its settings and then takes the stored numbers over, by name.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

_COUNTERS: Final = (
    "num_timesteps",
    "_total_timesteps",
    "_num_timesteps_at_start",
    "_episode_num",
    "_n_updates",
    "_current_progress_remaining",
)
"""What Stable-Baselines3 counts while it learns."""

_TRAIN_STATES: Final = ("policy.actor_state", "policy.qf_state", "ent_coef_state")
_TRAIN_PARTS: Final = ("step", "params", "target_params", "opt_state")
_KEYS: Final = ("key", "policy.key", "policy.noise_key")
"""Where sbx keeps networks with their optimisers, and its random keys."""


def learner_state(model: OffPolicyAlgorithm) -> dict[str, Any]:
    """Return all that :func:`restore_learner` needs but the replay buffer, as plain values and arrays."""
    networks = _torch_arrays(model) if isinstance(model, SAC) else _jax_arrays(model)
    started = model._last_obs is not None
    return {
        "counters": {name: getattr(model, name) for name in _COUNTERS},
        "episodes": [dict(info) for info in model.ep_info_buffer or ()],
        "last_observations": np.array(model._last_obs) if started else None,
        "last_episode_starts": np.array(model._last_episode_starts) if started else None,
        "networks": networks,
        "generators": _generators(model),
    }


def restore_learner(model: OffPolicyAlgorithm, stored: dict[str, Any]) -> None:
    """Let a new learner of the same settings go on from a stored state, bit for bit.

    Args:
        model: the learner; its networks must have the stored shapes.
        stored: what :func:`learner_state` returned.

    Raises:
        ValueError: networks of other names or shapes.
        KeyError: an entry is missing.
    """
    for name in _COUNTERS:
        setattr(model, name, stored["counters"][name])
    model.ep_info_buffer = deque(stored["episodes"], maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)  # no task here tells of success
    model._last_obs = stored["last_observations"]
    model._last_episode_starts = stored["last_episode_starts"]
    if isinstance(model, SAC):
        _restore_torch(model, stored["networks"])
    else:
        _restore_jax(model, stored["networks"])
    _restore_generators(model, stored["generators"])  # last: making a learner draws


def _generators(model: OffPolicyAlgorithm) -> dict[str, Any]:
    version, words, gauss = random.getstate()
    return {
        "python": {"version": version, "words": np.array(words, dtype=np.uint64), "gauss": gauss},
        "numpy": np.random.get_state(legacy=False),
        "torch": torch.get_rng_state().numpy(),
        "action_space": model.action_space.np_random.bit_generator.state,
    }


def _restore_generators(model: OffPolicyAlgorithm, stored: dict[str, Any]) -> None:
    python = stored["python"]
    random.setstate((python["version"], tuple(python["words"].tolist()), python["gauss"]))
    np.random.set_state(stored["numpy"])
    torch.set_rng_state(torch.from_numpy(stored["torch"]))
    model.action_space.np_random.bit_generator.state = stored["action_space"]


def _torch_modules(model: SAC) -> dict[str, Any]:
    """Return what holds tensors, by name; the policy holds actor, critics and their targets."""
    found: dict[str, Any] = {
        "policy": model.policy,
        "actor.optimizer": model.actor.optimizer,
        "critic.optimizer": model.critic.optimizer,
    }
    if model.ent_coef_optimizer is not None:
        found["ent_coef.optimizer"] = model.ent_coef_optimizer
    return found


def _torch_tensors(model: SAC) -> Iterator[tuple[str, torch.Tensor]]:
    for name, module in _torch_modules(model).items():
        if isinstance(module, torch.optim.Optimizer):
            for number, moments in module.state_dict()["state"].items():
                yield from ((f"{name}/{number}/{key}", value) for key, value in moments.items())
        else:
            yield from ((f"{name}/{key}", value) for key, value in module.state_dict().items())
    if model.log_ent_coef is not None:
        yield "log_ent_coef", model.log_ent_coef


def _torch_arrays(model: SAC) -> dict[str, NDArray[Any]]:
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in _torch_tensors(model)}


def _restore_torch(model: SAC, stored: dict[str, NDArray[Any]]) -> None:
    tensors = {name: torch.from_numpy(np.array(array)) for name, array in stored.items()}
    for name, module in _torch_modules(model).items():
        own = {key.removeprefix(f"{name}/"): value for key, value in tensors.items() if key.startswith(f"{name}/")}
        if not isinstance(module, torch.optim.Optimizer):
            _check_shapes(name, {key: value.shape for key, value in module.state_dict().items()}, own)
            module.load_state_dict(own)
            continue
        state: dict[int, dict[str, torch.Tensor]] = {}
        for key, value in own.items():
            number, _, moment = key.partition("/")
            state.setdefault(int(number), {})[moment] = value
        # The groups hold settings only, which the new learner has already.
        module.load_state_dict({"state": state, "param_groups": module.state_dict()["param_groups"]})
    if model.log_ent_coef is not None:
        model.log_ent_coef.data = tensors["log_ent_coef"]


def _check_shapes(name: str, wanted: dict[str, Any], stored: dict[str, Any]) -> None:
    """Refuse networks of another kind before anything is changed.

    Raises:
        ValueError: naming the first difference.
    """
    if set(wanted) != set(stored):
        raise ValueError(f"{name} has other parts: {sorted(set(wanted) ^ set(stored))[:3]}")
    for key, shape in wanted.items():
        if tuple(shape) != tuple(stored[key].shape):
            raise ValueError(f"{name}/{key} has shape {tuple(stored[key].shape)}, the learner needs {tuple(shape)}")


def _jax_leaves(model: Any, place: str) -> tuple[dict[str, Any], Any]:
    """Return the numbers of one network with its optimiser by stable path names, and how they fit together."""
    import jax

    state = _attribute(model, place)
    parts = {part: getattr(state, part) for part in _TRAIN_PARTS if hasattr(state, part)}
    leaves, tree = jax.tree_util.tree_flatten_with_path(parts)
    return {f"{place}{jax.tree_util.keystr(path)}": leaf for path, leaf in leaves}, tree


def _jax_arrays(model: Any) -> dict[str, NDArray[Any]]:
    found = {key: np.array(_attribute(model, key)) for key in _KEYS}
    for place in _TRAIN_STATES:
        found.update({name: np.array(leaf) for name, leaf in _jax_leaves(model, place)[0].items()})
    return found


def _restore_jax(model: Any, stored: dict[str, NDArray[Any]]) -> None:
    import jax
    import jax.numpy as jnp

    for place in _TRAIN_STATES:
        leaves, tree = _jax_leaves(model, place)
        own = {key: value for key, value in stored.items() if key.startswith((f"{place}[", f"{place}."))}
        _check_shapes(place, {key: np.shape(leaf) for key, leaf in leaves.items()}, own)
        parts = jax.tree_util.tree_unflatten(
            tree, [jnp.asarray(own[key], dtype=jnp.asarray(leaf).dtype) for key, leaf in leaves.items()]
        )
        _set_attribute(model, place, _attribute(model, place).replace(**parts))
    for key in _KEYS:
        _set_attribute(model, key, jnp.asarray(stored[key]))


def _attribute(model: Any, place: str) -> Any:
    holder, _, name = place.rpartition(".")
    return getattr(getattr(model, holder) if holder else model, name)


def _set_attribute(model: Any, place: str, value: Any) -> None:
    holder, _, name = place.rpartition(".")
    setattr(getattr(model, holder) if holder else model, name, value)
