"""Things in a folder that are no regular files, for tests that they are refused."""

from __future__ import annotations

import os
import socket
from pathlib import Path

ODD = ("pipe", "socket", "device", "folder")


def put_odd_file(path: Path, kind: str) -> str:
    """Put something in the present folder that is no regular file; return what a message says of it."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":  # its path is short: tests are in the folder
        socket.socket(socket.AF_UNIX).bind(path.name)
    elif kind == "device":
        os.symlink("/dev/zero", path)
    else:
        path.mkdir()
        return "cannot be read: Is a directory"
    return "is no file but a pipe, a socket or a device"
