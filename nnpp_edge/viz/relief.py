"""A map to draw on, and its relief, lit from the north-west. With numpy alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Bool, Float2D
from nnpp_edge.runtime.cells import Rectangle, Sides, holding, widened
from nnpp_edge.runtime.map.along import Line

Shade = NDArray[np.uint8]
"""(H, W) lightness of the relief, or a number for each cell."""
FLAT = 185
"""Level ground's."""
_AROUND = 0.15
_LEAST_AROUND = 16
"""Of the ground around a path that is shown: a share of its longer side, and cells."""
_ZOOMED = 0.5
"""Share of the map up to which a part of it is shown alone."""


@dataclass(frozen=True, eq=False)
class Chart:
    """A map to draw on: what all pictures of it share."""

    cost: Float2D
    """(H, W) traversability cost; impassable where NaN or from 1 up."""
    elevation: Float2D | None = None
    """(H, W) metres, NaN where unknown; without it the ground is drawn level."""
    sides_m: Sides | None = None
    """Of a cell, along columns and along rows; None where unknown."""
    north_deg: float | None = None
    """Where grid north lies, clockwise from up the rows; None where unknown."""

    @property
    def whole(self) -> Rectangle:
        """All of the map."""
        return (0, 0, *self.cost.shape)

    @property
    def unknown(self) -> Bool:
        """(H, W) where no height is known."""
        return np.isnan(self.cost if self.elevation is None else self.elevation)

    def around(self, places: Sequence[Line]) -> Rectangle:
        """The part to show of what lies at these places, each (N, 2): the whole map, unless they
        take up little of it.
        """
        cells = np.rint(np.concatenate([each[:, :2] for each in places])).astype(np.int64)
        row, col, rows, cols = holding(np.clip(cells, 0, np.subtract(self.cost.shape, 1)))
        longest = max(rows, cols)
        margin = max(math.ceil(_AROUND * longest), _LEAST_AROUND)
        high = margin + max(2 * longest // 3 - rows, 0) // 2
        wide = margin + max(2 * longest // 3 - cols, 0) // 2
        part = widened((row, col, rows, cols), (high, wide), self.cost.shape)
        return part if part[2] * part[3] <= _ZOOMED * self.cost.size else self.whole


def hillshade(elevation: Float2D, cell_size_m: float, cell_width_m: float | None = None) -> Shade:
    """Relief lit from the north-west: (H, W) uint8; unknown ground as if it were flat.

    Heights are exaggerated so that the steepest tenth of the map stands out, but never flattened.
    """
    rows, cols = elevation.shape
    # np.gradient wants two rows and columns
    missing = [(0, max(2 - side, 0)) for side in elevation.shape]
    padded = np.pad(elevation, missing, mode="edge")
    slopes = np.nan_to_num(np.gradient(padded, cell_size_m, cell_width_m or cell_size_m))
    south, east = slopes[:, :rows, :cols]
    tilt = np.hypot(south, east)
    steep = max(float(np.quantile(tilt, 0.9)), 1e-6)
    gain = min(max(0.7 / steep, 1.0), 50.0)
    # 45 degrees high, and as much from the north as from the west
    toward = math.sqrt(0.5) + 0.5 * gain * (south + east)
    light = toward / np.hypot(1.0, gain * tilt)
    return np.asarray(40.0 + 205.0 * np.clip(light, 0.0, 1.0), np.uint8)
