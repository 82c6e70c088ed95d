"""Where to search by the prices of links between blocks: all blocks on ways that cost nearly the least."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.bands import stripes
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.kernels.links import FULL, LATE, close_links, join_blocks, mark_links, settle_links
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP
from nnpp_edge.runtime.kernels.open_list import BUCKETS, CONTROL_SLOTS
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.region import Lookup, Region
from nnpp_edge.runtime.search.workspace import Workspace

CLOSED = 1000.0
"""Added to the price of a link that turned out to be none."""
_LAST_NUMBER = 2**30 - 1
Searched = tuple[NDArray[np.float32], NDArray[np.int32], int]
"""What a search of blocks leaves, see `settle_links`."""


class Links(NamedTuple):
    """Prices of the links between a map's blocks of 4 × 4 cells."""

    prices: NDArray[np.float32]
    """(nodes, 8) by block and direction, see `kernels.links`; inf where there is no block."""
    stride: int
    """Blocks to a row, with the border's."""

    @classmethod
    def room_for(cls, shape: Cell) -> "Links":
        """Of a map of so many rows and columns, without prices yet."""
        rows, cols = (math.ceil(n / FACTOR) for n in shape)
        return cls(np.empty(((rows + 2) * (cols + 2), 8), np.float32), cols + 2)

    def fill(self, price: float, first: int, last: int) -> None:
        """Put all links of some rows of blocks, counted with the border's, at one price."""
        blocks = self.prices.reshape(-1, self.stride, 8)
        blocks[first:last] = price
        rows, cols = np.arange(len(blocks))[first:last, None, None], np.arange(self.stride)[:, None]
        for at, most, step in ((rows, len(blocks), ROW_STEP), (cols, self.stride, COL_STEP)):
            there = at + np.array(step)
            no_link = (at < 1) | (at > most - 2) | (there < 1) | (there > most - 2)  # from the border, or into it
            np.copyto(blocks[first:last], np.float32(np.inf), where=no_link)

    @classmethod
    def of(cls, by_heading: NDArray[np.float32]) -> "Links":
        """From (4, R, C) float32: each link stands with the block that it leaves along one of the four headings."""
        rows, cols = by_heading.shape[1:]
        links = cls.room_for((FACTOR * rows, FACTOR * cols))
        join_blocks(by_heading, links)
        return links


