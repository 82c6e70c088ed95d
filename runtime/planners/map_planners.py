"""The planners of one map: each is made when first needed, and what several need is shared."""

from functools import cached_property
from pathlib import Path
from typing import Protocol

from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.corridor import CorridorPlanner
from nnpp_edge.runtime.planners.exact import ExactPlanner, MendingExactPlanner
from nnpp_edge.runtime.planners.learned import LearnedPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher, MendingSearcher, RegionMender, Searcher
from nnpp_edge.runtime.region.learned import LearnedRegions
from nnpp_edge.runtime.tuning import (
    BODY_CORRIDOR,
    CORRIDOR,
    NEAR,
    WIDENED_BODY_CORRIDOR,
    WIDENED_CORRIDOR,
)


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
        The network, loaded when first needed.
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
        self.has_poses = state.grid.poses is not None
        """Whether a vehicle's poses are searched."""
        self.exact = ExactPlanner(self.astar)

    def planner(self, method: Method, deadline: Deadline = NEVER) -> FindsPaths:
        """The planner of a method that is not ``auto``; on a map of poses ``nnpp`` is ``corridor``.

        OutOfTimeError where the coarse levels that it needs are not made by the deadline.
        """
        if method is Method.ASTAR:
            return self.exact
        self.state.pyramid_by(deadline)
        return self.learned if method is Method.NNPP and not self.has_poses else self.corridor

    def prepare_network(self) -> None:
        """Load the network of ``nnpp`` now, and show it the map; ModelError if it cannot be loaded.

        With poses, where none is asked, nothing.
        """
        if not self.has_poses:
            self.learned.prepare()

    def dynamic(self, method: DynamicMethod, deadline: Deadline = NEVER) -> FindsPaths:
        """The planner of a dynamic method that is not ``auto``; OutOfTimeError as by `planner`."""
        if method is DynamicMethod.DSTAR:
            return self.exact_mending
        if method is DynamicMethod.CORRIDOR_DSTAR:
            return self.corridor_mending
        learned = method is DynamicMethod.NNPP_DSTAR and not self.has_poses
        return self.learned_mending if learned else self.planner(method.base, deadline)

    def use_model(self, model: str | Path | NetworkModel) -> NetworkModel:
        """Ask this network from now on, once it has been loaded and tried; ModelError, and the old one stays."""
        if not isinstance(model, NetworkModel):
            model = NetworkModel(model)
            model.try_out()
        self.regions.use_model(model)
        return model

    def make_coarse_levels(self) -> None:
        """Pool the map now, so that the first plan does not wait for it."""
        _ = self.coarse_to_fine

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
        widths = (BODY_CORRIDOR, WIDENED_BODY_CORRIDOR) if self.has_poses else (CORRIDOR, WIDENED_CORRIDOR)
        return CorridorPlanner(self.coarse_to_fine, searcher, self.exact, widths)

    def _learned(self, searcher: Searcher) -> LearnedPlanner:
        parts = self.state, self.regions, self.coarse_to_fine, searcher, self.exact
        return LearnedPlanner(*parts, network_from=self._network_from)
