"""Traversability cost of an elevation map (NNPP, arXiv 2308.04792v3, Eq. 1).

A plane is fitted by least squares to each cell's 3×3 patch. Its tilt is the slope; the root mean square
of the patch's distances from it is the roughness; the distance of the cell's own point from it is the
elevation difference. Distances are taken at right angles to the plane. The paper leaves open which point's
distance makes the elevation difference and how the residuals are summed up: this module is the one place
where that is decided.
"""

import math
import os
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.traversability import fill_cost, fill_terms
from nnpp_edge.runtime.tuning import ROWS_PER_BAND

TERMS = ("slope", "roughness", "elevation difference")


@dataclass(frozen=True)
class Traversability:
    """What the rover can take: the limits and weights of Eq. 1, and the hard limits.

    The defaults are the paper's, made for a rover with wheels of decimetres on cells of a metre or less;
    on coarser cells the two lengths saturate (see `SaturationWarning`).
    """

    slope_limit_deg: float = 30.0
    """Steepest tilt φ_s that the slope term counts up to, degrees in (0, 90)."""
    roughness_limit_m: float = 0.6
    """Roughness r_s at which its term is full, metres."""
    step_limit_m: float = 0.2
    """Elevation difference H_s at which its term is full, metres."""
    slope_weight: float = 0.6
    roughness_weight: float = 0.2
    step_weight: float = 0.2
    hard_slope_deg: float = math.inf
    """Cells steeper than this are impassable; inf for no such limit."""
    hard_roughness_m: float = math.inf
    hard_step_m: float = math.inf

    def __post_init__(self) -> None:
        """Refuse limits that are not positive and weights that do not sum to 1."""
        if not 0.0 < self.slope_limit_deg < 90.0:
            raise InvalidMapError(f"slope limit must lie in (0, 90) degrees, got {self.slope_limit_deg}")
        for name in ("roughness_limit_m", "step_limit_m", "hard_slope_deg", "hard_roughness_m", "hard_step_m"):
            if not getattr(self, name) > 0.0:
                raise InvalidMapError(f"{name} must be greater than 0, got {getattr(self, name)}")
        weights = (self.slope_weight, self.roughness_weight, self.step_weight)
        if not (min(weights) >= 0.0 and math.isclose(sum(weights), 1.0, abs_tol=1e-6)):
            raise InvalidMapError(f"the three weights must be at least 0 and sum to 1, got {weights}")

    def _packed(self) -> NDArray[np.float64]:
        """What `fill_cost` takes: limits, weights, hard limits."""
        limits = math.radians(self.slope_limit_deg), self.roughness_limit_m, self.step_limit_m
        weights = self.slope_weight, self.roughness_weight, self.step_weight
        hard = math.radians(self.hard_slope_deg), self.hard_roughness_m, self.hard_step_m
        return np.array((*limits, *weights, *hard))


class SaturationWarning(UserWarning):
    """Over half of the map lies at or above the limit of a term, which then tells the cells apart no more."""


def traversability_cost(
    dem: Float2D,
    cell_size_m: float,
    traversability: Traversability | None = None,
    *,
    cell_width_m: float | None = None,
    warn: bool = True,
) -> Float2D:
    """Cost of crossing each cell, from slope, roughness and elevation difference.

    Parameters
    ----------
    dem : (H, W) float
        Elevation in metres; NaN where unknown.
    cell_size_m : float
        Side of a cell, along the rows' direction of travel (north to south).
    traversability : Traversability
        Limits and weights; the paper's if not given.
    cell_width_m : float
        Side of a cell from west to east, where cells are not square.
    warn : bool
        Whether to issue a `SaturationWarning` where it applies.

    Returns
    -------
    (H, W) float32
        Cost in [0, 1); inf where the elevation is unknown, where a hard limit is passed, or where all
        three terms are full (the paper's obstacles, T = 1).

    Raises
    ------
    InvalidMapError
        `dem` is not two-dimensional, is empty, or a cell size is not positive.

    Notes
    -----
    NNPP (arXiv 2308.04792v3), Eq. 1, each ratio clipped to 1. At the border and beside unknown cells the
    plane is fitted to the cells that are known; where these lie on one line, to the gradient along it.
    """
    dem = as_map(dem, "dem")
    cost = np.empty(dem.shape, np.float32)
    shares = _fill(dem, cell_size_m, cell_width_m, traversability or Traversability(), cost, None)
    if warn:
        for name, share in zip(TERMS, shares, strict=True):
            if share > 0.5:
                warnings.warn(
                    f"{100 * share:.0f} % of the cells reach the limit of the {name} term, which no longer tells "
                    "them apart: raise that limit, or rescale the map to smaller cells",
                    SaturationWarning,
                    stacklevel=2,
                )
    return cost


