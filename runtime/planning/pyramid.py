"""The map at falling resolution, for the coarse-to-fine search.

Each level has cells of 4 × 4 cells of the one below. A coarse cell stands for the largest connected piece of
the passable cells that it covers, and two neighbours are linked where their pieces touch. So whatever path a
coarse search finds can be walked on the level below, inside the cells it crosses: thin walls do not vanish,
and narrow passes stay open unless two of them share a coarse cell.

A coarse cell's weight is the mean over the cells it covers, those outside its piece counting as
`obstacle_weight`. Means keep the balance of length and weight: both halves of a step's cost shrink alike.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime._jit import kernel
from nnpp_edge.runtime.costmap import Rectangle
from nnpp_edge.runtime.grid import Grid, StepCost
from nnpp_edge.runtime.planning.astar import Region
from nnpp_edge.runtime.planning.expansion import COL_STEP, DIRECTION, ROW_STEP
from nnpp_edge.runtime.planning.workspace import Workspace

FACTOR = 4
_SMALLEST = 64
"""A level above the first coarse one is made only if its longer side has as many cells."""


@kernel
def _linked(weights, links, node, k, stride, corner_cutting):
    """Whether a step in direction k leads from a passable cell to another."""
    if links is not None:
        return (links[node] >> k) & 1 != 0
    there = node + ROW_STEP[k] * stride + COL_STEP[k]
    if weights[there] == np.inf:
        return False
    if k < 4 or corner_cutting:
        return True
    return weights[node + ROW_STEP[k] * stride] != np.inf and weights[node + COL_STEP[k]] != np.inf


@kernel
def _largest_piece(weights, links, rows, cols, row, col, corner_cutting):
    """The largest connected piece of the passable cells under a coarse cell, as 16 bits, row by row."""
    stride = cols + 2
    passable = 0
    for b in range(FACTOR * FACTOR):
        i, j = row * FACTOR + b // FACTOR, col * FACTOR + b % FACTOR
        if i < rows and j < cols and weights[(i + 1) * stride + j + 1] != np.inf:
            passable |= 1 << b
    if links is None and passable == (1 << FACTOR * FACTOR) - 1:
        return passable
    best, best_size = 0, 0
    while passable:
        piece, frontier, size = 0, passable & -passable, 0
        while frontier:
            bit = frontier & -frontier
            frontier ^= bit
            piece |= bit
            size += 1
            b = 0
            while bit >> b != 1:
                b += 1
            node = (row * FACTOR + b // FACTOR + 1) * stride + col * FACTOR + b % FACTOR + 1
            for k in range(8):
                i, j = b // FACTOR + ROW_STEP[k], b % FACTOR + COL_STEP[k]
                if 0 <= i < FACTOR and 0 <= j < FACTOR:
                    other = 1 << (i * FACTOR + j)
                    fresh = other & passable and not other & (piece | frontier)
                    if fresh and _linked(weights, links, node, k, stride, corner_cutting):
                        frontier |= other
        passable &= ~piece
        if size > best_size:
            best, best_size = piece, size
    return best


@kernel
def _pool(
    fine, fine_links, fine_rows, fine_cols, corner_cutting, obstacle, row0, row1, col0, col1,
    coarse, pieces, coarse_stride,
):  # fmt: skip
    """Weights and kept pieces of a rectangle of coarse cells; the least weight."""
    fine_stride = fine_cols + 2
    least = np.inf
    for row in range(row0, row1):
        for col in range(col0, col1):
            piece = _largest_piece(fine, fine_links, fine_rows, fine_cols, row, col, corner_cutting)
            total, cells = 0.0, 0
            for b in range(FACTOR * FACTOR):
                i, j = row * FACTOR + b // FACTOR, col * FACTOR + b % FACTOR
                if i < fine_rows and j < fine_cols:
                    cells += 1
                    if (piece >> b) & 1:
                        total += fine[(i + 1) * fine_stride + j + 1]
                    else:
                        total += obstacle
            there = (row + 1) * coarse_stride + col + 1
            pieces[there] = piece
            coarse[there] = total / cells if piece else np.inf
            least = min(least, np.float64(coarse[there]))
    return least


@kernel
def _link(
    fine, fine_links, fine_cols, corner_cutting, row0, row1, col0, col1, pieces, links, coarse_stride,
):  # fmt: skip
    """For a rectangle of coarse cells, the directions in which their pieces touch a neighbour's, as bits."""
    fine_stride = fine_cols + 2
    for row in range(row0, row1):
        for col in range(col0, col1):
            here = (row + 1) * coarse_stride + col + 1
            piece, found = pieces[here], 0
            for b in range(FACTOR * FACTOR):
                if not (piece >> b) & 1:
                    continue
                r, c = b // FACTOR, b % FACTOR
                if 0 < r < FACTOR - 1 and 0 < c < FACTOR - 1:
                    continue
                node = (row * FACTOR + r + 1) * fine_stride + col * FACTOR + c + 1
                for k in range(8):
                    i, j = r + ROW_STEP[k], c + COL_STEP[k]
                    up, left = (i >= 0) - 1 + (i >= FACTOR), (j >= 0) - 1 + (j >= FACTOR)
                    if up == 0 and left == 0:
                        continue
                    towards = DIRECTION[(up + 1) * 3 + left + 1]
                    if (found >> towards) & 1:
                        continue
                    neighbour = pieces[here + up * coarse_stride + left]
                    if (neighbour >> ((i - up * FACTOR) * FACTOR + j - left * FACTOR)) & 1 and _linked(
                        fine, fine_links, node, k, fine_stride, corner_cutting
                    ):
                        found |= 1 << towards
            links[here] = found


