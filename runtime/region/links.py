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
        self._reached, self._stamps = np.empty(blocks, np.float32), np.zeros(blocks, np.int32)
        self._heap = np.empty(8 * blocks + 8, np.float32), np.empty(8 * blocks + 8, np.int32)
        self._scratch = np.empty(blocks, np.float32), np.empty(2 << (blocks - 1).bit_length(), np.int32)
        self._bitmap = np.zeros((2 * rows, 2 * cols), np.int32)
        half = FACTOR // 2
        down, across = (np.arange(n, dtype=np.int32) // np.int32(half) for n in shape)
        self._quarters: Lookup = down, across
        self._stamp = 0

    def around(
        self, prices: NDArray[np.float32], start: Cell, goal: Cell, band: float, radius: int
    ) -> tuple[Region, int]:
        """The blocks on ways that cost at most 1 + `band` times the least, those around, and how many were expanded.

        Parameters
        ----------
        prices : (4, R, C) float32
            Of the links, see `kernels.links`.
        start, goal : (row, col)
            Cells of the map.
        radius : int
            Quarters of blocks that belong to the region around each block.

        Returns
        -------
        (Region, int)
            The region's bitmap is overwritten by the next call.
        """
        self._stamp += 1
        first, last = (cell[0] // FACTOR * self._cols + cell[1] // FACTOR for cell in (start, goal))
        beyond, found = 1.0 + band, (self._reached, self._stamps, self._stamp)
        expanded = settle_links(prices, last, first, beyond, *found, self._heap)
        mark_links(prices, first, beyond + 1e-6, found, self._scratch, radius, (self._bitmap, self._stamp))
        for row, col in (start, goal):
            row, col = 2 * (row // FACTOR), 2 * (col // FACTOR)
            self._bitmap[max(row - 2, 0) : row + 4, max(col - 2, 0) : col + 4] = self._stamp
        return Region(self._bitmap, *self._quarters, self._stamp), expanded


def without_dead_ends(prices: NDArray[np.float32], region: Region, searched: Workspace, shape: Cell) -> Prices:
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
