"""Tidy rows, the paper's and ours alike: a dict for each answer, and figures of many of them.

``planner`` names who answered, other text and numbers say to what (``size``, ``map``), and the rest
is measured: ``time_s``; ``found`` (in the first region that was searched, 1 or 0); ``cc`` of the
path beside ``exact_cc``, that of the optimal one; ``mm``, cells of the optimal path over those of
the region searched (Eq. 6); ``share`` of the map's cells that belong to that. What was not
measured, or is none without a path, is left out.
"""

import csv
import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.progress import shown

Row = dict[str, Any]
Key = tuple[Any, ...]


class Rows(list[Row]):
    """Rows, and figures of them."""

    def of(self, *planners: str, **values: object) -> "Rows":
        """The rows of these planners, by default of all, that have these values."""
        mine = (row for row in self if not planners or row.get("planner") in planners)
        return Rows(row for row in mine if all(row.get(k) == v for k, v in values.items()))

    def by(self, *names: str) -> "dict[Key, Rows]":
        """The rows by what they have under these names, in the order of their coming."""
        groups: dict[Key, Rows] = {}
        for row in self:
            groups.setdefault(tuple(row[name] for name in names), Rows()).append(row)
        return groups

    def all(self, name: str) -> list[float]:
        """The numbers under a name, of the rows that have it."""
        return [float(row[name]) for row in self if name in row]

    def mean(self, name: str) -> float:
        """Mean of the numbers under a name; NaN where there are none."""
        return float(np.mean(found)) if (found := self.all(name)) else math.nan

    def answered(self) -> "Rows":
        """The rows of those queries for which every planner found a path."""
        queries = [
            tuple(row.get(name) for name in ("scene", "size", "map", "plan")) for row in self
        ]
        failed = {
            at
            for at, row in zip(queries, self, strict=True)
            if not row.get("found", 1.0) and "cc" not in row
        }
        return Rows(row for at, row in zip(queries, self, strict=True) if at not in failed)

    def speedup(self, slower: str, faster: str) -> float:
        """Summed time of one planner over that of another, on the queries that both answered."""
        both = self.of(slower, faster).answered()
        fast = sum(both.of(faster).all("time_s"))
        return sum(both.of(slower).all("time_s")) / fast if fast else math.nan

    def increase(self, *planners: str) -> float:
        """By what share the summed CC of these planners' paths lies above the optimal ones'; NaN
        without a path.
        """
        solved = Rows(row for row in self.of(*planners) if "cc" in row)
        cc = sum(solved.all("cc"))
        exact = sum(solved.all("exact_cc"))
        if not solved:
            return math.nan
        return cc / exact - 1.0 if exact else (0.0 if cc == 0.0 else math.inf)

    def csv(self) -> str:
        """Comma-separated values for programs, floats in full; what a row lacks, inf and NaN are
        left empty.
        """
        out = io.StringIO()
        names = list(dict.fromkeys(name for row in self for name in row))
        writer = csv.DictWriter(out, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {k: v for k, v in row.items() if isinstance(v, str) or math.isfinite(v)} for row in self
        )
        return out.getvalue()


def seconds(value: float) -> str:
    """A time with its unit, three digits."""
    return f"{shown(value, '.3g')} s" if value >= 1.0 else f"{shown(1e3 * value, '.3g')} ms"


def times(ratio: float) -> str:
    """How many times as fast."""
    return f"{ratio:{'.0f' if ratio >= 100.0 else '.3g'}}×" if math.isfinite(ratio) else "–"


def percent(share: float, digits: int = 1) -> str:
    """A share as so many per cent, never as -0."""
    return shown(share, f"z.{digits}%")


def spread(values: Sequence[float] | NDArray[np.float64], digits: int) -> str:
    return f"{np.mean(values):.{digits}f} ± {np.std(values):.{digits}f}" if len(values) else "–"
