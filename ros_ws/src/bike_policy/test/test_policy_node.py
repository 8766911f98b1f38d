"""The installed policy node drives the simulator; `colcon test` runs this."""

import os
import signal
import subprocess
import time
from pathlib import Path

from ament_index_python.packages import get_package_prefix

from bike_sim.ros.isolation import DomainLease

PATIENCE = 90.0
"""Longest wait for anything, s."""


def test_policy_drives_the_simulator(tmp_path: Path) -> None:
    """Both end on a signal, with exit code 0."""
    commands = {
        "bike_sim": ["sim_node", "--ros-args", "-p", "engine:=whipple"],
        "bike_policy": ["drive", "--ros-args", "-p", "policy:=whipple"],
    }
    words = tmp_path / "words.txt"
    with DomainLease() as lease, words.open("w") as file:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(lease.domain_id)}
        running = []
        for package, (name, *arguments) in commands.items():
            program = Path(get_package_prefix(package)) / "lib" / package / name
            running.append(subprocess.Popen([program, *arguments], env=environment, stderr=file))
        try:
            end = time.monotonic() + PATIENCE
            while "driving episode 1" not in words.read_text() and time.monotonic() < end:
                time.sleep(0.1)
            for program in running:
                program.send_signal(signal.SIGINT)
            assert [program.wait(PATIENCE) for program in running] == [0, 0]
        finally:
            for program in running:
                program.kill()
    assert "driving episode 1" in words.read_text()
