"""Traversability cost of an elevation map (NNPP, arXiv 2308.04792v3, Eq. 1).

A plane is fitted by least squares to each cell's 3×3 patch. Its tilt is the slope, the root mean
square of the patch's distances from it the roughness, the cell's own distance the elevation
difference, all at right angles to the plane. Which point's distance counts, and how residuals are
summed up, the paper leaves open; it is decided here.
"""

import math
import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D, as_map, unmasked
from nnpp_edge.runtime.bands import in_bands
from nnpp_edge.runtime.cells import Cell, Rectangle, Sides, slices, widened
from nnpp_edge.runtime.errors import InvalidMapError, users_line
from nnpp_edge.runtime.kernels.traversability import (
    MOST_COST,
    PAPER_TERMS,
    fill_terms,
    fill_weights,
)
from nnpp_edge.runtime.options import LAYER_TERMS, TERMS, Term
from nnpp_edge.runtime.tuning import MOST_SAMPLED

Layers = dict[str, Float2D]
"""Numbers (H, W) of cells beside heights, by name."""
_SINGLE_STEP = Term("steepest single step", "°", "", "", "hard_gradient_deg")
"""What else a cell is limited by."""


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
        none = {name: math.inf for name in vars(self) if name.startswith("hard_")}
        return replace(self, **none)

    def scaled(self, factor: float) -> "Traversability":
        """By which ground with cells and heights `factor` times as large costs the same."""
        lengths = {name: factor * value for name, value in vars(self).items() if name[-2:] == "_m"}
        return replace(self, **lengths)

    @property
    def changed(self) -> dict[str, float]:
        """The values that are not the defaults, by name."""
        values = vars(self).items()
        return {name: value for name, value in values if value != getattr(type(self), name)}

    def __post_init__(self) -> None:
        if not 0.0 < self.slope_limit_deg < 90.0:
            raise InvalidMapError(
                f"slope limit must lie in (0, 90) degrees, got {self.slope_limit_deg}"
            )
        for name, value in vars(self).items():
            if not (value > 0.0 or name.endswith("_weight")):
                raise InvalidMapError(f"{name} must be greater than 0, got {value}")
        weights = [value for name, value in vars(self).items() if name.endswith("_weight")]
        if not (min(weights) >= 0.0 and math.isclose(sum(weights), 1.0, abs_tol=1e-6)):
            raise InvalidMapError(f"the weights must be at least 0 and sum to 1, got {weights}")

    def of_terms(self, kind: str) -> list[float]:
        """The ``limit``, ``weight`` or ``hard`` limit of each of `TERMS`, in the kernels' units."""
        names = [getattr(term, kind) for term in TERMS]
        return [
            math.radians(getattr(self, name)) if name.endswith("_deg") else getattr(self, name)
            for name in names
        ]

    def added(self, layers: Layers, part: Rectangle) -> Float2D:
        """(h, w) what layers add to the costs of a part of the map, inf beyond a hard limit; (0, 0)
        without any. A number that is not known counts as its limit.
        """
        found = []
        for term in LAYER_TERMS:
            if term.words in layers:
                numbers = layers[term.words][slices(part)]
                share = np.fmin(np.maximum(numbers, 0.0) / getattr(self, term.limit), 1.0)
                beyond = numbers > getattr(self, term.hard)
                found.append(np.where(beyond, np.inf, getattr(self, term.weight) * share))
        none = np.empty((0, 0), np.float32)
        return np.sum(found, axis=0, dtype=np.float32) if found else none

    @property
    def body_weights(self) -> tuple[float, float, float]:
        """Of a body's tilt, of the rise of the ground under its belly, and of its step."""
        return self.slope_weight, self.roughness_weight, self.step_weight

    def rule(self, dy: float, dx: float, scale: float = 1.0) -> NDArray[np.float64]:
        """As `fill_weights` takes it: (RULE_SLOTS,), for cells with these sides in metres, and the
        weight of a cost of 1.
        """
        steepest = self.hard_gradient_deg
        gradient = math.tan(math.radians(steepest)) if steepest < 90.0 else math.inf
        inverse = [1.0 / limit for limit in self.of_terms("limit")]
        terms = (*inverse, *self.of_terms("weight"), *self.of_terms("hard"))
        return np.array((dy, dx, scale, gradient, *terms))


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
    layers: Layers | None = None,
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
    layers : dict of (H, W) float
        Numbers of further terms (`options.LAYER_TERMS`), by name.

    Returns
    -------
    (H, W) float32
        Cost in [0, 1); inf where the elevation is unknown, where a hard limit is passed, or where
        all three terms of the paper are full (the paper's obstacles, T = 1).

    Raises
    ------
    InvalidMapError
        `dem` is not two-dimensional, is empty, or a cell size is not positive.

    Notes
    -----
    NNPP (arXiv 2308.04792v3), Eq. 1, each ratio clipped to 1. At the border and beside unknown
    cells the plane is fitted to the cells that are known; where these lie on one line, to the
    gradient along it.
    """
    heights, _ = relative_heights(dem)
    limits = traversability or Traversability()
    sides = sides_of(cell_size_m, cell_width_m)
    rule = limits.rule(*sides)
    rows, cols = heights.shape
    known = heights.reshape(-1)
    cost = np.empty(heights.size, np.float32)
    in_bands(
        lambda top, end: fill_weights(known, rows, cols, rule, (top, end, 0, cols), cost, 0, cols),
        0,
        rows,
        cols,
    )
    if warn:
        warn_of_saturation(heights, limits, sides)
    of_heights = cost.reshape(heights.shape)
    if not layers:
        return of_heights
    of_heights += limits.added(layers, (0, 0, rows, cols))
    return np.minimum(of_heights, MOST_COST, out=of_heights, where=of_heights < np.inf)


def terrain_terms(
    dem: Float2D, cell_size_m: float, *, cell_width_m: float | None = None
) -> Float2D:
    """Each term of each cell, in the order of `TERMS`, such as slope (rad), roughness (m) and
    elevation difference (m): (N, H, W) float32, NaN if unknown.
    """
    heights, _ = relative_heights(dem)
    return _terms(heights, sides_of(cell_size_m, cell_width_m)).astype(np.float32)


def _terms(
    heights: Float2D, sides_m: Sides, apart: tuple[int, int] = (1, 1)
) -> NDArray[np.float64]:
    """(N, h, w) terms of cells that lie so many rows and columns apart."""
    shape = [
        len(range(step // 2, side, step)) for side, step in zip(heights.shape, apart, strict=True)
    ]
    out = np.empty((len(TERMS), *shape))
    fill_terms(heights.reshape(-1), *heights.shape, *sides_m, apart, out)
    return out


def _told_at(dem: Float2D, cell: Cell, sides_m: Sides) -> list[tuple[Term, float]]:
    """Terms of a cell and its steepest step to a known neighbour, in the units of their limits;
    nothing of an unknown one.
    """
    part = widened((*cell, 1, 1), (1, 1), dem.shape)
    row = cell[0] - part[0]
    col = cell[1] - part[1]
    around = dem[slices(part)]
    rises = np.abs(around.astype(np.float64) - around[row, col])
    known = np.isfinite(rises)
    if not known.any():
        return []
    terms = terrain_terms(around, sides_m[0], cell_width_m=sides_m[1])[:, row, col].tolist()
    rows, cols = np.indices(around.shape)
    apart = np.hypot((rows - row) * sides_m[0], (cols - col) * sides_m[1])
    terms.append(np.arctan2(rises, apart)[known].max())
    return [
        (term, term.told(value)) for term, value in zip((*TERMS, _SINGLE_STEP), terms, strict=True)
    ]


def terms_in_words(dem: Float2D, cell: Cell, sides_m: Sides) -> str:
    """Terms of a cell, and its steepest step; empty for an unknown one."""
    words = []
    for term, value in _told_at(dem, cell, sides_m):
        digits = ".1f" if term.unit == "°" else ".2g"
        words.append(f"{term.words} {value:{digits}}{term.unit}")
    return ", ".join(words)


def why_impassable(dem: Float2D, cell: Cell, sides_m: Sides, limits: Traversability) -> str:
    """Why a cell is impassable, which it is: the limit that it passes."""
    told = _told_at(dem, cell, sides_m)
    for term, value in told:
        most = getattr(limits, term.hard)
        if value > most:
            unit = term.unit
            return f"{term.words} {value:.3g}{unit}, the hard limit is {most:g}{unit}"
    names = ", ".join(term.words for term in TERMS[:PAPER_TERMS])
    return f"{names} are all at their limits" if told else "its elevation is unknown"


def sides_of(cell_size_m: float, cell_width_m: float | None) -> Sides:
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


def warn_of_saturation(heights: Float2D, limits: Traversability, sides_m: Sides) -> None:
    """`SaturationWarning` where one applies, by a sample of the cells."""
    rows, cols = heights.shape
    apart = math.ceil(rows / MOST_SAMPLED), math.ceil(cols / MOST_SAMPLED)
    terms = _terms(heights, sides_m, apart)
    known = np.count_nonzero(np.isfinite(terms[0]))
    at_limit = map(np.count_nonzero, map(np.greater_equal, terms, limits.of_terms("limit")))
    full = [
        (term, count / known)
        for term, count in zip(TERMS, at_limit, strict=True)
        if 2 * count > known
    ]
    if full:
        shares = ", ".join(f"{100 * share:.0f} % ({term.words})" for term, share in full)
        warnings.warn(
            f"cells at the limit of a cost term, which no longer distinguishes them: {shares}: "
            f"raise {' and '.join(term.limit for term, _ in full)} (--limit KEY=VALUE), or judge "
            "cells as if they were smaller (--rescale METRES)",
            SaturationWarning,
            stacklevel=users_line(),
        )
