"""The layers of the page: a byte a pixel, with no more pixels than a screen has, whatever the map.

The page colours them (`page/layers.js`); nothing is compressed on the way to this machine's own browser.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.terrain.traversability import terrain_terms
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.viz.picture import hillshade

IMPASSABLE = 255
"""Of a pixel of costs."""
UNKNOWN = 0
"""Of a pixel of the relief."""
STEEPEST_DEG = 40.0
"""Slope from which on its layer grows no stronger."""
_BAND = 512
"""Rows whose slopes are computed at a time."""
_BLOCKED = 0.25
"""Share of a pixel's cells from which on it is impassable."""

Layer = NDArray[np.uint8]


def relief(dem: Dem, pixels: int) -> Layer:
    """Hillshade with at most so many pixels a side, 40 to 245; `UNKNOWN` where heights are."""
    elevation, factor = dem.elevation, max(max(dem.shape) / pixels, 1.0)
    if factor > 1.0:
        elevation = _mean_heights(elevation, pixels)
    grey = hillshade(elevation, dem.cell_size_m * factor, dem.cell_width_m * factor)
    grey[~np.isfinite(elevation)] = UNKNOWN
    return grey


def slope(dem: Dem, pixels: int) -> Layer:
    """Inclination of the cells, from 0 to 255 at `STEEPEST_DEG`; 0 where unknown."""
    rows, factor = dem.shape[0], 255.0 / math.radians(STEEPEST_DEG)
    slopes = np.empty(dem.shape, np.float32)
    for row in range(0, rows, _BAND):
        top, bottom = max(row - 1, 0), min(row + _BAND + 1, rows)
        heights = dem.elevation[top:bottom].copy()
        terms = terrain_terms(heights, dem.cell_size_m, cell_width_m=dem.cell_width_m)
        slopes[row : row + _BAND] = terms[0, row - top : row - top + _BAND]
    shares = np.minimum(_smaller(np.nan_to_num(slopes, copy=False), pixels) * factor, 255.0)
    return np.asarray(shares, np.uint8)


def costs(cost: Float2D, pixels: int) -> Layer:
    """Traversability costs, from 0 to 254; `IMPASSABLE` where a pixel's cells are, by a quarter of them."""
    passable = cost < 1.0
    strength = _smaller(np.where(passable, cost, np.float32(0.0)), pixels) * 254.0
    strength[_smaller(~passable, pixels) > _BLOCKED] = IMPASSABLE
    return strength.astype(np.uint8)


def region(found: Region, pixels: int) -> Layer:
    """Where a search was allowed to go: 255 inside, 0 outside."""
    return (_smaller(found.mask(), pixels) * 255.0).astype(np.uint8)


def _mean_heights(elevation: Float2D, pixels: int) -> Float2D:
    """Of the known cells below each pixel; NaN where fewer than half of them are."""
    known = np.isfinite(elevation)
    if known.all():
        return _smaller(elevation, pixels)
    share, total = _smaller(known, pixels), _smaller(np.where(known, elevation, np.float32(0.0)), pixels)
    return np.where(share > 0.5, total / np.maximum(share, np.float32(0.5)), np.float32(np.nan))


def _smaller(values: NDArray[np.float32] | NDArray[np.bool_], pixels: int) -> Float2D:
    """Means of the cells below each pixel, at most so many a side."""
    numbers: Float2D = values.astype(np.float32, copy=False)
    rows, cols = numbers.shape
    if (factor := max(rows, cols) / pixels) > 1.0:
        size = max(round(cols / factor), 1), max(round(rows / factor), 1)
        numbers = np.asarray(cv2.resize(numbers, size, interpolation=cv2.INTER_AREA), np.float32)
    return numbers
