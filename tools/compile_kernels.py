#!/usr/bin/env python3
"""Fills Numba's cache: rides each kind of vehicle and engine, plans a lap, races, looks a lap's limits up.

Numba compiles a function when it is first called with arguments of a type, and keeps the result beside the source,
where nodes and commands find it. Without this, the first ride would compile while nodes wait for each other.

    .venv/bin/python tools/compile_kernels.py
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.font_manager  # noqa: F401 (lists the fonts, which it does once)
import numpy as np

from bike_analysis.read.container import Container
from bike_policy.contract.bundle import DEFAULT_RACER
from bike_policy.riders.disturbed import DisturbedRider
from bike_policy.riders.rider import make_rider
from bike_policy.riders.wheel_to_wheel import RaceField, unverified_plan
from bike_sim.planning.envelope import envelope
from bike_sim.recording.mcap_file import McapFile
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.race import Race, RaceSettings, entries_of
from bike_sim.sim.request import COURSE_POINTS, Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike

CIRCUIT = "barcelona"
"""The circuit of ``make lap``, whose line is computed and kept on the way."""
MACHINE = "panigale_v4r"
SUSPENDED = "gsxr1000"


def ride(config: SimulatorConfig, course: str, rider_name: str) -> None:
    """Ride for two steps."""
    simulator, rider = Simulator(config), make_rider(rider_name)
    if not isinstance(simulator.vehicle, Superbike):
        rider = DisturbedRider(rider, load_disturbances("raw_sensors"))
    request = ResetRequest(course=course)
    snapshot = simulator.reset(simulator.at_own_speed(request) if course == CIRCUIT else request)
    assert simulator.course is not None
    rider.begin(simulator.vehicle, simulator.course, simulator.config.control_period, simulator.preview)
    for _ in range(2):
        command = rider.command(snapshot)
        assert command is not None
        snapshot = simulator.step(*command)
    simulator.close()


def ride_side_by_side(config: SimulatorConfig, course: str, preview: Preview) -> None:
    """Ride two vehicles as learning does."""
    batch = Batch(2, config, preview)
    for index in range(2):
        batch.reset(index, ResetRequest(course=course, seed=index))
    batch.step(np.zeros((2, 2)))
    batch.close()


def race() -> None:
    """Race two machines for two steps."""
    machines = Race(RaceSettings(CIRCUIT, 1, entries_of([MACHINE, MACHINE], "classical"), line=0.0))
    field = RaceField.of(machines, unverified_plan)
    for step in range(2):
        machines.step(field.commands(machines.batch, step))
    machines.close()


def evaluate_laps() -> None:
    """Look limits up, as the report of a lap does."""
    vehicle = load_superbike(MACHINE)
    limits, speeds = envelope(vehicle), np.array([30.0, 40.0])
    for found in (limits.lateral(speeds), limits.drive(speeds, speeds / 10.0), limits.brake(speeds, speeds / 10.0)):
        assert (found > 0.0).all()


def write_and_read() -> None:
    """Write and read a file of one message."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.mcap"
        file = McapFile(path, chunk_bytes=1024, compression="zstd")
        channel = file.add_channel("/bike/one", file.add_schema("std_msgs/msg/Empty", ""), {})
        file.add_message(channel, 0, 1, 1, b"\0\1\0\0")
        file.finish()
        assert sum(len(block) for block in Container(path).blocks()) == 1


def main() -> None:
    """Compile all."""
    superbike = superbike_config(MACHINE)
    for engine in ("pybullet", "whipple"):
        print(f"compiling: bicycle, engine {engine}", flush=True)
        ride(SimulatorConfig(engine=engine), "line", "lqr")
    ride_side_by_side(
        SimulatorConfig(engine="whipple", time_step=0.01), "random", Preview(by_time=True, interval=0.2, count=11)
    )
    print("compiling: superbike", flush=True)
    for name in ("classical", DEFAULT_RACER):
        ride(superbike, CIRCUIT, name)
    ride_side_by_side(replace(superbike, engine="compiled"), CIRCUIT, COURSE_POINTS)
    print("compiling: race", flush=True)
    race()
    print("compiling: suspended superbike", flush=True)
    ride_side_by_side(replace(superbike_config(SUSPENDED), engine="compiled"), "line", COURSE_POINTS)
    print("compiling: reports and recordings", flush=True)
    evaluate_laps()
    write_and_read()


if __name__ == "__main__":
    main()
