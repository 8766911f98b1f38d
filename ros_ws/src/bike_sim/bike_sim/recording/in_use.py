"""Locks of files and folders that one process writes at a time; a second one is refused and destroys nothing.

The lock is the kernel's (``flock``) on the file or folder itself. It leaves no file behind and ends with its process,
even a killed one; reading is free. Where a file system has no such locks, as some network ones, nothing is refused.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Final

LOCKS: Final = Path("/proc/locks")
_NO_LOCKS: Final = (errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


class Claim(AbstractContextManager["Claim"]):
    """A file or folder that this process alone writes, until `close` or its end."""

    def __init__(self, path: Path, what: str, hint: str = "") -> None:
        """Claim it.

        Args:
            path: an existing folder or file. A link counts as its target.
            what: word for it in an error, such as ``folder``.
            hint: what to do instead, for the error.

        Raises:
            OSError: another claim holds it, or it cannot be opened, or is a named pipe.
        """
        folder = path.is_dir()
        # A file is opened for writing, which some file systems require; non-blocking, because of named pipes.
        mode = os.O_RDONLY | os.O_DIRECTORY if folder else os.O_RDWR | os.O_NONBLOCK
        self._file: int | None = os.open(path, mode | os.O_CLOEXEC)
        try:
            if stat.S_ISFIFO(os.fstat(self._file).st_mode):
                raise OSError(f"{what} {path} is a named pipe, which no file can take the place of")
            self._lock(f"{what} {path}", hint)
        except BaseException:
            self.close()
            raise

    def _lock(self, named: str, hint: str) -> None:
        assert self._file is not None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = _holder(self._file)
            by = f"process {holder}" if holder else "another process"
            raise BlockingIOError(f"{named} is in use by {by}{hint and '; '}{hint}") from error
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise

    def close(self) -> None:
        """Give it back, also where a child process has inherited it. A second call does nothing."""
        file, self._file = self._file, None
        if file is not None:
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_UN)
            os.close(file)

    def __exit__(self, *_: object) -> None:
        """Give it back."""
        self.close()


def claim_folder(path: Path) -> Claim:
    """Claim the folder of a command's results.

    Args:
        path: the folder.

    Raises:
        OSError: another process has claimed it.
    """
    return Claim(path, "folder", "choose another with --out")


def _holder(file: int) -> int | None:
    """Return the number of the process that holds the lock of a file, where the kernel reports it."""
    status = os.fstat(file)
    device = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    found = None
    try:
        lines = LOCKS.read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        words = line.split()  # 1: FLOCK ADVISORY WRITE process major:minor:inode start end
        if len(words) < 6 or words[1] != "FLOCK" or words[5].rpartition(":")[2] != str(status.st_ino):
            continue
        if words[5] == device:
            return int(words[4]) if int(words[4]) > 0 else None
        found = int(words[4])  # some file systems number their devices otherwise here
    return found if found and found > 0 else None
