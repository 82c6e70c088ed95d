"""The layers of a map: numbers of its cells, of which its weights are made.

A patch changes one layer. The layer says what of the map weighs anew; `map.state.MapState` combines
the layers and knows none by name but those that a user may ask for.
"""

from abc import ABC, abstractmethod

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Float2D, as_map
from nnpp_edge.runtime.cells import Rectangle, slices
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.terrain.step_cost import StepModel

Put = tuple[Change, Rectangle]
"""What weighs otherwise, and the rectangle of new numbers, of no rows without any."""


class Layer(ABC):
    """Numbers of a map's cells, one array. A subclass is one kind of them."""

    name: str
    """By which patches come to it."""

    def read(self, patch: Float2D) -> Float2D:
        """A patch (h, w) as the layer keeps it; InvalidMapError where it is none."""
        return as_map(patch, "patch")

    @abstractmethod
    def put(self, part: Rectangle, patch: Float2D, seen: Bool | None, *, keeps: bool) -> Put:
        """Put a patch that was `read` into a part of the map; `seen` as for `MapState.update`.

        InvalidMapError for a number out of range: the map is as it was. With `keeps` the change
        says what cells weighed before.
        """


class Lowest(Layer):
    """The lowest layer, which makes the grid that the others change."""

    @abstractmethod
    def begin(self) -> Grid:
        """The grid by what the layer holds now, made anew."""

    @abstractmethod
    def cost(self) -> Float2D:
        """As `MapState.cost`, by this layer alone."""

    @abstractmethod
    def unknown(self, part: Rectangle) -> Bool:
        """As `MapState.unknown`."""


class Costs(Lowest):
    """Costs given, which are the grid's weights; `tells_unknown` keeps which cells are unknown."""

    name = "cost"

    def __init__(
        self, cost: Float2D, model: StepModel, corner_cutting: bool, tells_unknown: bool
    ) -> None:
        self._unknown = np.isnan(cost) if tells_unknown else None
        self.grid = Grid.of(cost, model, corner_cutting)
        self._begun = False

    def begin(self) -> Grid:
        if self._begun:
            self.grid.measure_bounds()
        self._begun = True
        return self.grid

    def put(self, part: Rectangle, patch: Float2D, seen: Bool | None, *, keeps: bool) -> Put:
        change = self.grid.update(patch, part[:2], keep_old_weights=keeps, seen=seen)
        if self._unknown is not None:
            everywhere = True if seen is None else seen
            np.copyto(self._unknown[slices(part)], np.isnan(patch), where=everywhere)
        return change, change.part

    def cost(self) -> Float2D:
        cost: Float2D = self.grid.map() / np.float32(self.grid.model.scale or 1.0)
        if self._unknown is not None:
            cost[self._unknown] = np.nan
        return cost

    def unknown(self, part: Rectangle) -> Bool:
        if self._unknown is None:
            return np.zeros(part[2:], np.bool_)
        return self._unknown[slices(part)].copy()
