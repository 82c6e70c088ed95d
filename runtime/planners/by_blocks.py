"""The search on ground that is known coarsely: over its blocks, and over cells where these have
been seen.
"""

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from nnpp_edge.runtime.arrays import Bool, Cells
from nnpp_edge.runtime.cells import Cell, Rectangle, cell_of, coarser, slices, widened
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.tiles import BLOCK_SEEN
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.layers import Costs
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.options import STATES
from nnpp_edge.runtime.planners.query import Found
from nnpp_edge.runtime.robots.robot import Price
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import (
    BLOCKS_AROUND,
    BLOCKS_BEYOND,
    MOST_BLOCK_WAYS,
    PRICE_SCALE,
)


class BlockWay:
    """The way over the blocks of a coarse map. Serves one thread at a time.

    Blocks cost by what is expected of them, and by what is known of their cells. `find` plans on a
    map of costs.
    """

    def __init__(
        self,
        state: MapState,
        find: Callable[[MapState], Callable[[Query, Work], Found]],
    ) -> None:
        assert state.unseen is not None
        self._grid = state.grid
        self._unseen = state.unseen
        everywhere = 0, 0, *self._unseen.dem.shape
        model = state.grid.model
        model = model._replace(scale=model.scale * PRICE_SCALE)
        ground = Ground(self._unseen.costs(everywhere) / PRICE_SCALE)
        self._map = MapState(ground, [Costs(ground.costs(), model, True, tells_unknown=False)])
        self._find = find(self._map)
        rows, cols = (
            np.arange(side, dtype=np.int32) // self._unseen.factor for side in state.shape
        )
        self._region = Region(np.zeros(self._unseen.dem.shape, np.int32), rows, cols, 0)

    def read(self, deadline: Deadline) -> None:
        """Have blocks cost by what is known of their cells now; OutOfTimeError at the deadline."""
        for part in self._unseen.read(self._grid, deadline):
            self._price(part, False)

    def _price(self, part: Rectangle, shut: Bool | bool) -> None:
        """Have blocks of a part cost by their prices, but for those that are `shut`."""
        if part[2]:
            costs = self._unseen.costs(part) / PRICE_SCALE
            self._map.update(*part[:2], np.where(shut, np.float32(np.inf), costs))

    def ways(self, query: Query, work: Work) -> Iterator[tuple[Cell, Region, Cells]]:
        """Ways, each around the obstacles by which the ones before it were blocked.

        Of each the cell up to which cells are to be searched, the blocks around the way there, and
        the cells (N, 2) that lead on from there to the goal, straight from block to block. The
        search is to lead as far as the first stretch was seen, or the way on is blocked; a body's,
        which does not lead over blocks, the whole way.
        """
        whole = self._grid.robot.moves.over == STATES
        side = self._unseen.factor
        start = coarser(query.start, side)
        goal = coarser(query.goal, side)
        shut = np.zeros(self._unseen.dem.shape, np.bool_)
        for _ in range(MOST_BLOCK_WAYS):
            left, top, width, height = cv2.boundingRect(shut.view(np.uint8))
            part = top, left, height, width
            self._price(part, shut[slices(part)])
            try:
                found = self._find(query._replace(start=start, goal=goal), work)
            finally:
                self._price(part, False)
            if found.search.status is not Status.OK:
                return
            way = found.search.path
            stops = way * side + side // 2
            stops[-1] = query.goal
            first = len(way) - 1 if whole else self._first(way, stops)
            beyond = over(stops[first:])[1:]
            yield cell_of(stops[first]), self._around(way[: first + 1]), beyond
            if (blocked := self._blocked(stops[: first + 1])) < 0:
                return
            known = self._unseen.blocked > 0.0
            row, col = over(stops)[blocked] // side
            _, number = cv2.connectedComponents(known.view(np.uint8))
            shut |= known & (number == number[row, col])
            shut[start] = False
            shut[goal] = False

    def _first(self, way: Cells, stops: Cells) -> int:
        """Number of the stop up to which cells are to be searched."""
        known = self._unseen.layers[1][tuple(way.T)]
        unseen = np.flatnonzero(known != BLOCK_SEEN)
        last = len(way) - 1
        first = min(int(unseen[0]) + BLOCKS_BEYOND, last) if len(unseen) else last
        while first < last and (blocked := self._blocked(stops[first:])) >= 0:
            first = min(first + blocked // self._unseen.factor + 1 + BLOCKS_BEYOND, last)
        return first

    def _around(self, way: Cells) -> Region:
        """The blocks of a way, and those around them."""
        self._region = region = self._region._replace(stamp=self._region.stamp + 1)
        for row, col in way.tolist():
            around = (BLOCKS_AROUND, BLOCKS_AROUND)
            part = widened((row, col, 1, 1), around, region.bitmap.shape)
            region.bitmap[slices(part)] = region.stamp
        return region

    def _blocked(self, stops: Cells) -> int:
        """Number of the first cell straight from stop to stop that a point cannot step on; or
        -1.
        """
        path = over(stops)
        return Price().walk(self._grid, path, 0, np.empty(len(path)))


def over(stops: Cells) -> Cells:
    """The cells (N, 2) from the first stop straight to each next one."""
    steps = np.abs(np.diff(stops, axis=0)).max(axis=1, initial=0)
    numbers = np.append(0, steps.cumsum())
    cells = np.arange(numbers[-1] + 1)
    between = [np.interp(cells, numbers, along) for along in stops.T]
    path: Cells = np.rint(np.column_stack(between)).astype(np.int32)
    return path
