"""What mending the search around an obstacle takes, beside a search afresh."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from nnpp_edge.runtime import DynamicPlanner
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.view.asked import Asked
from nnpp_edge.view.ground import Ground
from nnpp_edge.view.landscape import Landscape

Patches = Sequence[tuple[Rectangle, Float2D]]
"""Rectangles of the map with their new costs, or elevations."""
_LOADED: set[tuple[bool, bool, bool]] = set()
"""Kinds of maps for which this process has loaded what mends."""


@dataclass(frozen=True)
class Mended:
    """What became of the path before, and the two exact searches after it."""

    footing: str
    """How the path before stands now: a word of `Footing`, or nothing where there was none."""
    mended: Plan
    """By D* Lite, which keeps its search."""
    afresh: Plan
    """By A*."""


class Mending:
    """D* Lite's search towards the goal of what is asked, kept while obstacles appear. Serves one thread at a time.

    Parameters
    ----------
    ground, asked
        The map and the question.
    landscape : Landscape
        The same with the obstacles on it.
    cost : (H, W) float32
        What is planned on; None where elevations are.
    """

    def __init__(self, ground: Ground, asked: Asked, landscape: Landscape, cost: Float2D | None) -> None:
        self.goal = asked.goal
        kind = cost is None, landscape.vehicle is None, asked.slope_cost == "paper"
        if kind not in _LOADED:
            _LOADED.add(kind)
            _rehearse(asked, landscape)
        self._planner = _planner(asked, landscape, ground.dem.elevation if cost is None else cost, ground.sides_m)

    def lay(self, patches: Patches) -> None:
        """Put new costs, or elevations, into the map."""
        for part, patch in patches:
            _lay(self._planner, part, patch)

    def mend(self, start: Cell, patches: Patches) -> Mended:
        """Lay obstacles while a path from `start` stands, and find another in both ways."""
        self._planner.move(start)
        before = self._planner.replan()
        self.lay(patches)
        footing = str(self._planner.standing().footing) if before.ok else ""
        mended = self._planner.replan()
        return Mended(footing, mended, self._planner.replan(method="astar"))


def _planner(asked: Asked, landscape: Landscape, ground: Float2D, sides_m: tuple[float, float]) -> DynamicPlanner:
    """Of costs (H, W), or of elevations where the landscape is planned on by these."""
    if landscape.by_costs:
        return DynamicPlanner(
            ground,
            asked.goal,
            "dstar",
            also=("astar",),
            omega=asked.weight,
            corner_cutting=asked.corner_cutting,
        )
    return DynamicPlanner.of_elevation(
        ground,
        sides_m[0],
        asked.goal,
        asked.limits,
        "dstar",
        vehicle=landscape.vehicle,
        cell_width_m=sides_m[1],
        also=("astar",),
        corner_cutting=asked.corner_cutting,
        step_cost=asked.slope_cost,
        mobility=landscape.mobility,
    )


def _rehearse(asked: Asked, landscape: Landscape) -> None:
    """Mend a path on a small level map, so that no mending that is timed waits for compiled code."""
    vehicle = landscape.vehicle
    side = 1.0 if vehicle is None else (vehicle.radius_m or vehicle.reach_m) / 4.0
    small = np.zeros((64, 64), np.float32)
    wall = np.full((2, 8), 1.0 if landscape.by_costs else np.nan, np.float32)
    planner = _planner(replace(asked, goal=(50, 32)), landscape, small, (side, side))
    planner.move((12, 32))
    planner.replan()
    _lay(planner, (31, 28, 2, 8), wall)
    planner.standing()
    planner.replan()
    planner.replan(method="astar")


def _lay(planner: DynamicPlanner, part: Rectangle, patch: Float2D) -> None:
    """Put new costs, or elevations, into a planner's map."""
    (planner.update if planner.state.sides_m is None else planner.update_elevation)(part[0], part[1], patch)
