"""Packages that learning, explaining, sweeps, Parquet files and Foxglove need and riding does not.

The set-up for riding leaves them out because they are several times as large as all else; a second one brings them.
"""

from __future__ import annotations

import os
import subprocess
import sys
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
SWEEP_PACKAGES: Final = frozenset({"optuna", "ray"})
"""The same of those that a sweep needs besides."""

SETUP: Final = Path(__file__).resolve().parents[2] / "tools" / "setup"
"""The set-up of the checkout that this package is run from; of an installed wheel there is none."""


def missing_package(error: ImportError) -> str | None:
    """Return which of them an import did not find, or None where it failed for another reason."""
    name = (error.name or "").partition(".")[0]
    return name if isinstance(error, ModuleNotFoundError) and name in PACKAGES | SWEEP_PACKAGES else None


def offer(command: str, package: str) -> int:
    """Ask whether to install them, do so and begin this program anew; where nobody can be asked, say what to run.

    Args:
        command: name of the command that needs them.
        package: the one that is missing.

    Returns:
        2, where they are not installed.
    """
    stage, whose = ("sweep", "packages of sweeps") if package in SWEEP_PACKAGES else ("training", "learning packages")
    reason = f"bike {command}: this needs the {whose} ({package} is not installed)"
    if not SETUP.is_file():
        print(f"{reason}; run: pip install 'two-wheeler-lab[all]'", file=sys.stderr)
    elif not sys.stdin.isatty() or not sys.stderr.isatty():
        print(f"{reason}; run: make setup-{stage}", file=sys.stderr)
    else:
        print(f"{reason}. Install them now? [Y/n] ", end="", file=sys.stderr, flush=True)
        if sys.stdin.readline().strip().lower() in ("", "y", "yes"):
            if subprocess.run([SETUP, stage], check=False).returncode == 0:
                os.execv(sys.executable, sys.orig_argv)
        else:
            print(f"nothing was installed; `make setup-{stage}` does it later", file=sys.stderr)
    return 2
