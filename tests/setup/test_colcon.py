"""`colcon test` finds the tests inside the ROS packages, runs them and they pass."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.ros
@pytest.mark.slow
def test_colcon_runs_the_tests_of_the_packages(tmp_path: Path) -> None:
    prefix = Path(sys.prefix)
    paths = {"CMAKE_PREFIX_PATH": str(prefix), "AMENT_PREFIX_PATH": str(prefix), "VIRTUAL_ENV": str(prefix)}
    environment = os.environ | paths | {"PATH": f"{prefix / 'bin'}:{os.environ['PATH']}"}
    # As tools/setup builds the workspace; results go where nothing else is.
    command = ["colcon", "--log-base", tmp_path / "log", "test", "--base-paths", "ros_ws/src", "--merge-install"]
    command += ["--build-base", prefix / "workspace" / "build", "--install-base", prefix]
    command += ["--test-result-base", tmp_path / "results", "--event-handlers", "console_cohesion+"]
    shown = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    result = ["colcon", "test-result", "--all", "--test-result-base", tmp_path / "results"]
    found = subprocess.run(result, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert (found.returncode, found.stdout.strip().splitlines()[-1]) == (
        0,
        "Summary: 6 tests, 0 errors, 0 failures, 0 skipped",
    ), shown.stdout
