"""How nodes find each other: on this machine only, soon, and not those of another simulator. Imports no ROS."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import MutableMapping
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

DISCOVERY_VARIABLE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
DOMAIN_VARIABLE: Final = "ROS_DOMAIN_ID"
PROFILES_VARIABLE: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Names the settings of Fast DDS; other middleware takes no notice."""
PROFILES: Final = Path(__file__).parents[1] / "config" / "middleware" / "fastdds.xml"
LOCAL_PROFILES: Final = "DEFAULT_FASTRTPS_PROFILES.xml"
"""Settings of a user in the working directory, which Fast DDS reads by itself."""

FIRST_DOMAIN: Final = 1
LAST_DOMAIN: Final = 101
"""Domains that are lent out. 0 is everyone's default; above 101 ports collide with those that the kernel hands out."""


def prepare_discovery(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let nodes be found on this machine only, and soon, unless the user says otherwise.

    Args:
        environment: of the process that will have the nodes; it must not have had one yet.
    """
    environment.setdefault(DISCOVERY_VARIABLE, "LOCALHOST")
    if not Path(LOCAL_PROFILES).exists():
        environment.setdefault(PROFILES_VARIABLE, str(PROFILES))


class DomainLease:
    """A ROS domain that no other lease on this machine has, held until `close` or the end of the process.

    Attributes:
        domain_id: the domain.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """Take the first free domain, beginning at one that depends on the process.

        Args:
            folder: where the lock files lie; by default a folder for this user among the temporary files.

        Raises:
            OSError: every domain is taken, or the folder cannot be written.
        """
        folder = folder or Path(tempfile.gettempdir()) / f"bike_domains_{os.getuid()}"
        folder.mkdir(parents=True, exist_ok=True)
        count = LAST_DOMAIN - FIRST_DOMAIN + 1
        for k in range(count):
            domain_id = FIRST_DOMAIN + (os.getpid() + k) % count
            file = open(folder / f"{domain_id}.lock", "w")  # noqa: SIM115 - held open: the lock lives as long as the file
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.close()
                continue
            self._file: IO[str] = file
            self.domain_id = domain_id
            return
        raise OSError(f"all ROS domains from {FIRST_DOMAIN} to {LAST_DOMAIN} are taken (locks in {folder})")

    def close(self) -> None:
        """Give the domain back."""
        self._file.close()

    def __enter__(self) -> Self:
        """Return the lease."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the domain back."""
        self.close()
