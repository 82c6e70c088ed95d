"""Searches of the map at full resolution: what the planners are given to look for a path with."""

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell, apart
from nnpp_edge.runtime.deadline import OutOfTimeError
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.changes import ChangeReader
from nnpp_edge.runtime.map.pyramid import quarters
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.planners.query import Found, Query, Work, problem_with
from nnpp_edge.runtime.search.astar import LastMetres, Search, astar, by_kept_field, last_metres_to
from nnpp_edge.runtime.search.dstar_lite import DStarLite, serves
from nnpp_edge.runtime.search.landmarks import MOST_LANDMARKS, Landmarks
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import (
    DSTAR_SLOWER,
    EXPANDED_TWICE,
    FIELD_KEPT,
    MOST_JOINED,
    MOST_RATIO_FOR_LANDMARKS,
)

_FOR_READING = 0.25
"""Share of the time left that D* Lite may take to read the map before the region is searched
afresh.
"""


class Searcher(Protocol):
    """Searches a region of the map at full resolution."""

    def search(self, query: Query, work: Work, region: Region) -> Search:
        """Look for a path inside the region; expansions and time are added to `work`."""


class AStarSearcher:
    """A* afresh for each query, over the whole map or a region. Serves one thread at a time."""

    def __init__(self, state: MapState) -> None:
        self.grid = grid = state.grid
        self.workspace = Workspace(len(grid.weights), grid.steps.states_a_node)
        self._log = state.log
        self._kept: tuple[Cell, Region | None, int, Cell, float] | None = None
        """Of the field that is kept: goal, region, number of the search, its start, and the cost
        from there.
        """
        self.kept_above = 1.0
        """Cost of the path found by it, over what it promised."""
        self._since = state.log.reader()
        self._last_metres: tuple[Query, LastMetres | None] | None = None
        """Those of the newest query with a heading at its goal."""
        self._landmarks: Landmarks | None = None
        self._changes: ChangeReader | None = None
        """Since landmarks were set: without any, nothing has to be kept for it."""

    def search(
        self, query: Query, work: Work, region: Region | None, *, limit: int | None = None
    ) -> Search:
        """As `Searcher`; without a region the whole map, and after `limit` expansions it gives up
        with TIMEOUT.
        """
        start, goal, _, deadline, direction, wanted = query
        landmarks = self.landmarks
        hints = landmarks.towards(goal) if landmarks else None
        place = self.grid, start, goal, self.workspace, region
        last_metres = None
        if wanted is not None and start != goal:
            if self._last_metres is None or self._last_metres[0] is not query:
                last_metres = last_metres_to(self.grid, goal, wanted, self.workspace, deadline)
                self._last_metres = query, last_metres
                work.expansions += last_metres.expansions if last_metres else 0
            last_metres = self._last_metres[1]
        found = astar(
            *place,
            hints=hints,
            limit=limit,
            deadline=deadline,
            direction=direction,
            wanted=wanted,
            last_metres=last_metres,
        )
        work.expansions += found.expansions
        work.stage_ends("search")
        return found

    def keep_field(self, goal: Cell, found: Found) -> None:
        """Keep what guided the search that this was just found by, for `search_again`; at the goal
        nothing did.
        """
        assert self.workspace.field is not None
        if found.search.promised == math.inf:
            return
        start = found.search.path[0, :2].tolist()
        region = None if found.region is None else found.region.copy()
        self._kept = (
            goal,
            region,
            self.workspace.field.stamp,
            (start[0], start[1]),
            found.search.promised,
        )
        self.kept_above = found.cost / found.search.promised
        self._since = self._log.reader()

    def kept_cost(self, query: Query) -> float:
        """Least cost from start to goal by what guided an earlier search; inf to another goal, or
        if outdated.
        """
        field = self.workspace.field
        grid = self.grid
        if (
            self._kept is None
            or field is None
            or (query.goal, field.stamp) != (self._kept[0], self._kept[2])
        ):
            return math.inf
        if sum(change.cells for change in self._since.peek()) > FIELD_KEPT * grid.cells:
            return math.inf
        node = grid.node(*query.start)
        begun, promised = self._kept[3:]
        known = float(field.costs(slice(node, node + 1))[0])
        return (
            known
            if known < math.inf
            else promised - float(octile.py_func(*query.start, *begun, *grid.prices))
        )

    def search_again(
        self,
        query: Query,
        work: Work,
        by_way_of: NDArray[np.int32] | None = None,
        limit: int | None = None,
    ) -> Search | None:
        """A path of a body by what guided an earlier search, where `kept_cost` is known, to the
        goal or to a state (row, col, number) on the way; None where none is found, by `limit`
        expansions.
        """
        assert self._kept is not None
        start, goal, _, deadline, direction, wanted = query
        if by_way_of is not None:
            goal = int(by_way_of[0]), int(by_way_of[1])
            wanted = np.arange(self.workspace.states) == by_way_of[2]
        _, region, _, begun, promised = self._kept
        ends = self.grid, start, goal, self.workspace, region, begun, promised
        found = by_kept_field(
            *ends, limit=limit, deadline=deadline, direction=direction, wanted=wanted
        )
        work.expansions += found.expansions
        work.stage_ends("search")
        return found if found.status is Status.OK else None

    @property
    def landmarks(self) -> Landmarks | None:
        """From `prepare`; None before, after a cell has become cheaper, and where weights lie far
        apart.
        """
        if self._changes is not None and any(change.cheaper for change in self._changes.read()):
            self._landmarks = self._changes = None
        return self._landmarks if self.grid.step_ratio <= MOST_RATIO_FOR_LANDMARKS else None

    def prepare(self, landmarks: int, goals: Sequence[Cell]) -> None:
        """Set landmarks at these goals, and so many more spread over the map; errors as of
        `Planner.prepare`.
        """
        count = landmarks + len(goals)
        if count and (self.grid.steps.by_slope or self.grid.steps.by_poses):
            raise InvalidQueryError(
                "landmarks need steps that cost alike both ways, without turns: wanted "
                "step_cost='paper' and no body"
            )
        if not 0 <= count <= MOST_LANDMARKS:
            raise InvalidQueryError(
                f"landmarks and goals must be at most {MOST_LANDMARKS}, got {count}"
            )
        for goal in goals:
            if problem := problem_with(self.grid, goal, goal):
                raise InvalidQueryError(
                    f"goal {goal}: {problem.removeprefix('START_').lower().replace('_', ' ')}"
                )
        self._changes = self._log.reader()
        self._landmarks = Landmarks(self.grid, self.workspace)
        for goal in goals:
            self._landmarks.add(goal)
        self._landmarks.spread(count)


