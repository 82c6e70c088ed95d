"""Landmarks: the costs from a few cells to all others, computed once, sharpen the heuristic of every search.

For a landmark l the triangle inequality gives cost(n, goal) >= |d(l, n) - d(l, goal)|: the greatest over the
landmarks is a lower bound, and a consistent one (ALT, Goldberg and Harrelson 2005). So the optimum stays the
optimum, while cells that lie away from it are no longer expanded. A landmark at the goal itself makes the
bound exact, and a search goes straight along an optimal path.

The bounds outlive changes of the map by which no cell becomes cheaper: costs then only rise above them.
"""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.grid import Grid
from nnpp_edge.runtime.planning.astar import settle_all
from nnpp_edge.runtime.planning.expansion import LANES, read_lane, remotest
from nnpp_edge.runtime.planning.workspace import Workspace

_ROUNDING = 4e-6
"""Share of the greatest cost by which a sum of rounded steps may be off."""


class Landmarks:
    """Costs from up to eight cells of a grid to all others.

    Parameters
    ----------
    grid : Grid
        The map.
    workspace : Workspace
        Scratch memory of the grid's size.
    links : (nodes,) uint8
        As in `astar`.
    corner_cutting : bool
        As in `astar`.
    """

    def __init__(
        self,
        grid: Grid,
        workspace: Workspace,
        *,
        links: NDArray[np.uint8] | None = None,
        corner_cutting: bool = True,
    ) -> None:
        self._grid, self._workspace = grid, workspace
        self._links, self._corner_cutting = links, corner_cutting
        self.cells: list[tuple[int, int]] = []
        """Where the landmarks stand."""
        self.fields = np.zeros((len(grid.weights), LANES), np.float32)
        """(nodes, 8) cost from each landmark; 0 in the lanes that are free, inf where there is no path."""
        self._slack = 0.0

    def add(self, cell: tuple[int, int]) -> None:
        """Set a landmark at a passable cell: one search of the whole map.

        Raises
        ------
        InvalidQueryError
            All eight are taken.
        """
        lane = len(self.cells)
        if lane == LANES:
            raise InvalidQueryError(f"there is room for {LANES} landmarks, got one more")
        ws = self._workspace
        settle_all(self._grid, cell, ws, links=self._links, corner_cutting=self._corner_cutting)
        read_lane(ws.g, ws.meta, ws.stamp, self.fields, lane)
        self.cells.append(cell)
        finite = self.fields[:, lane]
        self._slack = max(self._slack, _ROUNDING * float(finite.max(where=np.isfinite(finite), initial=0.0)))

    def spread(self, count: int) -> None:
        """Set landmarks until there are `count`, each as far from the others as can be.

        They stand in the part of the map that is connected to the landmarks there are, or else to the
        passable cell nearest the middle; fewer are set where that part has too few cells.
        """
        if not self.cells:
            if (middle := self._middle()) is None:
                return
            self.add(middle)  # only to find the first by: the furthest cell from it takes its lane
            node, _ = remotest(self.fields, 1)
            if node < 0:
                return
            self.cells.clear()
            self.add(self._cell(node))
        while len(self.cells) < min(count, LANES):
            node, _ = remotest(self.fields, len(self.cells))
            if node < 0:
                return
            self.add(self._cell(node))

    def towards(self, goal: int) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
        """What the search's kernel needs to know for a goal's node: the fields, theirs at the goal, the slack."""
        return self.fields, self.fields[goal].copy(), self._slack

    def lower_bound(self, start: int, goal: int) -> float:
        """No path between two nodes costs less; inf where a landmark is connected to only one of them."""
        with np.errstate(invalid="ignore"):
            apart = np.abs(self.fields[start] - self.fields[goal])
        return max(float(np.nanmax(apart, initial=0.0)) - self._slack, 0.0)

    def _cell(self, node: int) -> tuple[int, int]:
        row, col = divmod(int(node), self._grid.stride)
        return row - 1, col - 1

    def _middle(self) -> tuple[int, int] | None:
        grid = self._grid
        rows, cols = np.divmod(np.flatnonzero(np.isfinite(grid.weights)), grid.stride)
        if len(rows) == 0:
            return None
        at = int(np.argmin(np.hypot(rows - 1 - grid.rows / 2, cols - 1 - grid.cols / 2)))
        return int(rows[at]) - 1, int(cols[at]) - 1
