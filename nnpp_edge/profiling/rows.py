"""Tidy rows, one for each answer, and figures of many of them.

``planner`` names who answered; other text and numbers say to what (``workload``, ``size``,
``map``, ``half``), and the rest is measured. What was not measured, or does not exist without a
path, is left out.
"""

import csv
import io
import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

Row = dict[str, Any]
Facts = dict[str, Any]
"""Content of JSON, by key; docs/reference/figures.md says what the keys of a profile's report mean.
"""
Line = Mapping[str, Any]
"""A line of a table, by key."""
PLACE = itemgetter("workload", "size", "planner")
"""What tells a row of results from the others of its report."""
REDUCTIONS: dict[str, Callable[[list[float]], np.floating]] = {
    "mean": np.mean,
    "median": np.median,
    "p90": partial(np.quantile, q=0.9),
    "p95": partial(np.quantile, q=0.95),
    "p99": partial(np.quantile, q=0.99),
    "p999": partial(np.quantile, q=0.999),
    "max": np.max,
    "share": np.mean,
}
"""How a column becomes a figure; a share is the mean of what is 0 or 1."""
SPREAD = ("median", "p90", "p99", "max", "mean")


class Rows(list[Row]):
    """Rows, and figures of them."""

    def of(self, *planners: str, **values: object) -> "Rows":
        """The rows of these planners, by default of all, that have these values."""
        found = Rows(row for row in self if values.items() <= row.items())
        return Rows(row for row in found if row.get("planner") in planners) if planners else found

    def having(self, *names: str) -> "Rows":
        """The rows that have something under each of these names."""
        return Rows(row for row in self if row.keys() >= {*names})

    def by(self, name: str) -> "dict[Any, Rows]":
        """The rows by their values under a name, in the order of the first of each."""
        return {key: rows for (key,), rows in self.groups([name]).items()}

    def groups(self, names: Sequence[str]) -> "dict[tuple[Any, ...], Rows]":
        """The rows by their values under several names, in the order of the first of each."""
        found = defaultdict[tuple[Any, ...], Rows](Rows)
        for row in self:
            found[tuple(row.get(name) for name in names)].append(row)
        return found

    def averaged(self, name: str) -> "Rows":
        """A row for each value under a name, with the means of the numbers that were measured."""
        found = Rows()
        for rows in self.by(name).values():
            measured = {key for key, value in rows[0].items() if isinstance(value, float)}
            found.append(rows[0] | {key: rows.mean(key) for key in measured})
        return found

    def all(self, name: str) -> list[float]:
        """The numbers under a name, of the rows that have it."""
        return [float(row[name]) for row in self if name in row]

    def mean(self, name: str) -> float:
        """Mean of the numbers under a name; NaN where there are none."""
        found = self.all(name)
        return float(np.mean(found)) if found else math.nan

    def ratio(self, name: str, other: str) -> float | None:
        """The sum of a column over that of another, of the rows that have both."""
        both = self.having(name, other)
        whole = sum(both.all(other))
        return sum(both.all(name)) / whole if whole > 0.0 else None

    def figure(self, name: str) -> float | None:
        """A figure by its name: a column and, behind the last underscore, its reduction."""
        column, _, how = name.rpartition("_")
        values = self.all(column)
        return float(REDUCTIONS[how](values)) if values else None

    def figures(self, names: str) -> Facts:
        """Several figures by their names."""
        return {name: self.figure(name) for name in names.split()}

    def spread(self, name: str) -> Facts | None:
        """Quantiles and mean of a column; None where it is empty."""
        found = {how: self.figure(f"{name}_{how}") for how in SPREAD}
        rounded = {how: round(value, 6) for how, value in found.items() if value is not None}
        return rounded or None

    def answered(self) -> "Rows":
        """The rows of those queries for which every planner found a path."""
        answered = Rows()
        for rows in self.groups(("scene", "size", "map", "plan")).values():
            if all("cc" in row or "found" not in row for row in rows):
                answered += rows
        return answered

    def speedup(self, slower: str, faster: str) -> float:
        """Summed time of one planner over that of another, on the queries that both answered."""
        both = self.of(slower, faster).answered()
        fast_s = sum(both.of(faster).all("time_s"))
        return sum(both.of(slower).all("time_s")) / fast_s if fast_s else math.nan

    def increase(self, *planners: str) -> float:
        """Share by which the summed CC of these planners' paths, by default of all, exceeds that of
        the optimal ones; NaN without a path.
        """
        share = self.of(*planners).ratio("cc", "exact_cc")
        return math.nan if share is None else share - 1.0

    def csv(self) -> str:
        """Comma-separated values, floats in full; inf, NaN and what a row lacks are left empty."""
        names = dict.fromkeys(name for row in self for name in row)
        out = io.StringIO()
        writer = csv.DictWriter(out, list(names), lineterminator="\n")
        writer.writeheader()
        for row in self:
            told = row.items()
            written = {
                key: value for key, value in told if isinstance(value, str) or math.isfinite(value)
            }
            writer.writerow(written)
        return out.getvalue()
