"""Answers in text: lines with a name each, and tables of rows."""

import io
import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from nnpp_edge.progress import markdown_table, shown

if TYPE_CHECKING:
    from nnpp_edge.runtime.loop.messages import Counters

Row = Mapping[str, Any]
Column = str | Callable[[Row], str]
Columns = dict[str, Column]
"""By title a key, or keys of inner tables joined by dots, and after a space the form for `shown`;
or a function.
"""
_PLACE = ("workload", "size")
"""A rule is drawn above a row where one of these changes."""


def tell(
    as_json: bool, figures: object, text: Callable[[], str], *, indent: int | None = None
) -> None:
    """Print an answer; what has no place in UTF-8, in a name that a file gives, is written out."""
    words = json.dumps(figures, indent=indent) if as_json else text()
    click.echo(words.encode(errors="backslashreplace").decode())


def aligned(lines: Mapping[str, object], indent: str = "") -> str:
    """Names and values in two columns, without what is empty."""
    lines = {name: value for name, value in lines.items() if value}
    width = max(12, *(len(name) + 2 for name in lines))
    return "\n".join(f"{indent}{name:<{width}}{value}" for name, value in lines.items())


def columns(words: str) -> Columns:
    """Columns as ``TITLE: KEY FORM | …``; a slash breaks the title's line, and a key alone is its
    own title.
    """
    found = (each.partition(": ") for each in words.split(" | "))
    return {title.replace("/", "\n"): key or title for title, _, key in found}


def table(rows: Sequence[Row], shown_as: Columns, *, markdown: bool = False) -> str:
    """Rows as a table."""
    body = [[_cell(row, column) for column in shown_as.values()] for row in rows]
    if markdown:
        return markdown_table(list(shown_as), body)
    from rich import box
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    place = list[object]()
    for at, title in enumerate(shown_as):
        grid.add_column(title, justify="left" if at < 3 else "right", no_wrap=True)
    for row, cells in zip(rows, body, strict=True):
        before = place
        place = [row.get(key) for key in _PLACE if key in shown_as]
        if before not in ([], place):
            grid.add_section()
        grid.add_row(*cells)
    console = Console(file=(out := io.StringIO()), width=200, markup=False, emoji=False)
    console.print(grid)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()).strip("\n")


def _cell(row: Row, column: Column) -> str:
    if callable(column):
        return column(row)
    keys, _, form = column.partition(" ")
    value: object = row
    for key in keys.split("."):
        value = value[key] if isinstance(value, Mapping) else None
    return shown(value, form)


def loop_lines(counters: "Counters") -> dict[str, str]:
    """What a loop did; what never happened is left out."""
    c = counters
    late = f"{c.overruns} overruns, {c.skipped} deadlines skipped"
    return {
        "ticks": f"{c.ticks}: {c.planned} planned, {c.kept} kept, {c.failed} without a path",
        "late": late if c.overruns or c.skipped else "",
        "degraded": counted(c.degraded),
        "errors": counted(c.errors),
        "dropped": counted(c.drops),
        "lost": counted(c.lost),
    }


def counted(counts: Mapping[str, int]) -> str:
    """How often each thing happened, without what never did."""
    return ", ".join(f"{what} {count}" for what, count in counts.items() if count)
