"""A figure, what else it might have been, and whether it is within limits all the same."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nnpp_edge.runtime.arrays import Floats


@dataclass(frozen=True)
class Interval:
    """A figure, and between what it lies: at 95 %, had other queries been drawn on this ground; or
    whatever others did on the machine meanwhile.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, drawn: Sequence[float] | Floats) -> "Interval":
        """By the same figure of queries that were drawn again, with replacement."""
        low, high = np.nanquantile(drawn, (0.025, 0.975)).tolist()
        return cls(float(value), low, high)

    def within(self, least: float = -math.inf, most: float = math.inf) -> bool | None:
        """Whether the figure is within limits; None where that cannot be told."""
        if least <= self.low and self.high <= most:
            return True
        if self.high < least or self.low > most:
            return False
        return None

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"
