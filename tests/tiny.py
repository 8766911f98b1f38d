"""A training on the compiled engine with a network that learns in no time."""

from typing import Any

TINY: dict[str, Any] = {
    "learner": "sb3",
    "learner.layers": [8],
    "learner.batch_size": 16,
    "learner.buffer_size": 2000,
    "learner.learning_starts": 20,
    "learner.environments": 2,
    "learner.updates": 1,
    "curriculum.validate_every": 40,
}
