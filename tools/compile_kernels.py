#!/usr/bin/env python3
"""Compiles what simulates ahead of time, by using it for one step: each vehicle and engine, a lap's plan, a reader.

Numba compiles a function when it is first called with arguments of a type, and keeps the result beside the source,
where nodes and commands find it. Without this, the first ride would compile while nodes wait for each other.

    .venv/bin/python tools/compile_kernels.py
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

CIRCUIT = "barcelona"
"""The circuit of ``make lap``, whose line is computed and kept on the way."""
MACHINE = "panigale_v4r"


def bicycle(engine: str) -> None:
    """Ride the bicycle for one step."""
    from bike_sim.sim.request import ResetRequest
    from bike_sim.sim.simulator import Simulator, SimulatorConfig

    simulator = Simulator(SimulatorConfig(engine=engine))
    simulator.reset(ResetRequest())
    simulator.step(0.1)
    simulator.close()


def bicycles_side_by_side() -> None:
    """Ride two bicycles as learning does."""
    from bike_sim.sim.batch import RideBatch
    from bike_sim.sim.request import Preview, ResetRequest
    from bike_sim.vehicles.bicycle import Vehicle
    from bike_sim.vehicles.files import load_vehicle

    vehicle = load_vehicle("whipple")
    assert isinstance(vehicle, Vehicle)
    batch = RideBatch(2, vehicle, Preview(by_time=True, interval=0.25, count=4))
    for index in range(2):
        batch.reset(index, ResetRequest(course="random", seed=index))
    batch.step(np.zeros(2))


def superbike() -> None:
    """Plan a lap and ride its first step, as the classical rider does through the nodes."""
    from bike_policy.riders.classical import ClassicalRider, Seen
    from bike_sim.sim import look
    from bike_sim.sim.request import ResetRequest
    from bike_sim.sim.track_ride import TrackRide, start_speed, superbike_config

    ride = TrackRide(superbike_config(MACHINE))
    speed = start_speed(CIRCUIT, ride.envelope)
    ride.reset(ResetRequest(course=CIRCUIT, speed_range=(speed, speed)))
    assert ride.course is not None
    rider = ClassicalRider(ride.vehicle, ride.course, ride.config.control_period, None, ride.envelope)
    seen = ride.step(0.0, 0.0)
    places = (look.PROGRESS, look.LATERAL_ERROR, look.HEADING_ERROR)
    rider.command(Seen(seen.speed, 0.0, *(float(seen.seen[place]) for place in places)))
    ride.step(0.01, 0.1)
    ride.close()


def recording() -> None:
    """Write and read a file of one message."""
    from bike_analysis.container import Container
    from bike_sim.recording.mcap_file import McapFile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.mcap"
        file = McapFile(path, chunk_bytes=1024, compression="zstd")
        channel = file.add_channel("/bike/one", file.add_schema("std_msgs/msg/Empty", ""), {})
        file.add_message(channel, 0, 1, 1, b"\0\1\0\0")
        file.finish()
        assert sum(len(block) for block in Container(path).blocks()) == 1


def fonts() -> None:
    """Have Matplotlib list the fonts, which it does once and speaks of."""
    import matplotlib.font_manager  # noqa: F401


KERNELS: dict[str, Callable[[], None]] = {
    "bicycle, compiled engine": lambda: bicycle("whipple"),
    "bicycle, PyBullet": lambda: bicycle("pybullet"),
    "bicycles side by side": bicycles_side_by_side,
    "superbike": superbike,
    "reading of recordings": recording,
    "list of fonts": fonts,
}
"""What is compiled, by name."""


def main() -> None:
    """Compile all, and say how long each took."""
    for name, use in KERNELS.items():
        print(f"compiling: {name}", flush=True)
        began = time.monotonic()
        use()
        print(f"compiled: {name}, {time.monotonic() - began:.1f} s", flush=True)


if __name__ == "__main__":
    main()
