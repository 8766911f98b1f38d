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
    from bike_sim.sim.config import SimulatorConfig
    from bike_sim.sim.request import ResetRequest
    from bike_sim.sim.simulator import Simulator

    simulator = Simulator(SimulatorConfig(engine=engine))
    simulator.reset(ResetRequest())
    simulator.step(0.1)
    simulator.close()


def bicycle_with_lqr() -> None:
    """Answer one snapshot as the LQR does, with the steady turns of the bicycle."""
    from bike_policy.riders.lqr import LqrRider
    from bike_sim.sim.config import SimulatorConfig
    from bike_sim.sim.request import ResetRequest
    from bike_sim.sim.simulator import Simulator

    simulator, rider = Simulator(SimulatorConfig(engine="whipple")), LqrRider()
    snapshot = simulator.reset(ResetRequest(course="line"))
    assert simulator.course is not None
    rider.begin(simulator.vehicle, simulator.course, simulator.config.control_period, simulator.preview)
    rider.command(snapshot)
    simulator.close()


def bicycles_side_by_side() -> None:
    """Ride two bicycles as learning does."""
    from bike_sim.sim.batch import make_batch
    from bike_sim.sim.config import SimulatorConfig
    from bike_sim.sim.request import Preview, ResetRequest

    batch = make_batch(
        2, SimulatorConfig(engine="whipple", time_step=0.01), Preview(by_time=True, interval=0.2, count=11)
    )
    for index in range(2):
        batch.reset(index, ResetRequest(course="random", seed=index))
    batch.step(np.zeros((2, 2)))
    batch.close()


def superbike() -> None:
    """Plan a lap and ride its first steps, as the classical rider does through the nodes."""
    from bike_policy.riders.classical import ClassicalRider
    from bike_sim.sim.request import ResetRequest
    from bike_sim.sim.simulator import Simulator
    from bike_sim.sim.superbike_plant import superbike_config

    simulator, rider = Simulator(superbike_config(MACHINE)), ClassicalRider()
    snapshot = simulator.reset(simulator.at_own_speed(ResetRequest(course=CIRCUIT)))
    assert simulator.course is not None
    rider.begin(simulator.vehicle, simulator.course, simulator.config.control_period, simulator.preview)
    for _ in range(2):
        command = rider.command(snapshot)
        assert command is not None
        snapshot = simulator.step(*command)
    simulator.close()


def superbikes_side_by_side() -> None:
    """Ride two superbikes as learning and rehearsals do; a verification that was kept compiles nothing."""
    from dataclasses import replace

    from bike_sim.sim.request import ResetRequest
    from bike_sim.sim.superbike_batch import CompiledSuperbikeBatch
    from bike_sim.sim.superbike_plant import superbike_config

    batch = CompiledSuperbikeBatch(2, replace(superbike_config(MACHINE), engine="compiled"))
    for index in range(2):
        batch.reset(index, batch.at_own_speed(index, ResetRequest(course=CIRCUIT)))
    batch.step(np.zeros((2, 2)))
    batch.close()


def report_of_laps() -> None:
    """Time a moment of a lap from outside, and look limits up, as the report of a lap does."""
    from bike_sim.course.files import load_track
    from bike_sim.course.lap_timing import Sample, time_laps
    from bike_sim.planning.envelope import envelope
    from bike_sim.vehicles.files import load_vehicle
    from bike_sim.vehicles.superbike import Superbike

    time_laps(load_track(CIRCUIT), [Sample(0.1 * k, float(k), 0.0, 1.0 + k, 0.0) for k in range(2)])
    vehicle = load_vehicle(MACHINE)
    assert isinstance(vehicle, Superbike)
    limits, speeds = envelope(vehicle), np.array([30.0, 40.0])
    for found in (limits.lateral(speeds), limits.drive(speeds, speeds / 10.0), limits.brake(speeds, speeds / 10.0)):
        assert (found > 0.0).all()


def recording() -> None:
    """Write and read a file of one message."""
    from bike_analysis.read.container import Container
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
    "bicycle with the LQR": bicycle_with_lqr,
    "bicycles side by side": bicycles_side_by_side,
    "superbikes side by side": superbikes_side_by_side,
    "superbike": superbike,
    "report of laps": report_of_laps,
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
