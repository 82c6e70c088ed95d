"""From which map size and which distance on one planner is sooner done than another, by the measured queries."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from nnpp_edge.profiling.contest import Facts

PAIRS = (("corridor", "astar"), ("nnpp", "astar"), ("nnpp", "corridor"))
"""Who might pay over whom."""
_BINS_PER_DOUBLING = 2
_FEWEST = 3
"""Queries that a bin of distances must have; one with fewer is joined to another."""


@dataclass
class Bin:
    """Queries of similar distance on maps of one size."""

    first: int
    """Least distance, in cells; the next bin's is the end."""
    times_ms: dict[str, list[float]]
    """By planner."""


def bins_by_size(results: Sequence[Facts]) -> dict[int, list[Bin]]:
    """For each size the queries of all workloads, near ones included, in bins of distance."""
    pooled: dict[int, dict[str, list[tuple[int, float]]]] = defaultdict(lambda: defaultdict(list))
    for row in results:
        queries = row["queries"]
        pooled[row["size"]][row["planner"]] += zip(queries["distance"], queries["time_ms"], strict=True)
    return {size: _bins(planners) for size, planners in sorted(pooled.items())}


def _bins(planners: dict[str, list[tuple[int, float]]]) -> list[Bin]:
    distances = sorted(distance for distance, _ in next(iter(planners.values())))
    edges = [0]
    for distance in distances:
        # the greatest power of 2 to the 1/_BINS_PER_DOUBLING that is no more than the distance
        number = math.floor(_BINS_PER_DOUBLING * math.log2(max(distance, 1)) + 1e-9)
        edge = math.ceil(math.pow(2.0, number / _BINS_PER_DOUBLING) - 1e-9)
        enough = sum(edges[-1] <= each < edge for each in distances) >= _FEWEST
        if enough and sum(each >= edge for each in distances) >= _FEWEST:
            edges.append(edge)
    return [
        Bin(
            int(first),
            {name: [ms for apart, ms in timed if first <= apart < end] for name, timed in planners.items()},
        )
        for first, end in pairwise([*edges, math.inf])
    ]


def break_even(results: Sequence[Facts]) -> list[Facts]:
    """For each pair of planners where one starts to pay over the other, as ``break_even`` in docs/profile.md."""
    by_size, sums = bins_by_size(results), dict[int, dict[str, float]]()
    for row in sorted(results, key=lambda row: row["size"]):  # of the queries that budgets are judged by
        totals = sums.setdefault(row["size"], defaultdict(float))
        totals[row["planner"]] += row["n"] * row["time_ms"]["mean"]
    lines: list[Facts] = []
    for planner, over in PAIRS:
        if not all(planner in totals and over in totals for totals in sums.values()):
            continue
        distances = {
            str(size): _from_where([(b.first, sum(b.times_ms[planner]) < sum(b.times_ms[over])) for b in bins])
            for size, bins in by_size.items()
        }
        size_from = _from_where([(size, totals[planner] < totals[over]) for size, totals in sums.items()])
        lines.append({"planner": planner, "over": over, "size_from": size_from, "distance_from": distances})
    return lines


def _from_where(wins: Sequence[tuple[int, bool]]) -> int | None:
    """The first place from which on it wins everywhere; None where it does not win at the end."""
    found = None
    for place, won in reversed(wins):
        if not won:
            break
        found = place
    return found
