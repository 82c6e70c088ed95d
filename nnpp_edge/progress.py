"""Progress on stderr, figures and tables for stdout."""

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

import click

MISSING = "–"
Progress = Callable[[int], None]
"""Called with how much is done."""


class Advance(Protocol):
    """Called with how much is done, and a few words on it."""

    def __call__(self, done: int, words: str = "", /) -> None: ...


THOUSANDTHS = 1000
"""The total of work that is told in shares, which a bar shows in %."""
_LINES = 20
"""Where stderr is no terminal, a line is written for each of so many parts of the work."""


def ignore(*_: object) -> None:
    """Do nothing: for callers who do not watch."""


@contextmanager
def bar(what: str, total: int, *, quiet: bool = False) -> Iterator[Advance]:
    """Show a progress bar on stderr; the value is a function to call with how much is done.

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
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn() if total == THOUSANDTHS else MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[words]}"),
    )
    with Progress(*columns, console=Console(stderr=True), auto_refresh=not quiet) as progress:
        task = progress.add_task(what, total=total, words="")

        def advance(done: int, words: str = "", /) -> None:
            progress.update(task, completed=done, words=words, refresh=quiet)

        yield advance


def _lines(what: str, total: int) -> Advance:
    """Write progress to a log: `train: 35 %, 12.0 min`, and the words."""
    parts = 0
    started = time.monotonic()

    def advance(done: int, words: str = "", /) -> None:
        nonlocal parts
        if done * _LINES // total > parts:
            parts = done * _LINES // total
            minutes = (time.monotonic() - started) / 60.0
            told = f"{what}: {100 * done // total} %, {minutes:.1f} min"
            click.echo(f"{told}, {words}" if words else told, err=True)

    return advance


def shown(value: object, form: str = "") -> str:
    """Write a value in the form of a format specification, or with ² behind it; without one three
    digits of a float. A dash stands for None, NaN and inf."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if form == "²":
        return f"{value}²"
    if form:
        return format(value, form).replace("%", " %")
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
    return str(value)


def with_unit(value: object, unit: str = "") -> str:
    """Write a value and its unit as in budgets; none behind a bare number or a dash."""
    word = shown(value)
    if word == MISSING:
        return word
    return word + {"": "", "1": "", "1/s": "/s", "x": "×"}.get(unit, f" {unit}")


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write rows as a table in Markdown, for documents."""
    lines = []
    for cells in [header, ["---"] * len(header), *rows]:
        joined = " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells)
        lines.append(f"| {joined} |")
    return "\n".join(lines)
