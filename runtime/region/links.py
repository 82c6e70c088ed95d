"""Where to search by the prices of links between blocks: all blocks on ways that cost nearly the least."""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.kernels.links import close_links, mark_links, settle_links
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.region import Lookup, Region
from nnpp_edge.runtime.search.workspace import Workspace

Prices = NDArray[np.float32]
Searched = tuple[NDArray[np.float32], NDArray[np.int32], int]
Guide = tuple[NDArray[np.float32], NDArray[np.int32], int, np.float32]
"""What a search of blocks left, see `settle_links`."""
CLOSED = 1000.0
"""Added to the price of a link that turned out to be none."""


class LinkSearch:
    """Searches of a map's blocks of 4 × 4 cells, whose links have prices. Serves one search at a time.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the map.
    """

    def __init__(self, shape: Cell) -> None:
        rows, cols = (math.ceil(n / FACTOR) for n in shape)
        blocks = rows * cols
        self._cols = cols
        self._there, self._back = ((np.empty(blocks, np.float32), np.zeros(blocks, np.int32)) for _ in range(2))
        self._heap = np.empty(8 * blocks + 8, np.float32), np.empty(8 * blocks + 8, np.int32)
        self._scratch = np.empty(blocks, np.float32), np.empty(2 << (blocks - 1).bit_length(), np.int32)
        self._bitmap = np.zeros((2 * rows, 2 * cols), np.int32)
        half = FACTOR // 2
        down, across = (np.arange(n, dtype=np.int32) // np.int32(half) for n in shape)
        self._quarters: Lookup = down, across
        self._stamp = 0
        self._guide: Guide = (*self._back, 0, np.float32(0.0))

    def around(
        self, prices: Prices, query: tuple[Cell, Cell], band: float, radius: int, least: float = 1.0
    ) -> tuple[Region, int]:
        """The blocks on ways that cost at most 1 + `band` times the least, those around, and how many were expanded.

        Parameters
        ----------
        prices : (4, R, C) float32
            Of the links, see `kernels.links`.
        query : (start, goal)
            Cells of the map.
        radius : int
            Quarters of blocks that belong to the region around each block.
        least : float
            No link costs less for a cell's length.

        Returns
        -------
        (Region, int)
            The region's bitmap is overwritten by the next call.
        """
        start, goal = self._blocks(query)
        found = self._searched(*self._back)
        nothing = (*self._there, 0, np.float32(0.0))
        expanded = settle_links(prices, np.float32(least), (goal, start), 1.0 + band, found, nothing, self._heap)
        self._guide = (*found, np.float32(found[0][start] * (1.0 + band)))
        return self._marked(prices, start, query, found, (band, radius)), expanded

    def around_again(
        self, prices: Prices, query: tuple[Cell, Cell], band: float, radius: int, least: float = 1.0
    ) -> tuple[Region, int]:
        """The same, where no link has become cheaper since `around` was called with this query: sooner."""
        start, goal = self._blocks(query)
        found = self._searched(*self._there)
        ends = start, goal
        expanded = settle_links(prices, np.float32(least), ends, 1.0 + band, found, self._guide, self._heap)
        return self._marked(prices, goal, query, found, (band, radius)), expanded

    def _blocks(self, query: tuple[Cell, Cell]) -> tuple[int, int]:
        start, goal = (row // FACTOR * self._cols + col // FACTOR for row, col in query)
        return start, goal

    def _searched(self, reached: NDArray[np.float32], stamps: NDArray[np.int32]) -> Searched:
        self._stamp += 1
        return reached, stamps, self._stamp

    def _marked(
        self, prices: Prices, first: int, query: tuple[Cell, Cell], found: Searched, width: tuple[float, int]
    ) -> Region:
        """The region around ways from block `first`, by the costs to the other end."""
        band, radius = width
        mark_links(prices, first, 1.0 + band + 1e-6, found, self._scratch, radius, (self._bitmap, self._stamp))
        for row, col in query:
            row, col = 2 * (row // FACTOR), 2 * (col // FACTOR)
            self._bitmap[max(row - 2, 0) : row + 4, max(col - 2, 0) : col + 4] = self._stamp
        return Region(self._bitmap, *self._quarters, self._stamp)


def without_dead_ends(prices: Prices, region: Region, searched: Workspace, shape: Cell) -> Prices:
    """The prices, with links closed that the last search of a region did not get across: a new array.

    Parameters
    ----------
    prices : (4, R, C) float32
        Of the links.
    region : Region
        Over the quarters of blocks.
    searched : Workspace
        Of that search.
    shape : (int, int)
        Rows and columns of the map.
    """
    out = prices.copy()
    reached = searched.meta, searched.stamp, shape
    close_links(out, (region.bitmap, region.stamp), reached, CLOSED, np.empty(prices.shape[1:], np.int8))
    return out
