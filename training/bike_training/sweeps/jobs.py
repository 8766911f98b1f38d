"""What a run of a sweep can do; a new kind is a class as below and an entry in JOBS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol, Self

from bike_training.sweeps.job_parts import JobEnd, Tell
from bike_training.sweeps.riding_jobs import EvaluateJob, LapJob
from bike_training.sweeps.training_job import TrainJob


class Job(Protocol):
    """A run that has been checked. Its result depends on its entries alone.

    Attributes:
        cores: processor cores that one needs. memory_gb: main memory that one needs, GB.
        axis: what its curves are drawn over, with its unit.
    """

    cores: ClassVar[float]
    memory_gb: ClassVar[float]
    axis: ClassVar[str]

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Check entries.

        Raises:
            ValueError: one is unknown, missing or means nothing. FileNotFoundError: no such vehicle, course or rider.
        """
        ...

    def estimate(self) -> float:
        """Return the processor time that it will take, s, from measured costs (docs/notes/scaling.md)."""
        ...

    def run(self, folder: Path, tell: Tell) -> JobEnd:
        """Do it, or go on with what is in its folder."""
        ...

    @staticmethod
    def curve(folder: Path) -> list[tuple[str, float, float]]:
        """Return its curves as rows of quantity, place on the axis, and value."""
        ...


JOBS: Final[dict[str, type[Job]]] = {"train": TrainJob, "evaluate": EvaluateJob, "lap": LapJob}
"""Every kind of run by the name of its task."""
