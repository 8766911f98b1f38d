"""A node that a program started for itself ends when that program is gone, however it went. Imports no ROS."""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from typing import Final

PARENT_VARIABLE: Final = "BIKE_PARENT"
"""Number of the process that a node is to end with; not set where a node is started by hand."""

PARENT_PERIOD: Final = 0.25
"""Wall-clock time between two looks at the parent, s."""


def end_with_this_process(environment: MutableMapping[str, str]) -> None:
    """Let a node that is started with an environment end with this process."""
    environment[PARENT_VARIABLE] = str(os.getpid())


def parent_is_gone() -> bool:
    """Return whether this process has lost the one that it is to end with.

    It is polled. The kernel's own signal for this (PR_SET_PDEATHSIG) comes when the thread ends that
    started the process, and would end the nodes of a program that starts them in a thread; the number of the parent is
    that of the program. It is also right where the parent was gone before the first look.
    """
    parent = os.environ.get(PARENT_VARIABLE)
    return parent is not None and parent != str(os.getppid())
