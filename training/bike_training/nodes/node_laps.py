"""Laps of a rider through simulator, policy and recorder nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from bike_policy.riders.classical import CLASSICAL
from bike_sim.physics.superbike.engine import TIME_STEP
from bike_sim.ros.isolation import DomainLease
from bike_training.nodes.ride_monitor import ride_recorded
from bike_training.rollout.laps import LONGEST_LAP

BEYOND: Final = 30.0
"""Distance that the ride continues beyond the last line, m."""


def ride_through_nodes(
    vehicle: str, circuit: str, length: float, laps: int, recording: Path, limit: float, rider: str = CLASSICAL
) -> float:
    """Ride an out-lap and flying laps and record them.

    Args:
        vehicle: name or file of a superbike.
        circuit: name or file of a circuit.
        length: of a lap of the followed line, m.
        laps: number of flying laps.
        recording: file to write.
        limit: theoretical lap, s.
        rider: name of a rider or folder of a policy.

    Returns:
        Wall-clock time of the ride, s.

    Raises:
        NodeLost: a node ended, no state came for long, or the recorder could not finish its file.
    """
    with DomainLease() as lease:
        simulator = {"vehicle": vehicle, "course": circuit, "time_step": TIME_STEP}
        notes = [f"policy={rider}", f"circuit={circuit}"]
        record = {"path": str(recording.resolve()), "overwrite": True, "notes": notes}
        pilot = {"policy": rider}
        if vehicle.endswith((".yaml", ".yml")):
            pilot["vehicle"] = vehicle
        end = (laps + 1) * length + BEYOND
        return ride_recorded(
            lease.domain_id,
            record,
            simulator,
            pilot,
            title=f"{vehicle}, {circuit}",
            way=end,
            longest=LONGEST_LAP * limit * (laps + 1),
            is_over=lambda state: bool(state.fallen or state.progress >= end),
        )
