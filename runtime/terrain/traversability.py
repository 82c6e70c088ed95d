"""Traversability cost of an elevation map (NNPP, arXiv 2308.04792v3, Eq. 1).

A plane is fitted by least squares to each cell's 3×3 patch. Its tilt is the slope, the root mean
square of the patch's distances from it the roughness, the cell's own distance the elevation
difference, all at right angles to the plane. Which point's distance counts, and how residuals are
summed up, the paper leaves open; it is decided here.
"""

import math
import warnings
from dataclasses import asdict, dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D, as_map, unmasked
from nnpp_edge.runtime.bands import in_bands
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.traversability import count_saturated, fill_terms, fill_weights
from nnpp_edge.runtime.tuning import MOST_SAMPLED

TERMS = {
    "slope": "slope_limit_deg",
    "roughness": "roughness_limit_m",
    "elevation difference": "step_limit_m",
}
"""The terms of Eq. 1, and the limit of each."""


@checked(InvalidMapError)
@dataclass(frozen=True)
class Traversability:
    """Limits of the rover and weights of Eq. 1, and the hard limits.

    The defaults are the paper's, made for a rover with wheels of decimetres on cells of a metre or
    less; on coarser cells the two lengths saturate (see `SaturationWarning`).
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
    """Cells are impassable whose fitted plane is steeper, whatever single steps are; inf for no
    such limit.
    """
    hard_roughness_m: float = math.inf
    hard_step_m: float = math.inf
    hard_gradient_deg: float = math.inf
    """Cells are impassable from whose middle a step to a neighbouring cell's middle is steeper."""

    @classmethod
    def safe(cls, **values: float) -> "Traversability":
        """Limits of a robot that must stay whole: `slope_limit_deg` is a hard limit too.

        Cells steeper than that are impassable, and so are cells from which a single step is.
        `values` are those of the class; a hard limit among them counts in place of its default.
        """
        soft = cls(**values)
        hard_slope_deg = values.get("hard_slope_deg", soft.slope_limit_deg)
        hard_gradient_deg = values.get("hard_gradient_deg", hard_slope_deg)
        return replace(soft, hard_slope_deg=hard_slope_deg, hard_gradient_deg=hard_gradient_deg)

    def soft(self) -> "Traversability":
        """The same without hard limits."""
        none = {each.name: math.inf for each in fields(self) if each.name.startswith("hard_")}
        return replace(self, **none)

    @property
    def changed(self) -> dict[str, float]:
        """The values that are not the defaults, by name."""
        values = asdict(self)
        return {
            each.name: values[each.name]
            for each in fields(self)
            if values[each.name] != each.default
        }

    def __post_init__(self) -> None:
        if not 0.0 < self.slope_limit_deg < 90.0:
            raise InvalidMapError(
                f"slope limit must lie in (0, 90) degrees, got {self.slope_limit_deg}"
            )
        for name in (
            "roughness_limit_m",
            "step_limit_m",
            "hard_slope_deg",
            "hard_roughness_m",
            "hard_step_m",
            "hard_gradient_deg",
        ):
            if not getattr(self, name) > 0.0:
                raise InvalidMapError(f"{name} must be greater than 0, got {getattr(self, name)}")
        weights = self.weights
        if not (min(weights) >= 0.0 and math.isclose(sum(weights), 1.0, abs_tol=1e-6)):
            raise InvalidMapError(
                f"the three weights must be at least 0 and sum to 1, got {weights}"
            )

    @property
    def weights(self) -> tuple[float, float, float]:
        """Of slope, roughness and elevation difference; of a body of tilt, rise and step."""
        return self.slope_weight, self.roughness_weight, self.step_weight

    def rule(self, dy: float, dx: float, scale: float = 1.0) -> NDArray[np.float64]:
        """As `fill_weights` takes it: (RULE_SLOTS,) sides of a cell in metres, limits, weights, and
        the scale.
        """
        limits = math.radians(self.slope_limit_deg), self.roughness_limit_m, self.step_limit_m
        weights = self.weights
        hard = math.radians(self.hard_slope_deg), self.hard_roughness_m, self.hard_step_m
        steepest = self.hard_gradient_deg
        gradient = math.tan(math.radians(steepest)) if steepest < 90.0 else math.inf
        return np.array((dy, dx, *limits, *weights, *hard, scale, gradient))


class SaturationWarning(UserWarning):
    """Over half of the cells are at or above the limit of a term, which then no longer
    distinguishes them.
    """


