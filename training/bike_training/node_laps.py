"""Laps of the classical rider through simulator, policy and recorder nodes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

from bike_msgs.msg import BikeState
from tqdm import tqdm

from bike_policy.pilots import CLASSICAL
from bike_sim.isolation import DomainLease
from bike_sim.physics.superbike_engine import TIME_STEP
from bike_training.laps import LONGEST_LAP
from bike_training.node_process import NodeProcess
from bike_training.ride_monitor import RideMonitor

START_TIMEOUT: Final = 60.0
"""Wall-clock time that the nodes get to find each other, s; the first line of a machine takes some seconds."""

BEYOND: Final = 30.0
"""How far the ride goes on behind the last line, m."""


def ride_through_nodes(vehicle: str, circuit: str, length: float, laps: int, recording: Path, limit: float) -> float:
    """Ride an out-lap and flying laps and record them.

    Args:
        vehicle: name or file of a superbike.
        circuit: name or file of a circuit.
        length: of a lap of the followed line, m.
        laps: number of flying laps.
        recording: file to write.
        limit: theoretical lap, s.

    Returns:
        Wall-clock time of the ride, s.

    Raises:
        NodeLost: a node ended, or no state came for long.
    """
    with DomainLease() as lease:
        domain = lease.domain_id
        simulator = {"vehicle": vehicle, "course": circuit, "time_step": TIME_STEP}
        record = {"path": str(recording.resolve()), "overwrite": True, "notes": [f"circuit={circuit}"]}
        pilot = {"policy": CLASSICAL}
        if vehicle.endswith((".yaml", ".yml")):
            pilot["vehicle"] = vehicle
        with (
            NodeProcess("bike_sim.record", record, domain) as recorder,
            NodeProcess("bike_sim.sim_node", simulator, domain) as sim,
            RideMonitor(domain) as monitor,
        ):
            monitor.wait_for_recorder(START_TIMEOUT, [sim, recorder])
            with NodeProcess("bike_policy.drive", pilot, domain) as drive:
                begun = time.monotonic()
                end = (laps + 1) * length + BEYOND

                def is_over(state: BikeState) -> bool:
                    return bool(state.fallen or state.progress >= end)

                with tqdm(total=round(end), unit="m", desc=f"{vehicle}, {circuit}") as bar:
                    longest = LONGEST_LAP * limit * (laps + 1)
                    monitor.watch(bar, longest, [sim, recorder, drive], is_over)
                return time.monotonic() - begun
