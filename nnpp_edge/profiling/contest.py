"""Rivals × queries, in turns, judged by exact A*: a tidy row for each answer, and figures of the rows."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from nnpp_edge.runtime.cells import Endpoints

Figures = dict[str, str | float | None]
"""Figures by key; None where there was nothing to count."""
Columns = Mapping[str, list[float]]
"""The values of all rows by the names of their figures."""
Summary = Mapping[str, Callable[[Columns], float | None]]


@dataclass(frozen=True)
class Row:
    """One rival's answer to one query."""

    rival: str
    query: Endpoints
    figures: dict[str, float] = field(default_factory=dict)
    """By name; what was not measured, or is none without a path, is left out. Shares are means of zeros and ones."""


def summarised(rows: Iterable[Row], summary: Summary) -> Figures:
    """Figures of the rows of one rival."""
    columns: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        for name, value in row.figures.items():
            columns[name].append(value)
    return {key: figure(columns) for key, figure in summary.items()}


def of(name: str, reduce: Callable[[list[float]], np.floating]) -> Callable[[Columns], float | None]:
    """A figure of one column; None where it is empty."""
    return lambda columns: float(reduce(columns[name])) if columns[name] else None


def mean(name: str) -> Callable[[Columns], float | None]:
    """The mean of a column."""
    return of(name, np.mean)


def quantile(name: str, share: float) -> Callable[[Columns], float | None]:
    """The value of a column that this share of its values lie below."""
    return of(name, partial(np.quantile, q=share))


def gap(cost: float, optimum: float) -> float:
    """By how much a cost is above the optimum, as a share of it; of its size where energy is got back."""
    return (cost / optimum - 1.0) * math.copysign(1.0, optimum) if optimum else 0.0
