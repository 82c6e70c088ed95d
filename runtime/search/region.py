"""A part of a map, as a small bitmap over it."""

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Int32
from nnpp_edge.runtime.cells import Cell, Rectangle, slices
from nnpp_edge.runtime.kernels import records

Lookup = tuple[Int32, Int32]
"""For each row, and for each column, of a map the row or column of a bitmap that it lies in
(`records.Lookup`).
"""


class Region(records.RegionRecord):
    """Cells that a search may enter: a small bitmap over the map, read in place. Bitmaps are
    numbered rather than cleared.
    """

    __slots__ = ()

    @classmethod
    def everywhere(cls, rows: int, cols: int) -> "Region":
        """All of a map, as one block."""
        row_block = np.zeros(rows, np.int32)
        return cls(np.ones((1, 1), np.int32), row_block, np.zeros(cols, np.int32), 1)

    def blocks(self) -> Bool:
        """Which of the bitmap's blocks are inside; bool, of its shape."""
        inside: Bool = self.bitmap == self.stamp
        return inside

    def mask(self) -> Bool:
        """(H, W) bool, the region at the map's own size (for pictures and figures, not for
        planning).
        """
        return self.blocks()[np.ix_(self.row_block, self.col_block)]

    def holds(self, cell: Cell) -> bool:
        """Whether a cell of the map is inside."""
        row, col = cell
        return bool(self.bitmap[self.row_block[row], self.col_block[col]] == self.stamp)

    def add(self, part: Rectangle) -> None:
        """Add the blocks that hold a rectangle of the map's cells."""
        rows, cols = slices(part)
        blocks = np.ix_(self.row_block[rows], self.col_block[cols])
        self.bitmap[blocks] = self.stamp

    def area(self) -> int:
        """Number of the map's cells inside."""
        heights = np.bincount(self.row_block, minlength=self.bitmap.shape[0])
        widths = np.bincount(self.col_block, minlength=self.bitmap.shape[1])
        return int(heights @ self.blocks() @ widths)

    def shares_blocks(self, other: "Region") -> bool:
        """Whether the two bitmaps lie over the map alike, so that their blocks can be compared."""
        return (
            self.bitmap.shape == other.bitmap.shape
            and np.array_equal(self.row_block, other.row_block)
            and np.array_equal(self.col_block, other.col_block)
        )

    def copy(self) -> "Region":
        """This region with arrays of its own, which no later search overwrites."""
        return Region(
            self.blocks().astype(np.int32), self.row_block.copy(), self.col_block.copy(), 1
        )
