"""Tidy rows, the paper's and ours alike: a dict for each answer, and figures of many of them.

``planner`` names who answered, other text and numbers say to what (``size``, ``map``), and the rest
is measured: ``time_s``; ``found`` (in the first region that was searched, 1 or 0); ``cc`` of the
path beside ``exact_cc``, that of the optimal one; ``mm``, cells of the optimal path over those of
the region searched (Eq. 6); ``share`` of the map's cells that belong to that. What was not
measured, or does not exist without a path, is left out.
"""

import csv
import io
import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from nnpp_edge.progress import MISSING, shown

Row = dict[str, Any]


class Rows(list[Row]):
    """Rows, and figures of them."""

    def of(self, *planners: str, **values: object) -> "Rows":
        """The rows of these planners, by default of all, that have these values."""
        found = Rows(row for row in self if values.items() <= row.items())
        return Rows(row for row in found if row.get("planner") in planners) if planners else found

    def by(self, name: str) -> "dict[Any, Rows]":
        """The rows by their values under a name, in the order of the first of each."""
        return {key: rows for (key,), rows in self.groups([name]).items()}

    def groups(self, names: Sequence[str]) -> "dict[tuple[Any, ...], Rows]":
        """The rows by their values under several names, in the order of the first of each."""
        found = defaultdict[tuple[Any, ...], Rows](Rows)
        for row in self:
            found[tuple(row.get(name) for name in names)].append(row)
        return found

    def all(self, name: str) -> list[float]:
        """The numbers under a name, of the rows that have it."""
        return [float(row[name]) for row in self if name in row]

    def mean(self, name: str) -> float:
        """Mean of the numbers under a name; NaN where there are none."""
        found = self.all(name)
        return float(np.mean(found)) if found else math.nan

    def total(self, name: str) -> float:
        """Sum of the numbers under a name; NaN where there are none."""
        return sum(self.all(name)) or math.nan

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

    def speedups(self, slower: str, faster: str) -> dict[int, float]:
        """The speed-up on maps of each size."""
        return {size: rows.speedup(slower, faster) for size, rows in self.by("size").items()}

    def increase(self, *planners: str) -> float:
        """Share by which the summed CC of these planners' paths, by default of all, exceeds that of
        the optimal ones; NaN without a path.
        """
        solved = Rows(row for row in self.of(*planners) if "cc" in row)
        exact = sum(solved.all("exact_cc"))
        return sum(solved.all("cc")) / exact - 1.0 if exact else math.nan

    def csv(self) -> str:
        """Comma-separated values, floats in full; inf, NaN and what a row lacks are left empty."""
        names = dict.fromkeys(name for row in self for name in row)
        out = io.StringIO()
        writer = csv.DictWriter(out, list(names), lineterminator="\n")
        writer.writeheader()
        for row in self:
            finite = {
                name: value
                for name, value in row.items()
                if isinstance(value, str) or math.isfinite(value)
            }
            writer.writerow(finite)
        return out.getvalue()


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
