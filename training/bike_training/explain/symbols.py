"""Readable names of what a policy sees, for pictures."""

from __future__ import annotations

from typing import Final

SYMBOLS: Final = {
    "roll": "roll φ",
    "steer": "steer δ",
    "roll_rate": "roll rate dφ/dt",
    "steer_rate": "steer rate dδ/dt",
    "rear_wheel": "rear wheel angle",
    "front_wheel": "front wheel angle",
    "front_wheel_rate": "front wheel rate",
    "yaw_cos": "cos ψ",
    "yaw_sin": "sin ψ",
}
"""Readable names of features."""
