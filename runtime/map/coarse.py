"""A map of heights that is known coarsely, and finely where it has been seen."""

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Cells, Float2D, Floats
from nnpp_edge.runtime.cells import Rectangle, holding, slices, widened
from nnpp_edge.runtime.map.along import Line
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.heights import HeightState
from nnpp_edge.runtime.map.unseen import Unseen
from nnpp_edge.runtime.memory import virtual_zeros
from nnpp_edge.runtime.terrain.traversability import relative_heights
from nnpp_edge.runtime.tuning import MOST_PRICE

_TOGETHER = 64
"""Cells of a path around which is looked at once, at most, for what is unknown."""


class CoarseState(HeightState):
    """A map of heights of which the means of blocks are known, until its cells are seen."""

    unseen: Unseen

    def _heights_of(self, ground: Ground) -> tuple[Float2D, float]:
        self.unseen = Unseen(ground)
        self._blocks = self.unseen.layers
        rows, cols = ground.shape
        _, base = relative_heights(np.asarray(ground.elevation))
        return virtual_zeros(rows * cols, np.float32).reshape(rows, cols), base

    def begin_anew(self) -> None:
        """As `MapState.begin_anew`."""
        super().begin_anew()
        # prices may be greater than any cost
        self.grid.set_bounds(self.grid.least, MOST_PRICE * self.grid.model.scale)

    def _noted(self, change: Change, part: Rectangle, *, heights: bool = False) -> Change:
        self.unseen.note(part)
        return super()._noted(change, part, heights=heights)

    def known_heights(self, part: Rectangle) -> Float2D:
        """As `MapState.known_heights`."""
        unknown = self.unknown(*slices(part))
        return np.where(unknown, np.float32(np.nan), self.heights[slices(part)])

    def _cost_by_heights(self) -> Float2D:
        """Unseen cells cost their block's price."""
        return np.where(self.unknown(), self.unseen.at(), super()._cost_by_heights())

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> Bool:
        """As `MapState.unknown`."""
        return super().unknown(rows, cols) | self.unseen.unknown(rows, cols)

    def known_along(self, path: Cells) -> int:
        """As `MapState.known_along`."""
        known = 0
        together = _TOGETHER
        while together and known < len(path):
            # as many cells as have nothing unknown around all of them
            some = path[known : known + together]
            part = widened(holding(some), self.grid.robot.reach, self.shape)
            if self.unseen.means(part) and np.isfinite(self.heights[slices(part)]).all():
                known += len(some)
                together = min(2 * together, _TOGETHER)
            else:
                together //= 2
        return known

    def _heights_at(self, places: Line) -> Floats:
        return self.unseen.heights_at(places, super()._heights_at(places))
