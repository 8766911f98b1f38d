"""Packages that not every command needs: those of learning, explaining, sweeps, Parquet files and Foxglove, and ROS 2.

The set-up for riding leaves the former out because they are several times as large as all else; a second one brings
them. The wheel brings neither ROS 2 nor the messages.
"""

from __future__ import annotations

import json
import re
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Final

PACKAGES: Final = frozenset(
    {
        "foxglove",
        "gymnasium",
        "jax",
        "jaxlib",
        "pyarrow",
        "sbx",
        "shap",
        "stable_baselines3",
        "tensorboard",
        "threadpoolctl",
        "torch",
    }
)
"""Names of those of learning, as they are imported."""
SWEEP_PACKAGES: Final = frozenset({"ray"})
"""The same of those that a sweep needs besides."""

ROS_PACKAGES: Final = re.compile(r"(rclpy|rosidl\w*|ament_index_python|builtin_interfaces|\w+_(msgs|interfaces))$")
"""Modules that come with ROS 2, or are built in its workspace."""
DISTRIBUTION: Final = "two-wheeler-lab"
"""Name of the wheel. No index has it, so that no advice may leave an installer to look for it there."""

SETUP: Final = Path(__file__).resolve().parents[2] / "tools" / "setup"
"""The set-up of the checkout that this package is run from; of an installed wheel there is none."""


def missing_package(error: ImportError) -> str | None:
    """Return which of them an import did not find, or None where it failed for another reason."""
    name = (error.name or "").partition(".")[0]
    known = name in PACKAGES | SWEEP_PACKAGES or ROS_PACKAGES.match(name)
    return name if isinstance(error, ModuleNotFoundError) and known else None


def advise(command: str, package: str) -> None:
    """Print what to run for a package that a command needs and that is missing."""
    if ROS_PACKAGES.match(package):
        print(
            f"bike {command}: this needs ROS 2 ({package} is not installed): run make setup in a checkout, see "
            "docs/how-to/install.md; without ROS there are superbikes (bike ride --course barcelona), evaluate, train, "
            "analyze and validate",
            file=sys.stderr,
        )
        return
    stage, whose = ("sweep", "packages of sweeps") if package in SWEEP_PACKAGES else ("training", "learning packages")
    reason = f"bike {command}: this needs the {whose} ({package} is not installed)"
    way = f"make setup-{stage}" if SETUP.is_file() else f"pip install '{DISTRIBUTION}[all] @ {_origin()}'"
    print(f"{reason}; run: {way}", file=sys.stderr)


def _origin() -> str:
    """Return the address that this wheel was installed from."""
    try:
        known = json.loads(distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    except PackageNotFoundError:
        known = {}
    return str(known.get("url", "file:///path/of/the.whl"))
