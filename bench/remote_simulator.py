"""What a simulator on another machine costs: a second network namespace stands for that machine.

    python -m bench.remote_simulator [--steps 2000] [--rounds 5]

Needs root. Two namespaces with one cable between them (veth) and no way out are made and removed again. In the near one
a client rides a simulator beside it, at 127.0.0.1 with shared memory, and in turn one in the far namespace, by UDP.
Both rides take the same steps, so times are compared within one run; the tenth of the steps that was fastest says least
about other work on the machine. The cable has no delay of its own: what a real network adds is to be added.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import psutil

from bike_sim.physics.state import ROLL
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.envs.ros_client import RosClient, RosClientConfig

NEAR, FAR = "bike-near", "bike-far"
ADDRESSES = {NEAR: "10.213.77.1/24", FAR: "10.213.77.2/24"}
DOMAIN = 42
"""Nobody else is in these namespaces."""
WARM_UP = 300
"""Steps before those that count: the simulator beside the client is a new one in each round."""


@contextmanager
def two_machines() -> Iterator[tuple[str, str]]:
    """Make two network namespaces with a cable between them, and remove them."""
    names = {place: f"{place}-{os.getpid()}" for place in ADDRESSES}
    try:
        for name in names.values():
            subprocess.run(["ip", "netns", "add", name], check=True)
        near, far = names[NEAR], names[FAR]
        cable = ["ip", "-n", near, "link", "add", "eth0", "type", "veth", "peer", "name", "eth0", "netns", far]
        subprocess.run(cable, check=True)
        for place, name in names.items():
            subprocess.run(["ip", "-n", name, "address", "add", ADDRESSES[place], "dev", "eth0"], check=True)
            for link in ("lo", "eth0"):
                subprocess.run(["ip", "-n", name, "link", "set", link, "up"], check=True)
        yield near, far
    finally:
        for name in names.values():
            subprocess.run(["ip", "netns", "delete", name], check=False, stderr=subprocess.DEVNULL)


def ride(steps: int, simulator: int | None) -> dict[str, float]:
    """Ride a straight line.

    Args:
        steps: control steps.
        simulator: process id of a simulator that runs; None starts one.

    Returns:
        Wall-clock time of a step, median and the tenth that was fastest, and processor time of a step, of client and
        simulator, s.
    """
    ros = RosClientConfig() if simulator is None else RosClientConfig(join=True, domain_id=DOMAIN)
    with RosClient(SimulatorConfig(time_step=0.005), ros) as client:
        other = psutil.Process(client._process.process.pid if simulator is None else simulator)
        _spans(client, WARM_UP)
        processor, others = time.process_time(), _processor_time(other)
        spans = _spans(client, steps)
        return {
            "median_s": statistics.median(spans),
            "fastest_tenth_s": statistics.quantiles(spans, n=10)[0],
            "client_processor_s": (time.process_time() - processor) / steps,
            "simulator_processor_s": (_processor_time(other) - others) / steps,
        }


def _spans(client: RosClient, steps: int) -> list[float]:
    """Ride control steps and return how long each of them took, s."""
    spans: list[float] = []
    while len(spans) < steps:
        snapshot = client.reset(ResetRequest(seed=len(spans), course="line"))
        while not snapshot.fallen and len(spans) < steps:
            began = time.perf_counter()
            snapshot = client.step(0.5 * float(snapshot.state[ROLL]))
            spans.append(time.perf_counter() - began)
    return spans


def _processor_time(process: psutil.Process) -> float:
    times = process.cpu_times()
    return times.user + times.system


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=2000, help="control steps of each round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--ride", choices=(NEAR, FAR), help=argparse.SUPPRESS)
    parser.add_argument("--simulator", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.ride:
        print(json.dumps(ride(args.steps, args.simulator if args.ride == FAR else None)))
        return
    opened = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": str(DOMAIN)}
    environments = {NEAR: dict(os.environ), FAR: opened}
    found: dict[str, list[dict[str, float]]] = {NEAR: [], FAR: []}
    with two_machines() as (near, far):
        # Its own shared memory as well: on another machine there is none to share.
        node = "mount -t tmpfs none /dev/shm && exec $0 -m bike_sim.ros.sim_node --ros-args -r __ns:=/bike"
        settings = ["-p", "mode:=lockstep", "-p", "course:=line", "-p", "time_step:=0.005"]
        command = ["ip", "netns", "exec", far, "sh", "-c", f'{node} "$@"', sys.executable, *settings]
        simulator = subprocess.Popen(command, env=opened)
        try:
            for _ in range(args.rounds):
                for place, environment in environments.items():
                    words = ["--ride", place, "--steps", str(args.steps), "--simulator", str(simulator.pid)]
                    inside = ["ip", "netns", "exec", near, sys.executable, "-m", "bench.remote_simulator", *words]
                    answer = subprocess.run(inside, env=environment, check=True, stdout=subprocess.PIPE, text=True)
                    found[place].append(json.loads(answer.stdout))
        finally:
            simulator.terminate()
            simulator.wait()
    medians = {
        place: {key: statistics.median(each[key] for each in rounds) for key in rounds[0]}
        for place, rounds in found.items()
    }
    figures = {
        "beside": medians[NEAR],
        "far": medians[FAR],
        "ratios": {key: medians[FAR][key] / medians[NEAR][key] for key in medians[FAR]},
        "load_average": os.getloadavg()[0],
    }
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
