"""From blocks whose links have prices to the map: searches of regions, which correct prices that were wrong."""

from typing import Protocol

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import Searcher
from nnpp_edge.runtime.region.links import Links, LinkSearch
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import LEAST_LOOK_MARGIN, LOOK_MARGIN, MOST_CORRECTIONS, CorridorWidth


class PricedLinks(Protocol):
    """A map, and the prices of the links between its blocks: `LookedMap` is one."""

    grid: Grid
    shape: Cell
    """Rows and columns of the map."""
    least: float
    """No link costs less for a cell's length."""
    looks: int
    """Prices are the same as long as this is."""

    def links_within(self, part: Rectangle, deadline: Deadline) -> Links:
        """Of the map as it is now; right within a rectangle of cells. OutOfTimeError at the deadline."""


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
        self._asked: tuple[tuple[Cell, Cell], int] | None = None

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
        deadline = query.deadline
        links = self._links.links_within(self._window(query), deadline)
        work.stage_ends("look")
        band = width.band + FACTOR * width.nearby / max(query.apart, FACTOR)
        ends, least = (query.start, query.goal), self._links.least
        around, asked = self._search.around, (ends, self._links.looks)
        if asked == self._asked:
            around = self._search.around_again
        self._asked = None
        for _ in range(1 if source is Source.REGION else MOST_CORRECTIONS):
            region, expanded = around(links, ends, band, width.radius, least, deadline)
            self._asked = asked
            work.expansions += expanded
            work.stage_ends("coarse")
            found = searcher.search(query, work, region)
            if found.status is not Status.NO_PATH:
                return Found.of(self._links.grid, found, source, region, work)
            if source is not Source.REGION:
                links = self._search.without_dead_ends(links, region, self._finest, deadline)
                around = self._search.around_again
        return None

    def _window(self, query: Query) -> Rectangle:
        """The cells about start and goal, which nearly all good paths keep to."""
        margin = int(LOOK_MARGIN * query.apart) + LEAST_LOOK_MARGIN
        low = [max(min(ends) - margin, 0) for ends in zip(query.start, query.goal, strict=True)]
        high = [min(max(e) + margin + 1, n) for *e, n in zip(query.start, query.goal, self._links.shape, strict=True)]
        return low[0], low[1], high[0] - low[0], high[1] - low[1]
