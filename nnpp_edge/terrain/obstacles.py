"""Simulated obstacles: rectangles of impassable cells that appear, move and vanish."""

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle, Shape, apart, slices

OBSTACLE = 1.0
"""Traversability cost of an obstacle: impassable (the paper's)."""
CLEAR = 3
"""Cells around robot and goal that no obstacle covers."""
# of single events: obstacles at a time; chances of a new one, else of one that vanishes rather than
# moves, and of a new one on the path ahead; cells that one moves at most, to each side
_MOST = 12
_APPEARS = 0.4
_DISAPPEARS = 0.4
_ACROSS_THE_PATH = 0.5
_REACH = 2
_SIDES = (1 / 20, 1 / 8)
"""Sides of an obstacle of the paper's scene, as shares of the map's."""
_ON_PATH = (0.15, 0.85)
_VANISHES = 0.25
_MOVES = 0.35
"""Where on what is left of the path one appears in the paper's scene, and the chances of each
there.
"""


class Obstacles:
    """Obstacles on a map of this shape, (H, W); the same for the same generator.

    Their cells have at least this `value`, and stay out of so many `clear` cells around robot and
    goal.
    """

    def __init__(
        self,
        shape: Shape,
        rng: np.random.Generator,
        *,
        value: float = OBSTACLE,
        clear: int = CLEAR,
    ) -> None:
        self.shape = shape
        self._rng = rng
        self._value = value
        self._clear = clear
        self.blocks: list[Rectangle] = []

    def one_event(self, robot: Cell, goal: Cell, path: Cells) -> list[Rectangle]:
        """One obstacle appears, moves or vanishes; the parts of the map that change, none where no
        place was free.
        """
        rng = self._rng
        blocks = self.blocks
        if not blocks or (len(blocks) < _MOST and rng.random() < _APPEARS):
            block = self._new(path)
            if self._near(block, robot, goal):
                return []
            blocks.append(block)
            return [block]
        at = int(rng.integers(len(blocks)))
        if rng.random() < _DISAPPEARS:
            return [blocks.pop(at)]
        old = blocks[at]
        new = self._moved(blocks[at], _REACH, _REACH)
        if new == old or self._near(new, robot, goal):
            return []
        blocks[at] = new
        return [old, new]

    def next_scene(self, robot: Cell, goal: Cell, path: Cells) -> None:
        """The paper's scene between two plans: some vanish, some move on, and one more appears
        across the path.
        """
        rng = self._rng
        kept = []
        for block in self.blocks:
            fate = rng.random()
            if fate < _VANISHES:
                continue
            if fate < _VANISHES + _MOVES:
                block = self._moved(block, block[2], block[3])
            kept.append(block)
        sides = []
        for n in self.shape:
            side = int(rng.uniform(*_SIDES) * max(self.shape))
            sides.append(min(max(side, 2), n))
        at = int(rng.uniform(*_ON_PATH) * (len(path) - 1))
        kept.append(self._around(path[at], *sides))
        self.blocks = [block for block in kept if not self._near(block, robot, goal)]

    def clear_of(self, cell: Cell) -> list[Rectangle]:
        """Remove the obstacles that are too near to a cell, and return them."""
        near = [block for block in self.blocks if self._near(block, cell)]
        self.blocks = [block for block in self.blocks if block not in near]
        return near

    def cover(self, ground: Float2D, part: Rectangle) -> Float2D:
        """A copy of a part of the ground with the obstacles on it."""
        return covered(ground, part, self.blocks, self._value)

    def _new(self, path: Cells) -> Rectangle:
        rng = self._rng
        least = min(2, *self.shape)
        most = max(max(self.shape) // 12, 2)
        rows, cols = (min(int(rng.integers(least, most + 1)), n) for n in self.shape)
        if len(path) > 2 and rng.random() < _ACROSS_THE_PATH:
            middle = path[int(rng.integers(1, len(path) - 1))]
        else:
            middle = rng.integers(0, self.shape)
        return self._around(middle, rows, cols)

    def _around(self, middle: NDArray[np.integer], rows: int, cols: int) -> Rectangle:
        """An obstacle of this size around a cell, moved inside the map."""
        row, col = middle.tolist()
        return self._inside(row - rows // 2, col - cols // 2, rows, cols)

    def _moved(self, block: Rectangle, most_rows: int, most_cols: int) -> Rectangle:
        row, col, rows, cols = block
        row += int(self._rng.integers(-most_rows, most_rows + 1))
        col += int(self._rng.integers(-most_cols, most_cols + 1))
        return self._inside(row, col, rows, cols)

    def _inside(self, row: int, col: int, rows: int, cols: int) -> Rectangle:
        row = min(max(row, 0), self.shape[0] - rows)
        col = min(max(col, 0), self.shape[1] - cols)
        return row, col, rows, cols

    def _near(self, block: Rectangle, *cells: Cell) -> bool:
        """Whether an obstacle is nearer to one of the cells than allowed."""
        return any(apart(block, cell) <= self._clear for cell in cells)


def covered(
    ground: Float2D,
    part: Rectangle,
    blocks: Collection[Rectangle],
    value: float = OBSTACLE,
) -> Float2D:
    """A copy of a part of the ground with obstacles of this value on it; they may reach beyond the
    map.
    """
    row, col, _, _ = part
    out = ground[slices(part)].copy()
    for top, left, height, width in blocks:
        down, across = (
            slice(max(at, 0), max(at + length, 0))
            for at, length in ((top - row, height), (left - col, width))
        )
        np.maximum(out[down, across], np.float32(value), out=out[down, across])
    return out


def changed_parts(before: Sequence[Rectangle], after: Sequence[Rectangle]) -> list[Rectangle]:
    """Where the map changes when obstacles become others: those that leave, then those
    that come.
    """
    left = [block for block in before if block not in after]
    came = [block for block in after if block not in before]
    return left + came
