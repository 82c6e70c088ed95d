"""From blocks whose links have prices to the map: searches of regions, which correct prices that were wrong."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import Searcher
from nnpp_edge.runtime.region.links import LinkSearch, without_dead_ends
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import MOST_CORRECTIONS, CorridorWidth


class PricedLinks(Protocol):
    """A map, and the prices of the links between its blocks: `LookedMap` is one."""

    grid: Grid
    shape: Cell
    """Rows and columns of the map."""

    @property
    def prices(self) -> NDArray[np.float32]:
        """(4, R, C) float32, see `kernels.links`, of the map as it is now."""


class LinkDescent:
    """Stands in for `CoarseToFine` on a map whose links have prices. Serves one thread at a time.

    Parameters
    ----------
    links : PricedLinks
        The map, and the prices.
    finest : Workspace
        Memory of the searches at full resolution.

    Notes
    -----
    A region without a path is not made wider at once. What its search has found out, at the price of many checks, is
    where it got no farther: links that lead from what it reached to blocks that it did not are closed, and the blocks
    are searched again. Poses that have been checked cost nothing the second time.
    """

    def __init__(self, links: PricedLinks, finest: Workspace) -> None:
        self._links, self._search, self._finest = links, LinkSearch(links.shape), finest

    def top_for(self, query: Query) -> int:
        """There is one coarse level."""
        return 1

    def find(
        self,
        query: Query,
        work: Work,
        searcher: Searcher,
        top: int,
        region: Region | None,
        width: CorridorWidth,
        source: Source,
    ) -> Found | None:
        """As `CoarseToFine.find`; where the source is ``WIDENED`` prices are corrected as often as it takes."""
        prices = self._links.prices
        work.stage_ends("look")
        band = width.band + FACTOR * width.nearby / max(query.apart, FACTOR)
        for _ in range(1 if source is Source.REGION else MOST_CORRECTIONS):
            region, expanded = self._search.around(prices, query.start, query.goal, band, width.radius)
            work.expansions += expanded
            work.stage_ends("coarse")
            found = searcher.search(query, work, region)
            if found.status is not Status.NO_PATH:
                return Found.of(self._links.grid, found, source, region, work)
            if source is not Source.REGION:
                prices = without_dead_ends(prices, region, self._reached())
                work.stage_ends("coarse")
        return None

    def _reached(self) -> NDArray[np.bool_]:
        """(H, W) the cells that the last search came to."""
        ws, grid = self._finest, self._links.grid
        reached: NDArray[np.bool_] = ws.meta[1::2] >> STAMP_SHIFT == ws.stamp
        return reached.reshape(grid.rows + 2, grid.stride)[1:-1, 1:-1]
