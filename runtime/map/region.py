"""A part of a map, as a small bitmap over it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Region(NamedTuple):
    """Where a search may go: a small bitmap over the map, read in place.

    A cell (row, col) is inside when ``bitmap[row_block[row], col_block[col]] == stamp``. Bitmaps are
    numbered rather than cleared.
    """

    bitmap: NDArray[np.int32]
    row_block: NDArray[np.int32]
    """(H,) row of the bitmap for each row of the map."""
    col_block: NDArray[np.int32]
    """(W,) column of the bitmap for each column of the map."""
    stamp: int = 1

    def holds(self, row: int, col: int) -> bool:
        """Whether a cell is inside."""
        return bool(self.bitmap[self.row_block[row], self.col_block[col]] == self.stamp)

    def mask(self) -> NDArray[np.bool_]:
        """(H, W) bool, the region at the map's own size (for pictures and figures, not for planning)."""
        return (self.bitmap == self.stamp)[np.ix_(self.row_block, self.col_block)]

    def area(self) -> int:
        """Number of the map's cells inside."""
        heights = np.bincount(self.row_block, minlength=self.bitmap.shape[0])
        widths = np.bincount(self.col_block, minlength=self.bitmap.shape[1])
        return int(heights @ (self.bitmap == self.stamp) @ widths)
