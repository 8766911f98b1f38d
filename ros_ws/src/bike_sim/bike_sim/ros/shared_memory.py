"""What nodes that were killed have left in shared memory is removed. Imports no ROS.

Fast DDS keeps a segment of half a megabyte for a participant, and a port for each of its addresses. One that is killed
leaves them until the machine is restarted or the memory is full. Each has a lock file next to it that is locked as
long as its owner lives, which ``fastdds shm clean`` uses as well.

One that is killed in the moment in which it makes a port leaves that without content and without a lock. Fast DDS does
not mend it: whoever gets the port next hears nothing, and nobody is told.
"""

from __future__ import annotations

import fcntl
import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bike_sim.ros.isolation import FIRST_PORT, PORTS_PER_DOMAIN

SHARED_MEMORY: Final = Path("/dev/shm")
SETTLED: Final = 2.0
"""Age after which a lock file counts, s: one that is younger may not be locked yet by the process that made it."""

_SEGMENT: Final = re.compile(r"(fastrtps_[0-9a-f]{16})_[es]l")
_PORT_FILE: Final = re.compile(r"fastrtps_port\d{1,5}")
_PORT: Final = re.compile(r"(fastrtps_port(\d{1,5}))_[es]l")


@dataclass(frozen=True)
class _Lock:
    """A lock file of Fast DDS; `domain` is that of a port, -1 for a port of no domain in particular."""

    path: Path
    guarded: tuple[str, ...]
    domain: int | None


def remove_leftovers(folder: Path = SHARED_MEMORY, settled: float = SETTLED) -> int:
    """Remove what belongs to processes of this user that are gone.

    A port stays as long as its domain has living ones: who sends to it may not have noticed that its owner is gone.

    Args:
        folder: of the shared memory.
        settled: least age of a lock file, s.

    Returns:
        Number of segments and ports that were removed.
    """
    locks = list(_locks(folder))
    living = {lock.domain for lock in locks if lock.domain is not None and _is_held(lock.path)}
    removed = 0
    for lock in locks:
        if lock.domain in living or (lock.domain == -1 and living):
            continue
        with _taken(lock.path, settled) as mine:
            if mine:
                for name in (*lock.guarded, lock.path.name):
                    with suppress(OSError):
                        if (folder / name).lstat().st_uid == os.geteuid():
                            (folder / name).unlink()
                removed += 1
    return removed + _remove_empty_ports(folder)


def _remove_empty_ports(folder: Path) -> int:
    """Remove ports of this user without content that nobody is just making; return their number."""
    removed = 0
    with suppress(OSError):
        for path in folder.iterdir():
            if _PORT_FILE.fullmatch(path.name):
                with suppress(OSError):
                    status = path.lstat()
                    mine = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid()
                    if mine and status.st_size == 0 and not _is_open(path):
                        path.unlink()
                        removed += 1
    return removed


def _is_open(path: Path) -> bool:
    """Whether a process of this user has a file open."""
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):
            if os.readlink(link) == str(path):
                return True
    return False


def _locks(folder: Path) -> Iterator[_Lock]:
    with suppress(OSError):
        for name in sorted(os.listdir(folder)):
            if found := _SEGMENT.fullmatch(name):
                yield _Lock(folder / name, (found[1],), None)
            elif found := _PORT.fullmatch(name):
                domain = max((int(found[2]) - FIRST_PORT) // PORTS_PER_DOMAIN, -1)
                yield _Lock(folder / name, (found[1], f"sem.{found[1]}_mutex"), domain)


def _is_held(path: Path) -> bool:
    with _taken(path, 0.0, anybody=True) as free:
        return not free


@contextmanager
def _taken(path: Path, settled: float, anybody: bool = False) -> Iterator[bool]:
    """Lock a lock file if it is free; return whether it was.

    Args:
        path: the file. It is opened for reading only, and never through a link.
        settled: least age, s.
        anybody: whether it may belong to another user.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        yield False
        return
    try:
        status = os.fstat(file)
        usable = stat.S_ISREG(status.st_mode) and time.time() - status.st_mtime >= settled
        if usable and (anybody or status.st_uid == os.geteuid()):
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                yield False
                return
            yield True
        else:
            yield False
    finally:
        os.close(file)
