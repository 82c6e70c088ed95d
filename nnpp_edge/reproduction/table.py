"""The table of an experiment's rows, for people."""

import math
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.progress import MISSING, markdown_table, shown, with_unit
from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.planners import CONTROLS_OF, PLAIN
from nnpp_edge.reproduction.regions import NETWORK


class TableLine(NamedTuple):
    """Rows that a line of the table is made from."""

    rows: Rows
    """Of the queries that count."""
    every: Rows
    """Of all queries."""
    astar: Rows
    """Of the A* of the same origin, of the queries that count."""


def summary(rows: Rows, by: Sequence[str], *, totals: bool = False) -> str:
    r"""A table for people: a line for each group by these names, a column for each figure that the
    rows have.

    Means, or for `totals` sums over the queries that all planners answered, beside how many each
    failed. *over A\** is over the A* of the same origin: the paper's, plain, or ours.
    """
    everything = rows.having(*by)
    if not isinstance(everything[0][by[0]], str):
        everything.sort(key=itemgetter(by[0]))
    counted = everything.answered() if totals else everything
    measured = {name for row in counted for name in row}
    columns = {}
    for head, (name, form) in MEANS.items():
        if name in measured:
            head, form = SUMS.get(head, (head, form)) if totals else (head, form)
            columns[head] = (name, form)
    lines = []
    for key, group in counted.groups(by).items():
        place = dict(zip(by, key, strict=True))
        astar = counted.of(**place | {"planner": _astar_beside(place.get("planner", ""))})
        line = TableLine(group, everything.of(**place), astar)
        names = [written(name, value) for name, value in place.items()]
        lines.append([*names, *(_text(line, *column) for column in columns.values())])
    return markdown_table([*by, *columns], lines)


def written(name: str, value: object) -> str:
    """A value in the first columns of a table."""
    if name == "planner":
        is_kind = value == NETWORK or value in CONTROLS_OF[NETWORK]
        return str(value) if is_kind or " " in str(value) else f"`{value}`"
    return {"size": "{}²", "plan": "T + {}Δt"}.get(name, "{}").format(value)


def _astar_beside(planner: str) -> str:
    """The A* of the same origin."""
    if planner.startswith("paper's"):
        return paper.ASTAR
    return PLAIN if planner.startswith("plain") else "astar"


def _text(line: TableLine, name: str, form: "Form") -> str:
    if callable(form):
        return form(line)
    mean = line.rows.mean(name)
    return seconds(mean) if form == "s" else shown(mean, form)


def _failed(line: TableLine) -> str:
    if not line.rows.all("found"):
        return MISSING
    failed = sum("cc" not in row for row in line.every)
    return f"{failed} of {len(line.every)}"


Form = str | Callable[[TableLine], str]
"""How a figure is written: its mean as `shown` does, or as a time (``s``), or by a function."""
MEANS: dict[str, tuple[str, Form]] = {
    "AT": ("time_s", "s"),
    "over A*": (
        "time_s",
        lambda line: with_unit(line.astar.mean("time_s") / line.rows.mean("time_s"), "x"),
    ),
    "inference": ("inference_s", "s"),
    "graph": ("graph_s", "s"),
    "search": ("search_s", "s"),
    "graph's share": ("graph_share", "z.1%"),
    "path, cells": ("path_cells", ".0f"),
    "CC": ("cc", ".2f"),
    "CC increase": ("exact_cc", lambda line: percent(line.rows.increase(), 2)),
    "cost above the optimum": ("gap", "z.2%"),
    "success": ("found", "z.1%"),
    "MM": ("mm", lambda line: spread(line.rows.all("mm"), 3)),
    "region, of the map": ("region_share", "z.1%"),
    "in common with the first": ("common", "z.1%"),
    "best ω": ("best_omega", lambda line: spread(line.rows.all("best_omega"), 4)),
}
"""Columns by their heads: the figure that each needs, and how it is written."""
SUMS: dict[str, tuple[str, Form]] = {
    "AT": ("time in all", lambda line: seconds(sum(line.rows.all("time_s")) or math.nan)),
    "CC": ("CC", lambda line: shown(sum(line.rows.all("cc")) or math.nan, ".2f")),
    "success": ("failed", _failed),
}
"""Columns that differ where sums are shown: by the head of the mean their own head and form."""


def seconds(value: float) -> str:
    """A time with its unit, three digits."""
    return with_unit(value, "s") if value >= 1.0 else with_unit(1e3 * value, "ms")


def percent(share: float, digits: int = 1) -> str:
    """A share in per cent, never as -0."""
    return shown(share, f"z.{digits}%")


def spread(values: list[float], digits: int) -> str:
    """Mean and standard deviation, of one value itself; a dash where there are no values."""
    if not values:
        return MISSING
    mean = f"{np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values):.{digits}f}"
