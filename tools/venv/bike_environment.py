"""Search paths of ROS 2, set once when a Python of the project's virtual environment starts.

`tools/setup` copies this file into the environment's site-packages beside `bike_environment.pth`, which imports it
before anything else runs. Every program of the environment (`bike`, the nodes, the tests, a plain `python`) then finds
the message packages, their shared libraries and the ament index without a sourced shell. This is the only place where
the project sets these variables:

* `AMENT_PREFIX_PATH` gets the environment itself (colcon installs the workspace into it), then `/opt/ros/DISTRIBUTION`.
* `ROS_DISTRO` gets the distribution that `tools/setup` chose, where it is not set.
* `LD_LIBRARY_PATH` gets the libraries of both. The dynamic loader reads it when a process starts, so Python restarts
  itself once. The ROS 2 wheels bring `ros_wheels_bootstrapper`, which does the same and marks it in
  `_ROS_WHEELS_BOOTSTRAP_COMPLETE`; but it trusts a mark inherited from another environment, and its order of the
  directories changes from run to run. This module comes first and leaves it nothing to do.
* `sys.path` gets the Python packages of an installed ROS 2, at its end.
"""

import os
import sys



def _distribution() -> str:
    """Name of the distribution of ROS 2 that the environment was made for."""
    try:
        with open(os.path.join(sys.prefix, "stamps", "distribution"), encoding="utf-8") as file:
            return file.read().strip()
    except OSError:
        return "jazzy"


ROS_ROOT = os.path.join("/opt/ros", _distribution())
WHEELS_MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


def _children(directory: str, ending: str) -> list[str]:
    """Sorted paths in `directory` whose name ends in `ending`; none where the directory does not exist."""
    names = sorted(os.listdir(directory)) if os.path.isdir(directory) else []
    return [os.path.join(directory, name) for name in names if name.endswith(ending)]


def _site_packages(prefix: str) -> str:
    """Directory of Python packages below `prefix`."""
    return os.path.join(prefix, "lib", f"python{sys.version_info.major}.{sys.version_info.minor}", "site-packages")


def _library_directories() -> list[str]:
    """Directories of shared libraries: the workspace, those bundled in the wheels, an installed ROS 2."""
    bundles = _children(_site_packages(sys.prefix), ".libs")
    bundled = [path for path in bundles if os.path.basename(path).startswith("ros_")]
    vendored = [os.path.join(path, "lib") for path in _children(os.path.join(ROS_ROOT, "opt"), "")]
    directories = [os.path.join(sys.prefix, "lib"), *bundled, os.path.join(ROS_ROOT, "lib"), *vendored]
    return [directory for directory in directories if os.path.isdir(directory)]


def _prepend(variable: str, directories: list[str]) -> None:
    """Puts `directories` in front of the search path `variable`; each entry stays once, empty ones go."""
    present = os.environ.get(variable, "").split(os.pathsep)
    os.environ[variable] = os.pathsep.join(dict.fromkeys(entry for entry in directories + present if entry))


def apply() -> None:
    """Sets the search paths of this process and of all that it starts; restarts Python where the loader needs it."""
    os.environ.setdefault("ROS_DISTRO", _distribution())
    _prepend("AMENT_PREFIX_PATH", [prefix for prefix in (sys.prefix, ROS_ROOT) if os.path.isdir(prefix)])
    if os.path.isdir(_site_packages(ROS_ROOT)) and _site_packages(ROS_ROOT) not in sys.path:
        sys.path.append(_site_packages(ROS_ROOT))
    first_library_directory = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)[0]
    if first_library_directory != os.path.join(sys.prefix, "lib"):
        _prepend("LD_LIBRARY_PATH", _library_directories())
        os.environ[WHEELS_MARK] = "1"
        os.execv(sys.executable, sys.orig_argv)


apply()
