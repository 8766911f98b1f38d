"""Progress of a sweep: one line a run with the time left at a terminal, one line for what ends elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager
from typing import Any, Final

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from bike_training.sweeps.runs import FAILED, FINISHED

LOG_PERIOD_S: Final = 30.0
"""Wall-clock time between two lines of a run where there is no terminal, s."""


class Display(AbstractContextManager["Display"]):
    """Shows a sweep on standard error."""

    def __init__(self, total: int, missing: int, quiet: bool) -> None:
        """Show runs.

        Args:
            total: all runs of the sweep.
            missing: those that are to be done now.
            quiet: show nothing but failures.
        """
        self.console = Console(file=sys.stderr, highlight=False)
        self._quiet, self._total, self._left = quiet, total, missing
        self._done, self._failed = total - missing, 0
        self._lines: dict[str, TaskID] = {}
        self._logged: dict[str, float] = {}
        self._began: dict[str, tuple[float, float]] = {}
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("[dim]{task.fields[words]}"),
            console=self.console,
            disable=quiet or not self.console.is_terminal,
        )

    def __enter__(self) -> Display:
        """Begin to show."""
        self._bars.start()
        self._all = self._bars.add_task("[bold]all runs", total=self._total, completed=self._done, words="")
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the terminal as it was."""
        self._bars.stop()

    def show_progress(self, name: str, done: float, total: float, words: str) -> None:
        """Show how far a run has come."""
        if self._quiet:
            return
        now = time.monotonic()
        began, first = self._began.setdefault(name, (now, done))
        if self.console.is_terminal:
            if name not in self._lines:
                self._lines[name] = self._bars.add_task(escape(name), total=total, completed=int(done), words=words)
            self._bars.update(self._lines[name], completed=done, total=total, words=escape(words))
        elif now - self._logged.get(name, began) >= LOG_PERIOD_S and done > first:
            self._logged[name] = now
            left = (now - began) * (total - done) / (done - first)
            self._print(f"{name}: {done:.0f} of {total:.0f}, about {_clock(left)} left  {words}")

    def show_end(self, name: str, record: dict[str, Any]) -> None:
        """Show how a run has ended, in one line."""
        self._left -= 1
        if name in self._lines:
            self._bars.remove_task(self._lines.pop(name))
        status = record["status"]
        self._failed += status == FAILED
        self._done += status == FINISHED
        self._bars.update(self._all, completed=self._done, words=f"{self._failed} failed" if self._failed else "")
        if status == FAILED:
            self.console.print(f"{escape(name)}: [red]failed[/red]: {escape(record['error'])}", soft_wrap=True)
        elif not self._quiet:
            time_text = f" after {_clock(record['seconds'])}" if "seconds" in record else ""
            self._print(f"{name}: {status}{time_text} ({self._done} of {self._total} done)")

    def _print(self, text: str) -> None:
        self.console.print(escape(text), soft_wrap=True)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