class RegionMender:
    """D* Lite in regions, kept from one query to the next. Serves one thread at a time.

    Worth it for queries towards one goal: another goal starts D* Lite afresh.
    """

    def __init__(self, state: MapState) -> None:
        self._state = state
        self._dstar: DStarLite | None = None
        self._known: Region | None = None
        """Where D* Lite has searched; None where it has forgotten all."""
        self._latest: Region | None = None
        """Where was searched last, by D* Lite or afresh."""
        self._restarts = 0
        """How often D* Lite had forgotten all by its last search."""
        self._saving_missed = 0.0
        """Work that mending would have saved since it was last done, had it been done each time, in
        new searches.
        """
        self._changes = state.log.reader()
        """Since the last region was searched."""

    def expect(self, goal: Cell) -> DStarLite:
        """Set D* Lite up for queries to this goal, in a region that holds nothing yet; nothing is
        read yet.
        """
        blocks = [2 * math.ceil(cells / FACTOR) for cells in self._state.shape]
        rows, cols = self._state.shape
        nothing = Region(np.zeros(blocks, np.int32), quarters(rows), quarters(cols))
        if self._dstar is None:
            self._dstar = DStarLite(self._state, goal, nothing)
        else:
            self._dstar.set_goal(goal)
            self._dstar.set_region(nothing)
        self._known = self._latest = None
        self._changes.skip()
        self._saving_missed = 0.0
        self._restarts = self._dstar.restarts
        return self._dstar

    def prepare(self, goal: Cell) -> None:
        """Do now what the first query to this goal would else do, all of the memory backed by the
        system.
        """
        dstar = self.expect(goal)
        touch(dstar.memory)
        dstar.plan(goal)  # so that the cells left out are dealt with now

    def read(self, query: Query) -> None:
        """Have D* Lite read what it has not; OutOfTimeError once that has taken a part of the time
        that is left.
        """
        self._for(query).read(query.deadline.share(_FOR_READING))

    @property
    def serves(self) -> bool:
        """Whether steps on the map are near enough to one another in cost."""
        return serves(self._state.grid)

    def knows_region(self, goal: Cell) -> bool:
        """Whether there is a search to be repaired, for this goal."""
        return (
            self.serves
            and self._dstar is not None
            and self._dstar.goal == goal
            and self._known is not None
        )

    def search(self, query: Query, work: Work, region: Region | None) -> Search:
        """Mend the search in this region, or in the one that is known, from the query's start.

        OutOfTimeError, as by `read`, where a new region cannot be read in a part of the time.
        """
        dstar = self._for(query)
        dstar.move_start(query.start)
        if region is not None:
            self._latest, self._known = region, self._joined(region)
            dstar.set_region(self._known)
            self.read(query)
        found = dstar.plan(query.start, deadline=query.deadline)
        work.expansions += found.expansions
        self._saving_missed = 0.0
        self._restarts = dstar.restarts
        self._changes.skip()
        work.stage_ends("search")
        # D* Lite does not say what it refused: the octile distance is the bound
        straight = octile.py_func(*query.start, *query.goal, *self._state.grid.prices)
        return found._replace(refused_f=straight)

    def worth_mending(self, query: Query, work: Work, region: Region) -> bool:
        """Whether D* Lite is expected to search a region with less work than A*, now or before
        long.

        A fresh search expands most of a region. D* Lite expands the cells that are new to it, and
        twice those that lie between the start and a change, and takes longer for each. What a fresh
        search leaves unmended is to be mended later: once steps that D* Lite would have made
        cheaply sum to what that is dearer by, it is mended after all. What such a step would have
        taken is estimated from the distances of the changes.
        """
        dstar = self._for(query)
        dstar.move_start(query.start)
        if dstar.restarts != self._restarts:
            self._known = None
        mended = DSTAR_SLOWER * _new_share(region, self._known)
        known_to_pay = mended <= 1.0 + self._saving_missed
        if known_to_pay:
            mended += DSTAR_SLOWER * EXPANDED_TWICE * dstar.reach()
        # as `DStarLite.reach`, by distances as the king moves
        nearest = min(
            (apart(change.part, query.goal) for change in self._changes.peek()), default=query.apart
        )
        step = DSTAR_SLOWER * EXPANDED_TWICE * max(1.0 - nearest / query.apart, 0.0)
        if step < 1.0:
            step += DSTAR_SLOWER * _new_share(region, self._latest)
        self._latest = region
        self._changes.skip()
        worth = mended <= 1.0 + self._saving_missed
        if not worth:
            self._saving_missed += max(1.0 - step, 0.0)
        done = "mended" if worth else "searched afresh"
        least = "" if known_to_pay else " or more"
        work.remark = (
            f"{done}: mending was estimated at {mended:.2f} times{least} the work of a fresh search"
        )
        return worth

    def _for(self, query: Query) -> DStarLite:
        """D* Lite with the query's goal."""
        if self._dstar is None or self._dstar.goal != query.goal:
            return self.expect(query.goal)
        return self._dstar

    def _joined(self, region: Region) -> Region:
        """The region together with the last one: to D* Lite, cells that leave are much work, and
        stay for nothing.
        """
        wanted = region.blocks()
        known = self._known
        both = wanted | known.blocks() if known and region.shares_blocks(known) else wanted
        if np.count_nonzero(both) > MOST_JOINED * np.count_nonzero(wanted):
            both = wanted
        return Region(both.astype(np.int32), region.row_block, region.col_block)


class MendingSearcher:
    """D* Lite in a region where that is expected to be less work than A* afresh; `always`, whatever
    it takes.
    """

    def __init__(self, mender: RegionMender, fresh: AStarSearcher, *, always: bool = False) -> None:
        self._mender = mender
        self._fresh = fresh
        self._always = always

    def search(self, query: Query, work: Work, region: Region) -> Search:
        """As `Searcher`."""
        work.remark = ""
        if self._mender.serves and query.start != query.goal:
            with suppress(
                OutOfTimeError
            ):  # of what D* Lite may take: the next query's goes on from there
                self._mender.read(query)
                if self._always or self._mender.worth_mending(query, work, region):
                    return self._mender.search(query, work, region)
        return self._fresh.search(query, work, region)


def _new_share(region: Region, known: Region | None) -> float:
    """The share of a region's blocks that are outside another; None holds nothing."""
    if known is None or not region.shares_blocks(known):
        return 1.0
    blocks = region.blocks()
    new = blocks & ~known.blocks()
    return float(new.sum()) / max(int(blocks.sum()), 1)
