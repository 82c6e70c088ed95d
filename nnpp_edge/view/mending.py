"""What mending the search around an obstacle takes, beside a search afresh."""

from collections.abc import Sequence
from dataclasses import dataclass

from nnpp_edge.runtime import DynamicPlanner
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.view.asked import Asked
from nnpp_edge.view.ground import Ground
from nnpp_edge.view.landscape import Landscape

Patches = Sequence[tuple[Rectangle, Float2D]]
"""Rectangles of the map with their new costs, or elevations."""


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
        if cost is not None:
            self._planner = DynamicPlanner(
                cost,
                asked.goal,
                "dstar",
                also=("astar",),
                omega=asked.weight,
                corner_cutting=asked.corner_cutting,
            )
            return
        dem = ground.dem
        self._planner = DynamicPlanner.of_elevation(
            dem.elevation,
            dem.cell_size_m,
            asked.goal,
            asked.limits,
            "dstar",
            vehicle=landscape.vehicle,
            cell_width_m=dem.cell_width_m,
            also=("astar",),
            corner_cutting=asked.corner_cutting,
            step_cost=asked.slope_cost,
            mobility=landscape.mobility,
        )

    def lay(self, patches: Patches) -> None:
        """Put new costs, or elevations, into the map."""
        for (row, col, _, _), patch in patches:
            if self._planner.state.sides_m is None:
                self._planner.update(row, col, patch)
            else:
                self._planner.update_elevation(row, col, patch)

    def mend(self, start: Cell, patches: Patches) -> Mended:
        """Lay obstacles while a path from `start` stands, and find another in both ways."""
        self._planner.move(start)
        before = self._planner.replan()
        self.lay(patches)
        footing = str(self._planner.standing().footing) if before.ok else ""
        mended = self._planner.replan()
        return Mended(footing, mended, self._planner.replan(method="astar"))
