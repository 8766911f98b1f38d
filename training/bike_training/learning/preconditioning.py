"""Networks that see an observation in other coordinates.

The paper's observation holds roll angles of a tenth beside wheel angles of hundreds, and preview points of metres whose
second differences of centimetres say how the path bends. Networks whose weights all learn at one pace first learn of
what is large. The change of coordinates is linear, fixed and invertible, so it shows and hides nothing; it belongs to
the networks, and the actor that is deployed has it in its first layer and takes the observation as it is.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import flax.linen as nn
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from sbx.common.policies import SquashedGaussianActor, VectorCritic

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.observation import LEAN_LAYOUT, TURN_LAYOUT, ObservationLayout
from bike_sim.schema import GRAVITY

_SIZES: Final = {
    "x": 100.0,
    "y": 100.0,
    "yaw": 3.0,
    "yaw_wrapped": 3.0,
    "roll": 0.5,
    "steer": 0.5,
    "rear_wheel": 300.0,
    "front_wheel": 300.0,
    "steer_rate": 2.0,
    "front_wheel_rate": 10.0,
    "speed": 4.0,
}
"""Typical sizes of features that are not of order one in SI units, in rides of a minute at 2 to 7 m/s."""

Matrix = tuple[tuple[float, ...], ...]


def coordinates(layout: ObservationLayout) -> NDArray[np.float32]:
    """Return the matrix that an observation, as a row, is multiplied by, shape (layout size, layout size).

    Raises:
        ValueError: it is not the observation of a path task.
    """
    if layout.races:
        raise ValueError("setting learner.precondition=True is for tasks on paths")
    first = layout.size - layout.preview_count
    sizes = [abs(gain) * _SIZES.get(name, 1.0) for name, gain in zip(layout.names, layout.gains, strict=True)]
    matrix = np.diag([1.0 / size for size in sizes[:first]] + [1.0] * layout.preview_count)
    if layout.terms in _IN_LEANS:
        return _lean_coordinates(layout).astype(np.float32)
    if "preview_points" in layout.terms:
        matrix[first:, first:] = _differences(layout).T / layout.gains[first]
    return matrix.astype(np.float32)


def _differences(layout: ObservationLayout) -> NDArray[np.float64]:
    """Return what turns preview points (m) into the offset, the first difference and the second ones.

    By time they are a lateral velocity (m/s) and tangents of the lean that the path asks for, as ``preview_lean`` is.
    """
    count, step = layout.preview_count, layout.preview_interval
    matrix = np.eye(count)
    once, twice = (step, GRAVITY * step**2) if layout.preview_by_time else (step, 1.0)
    if count > 1:
        matrix[1, :2] = np.array([-1.0, 1.0]) / once
    for row in range(2, count):
        matrix[row, row - 2 : row + 1] = np.array([1.0, -2.0, 1.0]) / twice
    return matrix


_IN_LEANS: Final = (LEAN_LAYOUT.terms, TURN_LAYOUT.terms)
"""Terms of layouts whose preview is in leans."""
_LEAN_SIZES: Final = {"roll": 0.1, "steer": 0.1, "roll_rate": 0.3, "steer_rate": 0.5, "front_wheel_rate": 10.0}
"""Sizes of the deviations from a line by which an exact actor steers: rad, rad/s."""
_OFFSET: Final = 0.1
"""The same of the distance from the line, m."""
_LATERAL_VELOCITY: Final = 0.3
"""The same, m/s."""
_LEAN: Final = 0.3
"""Size of a tangent of lean along a line."""
_NEXT_LEANS: Final = slice(2, 5)
"""Preview places of the leans that the roll is compared with."""
_SET_POINT: Final = 0.1
"""Size of the difference of a set point and the steering angle, rad: it is what the drive acts by."""


def _lean_coordinates(layout: ObservationLayout) -> NDArray[np.float64]:
    """Return the coordinates of a layout whose preview is in leans; the roll is taken from the lean asked next."""
    first = layout.size - layout.preview_count
    sizes = [gain * _LEAN_SIZES[name] for name, gain in zip(layout.names[:first], layout.gains, strict=False)]
    leans = [_OFFSET, _LATERAL_VELOCITY, *[_LEAN] * (layout.preview_count - 2)]
    matrix = np.diag(1.0 / np.array(sizes + leans))
    asked = np.arange(first, layout.size)[_NEXT_LEANS]
    # A turn to the left bends with a positive lean and a negative roll.
    roll = layout.names.index("roll")
    matrix[asked, roll] = 1.0 / (len(asked) * _LEAN_SIZES["roll"])
    return matrix


class PreconditionedActor(SquashedGaussianActor):
    """Actor of sbx that sees its inputs in other coordinates.

    Attributes:
        matrix: that inputs, as rows, are multiplied by.
    """

    matrix: Matrix = ()

    def __call__(self, x: jnp.ndarray) -> Any:
        """Return the distribution of actions."""
        return super().__call__(x @ jnp.asarray(self.matrix))


class PreconditionedCritics(VectorCritic):
    """Critics of sbx that see observations and actions in other coordinates.

    Attributes:
        matrix: that observations, as rows, are multiplied by.
        action_gain: factor of actions.
        action_origin: that observations, as rows, are multiplied by and that is taken from actions; empty for nothing.
    """

    matrix: Matrix = ()
    action_gain: float = 1.0
    action_origin: tuple[float, ...] = ()

    def __call__(self, obs: jnp.ndarray, action: jnp.ndarray) -> Any:
        """Return the values of observations and actions."""
        if self.action_origin:
            action = self.action_gain * action - (obs @ jnp.asarray(self.action_origin))[:, None]
        return super().__call__(obs @ jnp.asarray(self.matrix), action)


def networks(layout: ObservationLayout, action: ActionLayout) -> dict[str, Any]:
    """Return arguments of sbx's policy for networks that see an observation in coordinates of order one.

    Args:
        layout: of the observation.
        action: of the task.

    Raises:
        ValueError: it is not the observation of a path task.
    """
    matrix = tuple(tuple(map(float, row)) for row in coordinates(layout))
    critics = partial(PreconditionedCritics, matrix=matrix)
    if layout.terms in _IN_LEANS:
        place = layout.names.index("steer")
        origin = [0.0] * layout.size
        origin[place] = float(1.0 / (layout.gains[place] * _SET_POINT))
        critics = partial(critics, action_gain=action.columns[0].scale / _SET_POINT, action_origin=tuple(origin))
    return {"actor_class": partial(PreconditionedActor, matrix=matrix), "vector_critic_class": critics}


def taken_in(kernel: NDArray[np.float32], actor: nn.Module) -> NDArray[np.float32]:
    """Return the weights (outputs, inputs) of an actor's first layer for observations as they are."""
    if not isinstance(actor, PreconditionedActor):
        return kernel
    return (kernel.astype(np.float64) @ np.asarray(actor.matrix).T).astype(np.float32)


def given_out(kernel: Any, actor: nn.Module) -> Any:
    """Return the kernel (inputs, outputs) of an actor's first layer in its coordinates; see `taken_in`."""
    if not isinstance(actor, PreconditionedActor):
        return kernel
    return np.linalg.solve(np.asarray(actor.matrix, dtype=np.float64), np.asarray(kernel)).astype(np.float32)
