"""Time stamps as messages carry them. Apart from `messages`, so that the recorder starts without the simulator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from builtin_interfaces.msg import Time

if TYPE_CHECKING:
    from bike_sim.sim.snapshot import Snapshot

NANOSECONDS: Final = 1_000_000_000


def time_to_message(nanoseconds: int) -> Time:
    """Return a time stamp."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def time_from_message(stamp: Time) -> int:
    """Return the nanoseconds of a time stamp."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def stamp_message(message: Any, snapshot: Snapshot, stamp: int, frame: str) -> None:
    """Fill the fields that tell of which moment a message is: its header, episode and step.

    Args:
        message: with these fields.
        snapshot: what the message is about.
        stamp: simulated time, ns.
        frame: name of the frame of its coordinates.
    """
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = frame
    message.episode = snapshot.episode
    message.step = snapshot.step
