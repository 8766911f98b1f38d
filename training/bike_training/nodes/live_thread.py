"""A ride that a page shows, in a thread of its own: what `LiveRide` and `LiveWatch` have in common.

Others put requests into it and get told about states and events; nothing else is shared.
"""

from __future__ import annotations

import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

from bike_analysis.read.messages import Simulation
from bike_sim.course.course import Course


class LiveThread(ABC):
    """Goes on until `end`; requests come through `ask`.

    Attributes:
        course: the followed line, once the ride has begun.
        domain_id: ROS domain of its nodes, likewise.
        settings: control period, s, and how the motion is computed, likewise.
    """

    thread_name: ClassVar[str]
    course: Course | None = None
    domain_id = 0
    settings: tuple[float, Simulation | None] = (0.0, None)

    def __init__(self, tell: Callable[[dict[str, Any]], None]) -> None:
        """Prepare.

        Args:
            tell: called from the ride's thread with each message for the page; the last one is ``{"ended": True}``.
        """
        self._tell = tell
        self._requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._begun = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=self.thread_name, daemon=True)

    def start(self) -> None:
        """Begin, and return when course and first state are there.

        Raises:
            NodeLost: no simulator appeared. ValueError: a rider that cannot ride this.
        """
        self._thread.start()
        self._begun.wait()
        self.check()

    def check(self) -> None:
        """Raise what ended the ride, if anything did."""
        if self._failure is not None:
            raise self._failure

    def end(self) -> None:
        """End, and wait until all that was opened is closed."""
        self._ended.set()
        self._thread.join()

    def ask(self, request: dict[str, Any]) -> None:
        """Put in a request, checked by `checked_request`."""
        self._requests.put(request)

    @abstractmethod
    def status(self) -> dict[str, Any]:
        """Return how the ride goes on, for the page; from any thread."""

    # ------------------------------------------------------------------------------------------------ in its own thread

    @abstractmethod
    def _live(self) -> None:
        """Set `_begun` once course and first state are there, and return when `_ended` is set."""

    def _run(self) -> None:
        try:
            self._live()
        except BaseException as error:
            self._failure = error
        finally:
            self._begun.set()
            self._tell({"ended": True})

    def _asked(self) -> Iterator[dict[str, Any]]:
        """Take the requests that wait."""
        while not self._requests.empty():
            yield self._requests.get()
