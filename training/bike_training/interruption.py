"""Signals that end a program: how they are taken, and which one came."""

from __future__ import annotations

import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Final, NoReturn

from bike_training.envs.node_process import tell_all_to_end

ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a program."""

SHELL_BASE: Final = 128
"""A program that a signal ended has this and the number of the signal as its exit code, as shells have it."""

AGAIN_AFTER: Final = 0.05
"""Wall-clock time after which an interruption that came at a bad moment is tried again, s."""

UNINTERRUPTIBLE_MODULES: Final = ("importlib._bootstrap", "weakref", "_weakrefset")
"""Modules in whose functions an exception may become another error, or nothing."""

Handler = Callable[[int, FrameType | None], object]


_came: list[int] = []
"""Signals that were handled."""


@contextmanager
def signals_noted() -> Iterator[Callable[[], int]]:
    """Take note of signals that end a program, whichever handler takes them: learning has one of its own.

    Yields:
        A function that returns the exit code of the first signal that came, or 0.
    """
    before = len(_came)
    yield lambda: SHELL_BASE + _came[before] if len(_came) > before else 0


def _note(handler: Handler, number: int, frame: FrameType | None) -> object:
    _came.append(number)
    return handler(number, frame)


@contextmanager
def signals_handled(handler: Handler) -> Iterator[None]:
    """Let a handler take the signals that end a program while the block lasts; one that is ignored stays so (nohup)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, partial(_note, handler)) for number in numbers}
    try:
        yield
    finally:
        for number, handled in before.items():
            signal.signal(number, handled)


def leave_at_once(number: int, frame: FrameType | None) -> NoReturn:
    """End the process: for the time in which it loads its modules and has nothing to close.

    An exception would not do: extension modules turn one that comes while they are loaded into errors of their own.
    """
    os.write(2, b"interrupted\n")
    os._exit(SHELL_BASE + number)


def interrupt(number: int, frame: FrameType | None) -> None:
    """Request the nodes to end and raise KeyboardInterrupt, as soon as something can catch it.

    Raises:
        KeyboardInterrupt: always, but later where it would be lost or taken for another error.
    """
    tell_all_to_end()
    if not _would_lose_it(frame):
        raise KeyboardInterrupt
    again = threading.Timer(AGAIN_AFTER, _signal_again, [number])
    again.daemon = True
    again.start()


def _signal_again(number: int) -> None:
    ident = threading.main_thread().ident
    if getattr(signal.getsignal(number), "args", None) == (interrupt,) and ident is not None:
        signal.pthread_kill(ident, number)


def _would_lose_it(frame: FrameType | None) -> bool:
    """Whether a module is being loaded, or Python calls what it ignores exceptions of.

    That is a destructor, a callback of garbage collection, or a callback of the standard library's weak references.
    """
    ignored = [getattr(callback, "__code__", None) for callback in gc.callbacks]
    while frame is not None:
        code = frame.f_code
        if frame.f_globals.get("__name__") in UNINTERRUPTIBLE_MODULES or code.co_name == "__del__" or code in ignored:
            return True
        frame = frame.f_back
    return False