@kernel
def _mark(path, radius, stamp, bitmap):
    """Number the cells within `radius` (as the king moves) of a path's."""
    rows, cols = bitmap.shape
    for n in range(len(path)):
        for i in range(max(path[n, 0] - radius, 0), min(path[n, 0] + radius + 1, rows)):
            for j in range(max(path[n, 1] - radius, 0), min(path[n, 1] + radius + 1, cols)):
                bitmap[i, j] = stamp


class Level:
    """A grid, its scratch memory, and a bitmap over it that marks a region for the level below."""

    def __init__(self, grid: Grid, linked: bool) -> None:
        self.grid = grid
        self.links: NDArray[np.uint8] | None = np.zeros(len(grid.weights), np.uint8) if linked else None
        """Directions in which each cell is linked to its neighbour, as bits; None where passability decides."""
        self.pieces = np.zeros(len(grid.weights) if linked else 0, np.int32)
        self.workspace = Workspace(len(grid.weights))
        self.coarse_cells = (
            np.arange(grid.rows, dtype=np.int32) // FACTOR,
            np.arange(grid.cols, dtype=np.int32) // FACTOR,
        )
        """Row and column, on the level above, of each row and column."""
        self._bitmap = np.zeros((grid.rows, grid.cols), np.int32)
        self._stamp = 0

    def around(self, path: NDArray[np.int32], radius: int, finer: "Level") -> Region:
        """The cells within `radius` of a path on this level, as a region of the next finer level."""
        self._stamp += 1
        _mark(path, radius, self._stamp, self._bitmap)
        return Region(self._bitmap, *finer.coarse_cells, self._stamp)


class Pyramid:
    """Levels of a map, finest first."""

    def __init__(self, grid: Grid, corner_cutting: bool = True) -> None:
        self.corner_cutting = corner_cutting
        self.levels = [Level(grid, linked=False)]
        rows, cols = grid.rows, grid.cols
        while len(self.levels) == 1 or max(rows, cols) >= FACTOR * _SMALLEST:
            rows, cols = math.ceil(rows / FACTOR), math.ceil(cols / FACTOR)
            self.levels.append(Level(Grid.empty(rows, cols, grid.model), linked=True))
        self.update((0, 0, grid.rows, grid.cols))

    def update(self, changed: Rectangle) -> None:
        """Pool anew the cells above a rectangle of the finest level."""
        row0, col0, rows, cols = changed
        row1, col1 = row0 + rows, col0 + cols
        for fine, coarse in zip(self.levels, self.levels[1:], strict=False):
            row0, col0 = row0 // FACTOR, col0 // FACTOR
            row1, col1 = math.ceil(row1 / FACTOR), math.ceil(col1 / FACTOR)
            finest = self.levels[0].grid
            least = _pool(
                fine.grid.weights, fine.links, fine.grid.rows, fine.grid.cols, self.corner_cutting,
                self.obstacle_weight, row0, row1, col0, col1, coarse.grid.weights, coarse.pieces,
                coarse.grid.stride,
            )  # fmt: skip
            # means lie above the least of what they average, which makes a coarse search's heuristic the better
            whole = (row1 - row0, col1 - col0) == (coarse.grid.rows, coarse.grid.cols)
            coarse.grid.least = least if whole else min(least, coarse.grid.least)
            # a neighbour's links change too, and with them what is connected under the level above
            row0, row1 = max(row0 - 1, 0), min(row1 + 1, coarse.grid.rows)
            col0, col1 = max(col0 - 1, 0), min(col1 + 1, coarse.grid.cols)
            _link(
                fine.grid.weights, fine.links, fine.grid.cols, self.corner_cutting, row0, row1, col0, col1,
                coarse.pieces, coarse.links, coarse.grid.stride,
            )  # fmt: skip
            coarse.grid.greatest = max(finest.greatest, self.obstacle_weight)

    @property
    def obstacle_weight(self) -> float:
        """What an impassable cell counts for in the mean: T = 1, or as the dearest passable cell."""
        finest = self.levels[0].grid
        return finest.model.scale if finest.model.kind is StepCost.PAPER else finest.greatest
