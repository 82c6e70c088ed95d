"""The map at falling resolution, for the coarse-to-fine search.

Each level has cells of 4 × 4 cells of the one below. A coarse cell stands for the largest connected piece of
the passable cells that it covers, and two neighbours are linked where their pieces touch. So whatever path a
coarse search finds can be walked on the level below, inside the cells it crosses: thin walls do not vanish,
and narrow passes stay open unless two of them share a coarse cell.

A coarse cell's weight is the mean over the cells it covers, those outside its piece counting as
`obstacle_weight`. Means keep the balance of length and weight: both halves of a step's cost shrink alike.
"""

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.expansion import COL_STEP, DIRECTION, ROW_STEP
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import StepCost
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.search.astar import Search, astar
from nnpp_edge.runtime.search.landmarks import Landmarks
from nnpp_edge.runtime.search.workspace import OPEN_BIT, STAMP_SHIFT, Workspace

FACTOR = 4
ALL = (1 << FACTOR * FACTOR) - 1
"""The piece of a coarse cell that is passable all over."""
_FIRST_ROW = (1 << FACTOR) - 1
_FIRST_COL = ALL // _FIRST_ROW
_LAST_COL = _FIRST_COL << FACTOR - 1
_TO_LAST_ROW = FACTOR * (FACTOR - 1)
_SMALLEST = 64
"""A level above the first coarse one is made only if its longer side has as many cells."""
_LANDMARKS = 4
_PATIENCE = 3
"""A landmark is set on a level whenever its searches have expanded so many times as many cells as that takes."""
_MOST_CELLS_FOR_LANDMARKS = 1 << 15
"""A landmark on a level of so many cells takes two milliseconds."""


@kernel
def _spread(piece, diagonally):
    """A set of a coarse cell's 16 cells, as bits row by row, and their neighbours within it."""
    beside = piece | (piece & ~_LAST_COL) << 1 | (piece & ~_FIRST_COL) >> 1
    up_and_down = beside if diagonally else piece
    return (beside | up_and_down << FACTOR | up_and_down >> FACTOR) & ALL


@kernel
def _largest_of(passable, diagonally):
    """The largest connected set of the passable cells under a coarse cell, where passability alone decides.

    A diagonal step that may not cut corners joins no cells that straight steps do not.
    """
    best, best_size = 0, 0
    while passable:
        before, piece = 0, passable & -passable
        while piece != before:
            before, piece = piece, _spread(piece, diagonally) & passable
        passable &= ~piece
        size, rest = 0, piece
        while rest:
            rest &= rest - 1
            size += 1
        if size > best_size:
            best, best_size = piece, size
    return best


@kernel
def _largest_piece(weights, links, rows, cols, row, col, corner_cutting):
    """The largest connected piece of the passable cells under a coarse cell, as 16 bits, row by row."""
    stride = cols + 2
    passable = 0
    for b in range(FACTOR * FACTOR):
        i, j = row * FACTOR + b // FACTOR, col * FACTOR + b % FACTOR
        if i < rows and j < cols and weights[(i + 1) * stride + j + 1] != np.inf:
            passable |= 1 << b
    if links is None:
        return passable if passable == ALL else _largest_of(passable, corner_cutting)
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
                    if fresh and (links[node] >> k) & 1:
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
def _touching(weights, stride, row, col, here, there, up, left, corner_cutting):
    """Whether a step leads from a coarse cell's piece into that of its neighbour, where passability alone decides."""
    if left == 0:
        edge, other = (here, there >> _TO_LAST_ROW) if up < 0 else (here >> _TO_LAST_ROW, there)
        if corner_cutting:
            edge = _spread(edge & _FIRST_ROW, False)
        return edge & other & _FIRST_ROW != 0
    if up == 0:
        edge, other = (here, there >> FACTOR - 1) if left < 0 else (here >> FACTOR - 1, there)
        if corner_cutting:
            edge = _spread(edge & _FIRST_COL, False)
        return edge & other & _FIRST_COL != 0
    i, j = (0 if up < 0 else FACTOR - 1), (0 if left < 0 else FACTOR - 1)
    corner, across = i * FACTOR + j, (FACTOR - 1 - i) * FACTOR + FACTOR - 1 - j
    if not (here >> corner) & (there >> across) & 1:
        return False
    node = (row * FACTOR + i + 1) * stride + col * FACTOR + j + 1
    return corner_cutting or (weights[node + up * stride] != np.inf and weights[node + left] != np.inf)


