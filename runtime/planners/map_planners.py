"""The planners of one map: each is made when first needed, and what several need is shared."""

import functools
import warnings
from functools import cached_property
from pathlib import Path
from typing import Protocol

from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.map.prices import Price
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.passage import unsuited
from nnpp_edge.runtime.network.passage_model import PassageModel, VehicleNetwork, passage_model
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.corridor import CorridorPlanner
from nnpp_edge.runtime.planners.exact import ExactPlanner, MendingExactPlanner
from nnpp_edge.runtime.planners.learned import LearnedPlanner
from nnpp_edge.runtime.planners.link_descent import LinkDescent
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher, MendingSearcher, RegionMender, Searcher
from nnpp_edge.runtime.region.learned import LearnedRegions
from nnpp_edge.runtime.region.looked import LookedMap
from nnpp_edge.runtime.tuning import (
    BODY_CORRIDOR,
    CORRIDOR,
    FAR_FOR_BODY,
    LARGE_MAP_FOR_BODY,
    LEARNED_CORRIDOR,
    NEAR,
    NETWORK_CORRIDOR,
    WIDENED_BODY_CORRIDOR,
    WIDENED_CORRIDOR,
    WIDENED_NETWORK_CORRIDOR,
    CorridorWidth,
)

_SHIPPED = "edge"
"""The name that stands for the shipped networks, for a point's regions and for a vehicle's prices."""


class FindsPaths(Protocol):
    """A planner: one way of finding a path."""

    def find(self, query: Query, work: Work) -> Found:
        """A path, good enough for the query; what that takes is added to `work`."""


