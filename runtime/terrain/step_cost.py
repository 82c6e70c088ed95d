"""Costs of a step between two cells.

Both models have one form, so that the searches need not know which is in use:

    step(i, j) = length_term[kind] + weight_term[kind] · (w_i + w_j),   kind 0 straight, 1 diagonal

- ``paper`` (NNPP, Eq. 2-4): L + 255·ω·(T_i + T_j) with w = 255·ω·T. The paper's ω is for T in grey
  levels.
- ``length``: L × the mean of the two weights.

Steps that cost by the slope, and so not alike both ways, are those of `slope_cost` and `directed`.
"""

import math
from enum import StrEnum
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError

SQRT2 = math.sqrt(2.0)
PAPER_OMEGA = 0.011
"""Weight of the traversability cost per grey level (NNPP, section 4.2)."""
GREY_LEVELS = 255.0
LEAST_WEIGHT = float(np.finfo(np.float32).tiny)
MOST_WEIGHT = 1e30
"""Between these, sums of weights are neither too small for the full precision of a float32 nor too
great for one.
"""


class StepCost(StrEnum):
    """Kinds of costs of a step; see the module's description."""

    PAPER = "paper"
    LENGTH = "length"


class StepModel(NamedTuple):
    """Coefficients of a step's cost, and of the weight that a cell's cost becomes."""

    kind: StepCost
    scale: float
    length_term: tuple[float, float]
    weight_term: tuple[float, float]
    costs: tuple[float, float, float]
    """Range of a cell's cost: least and most of a passable one, and from where on it is
    impassable.
    """

    @classmethod
    def of(cls, step_cost: str, omega: float = PAPER_OMEGA) -> "StepModel":
        """The model of that name; InvalidQueryError for another name or an omega out of range."""
        if step_cost == StepCost.LENGTH:
            costs = LEAST_WEIGHT, MOST_WEIGHT, math.inf
            return cls(StepCost.LENGTH, 1.0, (0.0, 0.0), (0.5, 0.5 * SQRT2), costs)
        if step_cost != StepCost.PAPER:
            raise InvalidQueryError(f"step_cost must be 'paper' or 'length', got {step_cost!r}")
        if not 0.0 <= omega <= MOST_WEIGHT / GREY_LEVELS:
            raise InvalidQueryError(
                f"omega must be from 0 to {MOST_WEIGHT / GREY_LEVELS:.0e}, got {omega}"
            )
        costs = 0.0, 1.0, 1.0
        return cls(StepCost.PAPER, GREY_LEVELS * omega, (1.0, SQRT2), (1.0, 1.0), costs)

    def refuses(self, cost: NDArray[np.float32]) -> bool:
        """Whether a passable one of these costs is out of range."""
        least, most, ceiling = self.costs
        return bool(((cost < least) | ((cost > most) & (cost < ceiling))).any())

    def refuse(self, cost: float) -> NoReturn:
        """InvalidMapError for a cost that no passable cell may have."""
        least, most, _ = self.costs
        wanted = "at least 0" if self.kind is StepCost.PAPER else f"from {least:.3g} to {most:g}"
        raise InvalidMapError(f"every passable cost must be {wanted}, got one of {cost:g}")

    def step(self, kind: int, weights: float) -> float:
        """Cost of a straight (0) or diagonal (1) step between cells whose weights sum to
        `weights`.
        """
        return self.length_term[kind] + self.weight_term[kind] * weights