@kernel
def _link_finest(fine, stride, corner_cutting, row0, row1, col0, col1, pieces, links, coarse_stride):
    """As `_link`, where passability alone decides."""
    for row in range(row0, row1):
        for col in range(col0, col1):
            node = (row + 1) * coarse_stride + col + 1
            here, found, every = pieces[node], 0, pieces[node]
            for k in range(8):
                every &= pieces[node + ROW_STEP[k] * coarse_stride + COL_STEP[k]]
            if every == ALL:
                links[node] = 255
                continue
            for k in range(8):
                up, left = ROW_STEP[k], COL_STEP[k]
                there = pieces[node + up * coarse_stride + left]
                if here and there and _touching(fine, stride, row, col, here, there, up, left, corner_cutting):
                    found |= 1 << k
            links[node] = found


@kernel
def _link(
    fine, fine_links, fine_cols, row0, row1, col0, col1, pieces, links, coarse_stride,
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
                    if (neighbour >> ((i - up * FACTOR) * FACTOR + j - left * FACTOR)) & 1 and (
                        fine_links[node] >> k
                    ) & 1:
                        found |= 1 << towards
            links[here] = found


@kernel
def _pool_and_link(
    fine, fine_links, fine_rows, fine_cols, corner_cutting, obstacle, row0, row1, col0, col1, rows, cols, coarse,
    pieces, links, stride,
):  # fmt: skip
    """`_pool` a rectangle of the rows × cols coarse cells, then `_link` it and its rim, whose links change too."""
    least = _pool(
        fine, fine_links, fine_rows, fine_cols, corner_cutting, obstacle, row0, row1, col0, col1, coarse, pieces,
        stride,
    )  # fmt: skip
    row0, row1, col0, col1 = max(row0 - 1, 0), min(row1 + 1, rows), max(col0 - 1, 0), min(col1 + 1, cols)
    if fine_links is None:
        _link_finest(fine, fine_cols + 2, corner_cutting, row0, row1, col0, col1, pieces, links, stride)
    else:
        _link(fine, fine_links, fine_cols, row0, row1, col0, col1, pieces, links, stride)
    return least


@kernel
def _mark(path, radius, stamp, bitmap):
    """Number the quarters of a path's cells, and those within `radius` (as the king moves) of them."""
    rows, cols = bitmap.shape
    for n in range(len(path)):
        for i in range(max(2 * path[n, 0] - radius, 0), min(2 * path[n, 0] + 2 + radius, rows)):
            for j in range(max(2 * path[n, 1] - radius, 0), min(2 * path[n, 1] + 2 + radius, cols)):
                bitmap[i, j] = stamp


@kernel
def _number(row, col, stamp, bitmap):
    """Number the four quarters of a cell."""
    for i in range(2 * row, 2 * row + 2):
        for j in range(2 * col, 2 * col + 2):
            bitmap[i, j] = stamp


@kernel
def _flood(weights, links, stride, steps, start, g, meta, search, limit, reached, queued, queue, stamp, bitmap):
    """Number the cells on paths from `start` that cost at most `limit`, and find what it costs to reach them.

    What is left from a cell is g of an earlier search, which began at the other end. With that as a bound, few
    cells are looked at twice, so a plain queue serves.
    """
    length_s, length_d, weight_s, weight_d = steps
    mask = len(queue) - 1
    head, tail = 0, 1
    queue[0] = start
    reached[start] = 0.0
    _number(start // stride - 1, start % stride - 1, stamp, bitmap)
    while head != tail:
        node = np.int64(queue[head & mask])
        head += 1
        queued[node] = 0
        for k in range(8):
            if not (links[node] >> k) & 1:
                continue
            there = node + ROW_STEP[k] * stride + COL_STEP[k]
            word = meta[2 * there + 1]
            if word >> STAMP_SHIFT != search or word & OPEN_BIT:
                continue
            length, weight = (length_s, weight_s) if k < 4 else (length_d, weight_d)
            cost = reached[node] + np.float32(length + weight * (weights[node] + weights[there]))
            if cost + g[2 * there] > limit:
                continue
            row, col = there // stride - 1, there % stride - 1
            if bitmap[2 * row, 2 * col] == stamp and cost >= reached[there]:
                continue
            _number(row, col, stamp, bitmap)
            reached[there] = cost
            if not queued[there]:
                queued[there] = 1
                queue[tail & mask] = there
                tail += 1


@kernel
def _read_ahead(path, weights, meta, stride, rows, cols):
    """Read what the next finer search will, along a path of cells: in any order, memory answers many times as soon.

    Returns a number that means nothing, so that the compiler leaves the reading in.
    """
    seen = np.int64(0)
    for n in range(len(path)):
        first = max(FACTOR * path[n, 1] - FACTOR // 2, 0)
        last = min(FACTOR * path[n, 1] + FACTOR + FACTOR // 2, cols) - 1
        for i in range(FACTOR * path[n, 0], min(FACTOR * path[n, 0] + FACTOR, rows)):
            row = (i + 1) * stride + 1
            seen += np.int64(weights[row + first] > weights[row + last])
            seen += meta[2 * (row + first)] ^ meta[2 * (row + last)]
    return seen


@kernel
def _surround(
    grid, start, g, meta, search, band, reached, queued, queue, path, radius, stamp, bitmap, finer, finer_meta
):  # fmt: skip
    """Number the quarters of what lies around a path, and on paths that cost at most 1 + `band` times as much.

    `grid` is (weights, links, stride, steps), `finer` (weights, stride, rows, cols) of the next finer level.
    """
    weights, links, stride, steps = grid
    if band > 0.0 and len(path) > 1:
        limit = (1.0 + band) * g[2 * start]
        _flood(
            weights, links, stride, steps, start, g, meta, search, limit, reached, queued, queue, stamp, bitmap
        )  # fmt: skip
    _mark(path, radius, stamp, bitmap)  # last: the flood goes by the numbers that it wrote
    return _read_ahead(path, finer[0], finer_meta, *finer[1:])


class Level:
    """A grid, its scratch memory, and a bitmap of its cells' quarters that marks a region for the level below."""

    def __init__(self, grid: Grid, linked: bool) -> None:
        nodes = len(grid.weights)
        self.grid = grid
        self.links: NDArray[np.uint8] | None = np.zeros(nodes, np.uint8) if linked else None
        """Directions in which each cell is linked to its neighbour, as bits; None where passability decides."""
        self.pieces = np.zeros(nodes if linked else 0, np.int32)
        self.workspace = Workspace(nodes)
        self.landmarks: Landmarks | None = None
        """Of the grid as it is now."""
        self.quarters = (
            np.arange(grid.rows, dtype=np.int32) // (FACTOR // 2),
            np.arange(grid.cols, dtype=np.int32) // (FACTOR // 2),
        )
        """Row and column, among the quarters of the cells of the level above, of each row and column."""
        if linked:
            self._reached = np.empty(nodes, np.float32)
            self._queued = np.zeros(nodes, np.uint8)
            self._queue = np.empty(1 << (nodes - 1).bit_length(), np.int32)
            self._bitmaps = np.zeros((2, 2 * grid.rows, 2 * grid.cols), np.int32)
        self._stamp = 0
        self._spent: float = 0

    def search(
        self, start: Cell, goal: Cell, region: Region | None, landmarks: Landmarks | None = None, **options: Any
    ) -> Search:
        """`astar` on this level, by the landmarks given or, without a region, the level's own.

        Searches of a whole coarse level get landmarks, one at a time, once they have expanded several times the
        cells that this takes: so a map that is asked often is answered sooner, and one that changes loses little.
        """
        hints = landmarks or (self.landmarks if region is None else None)
        found = astar(
            self.grid, start, goal, self.workspace, region=region, links=self.links, landmarks=hints, **options
        )
        if region is None and self.links is not None and self.grid.cells <= _MOST_CELLS_FOR_LANDMARKS:
            self._spent += found.expansions
        return found

    def invest(self) -> None:
        """Set another landmark if enough work has been spent without; the workspace is then another search's."""
        if self._spent < _PATIENCE * self.grid.cells:
            return
        self.landmarks = self.landmarks or Landmarks(self.grid, self.workspace, links=self.links)
        count = len(self.landmarks.cells)
        self.landmarks.spread(count + 1)
        enough = len(self.landmarks.cells) in (count, _LANDMARKS)  # there is no place for more, or no need
        self._spent = -math.inf if enough else 0

    def changed(self) -> None:
        """The grid is another now."""
        self.landmarks, self._spent = None, 0

    def around(self, found: Search, start: Cell, radius: int, band: float, finer: "Level") -> Region:
        """What the next finer level is to search, as a region of that level.

        Parameters
        ----------
        found : Search
            The last search here, from the goal to `start`, that settled the band.
        start : (row, col)
            Where the query starts.
        radius : int
            The quarters of cells within so many of the path's belong to it.
        band : float
            So do those on paths that cost at most 1 + `band` times as much.
        finer : Level
            The next finer level.

        Returns
        -------
        Region
            It holds until the call after the next.
        """
        self._stamp += 1
        bitmap = self._bitmaps[self._stamp % 2]
        grid, ws, below = self.grid, self.workspace, finer.grid
        _surround(
            (grid.weights, self.links, grid.stride, grid.steps), grid.node(*start), ws.g, ws.meta, ws.stamp, band,
            self._reached, self._queued, self._queue, found.path, radius, self._stamp, bitmap,
            (below.weights, below.stride, below.rows, below.cols), finer.workspace.meta,
        )  # fmt: skip
        return Region(bitmap, *finer.quarters, self._stamp)


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
        row1, col1, obstacle = row0 + rows, col0 + cols, self.obstacle_weight
        greatest = max(self.levels[0].grid.greatest, obstacle)
        for fine, coarse in itertools.pairwise(self.levels):
            row0, row1 = row0 // FACTOR, -(-row1 // FACTOR)
            col0, col1 = col0 // FACTOR, -(-col1 // FACTOR)
            grid = coarse.grid
            least = _pool_and_link(
                fine.grid.weights, fine.links, fine.grid.rows, fine.grid.cols, self.corner_cutting, obstacle, row0,
                row1, col0, col1, grid.rows, grid.cols, grid.weights, coarse.pieces, coarse.links, grid.stride,
            )  # fmt: skip
            # means lie above the least of what they average, which makes a coarse search's heuristic the better
            whole = (row1 - row0, col1 - col0) == (grid.rows, grid.cols)
            grid.set_bounds(least if whole else min(least, grid.least), greatest)
            coarse.changed()
            # what is connected under the level above changes with the links on the rim
            row0, row1 = max(row0 - 1, 0), min(row1 + 1, grid.rows)
            col0, col1 = max(col0 - 1, 0), min(col1 + 1, grid.cols)

    def touch(self) -> None:
        """Have the system back all arrays with memory now."""
        for level in self.levels:
            touch(level, level.grid, level.workspace)

    @property
    def obstacle_weight(self) -> float:
        """What an impassable cell counts for in the mean: T = 1, or as the dearest passable cell."""
        finest = self.levels[0].grid
        return finest.model.scale if finest.model.kind is StepCost.PAPER else finest.greatest
