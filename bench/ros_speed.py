"""Speed of the road over ROS 2: control steps a second in lockstep.

Client, simulator and policy are separate processes that talk over DDS. The rides in process and over ROS, and two plain
rclpy processes that only pass the same messages, take turns in short rounds. A ratio is taken in each round, of
neighbours in time, and the median of the rounds counts, so that it means something on a busy machine; the processor
time of all processes of a side is compared as well. Speeds are those of the best round.
"""

from __future__ import annotations

import time
from typing import Final

import numpy as np
import psutil

from bench.ros_peer import Peer
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
    times: dict[str, list[float]] = {"local": [], "ros": [], "peer": []}
    spent = dict.fromkeys(times, 0.0)
    single: list[float] = []
    with RosClient(config) as remote, Peer() as peer:

        def ride(client: Client) -> float:
            took = _ride(client, steps)
            if client is remote:
                single.extend(took)
            return float(np.sum(took))

        sides = {
            "local": lambda: ride(local),
            "ros": lambda: ride(remote),
            "peer": lambda: peer.pass_messages(steps),
        }
        for turn in range(rounds):
            # Either way round, so that what grows or falls in the course of a round favours none.
            for name in reversed(sides) if turn % 2 else sides:
                before = _processor_time()
                times[name].append(sides[name]())
                spent[name] += _processor_time() - before
    local.close()
    best = {name: steps / min(taken) for name, taken in times.items()}
    ratios = np.array(times["peer"]) / np.array(times["ros"])
    low, middle, high = np.percentile(ratios, [25.0, 50.0, 75.0])
    median, p99 = np.percentile(single, [50.0, 99.0])
    return {
        "local_control_steps_per_s": best["local"],
        "ros_control_steps_per_s": best["ros"],
        "ros_to_local_ratio": best["ros"] / best["local"],
        "empty_rclpy_round_trips_per_s": best["peer"],
        "ros_to_empty_rclpy_ratio": float(middle),
        "ros_to_empty_rclpy_ratio_lower_quartile": float(low),
        "ros_to_empty_rclpy_ratio_upper_quartile": float(high),
        "ros_cpu_ms_per_step": 1e3 * spent["ros"] / (rounds * steps),
        "empty_rclpy_cpu_ms_per_round_trip": 1e3 * spent["peer"] / (rounds * steps),
        "ros_to_empty_rclpy_cpu_ratio": spent["peer"] / spent["ros"],
        "ros_step_median_ms": 1e3 * float(median),
        "ros_step_p99_ms": 1e3 * float(p99),
    }


def _processor_time() -> float:
    """Return the processor time of this process and its children so far, s; waiting ones add next to nothing."""
    here = psutil.Process()
    return sum(sum(process.cpu_times()[:2]) for process in (here, *here.children()))


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
