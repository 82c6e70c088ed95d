"""The search on ground that is known coarsely: over its blocks, and over cells where these have
been seen.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.tiles import BLOCK_SEEN
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import MapState, map_state
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.tuning import BLOCKS_AROUND, BLOCKS_BEYOND, PRICE_SCALE

CellPath = NDArray[np.int32]


class BlockWay:
    """The way over the blocks of a coarse map. Serves one thread at a time.

    Blocks cost by what is expected of them, and by what was seen of their cells. `omega` is the
    weight of a cost, per grey level; `find` plans on a map of costs.
    """

    def __init__(
        self,
        state: MapState,
        omega: float,
        find: Callable[[MapState], Callable[[Query, Work], Found]],
    ) -> None:
        assert state.unseen is not None
        self._unseen = state.unseen
        everywhere = 0, 0, *self._unseen.dem.shape
        self._map = map_state(
            Ground(self._unseen.costs(everywhere) / PRICE_SCALE), omega * PRICE_SCALE
        )
        self._find = find(self._map)
        rows, cols = (
            np.arange(side, dtype=np.int32) // self._unseen.factor for side in state.shape
        )
        self._region = Region(np.zeros(self._unseen.dem.shape, np.int32), rows, cols, 0)

    def changed(self, part: tuple[int, int, int, int]) -> None:
        """Blocks of a part cost otherwise now."""
        self._map.update(*part[:2], self._unseen.costs(part) / PRICE_SCALE)

    def find(self, query: Query, work: Work, *, whole: bool) -> tuple[CellPath, int, Region] | None:
        """Cells to go by: the middles of the blocks on the way, and the goal; up to which of them
        the first stretch leads that has been seen, or the `whole` way; and the blocks around that.
        None where no way was found.
        """
        side = self._unseen.factor
        start, goal = ((cell[0] // side, cell[1] // side) for cell in (query.start, query.goal))
        found = self._find(query._replace(start=start, goal=goal), work)
        if found.search.status is not Status.OK:
            return None
        way = found.search.path
        stops = way * side + side // 2
        stops[-1] = query.goal
        unseen = np.flatnonzero(self._unseen.layers[1][way[:, 0], way[:, 1]] != BLOCK_SEEN)
        first = min(
            int(unseen[0]) + BLOCKS_BEYOND if len(unseen) and not whole else len(way), len(way) - 1
        )
        self._region = region = self._region._replace(stamp=self._region.stamp + 1)
        for row, col in way[: first + 1].tolist():
            rows, cols = (
                slice(max(at - BLOCKS_AROUND, 0), at + BLOCKS_AROUND + 1) for at in (row, col)
            )
            region.bitmap[rows, cols] = region.stamp
        return stops, first, region


def over(stops: CellPath) -> CellPath:
    """The cells (N, 2) from the first stop straight to each next one."""
    steps = np.abs(np.diff(stops, axis=0)).max(axis=1, initial=0)
    begins = np.repeat(np.cumsum(steps) - steps, steps)
    share = ((np.arange(len(begins)) - begins + 1) / np.repeat(steps, steps))[:, None]
    begin, end = (np.repeat(ends, steps, axis=0) for ends in (stops[:-1], stops[1:]))
    return np.concatenate(
        (stops[:1], np.rint(begin * (1.0 - share) + end * share).astype(np.int32))
    )
