"""Progress of a sweep: one bar over its runs, and one line for each that ends."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from typing import Any

from tqdm import tqdm

from bike_training.progress import progress_bar
from bike_training.sweeps.runs import FAILED, FINISHED


class Display(AbstractContextManager["Display"]):
    """Shows a sweep on standard error."""

    def __init__(self, total: int, missing: int, quiet: bool) -> None:
        """Show runs.

        Args:
            total: all runs of the sweep.
            missing: those that are to be done now.
            quiet: show nothing but failures.
        """
        self._quiet, self._total, self._done = quiet, total, total - missing
        self._shares: dict[str, float] = {}
        self._bar = progress_bar("runs", "run", total, quiet=quiet)
        self._bar.initial = self._bar.n = self._done

    def __exit__(self, *_: object) -> None:
        """Leave the terminal as it was."""
        self._bar.close()

    def show_progress(self, name: str, done: float, total: float, text: str) -> None:
        """Show how far a run has come."""
        self._shares[name] = min(1.0, done / total) if total else 0.0
        self._bar.set_postfix_str(f"{name}: {done:.0f} of {total:.0f} {text}", refresh=False)
        self._bar.update(round(self._done + sum(self._shares.values()), 2) - self._bar.n)

    def show_end(self, name: str, record: dict[str, Any]) -> None:
        """Show how a run has ended, in one line."""
        self._shares.pop(name, None)
        status = record["status"]
        self._done += status == FINISHED
        if status == FAILED:
            tqdm.write(f"{name}: failed: {record['error']}", file=sys.stderr)
        elif not self._quiet:
            took = f" after {tqdm.format_interval(record['seconds'])}" if "seconds" in record else ""
            tqdm.write(f"{name}: {status}{took} ({self._done} of {self._total} done)", file=sys.stderr)
