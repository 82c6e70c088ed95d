"""Work of mending the search around an obstacle, beside a search afresh."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nnpp_edge.runtime import DynamicPlanner
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.view.asked import Asked
from nnpp_edge.view.landscape import told_costs

_LOADED: set[tuple[bool, bool]] = set()
"""Kinds of grounds for which this process has loaded what mends."""


@dataclass(frozen=True)
class Mended:
    """The path before an obstacle, and the two exact searches after it."""

    footing: str
    """How the path before stands now: a word of `Footing`, or nothing where there was none."""
    mended: Plan
    """By D* Lite, which keeps its search."""
    afresh: Plan
    """By A*."""


class Mending:
    """D* Lite's search towards the goal that is asked for, kept while obstacles appear. For one thread at a time."""

    def __init__(self, ground: Ground, asked: Asked) -> None:
        self.goal = asked.goal
        kind = ground.vehicle is None, asked.slope_cost == "paper"
        if kind not in _LOADED:
            _LOADED.add(kind)
            _rehearse(ground, asked)
        self._planner = _planner(ground, asked, asked.goal)

    def lay(self, parts: Iterable[Rectangle], obstacles: Sequence[Rectangle]) -> None:
        """Bring rectangles up to date, on which these obstacles lie now."""
        for part in parts:
            self._planner.update(part[0], part[1], told_costs(part, obstacles))

    def mend(self, start: Cell, parts: Iterable[Rectangle], obstacles: Sequence[Rectangle]) -> Mended:
        """Lay obstacles while a path from `start` stands, and find another in both ways."""
        self._planner.move(start)
        before = self._planner.replan()
        self.lay(parts, obstacles)
        footing = str(self._planner.standing().footing) if before.ok else ""
        mended = self._planner.replan()
        return Mended(footing, mended, self._planner.replan(method="astar"))


def _planner(ground: Ground, asked: Asked, goal: Cell) -> DynamicPlanner:
    return DynamicPlanner(
        ground, goal, "dstar", also=("astar",), omega=asked.weight, corner_cutting=asked.corner_cutting
    )


def _rehearse(ground: Ground, asked: Asked) -> None:
    """Mend a path on a small level map, so that no mending that is timed waits for compiled code."""
    vehicle = ground.vehicle
    side = 1.0 if vehicle is None else (vehicle.radius_m or vehicle.reach_m) / 4.0
    small = replace(ground, elevation=np.zeros((64, 64), np.float32), cell_size_m=side, cell_width_m=None)
    planner = _planner(small, asked, (50, 32))
    planner.move((12, 32))
    planner.replan()
    planner.update(31, 28, np.ones((2, 8), np.float32))
    planner.standing()
    planner.replan()
    planner.replan(method="astar")
