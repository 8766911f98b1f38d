"""Speed of the road over ROS 2: control steps a second in lockstep.

Client and simulator are separate processes that talk over DDS. The rides in process and over ROS, and two plain rclpy
nodes that only pass the same messages, take turns in short rounds. A ratio is taken in each round, of neighbours in
time, and the median of the rounds counts, so that it means something on a busy machine. Speeds are those of the best
round.
"""

from __future__ import annotations

import time
from typing import Final

import numpy as np

from bench.ros_peer import peers
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_training.envs.clients import Client
from bike_training.envs.ros_client import RosClient

EPISODE_STEPS: Final = 30
"""Steps before the bicycle is set upright again: it rides without a hand on the handlebar."""
START: Final = ResetRequest(course="line", speed_range=(5.0, 5.0))


def measure(rounds: int = 15, steps: int = 150, time_step: float = 0.005) -> dict[str, float]:
    """Return control steps a second in process and over ROS, and of messages alone, with the same engine in one run.

    Args:
        rounds: rounds of each.
        steps: control steps in a round.
        time_step: integration step of PyBullet, s.
    """
    config = SimulatorConfig(engine="pybullet", time_step=time_step)
    local = Simulator(config)
    taken, alone = [], []
    with RosClient(config) as remote, peers() as passed:
        for _ in range(rounds):
            taken.append([_ride(client, steps) for client in (local, remote)])
            alone.append(passed(steps))
    local.close()
    whole = np.sum(taken, axis=2)
    in_process, over_ros = steps / whole.min(axis=0)
    median, p99 = np.percentile([ros for _, ros in taken], [50.0, 99.0])
    return {
        "local_control_steps_per_s": float(in_process),
        "ros_control_steps_per_s": float(over_ros),
        "empty_rclpy_round_trips_per_s": steps / min(alone),
        "ros_to_local_ratio": float(np.median(whole[:, 0] / whole[:, 1])),
        "ros_to_empty_rclpy_ratio": float(np.median(np.array(alone) / whole[:, 1])),
        "ros_step_median_ms": 1e3 * float(median),
        "ros_step_p99_ms": 1e3 * float(p99),
    }


def _ride(client: Client, steps: int) -> list[float]:
    """Return the wall-clock time of each of a number of steps, s; resets are not counted."""
    taken = []
    snapshot: Snapshot | None = None
    for _ in range(steps):
        if snapshot is None or snapshot.step == EPISODE_STEPS:
            snapshot = client.reset(START)
        began = time.perf_counter()
        snapshot = client.step(0.0)
        taken.append(time.perf_counter() - began)
    return taken
