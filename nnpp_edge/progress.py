"""Progress on stderr, figures and tables for stdout."""

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import click

MISSING = "–"
_LINES = 20
"""Where stderr is no terminal, a line is written for each of so many parts of the work."""


@contextmanager
def bar(what: str, total: int, *, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """A progress bar on stderr; the value is a function to call with how much is done.

    A quiet one is drawn only then: no thread of its own takes time from what is measured.
    """
    if not sys.stderr.isatty():
        yield _lines(what, max(total, 1))
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), auto_refresh=not quiet) as progress:
        task = progress.add_task(what, total=total)
        yield lambda done: progress.update(task, completed=done, refresh=quiet)


def _lines(what: str, total: int) -> Callable[[int], None]:
    """Progress for a log: `train: 35 %, 12 min`."""
    told = 0
    started = time.monotonic()

    def advance(done: int) -> None:
        nonlocal told
        if (part := done * _LINES // total) > told:
            told = part
            minutes = (time.monotonic() - started) / 60.0
            click.echo(f"{what}: {100 * done // total} %, {minutes:.1f} min", err=True)

    return advance


def shown(value: object, form: str = "") -> str:
    """A value in the form of a format specification, or with ² behind it; three digits of a float
    without one.

    A dash stands for None, NaN and inf.
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if form == "²":
        return f"{value}²"
    if isinstance(value, float) and not form:
        form = ".0f" if abs(value) >= 1000.0 else ".3g"
    text = format(value, form)
    return text.replace("%", " %") if form else text


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Rows as a table in Markdown, for documents."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(" ".join(cell.split()) for cell in line) + " |" for line in lines
    )
