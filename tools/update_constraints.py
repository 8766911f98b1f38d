#!/usr/bin/env python3
"""Writes requirements/constraints.txt: the versions that are installed, where they come from, and how large they are.

Each line is a version, the requirement file that brings it (the first of STAGES that does) and the size of its wheel,
from which the set-up knows what is still to come. Left out are PyTorch and what its builds bring along, because they
differ from machine to machine, and what was installed from a folder.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from install_wheels import CONSTRAINTS, normal

STAGES = ("runtime", "build", "ros", "training", "sweep", "dev")
"""Requirement files in the order in which they are installed."""

HEAD = """\
# Versions of everything that the pinned packages pull in, as tested together, each with the requirement file that
# brings it and the size of its wheel. Refresh: tools/update-constraints
"""
_ELSEWHERE = re.compile(r"(torch$|nvidia|triton|cuda|pip$)")


def installed_versions() -> dict[str, tuple[str, str]]:
    """Return name and version of what pip has installed from an index, by normal name."""
    found = {}
    for package in distributions():
        by_pip = (package.read_text("INSTALLER") or "").strip() == "pip" and not package.read_text("direct_url.json")
        if by_pip and not _ELSEWHERE.match(package.name):
            found[normal(package.name)] = (package.name, package.version)
    return found


def resolve(stages: Sequence[str], constraints: Path) -> dict[str, str]:
    """Return the files that an empty environment would get for stages: addresses by normal name."""
    files = [word for stage in stages for word in ("-r", str(CONSTRAINTS.with_name(f"{stage}.txt")))]
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--report", "-"]
    report = subprocess.run([*command, *files, "-c", str(constraints)], check=True, capture_output=True, text=True)
    entries: list[dict[str, Any]] = json.loads(report.stdout)["install"]
    return {normal(entry["metadata"]["name"]): entry["download_info"]["url"] for entry in entries}


def size(address: str) -> float:
    """Return the size of a file, MB."""
    if address.startswith("file://"):
        with urllib.request.urlopen(address, timeout=60) as answer:
            return int(answer.headers["Content-Length"]) / 1e6
    request = urllib.request.Request(address, method="HEAD")
    with urllib.request.urlopen(request, timeout=60) as answer:
        return int(answer.headers["Content-Length"]) / 1e6


def text_of(versions: Mapping[str, tuple[str, str]], origins: Mapping[str, str], sizes: Mapping[str, float]) -> str:
    """Return the file's text; a version that no stage brings (any more) is left out.

    Args:
        versions: name and version by normal name.
        origins: stage by normal name.
        sizes: size of the wheel by normal name, MB.
    """
    lines = [
        f"{name}=={version}  # {origins[key]}, {max(sizes[key], 0.01):.2f} MB\n"
        for key, (name, version) in sorted(versions.items())
        if key in origins
    ]
    return HEAD + "".join(lines)


def main() -> None:
    """Write the file."""
    versions = installed_versions()
    origins: dict[str, str] = {}
    addresses: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        pins = Path(folder) / "pins.txt"
        pins.write_text("".join(f"{name}=={version}\n" for name, version in versions.values()), encoding="utf-8")
        for count, stage in enumerate(STAGES, start=1):
            print(f"resolving {stage}", file=sys.stderr)
            found = resolve(STAGES[:count], pins)
            addresses |= found
            origins = {key: stage for key in found} | origins
    wanted = sorted(versions.keys() & origins.keys())
    with ThreadPoolExecutor(8) as pool:
        sizes = dict(zip(wanted, pool.map(size, [addresses[key] for key in wanted]), strict=True))
    scratch = CONSTRAINTS.with_suffix(".tmp")
    scratch.write_text(text_of(versions, origins, sizes), encoding="utf-8")
    scratch.replace(CONSTRAINTS)


if __name__ == "__main__":
    main()
