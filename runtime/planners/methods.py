"""The ways of finding a path on one map: what they share is made when first needed."""

import math
from functools import cached_property
from pathlib import Path

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.map.pyramid import coarse_shapes
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.priors import set_prices
from nnpp_edge.runtime.planners.by_blocks import BlockWay, over
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.searchers import (
    AStarSearcher,
    MendingSearcher,
    Searcher,
)
from nnpp_edge.runtime.planners.standing_path import Rest
from nnpp_edge.runtime.region.learned import LearnedRegions
from nnpp_edge.runtime.search.astar import Search
from nnpp_edge.runtime.search.dstar_lite import DStarLite, serves
from nnpp_edge.runtime.tuning import (
    BRIEF_EXPANSIONS,
    FAR,
    IN_VAIN,
    JOIN_AHEAD,
    JOIN_BEHIND,
    JOIN_EXPANSIONS,
    LARGE_MAP,
    LEARNED_CORRIDOR,
    MOST_ABOVE_FIELD,
    MOST_DRIFT,
    MOST_IN_VAIN,
    NEAR,
    REFINE_FROM,
    CorridorWidth,
)

_UNASKED = "no network is used for a vehicle's body: the corridor is as fast, closer to optimal"


def pick_method(
    shape: tuple[int, int], model: str | Path | NetworkModel, has_body: bool, apart: int
) -> tuple[Method, str]:
    """The method that ``auto`` picks on such a map for a goal `apart` cells away, by ``nnpp``'s
    `model`, and why.
    """
    if apart < NEAR:
        return Method.ASTAR, f"the goal is less than {NEAR} cells away"
    if has_body:
        return (
            Method.CORRIDOR,
            "for a body as fast as exact search on small maps, faster on large ones",
        )
    model = model.path if isinstance(model, NetworkModel) else model
    if (
        max(shape) >= LARGE_MAP and apart >= FAR and Path(model).stem == "edge"
    ):  # of which the figures are
        return Method.NNPP, f"the fastest from {FAR} cells on, on a large map"
    return Method.CORRIDOR, "as fast as the learned region, closer to optimal"


