"""Compares records in every field, floating-point numbers bit by bit; two NaN are the same."""

from __future__ import annotations

import struct
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def assert_same(a: Any, b: Any, but: tuple[str, ...] = (), where: str = "") -> None:
    """Compare two records, or two values of them.

    Args:
        a: what was found.
        b: what it should be.
        but: fields of the record that may differ.
        where: field that is compared, for the message.
    """
    if is_dataclass(a):
        assert type(a) is type(b), where
        for spec in fields(a):
            if spec.name not in but:
                assert_same(getattr(a, spec.name), getattr(b, spec.name), (), f"{where}.{spec.name}")
    elif isinstance(a, tuple):
        assert isinstance(b, tuple), where
        assert len(a) == len(b), f"{where}: {a} and {b}"
        for k, (one, other) in enumerate(zip(a, b, strict=True)):
            assert_same(one, other, (), f"{where}[{k}]")
    elif isinstance(a, np.ndarray):
        assert isinstance(b, np.ndarray), where
        assert (a.dtype, a.shape) == (b.dtype, b.shape), where
        assert a.tobytes() == b.tobytes(), f"{where}: {a} and {b}"
    elif isinstance(a, float):
        assert struct.pack("d", a) == struct.pack("d", b), f"{where}: {a!r} and {b!r}"
    else:
        assert a == b, f"{where}: {a!r} and {b!r}"
