"""The ground under the wheels of a superbike during one control period: a record that compiled forces read.

Whoever knows the surroundings (`bike_sim.sim.ground` on a circuit) writes the record; the engines only read it. A wheel
stands on a patch: a second-order piece of surface around an origin below the wheel, with its grip. Bicycles roll
without slip on level ground and know none of this.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

PATCH_NAMES: Final = (
    "x", "y", "height", "cos", "sin", "grade", "bank", "crest", "grip", "drag", "bumps", "arc", "stretch",
)  # fmt: skip
"""Ground around one wheel.

x, y, height: origin, m, in the map. cos, sin: direction of the road there, seen from above. grade: rise per m along it.
bank: rise per m to its left. crest: change of the grade per m along it, 1/m, negative over a crest. grip: factor on
friction, 1 on a dry track. drag: rolling resistance by load beside the tyre's own. bumps: factor on the profile of
bumps. arc: place of the origin in that profile, m. stretch: how far it goes on in the profile per m along the road."""

PATCH: Final = np.dtype([(name, np.float64) for name in PATCH_NAMES])

GROUND: Final = np.dtype(
    [("rear", PATCH), ("front", PATCH), ("wind_x", np.float64), ("wind_y", np.float64), ("profile", np.int64)]
)
"""Patches under both wheels, the velocity of the air in the map (m/s), and which profile of bumps is theirs."""

BUMP_SPACING: Final = 0.1
"""Distance of the samples of a profile of bumps, m."""
BUMP_SAMPLES: Final = 8192
"""Samples of a profile, which repeats behind the last one."""


class Ground(NamedTuple):
    """Ground of a control period, as an engine takes it.

    Attributes:
        record: of `GROUND`, shape (1,).
        bumps: profiles of heights, m, shape (profiles, BUMP_SAMPLES); the record says which one counts.
    """

    record: NDArray[np.void]
    bumps: NDArray[np.float64]


NO_BUMPS: Final = np.zeros((1, BUMP_SAMPLES))
"""The profile of a perfectly smooth road."""
NO_BUMPS.setflags(write=False)


def flat_ground(rear_grip: float = 1.0, front_grip: float = 1.0) -> Ground:
    """Return level, smooth ground at height 0 in still air.

    Args:
        rear_grip: factor on friction under the rear wheel.
        front_grip: the same under the front wheel.
    """
    record = np.zeros(1, dtype=GROUND)
    for wheel, grip in (("rear", rear_grip), ("front", front_grip)):
        record[wheel]["cos"], record[wheel]["grip"], record[wheel]["stretch"] = 1.0, grip, 1.0
    return Ground(record, NO_BUMPS)


LEVEL: Final = flat_ground()
"""Level, smooth, dry ground in still air."""
LEVEL.record.setflags(write=False)
