#!/usr/bin/env python3
"""Draw a lap over the hills of a circuit: height, loads of both tyres and lean, beside the same lap on level ground.

.venv/bin/python tools/draw_hills.py docs/images/superbike_hills.png
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from bike_policy.riders.classical import ClassicalRider
from bike_sim.course import track_reading
from bike_sim.course.track import Track
from bike_sim.physics import superbike_forces as sf
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator

TRACKS = Path(track_reading.__file__).parents[1] / "config" / "tracks"


def level_copy(circuit: str, folder: Path) -> Path:
    """Write a shipped circuit without its heights."""
    kept, skipping = [], False
    for line in (TRACKS / f"{circuit}.yaml").read_text(encoding="utf-8").splitlines():
        skipping = line.startswith("elevation_m") or (skipping and line.startswith(" "))
        if not skipping:
            kept.append(line)
    path = folder / f"{circuit}_level.yaml"
    path.write_text("\n".join(kept) + "\n", encoding="utf-8")
    return path


def ride(vehicle: str, course: str) -> tuple[Track, NDArray[np.float64]]:
    """Ride an out-lap; return the circuit and rows of progress (m), speed (m/s), load (N) and camber (deg)."""
    simulator = Simulator(SimulatorConfig(vehicle=vehicle, engine="compiled", time_step=0.002, control_period=0.02))
    rider = ClassicalRider()
    snapshot = simulator.reset(simulator.at_own_speed(ResetRequest(course=course)))
    assert simulator.course is not None
    assert simulator.track is not None
    rider.begin(simulator.vehicle, simulator.course, simulator.config.control_period, simulator.preview)
    rows = []
    while not (snapshot.fallen or snapshot.finished):
        command = rider.command(snapshot)
        assert command is not None
        snapshot = simulator.step(*command)
        signals = snapshot.signals
        load = signals[sf.T_REAR_LOAD] + signals[sf.T_FRONT_LOAD]
        rows.append((snapshot.progress, snapshot.speed, load, np.degrees(signals[sf.T_REAR_CAMBER])))
    return simulator.track, np.array(rows)


def smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a running mean over half a second."""
    return np.convolve(np.pad(values, 12, mode="edge"), np.ones(25) / 25.0, mode="valid")


def main() -> None:
    """Ride both laps and draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--circuit", default="barcelona")
    parser.add_argument("--vehicle", default="panigale_v4r")
    args = parser.parse_args()
    track, hilly = ride(args.vehicle, args.circuit)
    with tempfile.TemporaryDirectory() as folder:
        _, level = ride(args.vehicle, str(level_copy(args.circuit, Path(folder))))
    figure, axes = plt.subplots(4, 1, figsize=(9.0, 8.0), sharex=True, layout="constrained")
    axes[0].plot(track.centre.s, track.elevation, color="#222222")
    axes[0].set_ylabel("height / m")
    along = np.linspace(0.0, track.length, 2000)
    for rows, colour, label in ((level, "#8a8a8a", "level"), (hilly, "#c2344a", "hills")):
        for axis, column in zip(axes[1:], (2, 1, 3), strict=True):
            values = smooth(rows[:, column]) if column == 2 else rows[:, column]
            axis.plot(along, np.interp(along, rows[:, 0], values), color=colour, lw=1.0, label=label)
    for axis, name in zip(axes[1:], ("load on both tyres / N", "speed / (m/s)", "camber / deg"), strict=True):
        axis.set_ylabel(name)
    axes[1].legend(loc="upper right")
    axes[-1].set_xlabel("progress / m")
    figure.savefig(args.picture, dpi=110)
    share = np.interp(level[:, 0], hilly[:, 0], smooth(hilly[:, 2])) / smooth(level[:, 2])
    print(f"load against level ground: {np.percentile(share, 1):.2f} to {np.percentile(share, 99):.2f} (1 to 99 %)")


if __name__ == "__main__":
    main()
