"""The installed simulator and recorder start, do their work and end; `colcon test` runs this."""

import os
import signal
import subprocess
import time
from pathlib import Path

from ament_index_python.packages import get_package_prefix

from bike_sim.ros.isolation import DomainLease

PATIENCE = 90.0
"""Longest wait for anything, s."""


def test_recorder_writes_what_the_simulator_publishes(tmp_path: Path) -> None:
    """Both end on a signal, with exit code 0, and the recording has states."""
    programs, recording = Path(get_package_prefix("bike_sim")) / "lib" / "bike_sim", tmp_path / "ride.mcap"
    parameters = {
        "record": (f"path:={recording}", "compression:=none"),
        "sim_node": ("course:=line", "engine:=whipple"),
    }
    with DomainLease() as lease:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(lease.domain_id)}
        running = {}
        for name, values in parameters.items():
            command = [programs / name, "--ros-args", *(word for value in values for word in ("-p", value))]
            running[name] = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        try:
            end = time.monotonic() + PATIENCE
            while not (recording.exists() and b"/bike/state" in recording.read_bytes()) and time.monotonic() < end:
                time.sleep(0.1)
            for program in running.values():
                program.send_signal(signal.SIGINT)
            words = {name: program.communicate(timeout=PATIENCE)[1] for name, program in running.items()}
        finally:
            for program in running.values():
                program.kill()
    assert [program.returncode for program in running.values()] == [0, 0], words
    assert b"/bike/state" in recording.read_bytes()