class MapPlanners:
    """Planners and searchers of one map. Serves one thread at a time.

    Parameters
    ----------
    state : MapState
        The map.
    model : str, Path or NetworkModel
        The network, loaded when first needed. On a map of poses ``network`` prices ask the passage network of a name
        or a file, and the shipped one for ``edge`` and for a network that is loaded.
    network_from : int
        As for `LearnedPlanner`.
    unseen_change : float
        As for `MapView`.
    """

    def __init__(
        self,
        state: MapState,
        model: str | Path | NetworkModel,
        *,
        network_from: int = NEAR,
        unseen_change: float = 0.0,
    ) -> None:
        self.state, self._network_from = state, network_from
        self._model, self._unseen_change = model, unseen_change
        self.astar = AStarSearcher(state)
        self._by_price: dict[Price, CorridorPlanner] = {}
        self.has_poses = state.grid.poses is not None
        """Whether a vehicle's poses are searched."""
        self._learned_width = BODY_CORRIDOR if self.has_poses else LEARNED_CORRIDOR
        self.exact = ExactPlanner(self.astar)

    def planner(self, method: Method, price: Price = Price.EQ1, deadline: Deadline = NEVER) -> FindsPaths:
        """The planner of a method that is not ``auto``; a corridor's, and with poses ``nnpp``'s, by a price.

        OutOfTimeError where the coarse levels that it needs are not made by the deadline.
        """
        if method is Method.ASTAR:
            return self.exact
        if price is Price.EQ1:
            self.state.pyramid_by(deadline)
        if method is Method.NNPP and not self.has_poses:
            return self.learned
        if price is Price.EQ1:
            return self.corridor
        if price not in self._by_price:
            parts = self.descent(price), self.astar, self.exact, self.widths(price)
            self._by_price[price] = CorridorPlanner(*parts)
        return self._by_price[price]

    def usual_price(self, method: Method) -> tuple[Price, str]:
        """What a method prices blocks by where no price is named, and the reason where that is not the network's."""
        if method is not Method.NNPP or not self.has_poses:
            return Price.EQ1, ""
        if not self.against_network:
            return Price.NETWORK, ""
        problem = f"nnpp goes by the price {Price.EQ1}: {self.against_network}"
        if self.state.grid.directed is None:
            warn_once(problem)
        return Price.EQ1, problem

    def descent(self, price: Price) -> CoarseToFine | LinkDescent:
        """Searches of the coarse levels of a price, or of its links."""
        if price is Price.EQ1:
            return self.coarse_to_fine
        return LinkDescent(LookedMap(self.state, self._passage), self.astar.workspace)

    def widths(self, price: Price) -> tuple[CorridorWidth, CorridorWidth]:
        """Of the first corridor by a price, and of the wider one."""
        if not self.has_poses:
            return CORRIDOR, WIDENED_CORRIDOR
        if price is Price.NETWORK:
            return NETWORK_CORRIDOR, WIDENED_NETWORK_CORRIDOR
        return BODY_CORRIDOR, WIDENED_BODY_CORRIDOR

    def prepare_network(self) -> None:
        """Load the network of ``nnpp`` now, and show it the map, but a vehicle's, which looks where a query needs it.

        ModelError if it cannot be loaded.
        """
        if self.has_poses:
            _ = self.by_network
        else:
            self.learned.prepare()

    def dynamic(self, method: DynamicMethod, deadline: Deadline = NEVER) -> FindsPaths:
        """The planner of a dynamic method that is not ``auto``; OutOfTimeError as by `planner`."""
        if method is DynamicMethod.DSTAR:
            return self.exact_mending
        if method is DynamicMethod.CORRIDOR_DSTAR:
            return self.corridor_mending
        if self.has_poses and method.base is Method.NNPP:  # which corrects prices by what A* has come to
            return self.by_network
        learned = method is DynamicMethod.NNPP_DSTAR
        return self.learned_mending if learned else self.planner(method.base, deadline=deadline)

    @property
    def by_network(self) -> FindsPaths:
        """``nnpp`` on a map of poses."""
        return self.planner(Method.NNPP, self.usual_price(Method.NNPP)[0])

    def use_model(self, model: str | Path | NetworkModel) -> str | Path | NetworkModel:
        """Ask this network from now on, once it has been loaded and tried; ModelError, and the old one stays.

        What is to be asked by whoever comes next is returned. With poses a name or a file is a passage network's, and
        InvalidMapError says that the vehicle is not in its range.
        """
        if self.has_poses:
            return self._use_passage(model)
        if not isinstance(model, NetworkModel):
            model = NetworkModel(model)
            model.run()
        self.regions.use_model(model)
        return model

    def _use_passage(self, model: str | Path | NetworkModel) -> str | Path | NetworkModel:
        poses = self.state.grid.poses
        assert poses is not None
        passage = _passage_of(model)
        passage.of(poses.vehicle, poses.sides_m)
        self._model = model
        self._by_price.pop(Price.NETWORK, None)
        for made in ("passage_network", "_passage", "against_network"):
            self.__dict__.pop(made, None)
        self._passage = passage
        return model

    def make_coarse_levels(self) -> None:
        """Pool the map now, so that the first plan does not wait for it."""
        _ = self.coarse_to_fine

    @cached_property
    def passage_network(self) -> VehicleNetwork:
        """The network that prices the map's links; InvalidMapError outside its range, ModelError without its file."""
        poses = self.state.grid.poses
        assert poses is not None
        return self._passage.of(poses.vehicle, poses.sides_m)

    @cached_property
    def _passage(self) -> PassageModel:
        return _passage_of(self._model)

    def network_pays(self, query: Query) -> bool:
        """Whether by the network's prices a vehicle's path is soonest found: on a large map, to a far goal."""
        if not self.has_poses or self.against_network:
            return False
        return max(self.state.shape) >= LARGE_MAP_FOR_BODY and query.apart >= FAR_FOR_BODY

    @cached_property
    def against_network(self) -> str:
        """Why no network prices links where nobody has named a price; empty if one does, or would for a body."""
        poses = self.state.grid.poses
        if poses is None:
            return ""
        if self.state.grid.directed is not None:
            return "the network prices steps alike both ways"
        problem = unsuited(poses.vehicle, poses.sides_m)
        if problem:
            problem = f"the network {problem}"
        elif self._model == _SHIPPED:  # one that the user has named is missed with an error
            try:
                passage_model()
            except ModelError as error:
                problem = str(error)
        return problem

    @cached_property
    def regions(self) -> LearnedRegions:
        """The network's regions."""
        return LearnedRegions(self.state, self._model, self._unseen_change)

    @cached_property
    def coarse_to_fine(self) -> CoarseToFine:
        """Searches of the coarse levels."""
        return CoarseToFine(self.state, self.astar.workspace)

    @cached_property
    def mender(self) -> RegionMender:
        """D* Lite in regions."""
        return RegionMender(self.state)

    @cached_property
    def corridor(self) -> CorridorPlanner:
        """The corridor, searched afresh."""
        return self._corridor(self.astar)

    @cached_property
    def corridor_mending(self) -> CorridorPlanner:
        """The corridor, mended where that is expected to be less work."""
        return self._corridor(MendingSearcher(self.mender, self.astar))

    @cached_property
    def corridor_mended(self) -> CorridorPlanner:
        """The corridor, always mended."""
        return self._corridor(MendingSearcher(self.mender, self.astar, always=True))

    @cached_property
    def learned(self) -> LearnedPlanner:
        """The network's region, searched afresh."""
        return self._learned(self.astar)

    @cached_property
    def learned_mending(self) -> LearnedPlanner:
        """The network's region, mended where that is expected to be less work."""
        return self._learned(MendingSearcher(self.mender, self.astar))

    @cached_property
    def exact_mending(self) -> MendingExactPlanner:
        """D* Lite over the whole map."""
        return MendingExactPlanner(self.state, self.exact)

    def _corridor(self, searcher: Searcher) -> CorridorPlanner:
        return CorridorPlanner(self.coarse_to_fine, searcher, self.exact, self.widths(Price.EQ1))

    def _learned(self, searcher: Searcher) -> LearnedPlanner:
        parts = self.state, self.regions, self.coarse_to_fine, searcher, self.exact
        return LearnedPlanner(*parts, network_from=self._network_from, width=self._learned_width)


def _passage_of(model: str | Path | NetworkModel) -> PassageModel:
    if isinstance(model, NetworkModel) or model == _SHIPPED:
        return passage_model()
    return PassageModel(model)


@functools.cache
def warn_once(problem: str) -> None:
    """Warn of something, the first time that it is said in a process."""
    warnings.warn(problem, stacklevel=9)
