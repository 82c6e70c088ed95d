"""The network's view of a query: the map brought to its size, and where start and goal lie.

Training takes these from here too, so that what runs is what was trained.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Planes
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.kernels.encoding import pool_planes

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid
    from nnpp_edge.runtime.search.region import Lookup

Point = tuple[float, float]
"""(row, col) in network cells."""


@dataclass(frozen=True)
class Frame:
    """How a map of rows × cols lies in the network's square of `size` cells to a side.

    The longer side fills it; what is left over, below or to the right, is shown as impassable. A
    step's two cost terms shrink alike, so the problem stays the same.
    """

    rows: int
    cols: int
    size: int

    @functools.cached_property
    def inner(self) -> tuple[int, int]:
        """Rows and columns of the square that the map fills; at least 1."""
        scale = self.size / max(self.rows, self.cols)
        return max(1, round(self.rows * scale)), max(1, round(self.cols * scale))

    def lookup(self, blocks: int) -> "Lookup":
        """Row and column, on a grid of blocks × blocks over the square, of each row and column of
        the map.
        """

        def spread(cells: int, inner: int) -> NDArray[np.int32]:
            # in units of 1 / (2 · cells) network cells
            centres = (2 * np.arange(cells, dtype=np.int64) + 1) * inner
            return (centres * blocks // (2 * cells * self.size)).astype(np.int32)

        return spread(self.rows, self.inner[0]), spread(self.cols, self.inner[1])

    def place(self, cell: Cell) -> Point:
        """Where a map cell's centre lies in the square."""
        row, col = cell
        down, across = self.inner
        return (row + 0.5) * down / self.rows - 0.5, (col + 0.5) * across / self.cols - 0.5


def map_planes(
    grid: "Grid",
    frame: Frame,
    out: Planes,
    parts: Sequence[Rectangle] | None = None,
    corner: Cell = (0, 0),
) -> None:
    """Bring a map, or a window of it, to the network's size by area averages.

    To `out`, (2, S, S) float32, are written the mean traversability cost with impassable cells
    counted as 1, and the share of impassable cells, both in [0, 1], both 1 outside the map; only
    under these `parts` of the window, by default all of it.
    """
    if parts is None:
        out[:] = 1.0
        parts = [(0, 0, frame.rows, frame.cols)]
    weights = grid.weights[corner[0] * grid.stride + corner[1] :]
    window = (frame.rows, frame.cols)
    scaled = map(np.float32, grid.as_traversability())
    pool_planes(weights, grid.stride, window, *scaled, frame.inner, np.array(parts), out)


def encode_gaussian(start: Point, goal: Point, sigma: float, out: Planes) -> None:
    """The paper's encoding (Eq. 5): a Gaussian of `sigma` network cells around start and one around
    goal.

    Written to `out`, (2, S, S) float32. Eq. 5's factor 1/(2πσ²) only scales the input and is left
    out.
    """
    cells = np.arange(out.shape[-1])
    for plane, end in zip(out, (start, goal), strict=True):
        over_rows, over_cols = (np.exp(-0.5 * ((cells - place) / sigma) ** 2) for place in end)
        np.multiply.outer(over_rows, over_cols, out=plane)
