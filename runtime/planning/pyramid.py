"""The map at falling resolution, for the coarse-to-fine search.

Each level has cells of 4 × 4 cells of the one below. A coarse cell's weight is the mean over the cells it
covers, an impassable one counting as `obstacle_weight`; it is impassable only where all of them are.
Means keep the balance of length and weight: both halves of a step's cost shrink by the same factor.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime._jit import kernel
from nnpp_edge.runtime.costmap import Rectangle
from nnpp_edge.runtime.grid import Grid, StepCost
from nnpp_edge.runtime.planning.astar import Region
from nnpp_edge.runtime.planning.workspace import Workspace

FACTOR = 4
_SMALLEST = 128
"""A level above the first coarse one is made only if its longer side has as many cells."""
_OBSTACLE_FACTOR = 4.0
"""How much more than T = 1 an impassable cell weighs in a mean; see docs/decisions.md."""


@kernel
def _pool(fine, fine_rows, fine_cols, obstacle, row0, row1, col0, col1, coarse, coarse_stride):
    fine_stride = fine_cols + 2
    for row in range(row0, row1):
        bottom = min((row + 1) * FACTOR, fine_rows)
        for col in range(col0, col1):
            right = min((col + 1) * FACTOR, fine_cols)
            total, blocked, cells = 0.0, 0, 0
            for i in range(row * FACTOR, bottom):
                for j in range(col * FACTOR, right):
                    w = fine[(i + 1) * fine_stride + j + 1]
                    cells += 1
                    if w == np.inf:
                        blocked += 1
                    else:
                        total += w
            there = (row + 1) * coarse_stride + col + 1
            if blocked == cells:
                coarse[there] = np.inf
            else:
                coarse[there] = (total + obstacle * blocked) / cells


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

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.workspace = Workspace(len(grid.weights))
        self._bitmap = np.zeros((grid.rows, grid.cols), np.int32)
        self._stamp = 0

    def around(self, path: NDArray[np.int32], radius: int, finer: "Level") -> Region:
        """The cells within `radius` of a path on this level, as a region of the next finer level."""
        self._stamp += 1
        _mark(path, radius, self._stamp, self._bitmap)
        return Region(self._bitmap, *_blocks(finer.grid), self._stamp)


def _blocks(grid: Grid) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Row and column of the coarse cell that holds each row and column."""
    return (
        np.arange(grid.rows, dtype=np.int32) // FACTOR,
        np.arange(grid.cols, dtype=np.int32) // FACTOR,
    )


class Pyramid:
    """Levels of a map, finest first."""

    def __init__(self, grid: Grid) -> None:
        self.levels = [Level(grid)]
        rows, cols = grid.rows, grid.cols
        while len(self.levels) == 1 or max(rows, cols) >= FACTOR * _SMALLEST:
            rows, cols = math.ceil(rows / FACTOR), math.ceil(cols / FACTOR)
            self.levels.append(Level(Grid.empty(rows, cols, grid.model)))
        self.update((0, 0, grid.rows, grid.cols))

    def update(self, changed: Rectangle) -> None:
        """Pool anew the cells above a rectangle of the finest level."""
        row0, col0, rows, cols = changed
        row1, col1 = row0 + rows, col0 + cols
        for fine, coarse in zip(self.levels, self.levels[1:], strict=False):
            row0, col0 = row0 // FACTOR, col0 // FACTOR
            row1, col1 = math.ceil(row1 / FACTOR), math.ceil(col1 / FACTOR)
            finest = self.levels[0].grid
            _pool(
                fine.grid.weights, fine.grid.rows, fine.grid.cols, self.obstacle_weight, row0, row1, col0, col1,
                coarse.grid.weights, coarse.grid.stride,
            )  # fmt: skip
            coarse.grid.least = finest.least
            coarse.grid.greatest = max(finest.greatest, self.obstacle_weight)

    @property
    def obstacle_weight(self) -> float:
        """What an impassable cell counts for in the mean: a multiple of the dearest passable one's weight."""
        finest = self.levels[0].grid
        dearest = finest.model.scale if finest.model.kind is StepCost.PAPER else finest.greatest
        return _OBSTACLE_FACTOR * dearest
