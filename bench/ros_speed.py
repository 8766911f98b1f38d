"""Speed of the road over ROS 2: control steps a second in lockstep, and the policy's answer.

Client, simulator and policy are separate processes that talk over DDS. The rides in process and over ROS, and two plain
rclpy processes that only pass the same messages, take turns in short rounds. A ratio is taken in each round, of
neighbours in time, and the median of the rounds counts, so that it means something on a busy machine; the processor
time of all processes of a side is compared as well. Speeds are those of the best round.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor

from bench.ros_peer import Peer
from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_sim.ros import node_tools
from bike_sim.ros.isolation import DomainLease
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_training.envs.clients import Client
from bike_training.envs.node_process import NodeLost, NodeProcess
from bike_training.envs.ros_client import RosClient

EPISODE_STEPS: Final = 30
"""Steps before the bicycle is set upright again: it rides without a hand on the handlebar."""
START_TIMEOUT_S: Final = 30.0
"""Wall-clock time in which the policy node must have reported, s."""
START: Final = ResetRequest(course="line", speed_range=(5.0, 5.0))


def lockstep_speed(time_step: float = 0.005, rounds: int = 15, steps: int = 150) -> dict[str, float]:
    """Return control steps a second in process and over ROS, and of messages alone, with the same engine in one run.

    Args:
        time_step: integration step of PyBullet, s.
        rounds: rounds of each.
        steps: control steps in a round.
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


def actor_latency(policy: str = DEFAULT_POLICY, duration: float = 6.0) -> dict[str, Any]:
    """Return how long the policy node takes from a state to its command, as it measures it itself.

    Args:
        policy: name or folder of a bundle.
        duration: wall-clock time of the ride, s.

    Raises:
        NodeLost: a node ended, or the policy node reported nothing in time.
    """
    with DomainLease() as lease:
        context = node_tools.join(lease.domain_id)
        node = rclpy.create_node("ros_speed", context=context, namespace=node_tools.NAMESPACE)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        figures: dict[str, str] = {}

        def on_report(message: DiagnosticArray) -> None:
            for status in message.status:
                if status.name.endswith("/drive"):
                    figures.update({entry.key: entry.value for entry in status.values})

        node.create_subscription(DiagnosticArray, "/diagnostics", on_report, node_tools.STREAM_QOS)
        try:
            with (
                NodeProcess(
                    "bike_sim.ros.sim_node", {"auto_reset": "fall", "time_step": 0.005}, lease.domain_id
                ) as sim,
                NodeProcess("bike_policy.drive", {"policy": policy}, lease.domain_id) as drive,
            ):
                nodes = (sim, drive)
                _spin(executor, nodes, START_TIMEOUT_S, lambda: "latency_p99_ms" in figures)
                if "latency_p99_ms" not in figures:
                    raise NodeLost(f"the policy node reported no answers within {START_TIMEOUT_S:g} s")
                answered, began = int(figures["states_answered"]), time.perf_counter()
                _spin(executor, nodes, duration, lambda: False)
                rate = (int(figures["states_answered"]) - answered) / (time.perf_counter() - began)
        finally:
            executor.shutdown()
            node.destroy_node()
            context.try_shutdown()
    return {
        "actor_latency_median_ms": float(figures["latency_median_ms"]),
        "actor_latency_p99_ms": float(figures["latency_p99_ms"]),
        "driven_control_steps_per_s": rate,
        "policy": figures["policy"],
    }


def _spin(
    executor: SingleThreadedExecutor, nodes: Sequence[NodeProcess], duration: float, done: Callable[[], bool]
) -> None:
    """Listen for a wall-clock time, s, or until something holds; nodes that end meanwhile are an error."""
    end = time.monotonic() + duration
    while not done() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
        for node in nodes:
            node.check()


def measure(rounds: int = 15, steps: int = 150, duration: float = 6.0) -> dict[str, Any]:
    """Return all figures of this module.

    Args:
        rounds: see `lockstep_speed`.
        steps: see `lockstep_speed`.
        duration: see `actor_latency`.
    """
    return {**lockstep_speed(rounds=rounds, steps=steps), **actor_latency(duration=duration)}
