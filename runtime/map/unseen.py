"""Ground of which the means of blocks are known, until its cells are seen."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Bool, Float2D, Floats, in_blocks
from nnpp_edge.runtime.cells import Rectangle, above, holding, slices, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.kernels.tiles import BLOCK_SEEN, BLOCK_UNKNOWN, BLOCK_UNTOUCHED
from nnpp_edge.runtime.map.along import Line, heights_at
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.terrain.traversability import relative_heights
from nnpp_edge.runtime.tuning import BLOCKED_PRICE, MOST_PRICE

_TOGETHER = 1 << 16
"""Cells that are summed up between two readings of the clock: a few milliseconds."""


class Unseen:
    """The blocks of a coarse map: what has been seen of each, and the price by which its other
    cells count.
    """

    def __init__(self, ground: Ground) -> None:
        assert ground.elevation is not None
        self.ground = ground
        self.factor = ground.factor
        self.dem = relative_heights(ground.elevation)[0]
        self.layers = np.zeros((2, *self.dem.shape), np.float32)
        """(2, H, W) prices, and what is known of the heights (`kernels.tiles.BLOCK_UNTOUCHED`)."""
        self.priced = False
        """Whether the prices are there."""
        self.mean, self.blocked, self.share = (
            np.zeros(self.dem.shape, np.float32) for _ in range(3)
        )
        """(H, W) of the cells of each block that were seen, or told of: mean T, impassable ones as
        1; share that is impassable; and what share they are of the block's."""
        self.left = self.dem.size
        """Blocks of which not all cells were, as far as `read` knows."""
        self._new = np.zeros(self.dem.shape, np.bool_)
        """(H, W) blocks that `read` is to sum up."""

    @property
    def source(self) -> dict[str, object]:
        """Its fields of `records.TileSource`."""
        prices, states = self.layers.reshape(2, -1)
        return {
            "block_side": self.factor,
            "block_cols": self.dem.shape[1],
            "block_prices": prices,
            "block_states": states,
        }

    def see(self, part: Rectangle, known: Bool, heights: Float2D) -> None:
        """Have the blocks take heights under the cells of a part that are `known` (h, w) now; those
        of the map are unknown in the blocks around, where nothing was seen.
        """
        states = self.layers[1]
        blocks = above(part, self.factor)
        firsts = [
            (np.arange(begin, begin + count) * self.factor - first).clip(0)
            for begin, count, first in zip(blocks[:2], blocks[2:], part[:2], strict=True)
        ]
        seen = np.logical_or.reduceat(known, firsts[0], 0)
        seen = np.logical_or.reduceat(seen, firsts[1], 1) & (states[slices(blocks)] != BLOCK_SEEN)
        for i, j in (np.argwhere(seen) + blocks[:2]).tolist():
            near = slices(widened((i, j, 1, 1), (1, 1), states.shape))
            untouched = states[near] == BLOCK_UNTOUCHED
            cells = in_blocks(heights, self.factor).swapaxes(1, 2)[near]
            cells[untouched] = np.nan
            states[near][untouched] = BLOCK_UNKNOWN
            states[i, j] = BLOCK_SEEN

    def note(self, part: Rectangle) -> None:
        """Heights of cells in a part of the map have changed, or what was told of them; so has what
        the cells beside them cost.
        """
        if part[2]:
            around = widened(part, (1, 1), self.ground.shape)
            self._new[slices(above(around, self.factor))] = True

    def read(self, grid: Grid, deadline: Deadline = NEVER) -> Iterator[Rectangle]:
        """Sum up what has been seen and told since this was last asked; gives the parts of the
        blocks that it is of.

        OutOfTimeError at the deadline: the next call goes on.
        """
        blocks = np.argwhere(self._new)
        together = max(_TOGETHER // self.factor**2, 1)
        for begin in range(0, len(blocks), together):
            deadline.check()
            some = blocks[begin : begin + together]
            self._sum_up(some, grid)
            self._new[tuple(some.T)] = False
            yield holding(some)

    def _sum_up(self, blocks: NDArray[np.intp], grid: Grid) -> None:
        """Sum up what is known of the cells of blocks (N, 2)."""
        assert grid.tiles is not None
        inside = np.argwhere(np.ones((self.factor, self.factor), np.bool_))
        cells = (blocks[:, None] * self.factor + inside).astype(np.int32, "C")  # (N, factor², 2)
        grid.tiles.open_along(cells.reshape(-1, 2))
        at = tuple(blocks.T)
        node = cells @ (grid.cols, 1)
        known = np.isfinite(grid.tiles.heights.reshape(-1)[node])
        known &= (self.layers[1][at] == BLOCK_SEEN)[:, None]
        known |= grid.tiles.told[node] > 0.0
        costs = grid.weights[(cells + 1) @ (grid.stride, 1)] / np.float32(grid.model.scale or 1.0)
        shut = known & ~(costs < np.inf)
        costs = np.where(shut, np.float32(1.0), np.where(known, costs, np.float32(0.0)))
        count = np.maximum(known.sum(1, dtype=np.float32), np.float32(1.0))
        share = known.mean(1, dtype=np.float32)
        self.left += int((self.share[at] == 1.0).sum()) - int((share == 1.0).sum())
        self.share[at] = share
        self.mean[at] = costs.sum(1) / count
        self.blocked[at] = shut.sum(1) / count

    def costs(self, part: Rectangle) -> Float2D:
        """Expected price of a cell of each block of a part, what was seen of it counted; inf where
        all is shut.
        """
        blocks = slices(part)
        share = self.share[blocks]
        blocked = self.blocked[blocks]
        here = np.minimum(
            self.mean[blocks] + np.float32(BLOCKED_PRICE) * blocked, np.float32(MOST_PRICE)
        )
        price: Float2D = share * here + (1.0 - share) * self.layers[0][blocks]
        return np.where((share == 1.0) & (blocked == 1.0), np.float32(np.inf), price)

    def unknown(self, part: Rectangle) -> Bool:
        """(h, w) cells of a part of the map whose heights mean nothing."""
        unknown: Bool = self.layers[1][self._blocks(part)] == BLOCK_UNTOUCHED
        return unknown

    def means(self, part: Rectangle) -> bool:
        """Whether all heights of a part of the map mean something."""
        blocks = slices(above(part, self.factor))
        return bool((self.layers[1][blocks] != BLOCK_UNTOUCHED).all())

    def heights_at(self, places: Line, known: Floats) -> Floats:
        """(N,) heights at places (N, 2) of the map: `known` where the cell was seen, else by the
        means of blocks.
        """
        blocks = np.rint(places).astype(np.int32) // self.factor
        unknown = self.layers[1][tuple(blocks.T)] == BLOCK_UNTOUCHED
        return np.where(unknown, heights_at(self.dem, (places + 0.5) / self.factor - 0.5), known)

    def prices(self, part: Rectangle) -> Float2D:
        """(h, w) the price of each cell of a part of the map."""
        prices: Float2D = self.layers[0][self._blocks(part)]
        return prices

    def _blocks(self, part: Rectangle) -> tuple[NDArray[np.intp], ...]:
        """Those of the cells of a part of the map, to index with."""
        row, col, rows, cols = part
        down = np.arange(row, row + rows) // self.factor
        across = np.arange(col, col + cols) // self.factor
        return np.ix_(down, across)
