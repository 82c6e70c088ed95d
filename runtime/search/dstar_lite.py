"""D* Lite: exact planning on a map that changes, towards one goal, from a start that moves.

Koenig and Likhachev, "D* Lite" (AAAI 2002), in its optimised form.
"""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Bool
from nnpp_edge.runtime.cells import Cell, Rectangle, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels import dstar as kernels
from nnpp_edge.runtime.kernels.nodes import FOUND, PAUSED, octile
from nnpp_edge.runtime.options import CELLS
from nnpp_edge.runtime.search.astar import Parts, Search
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.tuning import MOST_RATIO_FOR_DSTAR

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid
    from nnpp_edge.runtime.map.state import MapState

_BELOW = 1.0 - 2.0**-10
"""h, in octile distances: along a step it falls by so much less than that costs that rounding does
not change the order of keys."""


def serves(grid: "Grid") -> bool:
    """Whether D* Lite plans on this map: a point's or a disc's, with steps near enough to one
    another in cost.
    """
    return grid.robot.moves.over == CELLS and grid.step_ratio <= MOST_RATIO_FOR_DSTAR


class DStarLite:
    """Plans on one map towards one goal, again and again, in a region if given. Serves one thread
    at a time.

    It reads from the map's log what changed, and repairs its search when a path is asked for. Where
    a cell has become cheaper than any before, the heuristic would overestimate: it searches afresh.
    """

    def __init__(self, state: "MapState", goal: Cell, region: Region | None = None) -> None:
        self._grid = grid = state.grid
        self._changes = state.log.reader()
        count = len(grid.weights)
        room = count + kernels.SPARE_SLOTS
        self.g = np.empty(count)
        self.rhs = np.empty(count)
        self.keys = np.full(room, np.inf)
        self.nodes = np.empty(room, np.int32)
        self.slots = np.full(count, kernels.ABSENT, np.int32)
        self.size = np.zeros(1, np.int64)
        """As of `records.DStar`; to be read only."""
        self.set_goal(goal, region)

    def set_goal(self, goal: Cell, region: Region | None = None) -> None:
        """Another goal, in the whole map or a region: the search starts afresh."""
        self.goal = goal
        self._goal = self._start = self._grid.node(*goal)
        self.region = Region.everywhere(*self._grid.shape) if region is None else region.copy()
        self._begin(self._grid.prices)

    def set_region(self, region: Region) -> None:
        """Search only there from now on; start and goal count as inside. The bitmap may be changed
        afterwards.
        """
        if not region.shares_blocks(self.region):
            self.set_goal(self.goal, region)
            return
        differs = region.blocks() != self.region.blocks()
        self.region = region.copy()
        self._stale.append(((0, 0, *self._grid.shape), differs))

    def plan(self, start: Cell, *, deadline: Deadline = NEVER) -> Search:
        """Cheapest path from `start` to the goal on the map as it is now.

        Where several cost the same it may be another than a fresh search's. NO_PATH also where
        start or goal is impassable; TIMEOUT at the deadline, from where the next call goes on.
        """
        self._move_start(start)
        expansions = 0
        code = PAUSED
        while code != FOUND:
            self._read_changes()  # also after a pause
            if not (self._grid.is_passable(start) and self._grid.is_passable(self.goal)):
                return Search.without_path(Status.NO_PATH, expansions)
            search = self._search
            if self._update_vertices(search, deadline):
                code, expanded = kernels.compute_shortest_path(search, deadline.until)
                expansions += expanded
            if code != FOUND and not deadline.goes_on():
                return Search.without_path(Status.TIMEOUT, expansions)
        cost = self.rhs[self._start]
        if not math.isfinite(cost):
            return Search.without_path(Status.NO_PATH, expansions)
        most = min(self._grid.cells, int(cost / self._cheapest) + 2)
        path = np.empty((most, 2), np.int32)
        length = kernels.trace(search, path)
        return Search(Status.OK, path[:length].copy(), expansions)

    @property
    def _search(self) -> Parts:
        """As kernels take it."""
        return (  # `records.DStar`
            self._grid.packed,
            tuple(self.region),
            self._goal,
            self._start,
            *divmod(self._start, self._grid.stride),
            *self._prices,
            self._km,
            self.g,
            self.rhs,
            self.keys,
            self.nodes,
            self.slots,
            self.size,
        )

    def _begin(self, prices: Iterable[float]) -> None:
        """Forget all that was found. No straight and no diagonal step costs less than `prices`."""
        self._cheapest, diagonal = prices
        self._prices = (_BELOW * self._cheapest, _BELOW * diagonal)
        self._km = 0.0
        self._changes.skip()
        self._stale: list[tuple[Rectangle, Bool]] = []
        self.g.fill(math.inf)
        self.rhs.fill(math.inf)
        listed = self.nodes[: self.size[0]]
        self.slots[listed] = kernels.ABSENT
        self.keys[: len(listed)] = math.inf
        # the goal alone is on the open list
        self.rhs[self._goal] = self.keys[0] = 0.0
        self.nodes[0] = self._goal
        self.slots[self._goal] = 0
        self.size[0] = 1

    def _move_start(self, start: Cell) -> None:
        """Paths lead from `start` from now on."""
        node = self._grid.node(*start)
        if node == self._start:
            return
        left = self._grid.cell(self._start)
        self._start = node
        self._km += float(octile.py_func(*left, *start, *self._prices))
        for cell in (left, start):
            if not self.region.holds(cell):  # it counts as inside as long as paths lead from there
                self._touch((*cell, 1, 1))

    def _read_changes(self) -> None:
        """Note where the map has changed since the last time; start afresh where a cell became
        cheaper than any before, with prices between the new ones and none.
        """
        changes = self._changes.read()
        prices = self._grid.prices
        if prices[0] < self._cheapest:
            lengths = self._grid.model.length_term
            self._begin(0.5 * (p + length) for p, length in zip(prices, lengths, strict=True))
            return
        for change in changes:
            self._touch(widened(change.part, (1, 1), self._grid.shape))

    def _touch(self, part: Rectangle) -> None:
        """Have rhs of the cells of a part of the map worked out anew."""
        self._stale.append((part, np.ones(self.region.bitmap.shape, np.bool_)))

    def _update_vertices(self, search: Parts, deadline: Deadline) -> bool:
        """Work out rhs anew wherever a step has changed; whether it is done by the deadline."""
        while self._stale:
            part, blocks = self._stale.pop()
            row, col, rows, cols = part
            done = kernels.update_vertices(search, part, blocks, deadline.until)
            if done < rows:
                self._stale.append(((row + done, col, rows - done, cols), blocks))
                return False
        return True
