"""Time stamps as messages carry them. Apart from `messages`, so that the recorder starts without the simulator."""

from __future__ import annotations

from typing import Final

from builtin_interfaces.msg import Time

NANOSECONDS: Final = 1_000_000_000


def time_to_message(nanoseconds: int) -> Time:
    """Return a time stamp."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def time_from_message(stamp: Time) -> int:
    """Return the nanoseconds of a time stamp."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)
