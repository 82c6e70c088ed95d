"""The map at falling resolution, for the coarse-to-fine search.

Each level has cells of 4 × 4 cells of the one below. A coarse cell stands for the largest connected
piece of the passable cells that it covers, and two neighbours are linked where their pieces touch.
So whatever path a coarse search finds can be walked on the level below, inside the cells it
crosses: thin walls do not vanish, and narrow passes stay open unless two of them share a coarse
cell.

A coarse cell's weight is the mean over the cells it covers, those outside its piece counting as
impassable: as T = 1, or as the dearest passable cell. Means keep the balance of length and weight:
both halves of a step's cost shrink alike. Directed steps are averaged by direction, see
`robots.slope.directed`.
"""

import functools
import itertools
import math
from collections.abc import Iterator

import numpy as np

from nnpp_edge.runtime.arrays import Int32, UInt8, UInt16
from nnpp_edge.runtime.bands import stripes
from nnpp_edge.runtime.cells import Rectangle, above, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.kernels.pooling import FACTOR, NO_LINKS, NO_PIECES, pool_and_link
from nnpp_edge.runtime.kernels.records import Packed
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.tiles import CoarseRoom
from nnpp_edge.runtime.robots.robot import Robot
from nnpp_edge.runtime.search.region import Lookup
from nnpp_edge.runtime.terrain.step_cost import StepCost
from nnpp_edge.runtime.tuning import ANOTHER_LEVEL_FROM


class Level:
    """The map at one resolution. The finest has no pieces or links: there passability decides."""

    def __init__(
        self,
        grid: Grid,
        pieces: UInt16 = NO_PIECES,
        links: UInt8 = NO_LINKS,
    ) -> None:
        self.grid = grid
        self.links = links
        """Directions in which each cell is linked to its neighbour, as bits; empty on the finest
        level.
        """
        self.pieces = pieces
        """The piece that each cell stands for, as bits for the cells that it covers, row by row."""
        self.quarters: Lookup = quarters(grid.rows), quarters(grid.cols)
        """Row and column, among the quarters of the cells of the level above, of each row and
        column.
        """

    @property
    def packed(self) -> Packed:
        """As kernels take it."""
        grid = self.grid
        size = (grid.stride, grid.rows, grid.cols)
        return (grid.weights, self.pieces, self.links, *size)  # `records.LevelRecord`


class Pyramid:
    """Levels of a map, finest first. Those of a map of heights are computed with it, where a search
    reads them.

    They are right once `finish` has been called, and again after each `update`.
    """

    def __init__(self, grid: Grid) -> None:
        self.levels = [Level(grid)]
        shapes = coarse_shapes(grid.rows, grid.cols)
        model, (straight, diagonal) = grid.model, grid.model.weight_term
        share = grid.robot.moves.weight_share
        model = model._replace(weight_term=(share * straight, share * diagonal))
        self._left: Iterator[None] = iter(())
        """Pools a stripe at each step."""
        room = CoarseRoom(shapes)
        if grid.tiles is not None:
            grid.tiles.add_levels(room)
        for number, (shape, part) in enumerate(zip(shapes, room.parts, strict=True), 1):
            weights = room.weights[part]
            coarse = Grid(*shape, model, weights=weights, tiles=grid.tiles, level=number)
            coarse.drive_by(Robot(price=grid.robot.price.coarse(shape, grid.prices)))
            self.levels.append(Level(coarse, room.pieces[part], room.links[part]))
        self.update((0, 0, grid.rows, grid.cols))

    def update(self, changed: Rectangle) -> None:
        """Pool anew, when `finish` is called, the cells above a rectangle of the finest level."""
        self._left = itertools.chain(self._left, self._pool(changed))

    def finish(self, deadline: Deadline = NEVER) -> "Pyramid":
        """Pool what is left, and return this. At the deadline OutOfTimeError: the next call goes on
        from there.
        """
        finest = self.levels[0].grid
        if finest.tiles is not None and finest.robot.price.directed:
            # whose means need all weights
            finest.tiles.complete(deadline)
        for _ in self._left:
            deadline.check()
        return self

    def _pool(self, changed: Rectangle) -> Iterator[None]:
        """The work of `update`, stripe by stripe."""
        finest = self.levels[0].grid
        part = changed
        # weight of an impassable cell in the mean: T = 1, or as the dearest passable cell
        is_paper = finest.model.kind is StepCost.PAPER
        obstacle = finest.model.scale if is_paper else finest.greatest
        greatest = max(finest.greatest, obstacle)
        for fine, coarse in itertools.pairwise(self.levels):
            if finest.tiles is not None:  # pooled anew already, but for directed steps
                continue
            row, col, rows, cols = above(part, FACTOR)
            grid = coarse.grid
            least = math.inf
            finer = fine.packed
            packed = coarse.packed
            for first, last in stripes(rows, FACTOR**2 * cols):
                area = row + first, row + last, col, col + cols  # `records.Area`
                least = min(
                    least, pool_and_link(finer, finest.corner_cutting, obstacle, area, packed)
                )
                yield
            # means lie above the least of what they average, which makes a coarse search's
            # heuristic the better
            whole = (rows, cols) == grid.shape
            grid.set_bounds(least if whole else min(least, grid.least), greatest)
            # what is connected under the level above changes with the links on the rim
            part = widened((row, col, rows, cols), (1, 1), grid.shape)
        yield from finest.robot.price.pool(self.levels[1:], changed)


def coarse_shapes(rows: int, cols: int) -> list[tuple[int, int]]:
    """Rows and columns of the coarse levels of a map, finest first; there is at least one."""
    shapes: list[tuple[int, int]] = []
    while not shapes or max(rows, cols) >= ANOTHER_LEVEL_FROM:
        rows = math.ceil(rows / FACTOR)
        cols = math.ceil(cols / FACTOR)
        shapes.append((rows, cols))
    return shapes


@functools.lru_cache(maxsize=64)
def quarters(cells: int) -> Int32:
    """(cells,) int32, the quarter of a coarse cell, along one side of the map, that each row or
    column lies in.
    """
    return np.arange(cells, dtype=np.int32) // np.int32(FACTOR // 2)
