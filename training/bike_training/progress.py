"""What commands show: bars of progress at a terminal, lines of it in a log, and tables."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Literal

from tqdm import tqdm

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

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


@contextmanager
def status(console: Console, text: str) -> Iterator[Callable[[str], None]]:
    """Show what is being done; where there is no terminal, each part of it is a line on standard error.

    Yields:
        A function that takes the name of the part.
    """
    with console.status(text) as shown:

        def report(part: str) -> None:
            if console.is_terminal:
                shown.update(f"{text}: {part}")
            elif not console.quiet:
                print(f"{text}: {part}", file=sys.stderr, flush=True)

        yield report


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


def text_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> Table:
    """Return a table for people.

    Args:
        title: above it.
        headings: of the columns.
        rows: their cells.
        left: number of columns of text, which come first; the others stand on the right.
    """
    from rich import box  # late: most of what shows progress needs no table
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE, pad_edge=False)
    for place, heading in enumerate(headings):
        justify: Literal["left", "right"] = "left" if place < left else "right"
        table.add_column(heading, justify=justify, no_wrap=place >= left, overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table
