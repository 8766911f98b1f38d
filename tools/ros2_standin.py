#!/usr/bin/env python3
"""Stand-in for `ros2 run` where ros2cli is not available (it is not on PyPI).

`tools/setup` installs it into the project's environment as `ros2`, and only where there is no real one. It finds
executables as ros2run of Jazzy does, with the same messages and exit codes. One difference is meant: ros2run waits for
a child, which it leaves behind as an orphan on SIGTERM. The stand-in becomes the executable, so every signal reaches
the node and its exit code is the node's own; ros2run's closing line "[ros2run]: Process exited with failure N" is
therefore not printed.
"""

import argparse
import os
import shlex
import sys
from collections.abc import Sequence

from ament_index_python.packages import PackageNotFoundError, get_package_prefix


def executables(package: str, name: str) -> list[str]:
    """Finds the executables of a package, as ros2run does.

    Args:
        package: name of the ROS package.
        name: exact file name of the executable.

    Returns:
        Paths of executable files with that name below `lib/<package>` of the package's prefix, folders in order and
        those that begin with a dot left out.

    Raises:
        PackageNotFoundError: no ament index in AMENT_PREFIX_PATH knows the package.
        ValueError: the package name is empty or has characters that no package name has.
    """
    found = []
    for folder, subfolders, files in os.walk(os.path.join(get_package_prefix(package), "lib", package)):
        subfolders[:] = sorted(subfolder for subfolder in subfolders if not subfolder.startswith("."))
        path = os.path.join(folder, name)
        if name in files and os.access(path, os.X_OK):
            found.append(path)
    return found


def find_executable(package: str, name: str) -> str:
    """Returns the one executable of that name; ends the program with ros2run's message and exit code 1 otherwise."""
    try:
        paths = executables(package, name)
    except PackageNotFoundError:
        sys.exit(f"Package '{package}' not found")
    except ValueError as error:
        sys.exit(str(error))
    if not paths:
        sys.exit("No executable found")
    if len(paths) > 1:
        sys.exit("\n- ".join(["Multiple executables found:", *paths]))
    return paths[0]


def make_parser() -> argparse.ArgumentParser:
    """Makes the parser for the part of ros2's command line that the stand-in has."""
    parser = argparse.ArgumentParser(prog="ros2", description="Stand-in for `ros2 run`; all else needs ROS 2 itself.")
    commands = parser.add_subparsers(metavar="command", dest="command")
    run = commands.add_parser("run", help="run an executable of a package")
    run.add_argument("--prefix", help="command put before the executable, split by shell rules ('gdb -ex run --args')")
    run.add_argument("package_name", help="name of the ROS package")
    run.add_argument("executable_name", help="name of the executable")
    run.add_argument("argv", nargs=argparse.REMAINDER, help="arguments for the executable")
    return parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Becomes the executable that the command line names."""
    print("ros2: stand-in for `ros2 run`; ros2cli is not installed here", file=sys.stderr)
    parser = make_parser()
    options = parser.parse_args(arguments)
    if options.command is None:
        parser.print_help()
        return
    path = find_executable(options.package_name, options.executable_name)
    command = [*shlex.split(options.prefix or ""), path, *options.argv]
    sys.stdout.flush()
    try:
        os.execvp(command[0], command)
    except OSError as error:
        sys.exit(f"cannot run {command[0]}: {error.strerror}")


if __name__ == "__main__":
    main()
