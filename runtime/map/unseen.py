"""Ground of which the means of blocks are known, until its cells are seen."""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Rectangle, enclosing, slices
from nnpp_edge.runtime.kernels.tiles import BLOCK_SEEN, BLOCK_UNTOUCHED
from nnpp_edge.runtime.map.along import Line, heights_at
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.terrain.traversability import relative_heights
from nnpp_edge.runtime.tuning import BLOCKED_PRICE, MOST_PRICE


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
        """(2, H, W) prices, and what is known of the heights, as `map.tiles.Tiles` takes it."""
        self.priced = False
        """Whether the prices are there."""
        self.mean, self.blocked, self.share = (
            np.zeros(self.dem.shape, np.float32) for _ in range(3)
        )
        """(H, W) of the cells seen of each block: mean T, impassable ones as 1; share that is
        impassable; and what share they are of the block's."""
        self.left = self.dem.size
        """Blocks not all of whose cells have been seen, as far as `read` knows."""
        self._new: list[Rectangle] = []

    def note(self, part: Rectangle) -> None:
        """Heights of cells in a part of the map have changed."""
        if part[2] and part[3]:
            row, col, rows, cols = part
            side = self.factor
            last_row = (row + rows - 1) // side
            last_col = (col + cols - 1) // side
            row = row // side
            col = col // side
            self._new.append((row, col, last_row - row + 1, last_col - col + 1))

    def read(self, grid: Grid) -> Rectangle | None:
        """Sum up what has been seen since this was last asked; the blocks that it is of, None for
        none.
        """
        if not self._new:
            return None
        assert grid.tiles is not None
        part = enclosing(self._new)
        side = self.factor
        self._new = []
        row, col, rows, cols = part
        for i in range(row * side, (row + rows) * side, side):
            for j in range(col * side, (col + cols) * side, side):
                grid.tiles.open_at(i, j)
        cells = slices((row * side, col * side, rows * side, cols * side))
        known = np.isfinite(grid.tiles.heights[cells])
        known &= self.layers[1][self._blocks(*cells)] == BLOCK_SEEN
        costs = grid.map()[cells] / np.float32(grid.model.scale or 1.0)
        shut = known & ~(costs < np.inf)
        count = np.maximum(self._sums(known), 1.0)
        blocks = slices(part)
        share = self._sums(known) / np.float32(side**2)
        self.left += int((self.share[blocks] == 1.0).sum()) - int((share == 1.0).sum())
        self.share[blocks] = share
        self.mean[blocks] = (
            self._sums(np.where(shut, np.float32(1.0), np.where(known, costs, 0.0))) / count
        )
        self.blocked[blocks] = self._sums(shut) / count
        return part

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

    def unknown(self, rows: slice, cols: slice) -> NDArray[np.bool_]:
        """Cells of a part of the map whose heights mean nothing."""
        unknown: NDArray[np.bool_] = self.layers[1][self._blocks(rows, cols)] == BLOCK_UNTOUCHED
        return unknown

    def unknown_at(self, path: NDArray[np.int32]) -> NDArray[np.bool_]:
        """As `unknown`, of the cells (N, 2) of a path."""
        unknown: NDArray[np.bool_] = self.layers[1][tuple(path.T // self.factor)] == BLOCK_UNTOUCHED
        return unknown

    def heights_at(self, places: Line, known: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) heights at places (N, 2) of the map: `known` where the cell was seen, else by the
        means of blocks.
        """
        unknown = self.unknown_at(np.rint(places).astype(np.int32))
        return np.where(unknown, heights_at(self.dem, (places + 0.5) / self.factor - 0.5), known)

    def at(self) -> Float2D:
        """(rows, cols) the price of each cell of the map."""
        prices: Float2D = self.layers[0][self._blocks(slice(None), slice(None))]
        return prices

    def _sums(self, cells: NDArray[np.generic]) -> Float2D:
        """Sums over blocks."""
        rows, cols = (side // self.factor for side in cells.shape)
        by_block = cells.reshape(rows, self.factor, cols, self.factor)
        sums: Float2D = by_block.sum(axis=(1, 3), dtype=np.float32)
        return sums

    def _blocks(self, rows: slice, cols: slice) -> tuple[NDArray[np.intp], ...]:
        """Those of the cells of a part of the map, to index with."""
        sides = zip(self.dem.shape, (rows, cols), strict=True)
        return np.ix_(*(np.arange(side * self.factor)[part] // self.factor for side, part in sides))
