"""Speed of the analysis: an hour of riding at 100 Hz with every topic, which a superbike rides through the nodes.

The analysis is a fresh process, so that its memory is its own. Both wall-clock and processor time are given: only the
latter means something on a busy machine.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

from bike_sim.physics.superbike.engine import TIME_STEP
from bike_sim.ros.isolation import DomainLease
from bike_training.nodes.node_rides import ride_recorded

VEHICLE: Final = "panigale_v4r"
CIRCUIT: Final = "barcelona"
PERIOD: Final = 0.01
"""Control period of the recorded ride, s: 100 Hz."""
HOUR: Final = 3600.0
MEAN_SPEED: Final = 50.0
"""For the bar of progress, m/s."""


def measure(duration: float = HOUR) -> dict[str, float]:
    """Return time and memory of `bike analyze` of a recording with page, picture and figures.

    Args:
        duration: of the ride, s.

    Raises:
        RuntimeError: the rider fell, or the analysis failed.
    """

    def is_over(state: Any) -> bool:
        if state.fallen:
            raise RuntimeError(f"the rider of the benchmark fell after {state.progress:.1f} m")
        return bool(state.header.stamp.sec >= duration)

    with tempfile.TemporaryDirectory() as folder, DomainLease() as lease:
        path = Path(folder) / "hour.mcap"
        parameters: dict[str, dict[str, Any]] = {
            "record": {"path": str(path), "notes": ["policy=classical", f"vehicle={VEHICLE}"]},
            "sim_node": {"vehicle": VEHICLE, "course": CIRCUIT, "time_step": TIME_STEP, "control_period": PERIOD},
            "drive": {"policy": "classical"},
        }
        title, distance = f"{VEHICLE}, {CIRCUIT}", MEAN_SPEED * duration
        ride_recorded(lease.domain_id, parameters, title=title, distance=distance, longest=HOUR, is_over=is_over)
        print("analysing ...", file=sys.stderr)
        return hour_figures(path)


def hour_figures(path: Path) -> dict[str, float]:
    """Return what the analysis of a recording uses.

    Raises:
        RuntimeError: it failed.
    """
    words = [sys.executable, "-m", "bike_training.cli", "analyze", str(path), "--json", "--out", str(path.parent)]
    began = time.perf_counter()
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        output = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    took = time.perf_counter() - began
    if process.returncode:
        raise RuntimeError(f"bike analyze ended with exit code {process.returncode}")
    figures = json.loads(output)["figures"]
    return {
        "hour_messages": float(figures["recordings"][0]["messages"]),
        "hour_recording_mib": path.stat().st_size / 2**20,
        "hour_analysis_s": took,
        "hour_analysis_processor_s": usage.ru_utime + usage.ru_stime,
        "peak_memory_gib": usage.ru_maxrss / 2**20,
        "hour_laps": float(len(figures["rides"][0]["complete_laps"])),
    }
