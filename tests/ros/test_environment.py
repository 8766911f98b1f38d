"""The project's environment in a plain shell: nothing is sourced, and no variable is set."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAMS = [("bike_sim", "sim_node"), ("bike_sim", "record"), ("bike_policy", "drive")]


def plain_python(code: str, **environment: str) -> str:
    """Standard output of a Python that gets these environment variables and no others."""
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=90, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


# What a Python of another environment with ROS 2 wheels hands down to its children.
FOREIGN = {
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    "LD_LIBRARY_PATH": "/elsewhere/lib",
    "AMENT_PREFIX_PATH": "/elsewhere",
}


@pytest.mark.parametrize("environment", [{}, FOREIGN], ids=["plain", "inherited from another environment"])
def test_messages_go_through_the_compiled_type_support(environment: dict[str, str]) -> None:
    code = """
from bike_msgs.msg import BikeState
from rclpy.serialization import deserialize_message, serialize_message
state = deserialize_message(serialize_message(BikeState(lateral_error=0.25, preview_x=[1.0, 2.0])), BikeState)
print(state.lateral_error, list(state.preview_x))
"""
    assert plain_python(code, **environment) == "0.25 [1.0, 2.0]"


def test_ament_index_knows_the_packages() -> None:
    packages = ["bike_bringup", "bike_msgs", "bike_policy", "bike_sim"]
    code = f"from ament_index_python.packages import get_package_prefix as find; print(*map(find, {packages}))"
    assert {Path(prefix).resolve() for prefix in plain_python(code).split()} == {Path(sys.prefix).resolve()}


def test_packages_are_imported_from_the_sources() -> None:
    """Every place that Python would find a package in is the same folder: no second copy can get ahead of it."""
    sources = {"bike_sim": "ros_ws/src/bike_sim", "bike_policy": "ros_ws/src/bike_policy"}
    sources |= {"bike_training": "training", "bike_analysis": "analysis"}
    code = f"""
import sys
from pathlib import Path
for name in {[*sources]}:
    print(*{{(Path(place) / name).resolve() for place in sys.path if (Path(place) / name).exists()}})
"""
    assert plain_python(code).splitlines() == [
        str((ROOT / source / package).resolve()) for package, source in sources.items()
    ]


@pytest.mark.parametrize(("package", "program"), PROGRAMS, ids=[program for _, program in PROGRAMS])
def test_programs_are_installed_where_ros2_run_looks(package: str, program: str) -> None:
    path = Path(sys.prefix) / "lib" / package / program
    assert os.access(path, os.X_OK)
    interpreter = Path(path.read_text().splitlines()[0].removeprefix("#!"))
    assert interpreter.parent.samefile(Path(sys.prefix) / "bin")


def test_an_installed_ros2_is_not_shadowed() -> None:
    standin = Path(sys.prefix) / "bin" / "ros2"
    if Path("/opt/ros", os.environ.get("ROS_DISTRO", "jazzy")).exists():
        assert not standin.exists()
    else:
        assert "stand-in" in standin.read_text()