class Methods:
    """Finds paths on one map. Serves one thread at a time.

    Every method returns a path that is good enough for the query, and adds what that takes to
    `work`. OutOfTimeError where time was up before a search of the map could begin. `model` and
    `ask_from` as in `PlannerOptions`.
    """

    @checked(InvalidQueryError)
    def __init__(
        self,
        state: MapState,
        model: str | Path | NetworkModel = "edge",
        ask_from: int = NEAR,
    ) -> None:
        self.state = state
        self._ask_from = ask_from
        self.has_poses = not state.grid.robot.learned_region
        self.has_arcs = state.grid.robot.drives_arcs
        """Whether a vehicle's poses are searched, and whether it drives arcs."""
        self.keeps_field = False
        """Whether what guides a body's search serves the next one to the same goal, for an answer
        about as good.
        """
        self._in_vain: tuple[Cell, int] = (-1, -1), 0
        """Goal to which no corridor led lately, and for how many queries none is tried."""
        self.astar = AStarSearcher(state)
        self.regions = LearnedRegions(state, model)
        if state.unseen is not None:
            set_prices(state.unseen)
        self._dstar: DStarLite | None = None

    @cached_property
    def descent(self) -> CoarseToFine:
        """Searches of the coarse levels."""
        return CoarseToFine(self.state, self.astar.workspace)

    @cached_property
    def blocks(self) -> BlockWay:
        """Searches of the blocks of a coarse map."""
        return BlockWay(self.state, lambda state: Methods(state).corridor)

    @cached_property
    def mending(self) -> MendingSearcher:
        """D* Lite in regions."""
        return MendingSearcher(self.state, self.astar)

    def use_model(self, model: str | Path | NetworkModel) -> NetworkModel:
        """Ask this network from now on, once it has been loaded and tried; ModelError, and the old
        one stays.
        """
        if not isinstance(model, NetworkModel):
            model = NetworkModel(model)
            model.try_out()
        self.regions.use_model(model)
        return model

    def load_network(self) -> None:
        """Load the network now, and show it the map; ModelError if it cannot be loaded. With poses
        none is used.
        """
        if not self.has_poses:
            self.regions.prepare(
                self.state.pyramid.levels[self._network_level], self._network_level
            )

    def choose(self, method: str, query: Query) -> tuple[Method, str]:
        """The method of that name, for ``auto`` the one to pick and why; InvalidQueryError for
        another name.
        """
        if (wanted := Method(method)) is Method.AUTO:
            if self.has_arcs:
                return Method.CORRIDOR, "arcs are checked where the corridor leads"
            if self.state.unseen is not None:
                return Method.CORRIDOR, "over blocks where the ground is known coarsely"
            return pick_method(self.state.shape, self.regions.model, self.has_poses, query.apart)
        unasked = wanted is Method.NNPP and self.has_poses
        return wanted, _UNASKED if unasked else ""

    def find(self, method: Method | DynamicMethod, query: Query, work: Work) -> Found:
        """A path by a method that is not ``auto``."""
        by = DynamicMethod(method)
        if by is DynamicMethod.DSTAR:
            return self.mend_map(query, work)
        if by is DynamicMethod.ASTAR:
            return self.search_map(query, work)
        searcher: Searcher = self.mending if by.mends_regions else self.astar
        if by.base is Method.NNPP and not self.has_poses:
            return self.network_region(query, work, searcher)
        return self.corridor(query, work, searcher)

    def search_map(self, query: Query, work: Work, source: Source = Source.MAP) -> Found:
        """The optimal path, by A* over the whole map; `source` says why that was searched."""
        work.remark = ""
        return Found.of(self.state.grid, self.astar.search(query, work, None), source, None, work)

    def search_briefly(self, query: Query, work: Work) -> Found | None:
        """The optimal path; None where the way to the goal turns out too long for its distance."""
        limit = BRIEF_EXPANSIONS + 2 * query.apart**2
        found = self.astar.search(query, work, None, limit=limit)
        timeout = found.status is Status.TIMEOUT
        return None if timeout else Found.of(self.state.grid, found, Source.MAP, None, work)

    def mend_map(self, query: Query, work: Work) -> Found:
        """The optimal path, by D* Lite over the whole map; by A* where steps cost too differently
        for that.
        """
        if not serves(self.state.grid):
            return self.search_map(query, work)
        found = self._dstar_to(query.goal).plan(query.start, deadline=query.deadline)
        work.expansions += found.expansions
        work.stage_ends("search")
        return Found.of(self.state.grid, found, Source.MAP, None, work)

    def prepare_to_mend_map(self, goal: Cell) -> None:
        """Set D* Lite up for queries to this goal, all of its memory backed by the system."""
        dstar = self._dstar_to(goal)
        touch(dstar.memory)
        dstar.read()

    def corridor(
        self,
        query: Query,
        work: Work,
        searcher: Searcher | None = None,
        widths: tuple[CorridorWidth, CorridorWidth] | None = None,
    ) -> Found:
        """A path in a corridor around the coarse path, else in a wider one, else on the
        whole map.
        """
        by_blocks = None if self.state.unseen is None else self._by_blocks(query, work)
        if by_blocks is not None and by_blocks.suffices(query):
            return by_blocks
        self.state.pyramid_by(query.deadline)
        by_robot = self.state.grid.robot.corridors
        known = self.keeps_field and self.has_arcs and self.astar.kept_cost(query) < math.inf
        if known and (again := self.astar.search_again(query, work)) is not None:
            found = Found.of(self.state.grid, again, Source.REGION, None, work)
            if found.suffices(query) and found.cost <= MOST_ABOVE_FIELD * again.promised:
                return found
        searcher = searcher or self.astar
        top = self.descent.top_for(query)
        goal, times = self._in_vain
        if self.keeps_field and query.goal == goal and times:
            self._in_vain = goal, times - 1
            return self._search_at_last(query, work)
        doubtful: Found | None = None
        for width, source in zip(widths or by_robot, (Source.REGION, Source.WIDENED), strict=True):
            here = self.descent.find(query, work, searcher, top, None, width, source)
            if here is None:
                continue
            if not here.suffices(query):
                in_vain = self.has_arcs and here.search.status is Status.NO_PATH
                if in_vain and here.search.expansions > MOST_IN_VAIN * query.apart**2:
                    break
                continue
            if here.search.status is not Status.OK:
                return doubtful or here
            if (
                doubtful is None
                and self.has_arcs
                and here.cost > MOST_ABOVE_FIELD * here.search.promised
            ):
                doubtful = here  # an arc too many: perhaps there is a smoother way
                continue
            if self.keeps_field and self.has_arcs and here.region is not None:
                self.astar.keep_field(query.goal, here)
            return here if doubtful is None or here.cost < doubtful.cost else doubtful
        if doubtful is not None:
            return doubtful
        if self.has_arcs:  # before the search, which may end for want of time
            self._in_vain = query.goal, IN_VAIN
        return self._search_at_last(query, work)

    def _search_at_last(self, query: Query, work: Work) -> Found:
        """The optimal path, by A* over the whole map, every corridor having failed."""
        found = self.search_map(query, work, Source.FALLBACK)
        if self.keeps_field and self.has_arcs and found.search.status is Status.OK:
            self.astar.keep_field(query.goal, found)
        return found

    def _by_blocks(self, query: Query, work: Work) -> Found | None:
        """A path over cells as far as these were seen, and over blocks' middles beyond; None if
        none leads on.
        """
        state, grid = self.state, self.state.grid
        assert state.unseen is not None
        way = self.blocks  # before what is new is read: it begins with all
        way.read(query.deadline)
        if not state.unseen.left:
            return None
        for stops, first, region in way.ways(query, work, whole=self.has_poses):
            goal = query.goal if self.has_poses else (int(stops[first, 0]), int(stops[first, 1]))
            search = self.astar.search(query._replace(goal=goal), work, region)
            if search.status is not Status.NO_PATH:
                path = search.path
                if search.status is Status.OK and not self.has_poses:
                    path = np.concatenate((path[:-1], over(stops[first:])))
                bound = float(octile.py_func(*query.start, *query.goal, *grid.prices))
                whole = search._replace(path=path, refused_f=bound)
                return Found.of(grid, whole, Source.REGION, None, work)
        return None

    def rejoin(self, query: Query, work: Work, rest: Rest) -> Found | None:
        """A way to a place ahead on the path of arcs that stood, and on along that; None where a
        search is due.

        Without a way as short to search, the robot goes on along the path, if it is on it and all
        of it is clear.
        """
        promised = self.astar.kept_cost(query)
        if promised == math.inf:
            return None
        ahead = min(max(JOIN_AHEAD, rest.clear + JOIN_BEHIND), len(rest.states) - 1)
        search = self.astar.search_again(query, work, rest.states[ahead], JOIN_EXPANSIONS)
        if search is None and not rest.valid:
            return None
        way = (
            rest.states
            if search is None
            else np.concatenate((search.path, rest.states[ahead + 1 :]))
        )
        found = Found.of(
            self.state.grid, Search(Status.OK, way, 0, rest.bound), Source.STANDING, None, work
        )
        most = MOST_DRIFT * max(MOST_ABOVE_FIELD, self.astar.kept_above)
        return found if found.cost <= most * promised else None

    def network_region(self, query: Query, work: Work, searcher: Searcher | None = None) -> Found:
        """A path in the network's region, else in a wider one, else on the whole map; a near goal
        by A*.

        NNPP, sections 4.2 and 4.3. Raises ModelError where the network cannot be loaded.
        """
        if query.apart < self._ask_from and (near := self.search_briefly(query, work)) is not None:
            return near
        top = self._network_level
        deadline = query.deadline
        level = self.state.pyramid_by(deadline).levels[
            top
        ]  # before `descent`, which waits for all of them
        memory = self.descent.workspace(top)
        td, at_td, regions = self.regions.regions(
            query.start, query.goal, level, top, memory, work, deadline
        )
        for number, region in enumerate(regions):
            source = Source.WIDENED if number else Source.REGION
            found = self.descent.find(
                query, work, searcher or self.astar, top, region, LEARNED_CORRIDOR, source
            )
            if found is not None and found.suffices(query):
                break
        else:
            found = self.search_map(query, work, Source.FALLBACK)
        return found._replace(threshold=td, network_region=at_td)

    @property
    def _network_level(self) -> int:
        """Number of the level that the network's region is searched on first."""
        return len(coarse_shapes(*self.state.shape)) if max(self.state.shape) >= REFINE_FROM else 0

    def _dstar_to(self, goal: Cell) -> DStarLite:
        """D* Lite over the whole map, with this goal."""
        if self._dstar is None:
            self._dstar = DStarLite(self.state, goal)
        elif self._dstar.goal != goal:
            self._dstar.set_goal(goal)
        return self._dstar
