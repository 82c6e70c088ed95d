"""The ways of finding a path on one map: what they share is made when first needed."""

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.cells import Cell, apart
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import small_pages
from nnpp_edge.runtime.options import METHODS
from nnpp_edge.runtime.planners.plan import DynamicMethod, Plan, Source
from nnpp_edge.runtime.planners.query import Found, problem_with, told
from nnpp_edge.runtime.planners.searchers import (
    AStarSearcher,
    Searcher,
)
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import (
    BRIEF_EXPANSIONS,
    FAR,
    LARGE_MAP,
    LEARNED_CORRIDOR,
    MOST_CELLS_TO_REPAIR,
    NEAR,
    REFINE_FROM,
    REPAIRED_FROM,
    SPARSE_FROM,
    UNSEEN_CHANGE,
    CorridorWidth,
)

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.pyramid import Level
    from nnpp_edge.runtime.network.inference import NetworkModel
    from nnpp_edge.runtime.planners.by_blocks import BlockWay
    from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
    from nnpp_edge.runtime.planners.mending import MendingSearcher
    from nnpp_edge.runtime.region.learned import LearnedRegions


class Way(NamedTuple):
    """A method, why that one, and what looks for a path by it."""

    by: DynamicMethod
    why: str
    find: Callable[["Methods", Query, Work], Found | None]
    """None where the next way is to be tried."""


_NEAR = f"the goal is less than {NEAR} cells away"
_NONE_SUFFICES = "the network's regions hold no path that suffices"
_REPAIRS = "repairs of the last search are the fastest where the map changes near the robot"
_NEW_CORRIDOR = "a new corridor is faster than repairs here"


def pick_method(
    state: MapState, model: "str | Path | NetworkModel", cells_apart: int
) -> tuple[str, str]:
    """The method that ``auto`` picks on such a map for a goal so many `cells_apart`, by ``nnpp``'s
    `model`, and why.
    """
    moves = state.grid.robot.moves
    if cells_apart < moves.near:
        return "astar", _NEAR
    if moves.over not in METHODS["nnpp"].robots:
        return "corridor", "for a body as fast as exact search on small maps, faster on large ones"
    # the figures are of the network `edge`
    if max(state.shape) >= LARGE_MAP and cells_apart >= FAR and Path(file_of(model)).stem == "edge":
        return "nnpp", f"on a large map mostly the fastest from {FAR} cells on"
    return "corridor", "as fast as the learned region, closer to optimal"


def file_of(model: "str | Path | NetworkModel") -> str | Path:
    """Name or file of a network."""
    return model if isinstance(model, str | Path) else model.path


