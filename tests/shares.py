"""Message definitions from source directories, for tests of recordings without a built workspace."""

import os
from pathlib import Path

from bike_sim.recording.definitions import ShareResolver


def source_share(*roots: str | os.PathLike[str]) -> ShareResolver:
    """Return a resolver that finds packages in the first of some directories that has them."""
    directories = [Path(root) for root in roots]

    def resolve(package: str) -> Path:
        for directory in directories:
            if (directory / package / "msg").is_dir():
                return directory / package
        searched = ", ".join(str(d) for d in directories)
        raise FileNotFoundError(f"no messages of package {package!r} in {searched}")

    return resolve


def first_share(*resolvers: ShareResolver) -> ShareResolver:
    """Make a resolver that asks several in order and takes the first answer."""

    def resolve(package: str) -> Path:
        failures = []
        for resolver in resolvers:
            try:
                return resolver(package)
            except FileNotFoundError as error:
                failures.append(str(error))
        raise FileNotFoundError("; ".join(failures))

    return resolve