class LinkSearch:
    """Searches of a map's blocks of 4 × 4 cells, whose links have prices. Serves one search at a time.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the map.
    """

    def __init__(self, shape: Cell) -> None:
        rows, cols = (math.ceil(n / FACTOR) for n in shape)
        self._shape, self._stride, nodes = shape, cols + 2, (rows + 2) * (cols + 2)
        self._there, self._back = ((np.empty(nodes, np.float32), np.zeros(nodes, np.int32)) for _ in range(2))
        self._list = np.empty(BUCKETS, np.int32), np.empty(8 * nodes, np.int32), np.zeros(CONTROL_SLOTS, np.int64)
        self._scratch = np.empty(nodes, np.float32), np.empty(2 << (nodes - 1).bit_length(), np.int32)
        self._corrected = Links(np.empty((nodes, 8), np.float32), self._stride)
        self._came = np.empty(nodes, np.int8)
        self._bitmap = np.zeros((2 * rows, 2 * cols), np.int32)
        half = FACTOR // 2
        down, across = (np.arange(n, dtype=np.int32) // np.int32(half) for n in shape)
        self._quarters: Lookup = down, across
        self._number = 0
        self._guide: tuple[NDArray[np.float32], NDArray[np.int32], int, np.float32] | None = None

    def around(
        self,
        links: Links,
        query: tuple[Cell, Cell],
        band: float,
        radius: int,
        least: float = 1.0,
        deadline: Deadline = NEVER,
    ) -> tuple[Region, int]:
        """The blocks on ways that cost at most 1 + `band` times the least, those around, and how many were expanded.

        Parameters
        ----------
        links : Links
            Of the map.
        query : (start, goal)
            Cells of the map.
        radius : int
            Quarters of blocks that belong to the region around each block.
        least : float
            No link costs less for a cell's length.
        deadline : Deadline
            When to give up with OutOfTimeError.

        Returns
        -------
        (Region, int)
            The region's bitmap is overwritten by the next call.
        """
        start, goal = self._blocks(query)
        found, beyond = self._searched(*self._back), np.float32(1.0 + band)
        self._guide = None
        expanded = self._settle(links, least, (goal, start), beyond, found, deadline)
        self._guide = (*found, found[0][start] * beyond)
        return self._marked(links, start, query, found, (band, radius), deadline), expanded

    def around_again(
        self,
        links: Links,
        query: tuple[Cell, Cell],
        band: float,
        radius: int,
        least: float = 1.0,
        deadline: Deadline = NEVER,
    ) -> tuple[Region, int]:
        """The same, where no link has become cheaper since `around` was called with this query: sooner."""
        start, goal = self._blocks(query)
        found, beyond = self._searched(*self._there), np.float32(1.0 + band)
        expanded = self._settle(links, least, (start, goal), beyond, found, deadline)
        return self._marked(links, goal, query, found, (band, radius), deadline), expanded

    def without_dead_ends(
        self, links: Links, region: Region, searched: Workspace, deadline: Deadline = NEVER
    ) -> Links:
        """The links, those closed that the last search of a region did not get across; overwritten by the next call.

        Parameters
        ----------
        links : Links
            Of the map, or what the last call returned.
        region : Region
            Over the quarters of blocks.
        searched : Workspace
            Of that search.
        """
        out = self._corrected
        if links is not out:
            for first, last in stripes(*links.prices.shape):
                deadline.check()
                out.prices[first:last] = links.prices[first:last]
        reached = searched.meta, searched.stamp, self._shape
        close_links(out, (region.bitmap, region.stamp), reached, CLOSED, self._came)
        return out

    def _blocks(self, query: tuple[Cell, Cell]) -> tuple[int, int]:
        start, goal = ((row // FACTOR + 1) * self._stride + col // FACTOR + 1 for row, col in query)
        return start, goal

    def _searched(self, reached: NDArray[np.float32], seen: NDArray[np.int32]) -> Searched:
        if self._number == _LAST_NUMBER:
            self._number, self._guide = 0, None
            for each in (self._there, self._back):
                each[1][:] = 0
            self._bitmap[:] = 0
        self._number += 1
        return reached, seen, self._number

    def _settle(
        self,
        links: Links,
        least: float,
        ends: tuple[int, int],
        beyond: np.float32,
        found: Searched,
        deadline: Deadline,
    ) -> int:
        side, until = np.float32(FACTOR * least), deadline.at
        while (expanded := settle_links(links, side, ends, beyond, found, self._guide, self._list, until)) == FULL:
            heads, entries, control = self._list
            self._list = heads, np.empty(2 * len(entries), np.int32), control
            found[1][:] = 0
        if expanded == LATE:
            raise OutOfTimeError
        return int(expanded)

    def _marked(
        self,
        links: Links,
        first: int,
        query: tuple[Cell, Cell],
        found: Searched,
        width: tuple[float, int],
        deadline: Deadline,
    ) -> Region:
        """The region around ways from block `first`, by the costs to the other end."""
        band, radius = width
        marks = self._bitmap, self._number
        if not mark_links(links, first, 1.0 + band + 1e-6, found, self._scratch, radius, marks, deadline.at):
            raise OutOfTimeError
        for row, col in query:
            row, col = 2 * (row // FACTOR), 2 * (col // FACTOR)
            self._bitmap[max(row - 2, 0) : row + 4, max(col - 2, 0) : col + 4] = self._number
        return Region(self._bitmap, *self._quarters, self._number)
