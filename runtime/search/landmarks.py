"""Landmarks: the costs from a few cells to all others, computed once, sharpen the heuristic of
every search.

For a landmark l the triangle inequality gives cost(n, goal) >= |d(l, n) - d(l, goal)|: the greatest
over the landmarks is a lower bound, and a consistent one (ALT, Goldberg and Harrelson 2005); at the
goal itself it is exact. The bounds outlive changes of the map by which no cell becomes cheaper:
costs then only rise above them.
"""

from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Bool
from nnpp_edge.runtime.cells import Cell, nearest
from nnpp_edge.runtime.kernels.expansion import MOST_LANDMARKS
from nnpp_edge.runtime.kernels.records import Hints
from nnpp_edge.runtime.search.astar import settle_all
from nnpp_edge.runtime.search.workspace import Workspace

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid

_ROUNDING = 4e-6
"""Share of the greatest cost by which a sum of rounded steps may be off."""
_RIM = (
    (0.0, 0.0),
    (1.0, 1.0),
    (0.0, 1.0),
    (1.0, 0.0),
    (0.0, 0.5),
    (1.0, 0.5),
    (0.5, 0.0),
    (0.5, 1.0),
)
"""Where landmarks are set, as shares of the map's height and width."""


class Landmarks:
    """Costs from a few cells of a grid to all others, set at the map's corners and the middles of
    its sides, at most `count`; `workspace` is memory of the grid's size.

    Behind the goal, as seen from the start, a landmark's bound is nearly exact, and from the rim
    one is behind almost any goal. Each stands on the nearest cell that is connected to the one
    nearest the middle.
    """

    def __init__(self, grid: "Grid", workspace: Workspace, count: int) -> None:
        self._grid = grid
        grid.complete()
        connected = np.isfinite(grid.weights)
        if (middle := _nearest(connected, grid, 0.5, 0.5)) is not None:
            settle_all(grid, middle, workspace)
            connected = np.isfinite(workspace.costs())
        spots = [_nearest(connected, grid, *spot) for spot in _RIM]
        cells = dict.fromkeys(cell for cell in spots if cell is not None)
        self.cells = [*cells][:count]
        """Where the landmarks stand."""
        self.fields = fields = np.zeros((len(grid.weights), MOST_LANDMARKS), np.float32)
        """(nodes, 8) cost from each landmark; 0 in the lanes that are free, inf where there is no
        path.
        """
        for lane, cell in enumerate(self.cells):
            settle_all(grid, cell, workspace)
            fields[:, lane] = workspace.costs()
        self._slack = _ROUNDING * float(fields.max(where=np.isfinite(fields), initial=0.0))

    def towards(self, goal: Cell) -> Hints:
        """Hints of a search to a goal: the fields, theirs at the goal, and what they may
        be off by.
        """
        return Hints(self.fields, self.fields[self._grid.node(*goal)].copy(), self._slack)


def _nearest(chosen: Bool, grid: "Grid", down: float, right: float) -> Cell | None:
    """Of the nodes chosen, the cell nearest a place given in shares of the map's height
    and width.
    """
    cells = grid.inner(chosen)
    place = down * (grid.rows - 1), right * (grid.cols - 1)
    return nearest(cells, place) if cells.any() else None
