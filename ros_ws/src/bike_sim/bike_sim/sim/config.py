"""Settings of a simulator that are the same in all episodes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bike_sim.vehicles.files import load_vehicle


@dataclass(frozen=True)
class SimulatorConfig:
    """Vehicle, engine and steps.

    Attributes:
        vehicle: name of a shipped vehicle or path of a YAML file.
        engine: a kind of :func:`bike_sim.physics.engines.make_engine`.
        time_step: integration step, s; the control period must be a whole number of them.
        control_period: time between two commands, s (h of Weyrer et al. 2026, Sect. 3.1).
        history: number of roll and steer angles kept.
    """

    vehicle: str = "whipple"
    engine: str = "pybullet"
    time_step: float = 0.001
    control_period: float = 0.05
    history: int = 10

    def __post_init__(self) -> None:
        """Refuse steps that do not fit into each other.

        Raises:
            ValueError: naming the value.
        """
        for name in ("time_step", "control_period"):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise ValueError(f"{name} must be positive and finite, got {value!r} s")
        steps = self.control_period / self.time_step
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
            raise ValueError(
                f"control period {self.control_period} s is not a whole number of time steps of {self.time_step} s"
            )
        if self.history < 1:
            raise ValueError(f"history must be at least 1, got {self.history}")

    @property
    def substeps(self) -> int:
        """Integration steps in a control period."""
        return round(self.control_period / self.time_step)


def superbike_config(vehicle: str = "panigale_v4r", time_step: float | None = None) -> SimulatorConfig:
    """Return the settings with which a superbike rides: its own control period.

    Args:
        vehicle: name of a shipped superbike or path of a YAML file.
        time_step: integration step, s; None for that of the superbike's engines.

    Raises:
        ValueError: a vehicle file that is wrong.
        FileNotFoundError: an unknown vehicle.
    """
    from bike_sim.physics.superbike.engine import TIME_STEP  # late: a bicycle is spared tyres

    period = load_vehicle(vehicle).control_period
    return SimulatorConfig(vehicle, time_step=time_step or TIME_STEP, control_period=period)
