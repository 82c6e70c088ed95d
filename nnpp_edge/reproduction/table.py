"""The table of an experiment's rows, for people."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from nnpp_edge.profiling.rows import Rows
from nnpp_edge.progress import MISSING, markdown_table, shown
from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.planners import CONTROLS_OF, PLAIN, PLAIN_NN
from nnpp_edge.reproduction.regions import NETWORK, SHUFFLED, NetworkPair


class TableLine(NamedTuple):
    """Rows that a line of the table is made from."""

    rows: Rows
    """Of the queries that count."""
    every: Rows
    """Of all queries."""
    astar: Rows
    """Of the A* of the same origin, of the queries that count."""
    network: str


def summary(rows: Rows, by: Sequence[str], networks: NetworkPair, *, totals: bool = False) -> str:
    r"""A table for people: a line for each group by these names, a column for each figure that the
    rows have.

    Means, or for `totals` sums over the queries that all planners answered, beside how many each
    failed. *over A\** is over the A* of the same origin: the paper's, plain, or ours.
    """
    everything = rows.having(*by)
    if not isinstance(everything[0][by[0]], str):
        everything.sort(key=lambda row: float(row[by[0]]))
    counted = everything.answered() if totals else everything
    measured = {name for row in counted for name in row}
    if "planner" not in by:
        measured -= {"planner", "time_s"}
    heads = {**MEANS, **SUMS} if totals else MEANS
    columns = {head: form for head, (name, form) in heads.items() if name in measured}
    lines = []
    for key, group in counted.groups(by).items():
        place = dict(zip(by, key, strict=True))
        every = everything.of(**place)
        planner = place.get("planner", "")
        astar = counted.of(**place | {"planner": _astar_beside(planner)})
        line = TableLine(group, every, astar, network_of(planner, networks))
        names = [written(name, value) for name, value in place.items()]
        lines.append([*names, *(form(line) for form in columns.values())])
    renamed = [_SUMMED.get(head, head) if totals else head for head in columns]
    return markdown_table([*by, *renamed], lines)


def written(name: str, value: object) -> str:
    """A value in the first columns of a table."""
    if name == "planner":
        is_kind = value == NETWORK or value in CONTROLS_OF[NETWORK]
        return str(value) if is_kind or " " in str(value) else f"`{value}`"
    return {"size": "{}²", "plan": "T + {}Δt"}.get(name, "{}").format(value)


def network_of(planner: str, networks: NetworkPair) -> str:
    """The network that a planner runs."""
    if planner in (paper.ASTAR_NN, paper.DSTAR_NN):
        return "the paper's"
    if planner in ("nnpp", "nnpp-dstar"):
        return f"`{networks.ours.metadata.name}`"
    if planner in (PLAIN_NN, NETWORK):
        return f"`{networks.paper.metadata.name}`"
    if SHUFFLED in planner:
        return f"`{networks.paper.metadata.name}`, shuffled"
    return MISSING


def _astar_beside(planner: str) -> str:
    """The A* of the same origin."""
    if planner.startswith("paper's"):
        return paper.ASTAR
    return PLAIN if planner.startswith("plain") else "astar"


Cell = Callable[[TableLine], str]


def _mean(name: str, form: str) -> Cell:
    return lambda line: shown(line.rows.mean(name), form)


def _mean_s(name: str) -> Cell:
    return lambda line: seconds(line.rows.mean(name))


def _spread(name: str, digits: int) -> Cell:
    return lambda line: spread(line.rows.all(name), digits)


def _failed(line: TableLine) -> str:
    if not line.rows.all("found"):
        return MISSING
    failed = sum("cc" not in row for row in line.every)
    return f"{failed} of {len(line.every)}"


def _mended(line: TableLine) -> str:
    later = Rows(row for row in line.every if row.get("plan")).all("mended")
    return f"{sum(later):.0f} of {len(later)}" if later else MISSING


MEANS: dict[str, tuple[str, Cell]] = {
    "network": ("planner", lambda line: line.network),
    "AT": ("time_s", _mean_s("time_s")),
    "over A*": (
        "time_s",
        lambda line: times(line.astar.mean("time_s") / line.rows.mean("time_s")),
    ),
    "inference": ("inference_s", _mean_s("inference_s")),
    "graph": ("graph_s", _mean_s("graph_s")),
    "search": ("search_s", _mean_s("search_s")),
    "graph's share": ("graph_share", _mean("graph_share", "z.1%")),
    "path, cells": ("path_cells", _mean("path_cells", ".0f")),
    "CC": ("cc", _mean("cc", ".2f")),
    "CC increase": ("exact_cc", lambda line: percent(line.rows.increase(), 2)),
    "cost above the optimum": ("excess", _mean("excess", "z.2%")),
    "success": ("found", _mean("found", "z.1%")),
    "MM": ("mm", _spread("mm", 3)),
    "region, of the map": ("share", _mean("share", "z.1%")),
    "in common with the first": ("common", _mean("common", "z.1%")),
    "best ω": ("best_omega", _spread("best_omega", 4)),
    "mended, plans after the first": ("mended", _mended),
}
"""Columns by their heads: the figure that each needs, and how it is written."""
SUMS: dict[str, tuple[str, Cell]] = {
    "AT": ("time_s", lambda line: seconds(line.rows.total("time_s"))),
    "CC": ("cc", lambda line: shown(line.rows.total("cc"), ".2f")),
    "success": ("found", _failed),
}
"""Columns that differ where sums are shown, by the head of the mean."""
_SUMMED = {"AT": "time in all", "success": "failed"}
"""Their own heads."""


def seconds(value: float) -> str:
    """A time with its unit, three digits."""
    if not math.isfinite(value):
        return MISSING
    return f"{value:.3g} s" if value >= 1.0 else f"{1e3 * value:.3g} ms"


def times(ratio: float) -> str:
    """How many times as fast."""
    if not math.isfinite(ratio):
        return MISSING
    return f"{ratio:.0f}×" if ratio >= 100.0 else f"{ratio:.3g}×"


def percent(share: float, digits: int = 1) -> str:
    """A share in per cent, never as -0."""
    return shown(share, f"z.{digits}%")


def spread(values: list[float], digits: int) -> str:
    """Mean and standard deviation, of one value itself; a dash where there are no values."""
    if not values:
        return MISSING
    mean = f"{np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values):.{digits}f}"