class Methods:
    """Finds paths on one map. Serves one thread at a time.

    `plan` answers a query. The methods below it each return a path that is good enough for the
    query, and add what that takes to `work`; OutOfTimeError where time was up before a search of
    the map could begin. `model` and `ask_from` as in `PlannerOptions`; `repeated` queries lead to
    one goal, and what was found for one serves the next.
    """

    @checked(InvalidQueryError)
    def __init__(
        self,
        state: MapState,
        model: "str | Path | NetworkModel" = "edge",
        ask_from: int = NEAR,
        *,
        repeated: bool = False,
    ) -> None:
        self.state = state
        self._ask_from = ask_from
        self.astar = AStarSearcher(state)
        self.exhausted = self.astar.workspace
        """Memory of the newest search that found no path."""
        self._model = model
        self._repeated = repeated
        self._goal: Cell | None = None
        """Of the newest of repeated queries for which ``auto`` chose."""
        self._changes = state.log.reader()
        """Since then."""
        if state.unseen is not None:
            from nnpp_edge.runtime.network.priors import set_prices

            set_prices(state.unseen)

    # what a method needs is loaded with it

    @cached_property
    def regions(self) -> "LearnedRegions":
        """Regions by the network."""
        from nnpp_edge.runtime.region.learned import LearnedRegions

        return LearnedRegions(self.state, self._model, UNSEEN_CHANGE if self._repeated else 0.0)

    @cached_property
    def descent(self) -> "CoarseToFine":
        """Searches of the coarse levels."""
        from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine

        return CoarseToFine(self.state, self.astar.workspace)

    @cached_property
    def blocks(self) -> "BlockWay":
        """Searches of the blocks of a coarse map."""
        from nnpp_edge.runtime.planners.by_blocks import BlockWay

        return BlockWay(self.state, lambda state: Methods(state).corridor)

    @cached_property
    def mending(self) -> "MendingSearcher":
        """D* Lite in regions."""
        from nnpp_edge.runtime.planners.mending import MendingSearcher

        return MendingSearcher(self.state, self.astar)

    @cached_property
    def mending_map(self) -> "MendingSearcher":
        """D* Lite over the whole map."""
        from nnpp_edge.runtime.planners.mending import MendingSearcher

        return MendingSearcher(self.state, self.astar)

    def load_network(self) -> None:
        """Load the network now, and show it the map; ModelError if it cannot be loaded. For a robot
        for which none is used nothing is done.
        """
        if self.state.grid.robot.moves.over not in METHODS["nnpp"].robots:
            return
        self.regions.prepare(*self._network_level())

    def plan(
        self,
        query: Query,
        work: Work,
        method: str,
        *,
        keep_regions: bool = False,
    ) -> Plan:
        """The plan of a query, by the first way of a method that finds an answer, as the last one
        does.

        It is of the first where an end cannot be stood on, or time is up. InvalidQueryError where
        the method does not serve this robot.
        """
        state = self.state
        robot = state.grid.robot
        ways = self.ways(method, query)
        by, why, _ = ways[0]
        needs = by.entry.needs
        if problem := problem_with(state.grid, query.start, query.goal):
            why = told(problem, query, robot)
            return Plan(problem, by.entry.keeps or by, planner=by, reason=why)
        checked_before = robot.stance.checks
        large = state.grid.cells * robot.moves.states_a_node > SPARSE_FROM and needs
        try:
            with small_pages() if large or state.unseen is not None else nullcontext():
                for way in ways:
                    if (found := way.find(self, query, work)) is not None:
                        by, why, _ = way
                        break
        except OutOfTimeError:  # before a search of the map could begin
            why = ""
            nothing = Search.without_path(Status.TIMEOUT)
            found = Found(nothing, Source.REGION if needs else Source.MAP)
        assert found is not None
        if query.direction >= 0 or query.wanted is not None:  # no steps are counted there
            found = found._replace(lower_bound=found.lower_bound - robot.at_ends(query))
        within = by.entry.bound
        if 1.0 < within < math.inf and found.search.status is Status.OK:
            found = found._replace(lower_bound=max(found.cost / within, 0.0))
        plan = found.plan(by, work, state, checked_before, choice=why, keep_regions=keep_regions)
        if plan.status is not Status.NO_PATH:
            return plan
        self.exhausted = found.search.exhausted or self.astar.workspace
        deadline = query.deadline
        deadline.goes_on()  # it takes a while to tell why
        ended = robot.moves.why_ended(state.grid, query.start, query.goal, self.exhausted, deadline)
        return replace(plan, reason=f"{plan.reason}; {ended}") if ended else plan

    def ways(self, method: str, query: Query) -> Sequence[Way]:
        """How a path is found by a method, and why that one; InvalidQueryError where it does not
        serve this robot.
        """
        entry = METHODS[method]
        if entry.chooses:
            return self.choose(query)
        over = self.state.grid.robot.moves.over
        if over in entry.robots:
            return [_way(method)]
        other, why = entry.instead
        if not other:
            fit = ", ".join(each.name for each in METHODS.values() if over in each.robots)
            raise InvalidQueryError(
                f"method {entry.name!r} does not plan over {over}: wanted one of {fit}"
            )
        return [_way(other, why)._replace(by=DynamicMethod(method))]

    def choose(self, query: Query) -> Sequence[Way]:
        """How ``auto`` finds a path: by what figures say of the map, the robot and the distance."""
        if self.state.unseen is not None:
            return [_way("corridor", "over blocks where the ground is known coarsely")]
        repairs = self.repairs(query)
        self._changes.skip()
        if repairs:
            return [Way(DynamicMethod.DSTAR, _REPAIRS, Methods.repaired), _way("corridor")]
        if self._repeated:
            self._goal = query.goal
        picked, why = pick_method(self.state, self._model, query.apart)
        if picked == "astar":
            long = _NEW_CORRIDOR if self._repeated else f"{why}, but the way is long"
            near = Way(DynamicMethod.ASTAR, why, Methods.search_briefly)
            return [near, _way("corridor", long)]
        if self._repeated:
            return [_way("corridor", _NEW_CORRIDOR)]
        if picked == "nnpp":
            alone = partial(Methods.network_region, alone=True)
            return [Way(DynamicMethod.NNPP, why, alone), _way("corridor", _NONE_SUFFICES)]
        return [_way(picked, why)]

    def repairs(self, query: Query) -> bool:
        """Whether ``auto`` repairs its last search by D* Lite: that was for this goal, and nothing
        has changed near it since.
        """
        grid = self.state.grid
        if query.goal != self._goal or grid.cells > MOST_CELLS_TO_REPAIR:
            return False
        from nnpp_edge.runtime.search.dstar_lite import serves

        if not serves(grid):
            return False
        near = REPAIRED_FROM * query.apart
        return all(apart(each.part, query.goal) >= near for each in self._changes.peek())

    def repaired(self, query: Query, work: Work) -> Found | None:
        """As `mend_map`; None where there is no path, which another search is to show."""
        found = self.mend_map(query, work)
        return None if found.search.status is Status.NO_PATH else found

    def mended_corridor(self, query: Query, work: Work) -> Found:
        """As `corridor`, and in it D* Lite."""
        return self.corridor(query, work, searcher=self.mending)

    def mended_region(self, query: Query, work: Work) -> Found | None:
        """As `network_region`, and in it D* Lite."""
        return self.network_region(query, work, searcher=self.mending)

    def search_map(self, query: Query, work: Work, source: Source = Source.MAP) -> Found:
        """The optimal path, by A* over the whole map; `source` says why that was searched."""
        return Found.of(self.state.grid, self.astar.search(query, work, None), source)

    def search_briefly(self, query: Query, work: Work) -> Found | None:
        """The optimal path; None where the way to the goal turns out too long for its distance."""
        limit = BRIEF_EXPANSIONS + 2 * query.apart**2
        found = self.astar.search(query, work, None, limit=limit)
        if found.status is Status.TIMEOUT:
            return None
        return Found.of(self.state.grid, found, Source.MAP)

    def mend_map(self, query: Query, work: Work) -> Found:
        """The optimal path, by D* Lite over the whole map; by A* where steps cost too differently
        for that.
        """
        search = self.mending_map.search(query, work, None)
        return Found.of(self.state.grid, search, Source.MAP)

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
        if self.state.unseen is not None:
            by_blocks = self._by_blocks(query, work)
            if by_blocks is not None and by_blocks.suffices(query):
                return by_blocks
        for found in self.descent.corridors(query, work, searcher or self.astar, widths):
            if found.suffices(query):
                return found
        return self.search_map(query, work, Source.FALLBACK)

    def _by_blocks(self, query: Query, work: Work) -> Found | None:
        """A path over cells as far as these were seen, and over blocks' middles beyond; None if
        none leads on.
        """
        grid = self.state.grid
        unseen = self.state.unseen
        assert unseen is not None
        way = self.blocks  # before what is new is read: it begins with all
        way.read(query.deadline)
        if not unseen.left:
            return None
        for goal, region, beyond in way.ways(query, work):
            search = self.astar.search(query._replace(goal=goal), work, region)
            if search.status is not Status.NO_PATH:
                path = search.path
                if search.status is Status.OK and len(beyond):
                    path = np.concatenate((path, beyond))
                bound = float(octile.py_func(*query.start, *query.goal, *grid.prices))
                search = search._replace(path=path, refused_f=bound)
                return Found.of(grid, search, Source.REGION)
        return None

    def network_region(
        self,
        query: Query,
        work: Work,
        searcher: Searcher | None = None,
        *,
        alone: bool = False,
    ) -> Found | None:
        """A path in the network's region, else in a wider one, else on the whole map, or with
        `alone` None; a near goal by A*.

        NNPP, sections 4.2 and 4.3. Raises ModelError where the network cannot be loaded.
        """
        if query.apart < self._ask_from and (near := self.search_briefly(query, work)) is not None:
            return near
        level, top = self._network_level(query.deadline)
        td, at_td, regions = self.regions.regions(
            query.start,
            query.goal,
            level,
            top,
            self.descent.workspace(top),
            work,
            query.deadline,
        )
        for number, region in enumerate(regions):
            source = Source.WIDENED if number else Source.REGION
            found = self.descent.find(
                query, work, searcher or self.astar, top, region, LEARNED_CORRIDOR, source
            )
            if found is not None and found.suffices(query):
                break
        else:
            if alone:
                return None
            found = self.search_map(query, work, Source.FALLBACK)
        return found._replace(threshold=td, network_region=at_td)

    def _network_level(self, deadline: Deadline = NEVER) -> "tuple[Level, int]":
        """The level that the network's region is searched on first, and its number; OutOfTimeError
        at the deadline.
        """
        levels = self.descent.update(deadline)
        number = 0 if max(self.state.shape) < REFINE_FROM else len(levels) - 1
        return levels[number], number


def _way(method: str, why: str = "") -> Way:
    """How a path is found by a method that chooses among no others."""
    find = METHODS[method].find
    finder = resolve_name(find) if ":" in find else getattr(Methods, find)
    return Way(DynamicMethod(method), why, finder)
