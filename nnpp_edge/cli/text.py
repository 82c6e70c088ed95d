"""Answers in text: lines with a name each, and tables of rows."""

import json
from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
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
    titles = [title.split("\n") for title in shown_as]
    head = list(zip_longest(*titles, fillvalue=""))
    forms = []
    for at, cells in enumerate(zip(*head, *body, strict=True)):
        side = "<" if at < 3 else ">"
        forms.append(f"{side}{max(map(len, cells))}")
    lines = ["  ".join(map(format, cells, forms)).rstrip() for cells in [*head, *body]]
    lines.insert(len(head), "─" * max(map(len, lines)))
    return "\n".join(lines)


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