@checked(InvalidMapError)
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
    cell_size_m, cell_width_m : float
        Sides of a cell: from row to row and, where cells are not square, from column to column.
    traversability : Traversability
        Limits and weights; the paper's if not given.
    warn : bool
        Whether to issue a `SaturationWarning` where it applies.

    Returns
    -------
    (H, W) float32
        Cost in [0, 1); inf where the elevation is unknown, where a hard limit is passed, or where
        all three terms are full (the paper's obstacles, T = 1).

    Raises
    ------
    InvalidMapError
        `dem` is not two-dimensional, is empty, or a cell size is not positive.

    Notes
    ----- NNPP (arXiv 2308.04792v3), Eq. 1, each ratio clipped to 1. At the border and beside
    unknown cells the plane is fitted to the cells that are known; where these lie on one line, to
    the gradient along it.
    """
    heights, _ = relative_heights(dem)
    rule = (traversability or Traversability()).rule(*sides_of(cell_size_m, cell_width_m))
    (rows, cols), known, cost = (
        heights.shape,
        heights.reshape(-1),
        np.empty(heights.size, np.float32),
    )
    in_bands(
        lambda top, end: fill_weights(known, rows, cols, rule, (top, end, 0, cols), cost, 0, cols),
        0,
        rows,
        cols,
    )
    if warn:
        warn_of_saturation(heights, rule)
    return cost.reshape(heights.shape)


def terrain_terms(
    dem: Float2D, cell_size_m: float, *, cell_width_m: float | None = None
) -> Float2D:
    """Slope (rad), roughness (m) and elevation difference (m) of each cell: (3, H, W) float32, NaN
    if unknown.
    """
    heights, _ = relative_heights(dem)
    out = np.empty((3, *heights.shape), np.float32)
    fill_terms(heights.reshape(-1), *heights.shape, *sides_of(cell_size_m, cell_width_m), out)
    return out


class CellTerms(NamedTuple):
    """What the hard limits are on, at one cell; the first three NaN where its height is unknown."""

    slope_deg: float
    roughness_m: float
    step_m: float
    """The elevation difference."""
    gradient_deg: float
    """The steepest slope from the cell's middle to a known neighbour's; 0 without any."""


def terms_at(dem: Float2D, cell: Cell, sides_m: tuple[float, float]) -> CellTerms:
    """The terms at a cell of a map."""
    top = max(cell[0] - 1, 0)
    left = max(cell[1] - 1, 0)
    around = dem[top : cell[0] + 2, left : cell[1] + 2]
    rows, cols = np.indices(around.shape)
    apart = np.hypot((rows + top - cell[0]) * sides_m[0], (cols + left - cell[1]) * sides_m[1])
    rises = np.abs(np.asarray(around, np.float64) - dem[cell])
    gradient = np.arctan2(rises, apart)[np.isfinite(rises)].max(initial=0.0)
    terms = terrain_terms(around, sides_m[0], cell_width_m=sides_m[1])
    slope, roughness, step = terms[:, cell[0] - top, cell[1] - left].tolist()
    return CellTerms(math.degrees(slope), roughness, step, math.degrees(gradient))


def sides_of(cell_size_m: float, cell_width_m: float | None) -> tuple[float, float]:
    """Height and width of a cell; InvalidMapError where one is not a positive number."""
    dy = float(cell_size_m)
    dx = float(cell_size_m if cell_width_m is None else cell_width_m)
    if not (0.0 < dy < math.inf and 0.0 < dx < math.inf):
        raise InvalidMapError(f"cell size must be a positive number of metres, got {dy} × {dx}")
    return dy, dx


def relative_heights(dem: ArrayLike, base: float | None = None) -> tuple[Float2D, float]:
    """Heights as a C-contiguous (H, W) float32 map, and the height that they are relative to, which
    is kept exactly.

    32-bit floats are taken as they are, relative to 0. Other numbers are taken relative to the
    first known one, or to `base`, before they are rounded: so a map in float64 far above zero keeps
    its millimetres.
    """
    values = unmasked(dem)
    if (
        not values.flags.writeable
    ):  # to numba another type, for which all would be compiled once more
        values = values.copy()
    if values.dtype in (np.float16, np.float32) and not base:
        return as_map(values, "dem"), 0.0
    exact = as_map(values, "dem", np.float64)
    if base is None:
        known = exact[np.isfinite(exact)][:1]
        base = float(known[0]) if known.size else 0.0
    return as_map(exact - base, "dem"), base


def warn_of_saturation(heights: Float2D, rule: NDArray[np.float64], stacklevel: int = 4) -> None:
    """`SaturationWarning` where one applies, by a sample of the cells."""
    rows, cols = heights.shape
    steps = max(-(-rows // MOST_SAMPLED), 1), max(-(-cols // MOST_SAMPLED), 1)
    known, *at_limit = count_saturated(heights.reshape(-1), rows, cols, rule, steps)
    full = [
        (term, count / known)
        for term, count in zip(TERMS.items(), at_limit, strict=True)
        if 2 * count > known
    ]
    if full:
        shares = ", ".join(f"{100 * share:.0f} % ({name})" for (name, _), share in full)
        warnings.warn(
            f"cells at the limit of a cost term, which no longer distinguishes them: {shares}: "
            "raise "
            f"{' and '.join(limit for (_, limit), _ in full)} (--limit KEY=VALUE), or rescale to "
            "smaller cells",
            SaturationWarning,
            stacklevel=stacklevel,
        )
