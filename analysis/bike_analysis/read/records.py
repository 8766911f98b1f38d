"""Locations of the records in a chunk; compiled, because an hour of riding has millions of them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

RECORD_BYTES = 9
"""Opcode and length before each record of MCAP."""
MESSAGE_BYTES = 22
"""Channel, sequence number and two times before each message's data."""

_MESSAGE = 0x05


@njit(cache=True)
def _number(contents: NDArray[np.uint8], position: int, size: int) -> np.int64:
    """A little-endian number; values beyond 63 bits become negative, and are refused as a length."""
    value = np.int64(0)
    for k in range(size):
        value |= np.int64(contents[position + k]) << np.int64(8 * k)
    return value


@njit(cache=True)
def scan(
    contents: NDArray[np.uint8], bounds: NDArray[np.int64], messages: NDArray[np.int64], others: NDArray[np.int64]
) -> tuple[int, int, int]:
    """Walk through the records of chunks that lie next to each other.

    Args:
        contents: The chunks' contents.
        bounds: Where each chunk begins, and at last where the last one ends.
        messages: Filled with channel, log time, begin and end of the data, one row per message.
        others: Filled with opcode, begin and end of the content of all other records.

    Returns:
        Numbers of messages, of other records, and of chunks with a record that is incomplete: what stands before it
        counts.
    """
    found, rest, broken = 0, 0, 0
    for chunk in range(len(bounds) - 1):
        position, end = bounds[chunk], bounds[chunk + 1]
        while position < end:
            if position + RECORD_BYTES > end:
                broken += 1
                break
            opcode = contents[position]
            length = _number(contents, position + 1, 8)
            start = position + RECORD_BYTES
            if length < 0 or length > end - start or (opcode == _MESSAGE and length < MESSAGE_BYTES):
                broken += 1
                break
            position = start + length
            if opcode == _MESSAGE:
                messages[found, 0] = _number(contents, start, 2)
                messages[found, 1] = _number(contents, start + 6, 8)
                messages[found, 2] = start + MESSAGE_BYTES
                messages[found, 3] = position
                found += 1
            else:
                others[rest, 0] = opcode
                others[rest, 1] = start
                others[rest, 2] = position
                rest += 1
    return found, rest, broken
