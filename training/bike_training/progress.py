"""What commands show: bars of progress at a terminal, and lines of it in a log."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, Final

from tqdm import tqdm

LOG_EVERY: Final = 10.0
"""Wall-clock time between lines of progress in a log, s: they must not fill it."""


class _Lines:
    """Standard error that gets whole lines of what tqdm writes over one another."""

    encoding = "utf-8"

    def write(self, text: str) -> None:
        """Write a line."""
        if text.strip():
            print(text.strip(), file=sys.stderr, flush=True)

    def flush(self) -> None:
        """Do nothing: lines are flushed."""


def told_parts(text: str, quiet: bool) -> Callable[[str], None]:
    """Return a function that prints which part of something is being done on standard error, unless quiet."""
    return lambda part: None if quiet else print(f"{text}: {part}", file=sys.stderr, flush=True)


def progress_bar(title: str, unit: str, total: int | None = None, *, quiet: bool = False, leave: bool = True) -> Any:
    """Return a tqdm bar. Where there is no terminal it is a line at once and one every ten seconds.

    Args:
        title: activity, for the bar.
        unit: of the total.
        total: when it is done; None while it is not known.
        quiet: whether nothing is shown.
        leave: whether the bar stays at a terminal when it is done.
    """
    done = f"{{n_fmt}}/{{total_fmt}} {unit} [{{elapsed}}<{{remaining}}{{postfix}}]"
    options: dict[str, Any] = {"bar_format": f"{{l_bar}}{{bar}}| {done}", "leave": leave}
    if not sys.stderr.isatty():
        options = {"bar_format": f"{{desc}}: {done}", "file": _Lines(), "mininterval": LOG_EVERY}
    return tqdm(desc=title, total=total, unit=unit, smoothing=0.05, disable=quiet, **options)


def setter(bar: Any) -> Callable[[int, int], None]:
    """Return a function that sets a bar to the work done of the whole work."""

    def report(done: int, total: int) -> None:
        bar.total = total
        bar.update(done - bar.n)

    return report
