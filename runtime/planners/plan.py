"""What a planner answers with."""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import SQRT2


class Method(StrEnum):
    """How to plan."""

    AUTO = "auto"
    ASTAR = "astar"
    CORRIDOR = "corridor"
    NNPP = "nnpp"


class Source(StrEnum):
    """Where a path was found."""

    MAP = "map"
    """The whole map was searched because the method does so: the path is optimal."""
    REGION = "region"
    """In the first region."""
    WIDENED = "widened"
    """In a widened region, the first having failed."""
    FALLBACK = "fallback"
    """The whole map was searched because every region had failed: the path is optimal."""


def _no_path() -> NDArray[np.int32]:
    return np.empty((0, 2), np.int32)


@dataclass(frozen=True)
class Plan:
    """The answer to one query. Without a path its numbers are inf, or 0 for counts."""

    status: Status
    method: Method
    """The method that was used; for ``auto`` the one it picked."""
    source: Source | None = None
    """Where the path was found; None where no search was made."""
    path: NDArray[np.int32] = field(default_factory=_no_path)
    """(N, 2) cells (row, col) from start to goal; on TIMEOUT as far as the search had come, or empty."""
    cost: float = math.inf
    """Sum of the path's step costs."""
    length: float = math.inf
    """Length of the path in cells, a diagonal step counting √2."""
    traverse_cost: float = math.inf
    """CC: sum of the costs (``paper``: T; ``length``: weights) of the path's cells."""
    lower_bound: float = 0.0
    """No path on the map costs less."""
    expansions: int = 0
    """Cells expanded, at all levels and in all regions that were tried."""
    region: Region | None = None
    """Where the last search at full resolution was allowed to go; None for the whole map. It is read from
    the planner's memory and holds until the planner's next query."""
    network_region: Region | None = None
    """The network's region at the adaptive threshold itself (NNPP, section 4.3), with the same life."""
    threshold: float = math.nan
    """The adaptive threshold td, of a learned region."""
    by: str = ""
    """Name of the planner that was used: the method's, or a `DynamicPlanner`'s own for it."""
    reason: str = ""
    """Why ``auto`` picked its method, or how the search was made where there was a choice."""
    timings_ms: dict[str, float] = field(default_factory=dict)
    """Milliseconds by stage, and ``total``."""

    @property
    def ok(self) -> bool:
        """Whether the path leads from start to goal."""
        return self.status is Status.OK

    @property
    def bound(self) -> float:
        """The path costs at most this many times the optimum."""
        return self.cost / self.lower_bound if self.lower_bound > 0.0 else (1.0 if self.cost == 0.0 else math.inf)

    def summary(self) -> dict[str, Any]:
        """The plan without its arrays, ready for JSON (inf and NaN as None)."""

        def number(x: float) -> float | None:
            return round(x, 6) if math.isfinite(x) else None

        return {
            "status": str(self.status), "method": str(self.by or self.method),
            "source": None if self.source is None else str(self.source),
            "cost": number(self.cost), "length": number(self.length),
            "traverse_cost": number(self.traverse_cost), "lower_bound": number(self.lower_bound),
            "bound": number(self.bound) if self.ok else None, "cells": len(self.path),
            "expansions": self.expansions, "threshold": number(self.threshold), "reason": self.reason,
            "timings_ms": {k: round(v, 3) for k, v in self.timings_ms.items()},
        }  # fmt: skip


@kernel
def _measure(weights, stride, path):
    """Straight and diagonal steps, weights summed over straight and over diagonal steps, and over cells."""
    straight, diagonal, by_straight, by_diagonal, total = 0, 0, 0.0, 0.0, 0.0
    before = 0.0
    for n in range(len(path)):
        w = np.float64(weights[(path[n, 0] + 1) * stride + path[n, 1] + 1])
        total += w
        if n == 0:
            pass
        elif path[n, 0] != path[n - 1, 0] and path[n, 1] != path[n - 1, 1]:
            diagonal += 1
            by_diagonal += before + w
        else:
            straight += 1
            by_straight += before + w
        before = w
    return straight, diagonal, by_straight, by_diagonal, total


def measure(grid: Grid, path: NDArray[np.int32]) -> tuple[float, float, float]:
    """Cost, length in cells and CC of a path, summed in float64."""
    straight, diagonal, by_straight, by_diagonal, total = _measure(grid.weights, grid.stride, path)
    length_s, length_d, weight_s, weight_d = grid.steps
    cost = length_s * straight + length_d * diagonal + weight_s * by_straight + weight_d * by_diagonal
    scale = grid.model.scale
    return cost, straight + SQRT2 * diagonal, total / scale if scale else 0.0
