"""The corridor planner alone, of any width, by any price, and by controls: what might do as well as a network."""

import math
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.prices import Price
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.passage_model import PassageModel, passage_model
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.corridor import CorridorPlanner
from nnpp_edge.runtime.planners.link_descent import LinkDescent
from nnpp_edge.runtime.planners.map_planners import MapPlanners
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.planners.query import Query, Work
from nnpp_edge.runtime.region.links import Links
from nnpp_edge.runtime.region.looked import LookedMap
from nnpp_edge.runtime.terrain.vehicle import HEADINGS
from nnpp_edge.runtime.tuning import WIDENED_CORRIDOR, CorridorWidth


class Control(StrEnum):
    """Prices of links that show what the network's are owed to: searched and corrected alike, of the same widths."""

    STRAIGHT = "straight"
    """All alike by their length: what lies between start and goal."""


class CorridorAlone:
    """The corridor planner on a map of its own.

    Parameters
    ----------
    state : MapState
        The map; of heights, with a vehicle, for any other price than ``eq1``.
    price : Price or Control
        Of blocks or links.
    first : CorridorWidth
        Of the first corridor, instead of the price's own. Of the learned region's width it shows what is owed to the
        network, and what to narrow corridors alone.
    passage : PassageModel
        Whose prices ``network`` are, instead of the shipped network's.
    """

    def __init__(
        self,
        state: MapState,
        price: Price | Control = Price.EQ1,
        *,
        first: CorridorWidth | None = None,
        passage: PassageModel | None = None,
    ) -> None:
        self._state, self._price, self._passage = state, price, passage
        self._planners = MapPlanners(state, "edge")
        self._widths = self._planners.widths(price if isinstance(price, Price) else Price.NETWORK)
        if first is not None:
            self._widths = first, WIDENED_CORRIDOR
        self._corridor: CorridorPlanner | None = None

    def plan(
        self, start: Cell, goal: Cell, *, method: str, keep_regions: bool = False, price: str | None = None
    ) -> Plan:
        """As `Planner.plan`; there is but one method, and one price. The first plan makes what they need."""
        work, checked, planners = Work(), self._state.checked, self._planners
        if self._corridor is None:
            self._corridor = CorridorPlanner(self._descent(), planners.astar, planners.exact, self._widths)
        found = self._corridor.find(Query(start, goal), work)
        computed, checks = self._state.costs_computed, self._state.checked - checked
        return found.plan(
            Method.CORRIDOR, work, planner=method, keep_regions=keep_regions, costs_computed=computed, checks=checks
        )

    def _descent(self) -> CoarseToFine | LinkDescent:
        state, memory = self._state, self._planners.astar.workspace
        if self._price is Price.NETWORK:
            return LinkDescent(LookedMap(state, self._passage or passage_model()), memory)
        if isinstance(self._price, Price):
            return self._planners.descent(self._price)
        return LinkDescent(MadeLinks(state, straight_links(state.shape)), memory)


class MadeLinks:
    """Prices of links that do not follow the map's changes: (4, R, C) float32, see `Links.of`."""

    least, looks = 1.0, 0
    """None is cheaper for a cell's length; and the network is never asked."""

    def __init__(self, state: MapState, prices: NDArray[np.float32]) -> None:
        self.grid, self.shape, self._links = state.grid, state.shape, Links.of(prices)

    def links_within(self, part: Rectangle, deadline: object = None) -> Links:
        """All of them."""
        return self._links


def straight_links(shape: Cell) -> NDArray[np.float32]:
    """(4, R, C) prices of links on a map of this shape: their lengths in cells."""
    lengths = np.array([FACTOR * math.hypot(*heading) for heading in HEADINGS], np.float32)
    return np.tile(lengths[:, None, None], (1, *(math.ceil(n / FACTOR) for n in shape)))