def update_cost(
    cost: Float2D,
    dem: Float2D,
    changed: Rectangle,
    cell_size_m: float,
    traversability: Traversability | None = None,
    *,
    cell_width_m: float | None = None,
) -> Rectangle:
    """Bring `cost` up to date after `dem` has changed in a rectangle.

    Only that rectangle and the rim of one cell around it are computed; both are clipped to the map.

    Parameters
    ----------
    cost : (H, W) float32
        Written in place.
    dem : (H, W) float
        Elevation in metres, the change already in it.
    changed : (row, col, rows, cols)
        The cells of `dem` that changed.
    cell_size_m, traversability, cell_width_m
        As for `traversability_cost`.

    Returns
    -------
    (row, col, rows, cols)
        The cells of `cost` that were computed; rows or cols is 0 where the rectangle misses the map.
    """
    dem = as_map(dem, "dem")
    if cost.shape != dem.shape or cost.dtype != np.float32:
        raise InvalidMapError(f"cost must be {dem.shape} float32, got {cost.shape} {cost.dtype}")
    row, col, rows, cols = changed
    row0, row1 = max(row - 1, 0), min(row + rows + 1, dem.shape[0])
    col0, col1 = max(col - 1, 0), min(col + cols + 1, dem.shape[1])
    if rows < 1 or cols < 1 or row0 >= row1 or col0 >= col1:
        return (0, 0, 0, 0)
    part = (row0, col0, row1 - row0, col1 - col0)
    _fill(dem, cell_size_m, cell_width_m, traversability or Traversability(), cost, part)
    return part


def terrain_terms(dem: Float2D, cell_size_m: float, *, cell_width_m: float | None = None) -> Float2D:
    """Slope (rad), roughness (m) and elevation difference (m) of each cell: (3, H, W) float32, NaN if unknown."""
    dem = as_map(dem, "dem")
    dy, dx = _spacing(cell_size_m, cell_width_m)
    out = np.empty((3, *dem.shape), np.float32)
    fill_terms(dem, dy, dx, out)
    return out


def _spacing(cell_size_m: float, cell_width_m: float | None) -> tuple[float, float]:
    dy, dx = float(cell_size_m), float(cell_size_m if cell_width_m is None else cell_width_m)
    if not (0.0 < dy < math.inf and 0.0 < dx < math.inf):
        raise InvalidMapError(f"cell size must be a positive number of metres, got {dy} × {dx}")
    return dy, dx


def _fill(
    dem: Float2D,
    cell_size_m: float,
    cell_width_m: float | None,
    traversability: Traversability,
    cost: Float2D,
    part: Rectangle | None,
) -> NDArray[np.float64]:
    """Compute `part` of the cost (None: all of it), rows shared out over the cores; the saturated shares."""
    dy, dx = _spacing(cell_size_m, cell_width_m)
    limits = traversability._packed()
    row, col, rows, cols = part or (0, 0, *dem.shape)
    bands = [(a, min(a + ROWS_PER_BAND, row + rows)) for a in range(row, row + rows, ROWS_PER_BAND)]

    def fill(band: tuple[int, int]) -> NDArray[np.int64]:
        saturated = np.zeros(4, np.int64)
        fill_cost(dem, dy, dx, limits, (*band, col, col + cols), cost, saturated)
        return saturated

    if len(bands) == 1:
        counts = fill(bands[0])
    else:
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            counts = np.sum(list(pool.map(fill, bands)), axis=0)
    shares: NDArray[np.float64] = counts[1:] / max(counts[0], 1)
    return shares
