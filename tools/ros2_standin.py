#!/usr/bin/env python3
"""Stand-in for `ros2 run` where ros2cli is not available (it is not on PyPI).

`tools/setup` installs it into the project's environment as `ros2`, and only where there is no real one. It becomes the
executable, so every signal reaches the node and its exit code is the node's own.
"""

import argparse
import os
import sys
from collections.abc import Sequence

from ament_index_python.packages import PackageNotFoundError, get_package_prefix


def main(arguments: Sequence[str] | None = None) -> None:
    """Becomes the executable that the command line names; ends with ros2run's message where there is none."""
    print("ros2: stand-in for `ros2 run`; ros2cli is not installed here", file=sys.stderr)
    parser = argparse.ArgumentParser(prog="ros2", description="Stand-in for `ros2 run`; all else needs ROS 2 itself.")
    run = parser.add_subparsers(metavar="command", required=True).add_parser("run", help="run a package's executable")
    run.add_argument("package_name", help="name of the ROS package")
    run.add_argument("executable_name", help="name of the executable")
    run.add_argument("argv", nargs=argparse.REMAINDER, help="arguments for the executable")
    options = parser.parse_args(arguments)
    try:
        folder = os.path.join(get_package_prefix(options.package_name), "lib", options.package_name)
    except (PackageNotFoundError, ValueError):
        sys.exit(f"Package '{options.package_name}' not found")
    path = os.path.join(folder, options.executable_name)
    if not (os.path.isfile(path) and os.access(path, os.X_OK)):
        sys.exit("No executable found")
    try:
        os.execv(path, [path, *options.argv])
    except OSError as error:
        sys.exit(f"cannot run {path}: {error.strerror}")


if __name__ == "__main__":
    main()
