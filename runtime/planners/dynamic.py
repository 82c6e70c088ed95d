"""Planning towards one goal on a map that changes, from a start that moves.

NNPP, section 5.5, Tables 3 and 4: a path is planned, the robot follows it, the map changes, and the
rest is planned anew. Every method answers on the newest map; they differ in what they keep from one
answer to the next.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, Unpack

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Bool, Cells, Float2D
from nnpp_edge.runtime.cells import Cell, as_cell
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.map.changes import ChangeReader
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.options import PlannerOptions
from nnpp_edge.runtime.planners.methods import Way, file_of
from nnpp_edge.runtime.planners.on_map import (
    OnMap,
    one_at_a_time,
    split,
)
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan, Source
from nnpp_edge.runtime.planners.query import Found, Work
from nnpp_edge.runtime.planners.slices import InSlices
from nnpp_edge.runtime.planners.standing_path import Departure, Standing, StandingPath
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.tuning import (
    AGAIN_EXPANSIONS,
    BEFORE_BLOCK,
    JOIN_AHEAD,
    MOST_AHEAD,
    NEAR,
)

if TYPE_CHECKING:
    from nnpp_edge.runtime.terrain.traversability import Traversability

_JOINED = "a way to the standing path, and on along that"
_GOES_ON = "the search goes on"
_CHANGED = "the map changed while it was searched, which begins anew"
_NOT_FROM_AHEAD = "no way leads on from where the standing path is clear; it is searched from here"
_CORRIDOR = "a new corridor is faster than repairs"


class _UnderWay(NamedTuple):
    """A search that goes on from one call to the next."""

    query: Query
    """As it was when the search began; there it starts."""
    ahead: int
    """Number on the standing path of the place where it starts; -1 where that was the robot's."""
    new: bool
    """Whether it is in its first slice, and may begin anew from a place ahead."""
    method: DynamicMethod
    work: Work
    call: InSlices[Plan]
    changes: ChangeReader
    """Of the map, since it began."""


class DynamicPlanner(OnMap):
    """Plans repeatedly to a goal while the map changes and the start moves. For one thread at a
    time.

    A call that was broken off leaves the map and the standing path.

    Parameters
    ----------
    goal : (row, col)
        A cell of the map.
    method : str
        One of `DynamicMethod`. ``auto`` picks exact A* for a goal nearby, unless the way there is
        long; else a new corridor.
    refine : str
        As in `PlanOptions`, of every plan.
    cost, cell_size_m, **options
        As for `Planner`, as errors are; or there is no such method, or the goal is outside the map.

    Examples
    --------
    >>> import numpy as np
    >>> planner = DynamicPlanner(np.full((20, 30), 0.2, np.float32), goal=(15, 27), method="dstar")
    >>> planner.move((2, 3))
    >>> len(planner.replan().path)
    25
    >>> planner.update(0, 10, np.ones((19, 2)))  # an obstacle
    38
    >>> planner.standing().footing
    <Footing.BLOCKED: 'blocked'>
    >>> planner.replan().ok
    True
    """

    @checked(InvalidQueryError)
    def __init__(
        self,
        cost: Float2D | Ground,
        goal: Cell,
        method: str = DynamicMethod.AUTO,
        *,
        refine: str | None = None,
        cell_size_m: float | None = None,
        **options: Unpack[PlannerOptions],
    ) -> None:
        self.method = DynamicMethod(method)
        self._start: Cell | None = None
        self._heading_deg: float | None = None
        self._goal_heading_deg: float | None = None
        self._standing: Plan | None = None
        super().__init__(cost, cell_size_m, options, tell_unknown=True)
        self._refines = self._frees(refine)
        self.set_goal(goal)

    @classmethod
    def of_elevation(
        cls,
        dem: Float2D,
        cell_size_m: float,
        goal: Cell,
        traversability: "Traversability | None" = None,
        method: str = DynamicMethod.AUTO,
        *,
        refine: str | None = None,
        **options: Unpack[PlannerOptions],
    ) -> "DynamicPlanner":
        """A planner of elevations, as `Planner.of_elevation`; with a vehicle, over its poses."""
        own, rest = split(options)
        ground = Ground.of_elevation(dem, cell_size_m, traversability, **own)
        return cls(ground, goal, method, refine=refine, **rest)

    @classmethod
    def of_coarse(
        cls,
        dem: Float2D,
        cell_size_m: float,
        factor: int,
        goal: Cell,
        traversability: "Traversability | None" = None,
        *,
        prior: str = "network",
        **options: Unpack[PlannerOptions],
    ) -> "DynamicPlanner":
        """A planner of ground that is known coarsely, as `Planner.of_coarse`."""
        own, rest = split(options)
        model = file_of(rest.pop("model", "unseen"))
        ground = Ground.of_coarse(
            dem, cell_size_m, factor, traversability, prior=prior, model=model, **own
        )
        return cls(ground, goal, **rest)

    _repeated = True
    _under_way: _UnderWay | None = None
    _looks_ahead = True
    """Whether searches may start ahead of the robot: not after one that led to nothing."""

    def _make(self) -> None:
        """As `OnMap._make`; the standing path stays, but no lower bound of its cost."""
        super()._make()
        self._path = StandingPath(self._state)
        if self._state.unseen is not None:
            _ = self._methods.blocks
        elif not self.method.whole_map:
            _ = self._methods.descent  # pooled now, so that the first plan does not wait for it
        if (standing := self._standing) is not None and tuple(standing.path[-1]) == self._goal:
            with suppress(InvalidQueryError):  # it may not be walkable any more
                self._path.set(replace(standing, lower_bound=0.0))

    def _begin_anew(self) -> None:
        self._stop_searching()
        self._standing = self._path.plan
        super()._begin_anew()

    def __getstate__(self) -> dict[str, object]:
        """The map, the model, the ends, and the standing path: a copy begins anew with these."""
        own = {
            name: getattr(self, name)
            for name in (
                "_refines",
                "_start",
                "_heading_deg",
                "_goal",
                "_goal_heading_deg",
                "method",
            )
        }
        return super().__getstate__() | own | {"_standing": self._path.plan}

    @property
    def goal(self) -> Cell:
        """The cell that paths lead to."""
        return self._goal

    @property
    def goal_heading_deg(self) -> float | None:
        """In which they arrive there; None for any."""
        return self._goal_heading_deg

    @property
    def standing_plan(self) -> Plan | None:
        """The last plan that had a path."""
        return self._path.plan

    @checked(InvalidQueryError)
    @one_at_a_time
    def set_goal(self, goal: Cell, heading_deg: float | None = None) -> None:
        """Another goal, in which a body arrives as by `goal_heading_deg` of `PlanOptions`; the
        standing path is forgotten. InvalidQueryError if it is outside the map, or the heading no
        number.
        """
        _check_heading(heading_deg)
        cell = as_cell(goal, "goal")
        if not self._state.grid.holds(cell):
            raise InvalidQueryError(f"goal must lie inside the map of {self.shape}, got {cell}")
        self._goal = cell
        self._goal_heading_deg = heading_deg
        self._path.forget()
        self._stop_searching()
        self._looks_ahead = True

    @property
    def searching(self) -> bool:
        """Whether a search goes on that the next `replan` that `goes_on` takes up."""
        return self._under_way is not None

    @property
    def searching_from(self) -> int:
        """Number on the standing path of the place, ahead of the robot, from which a search goes
        on: so far it may drive. -1 without one.
        """
        return -1 if self._under_way is None else self._under_way.ahead

    def _stop_searching(self) -> None:
        if self._under_way is not None:
            self._under_way.call.stop()
        self._under_way = None

    def _changed(self) -> None:
        self._path.catch_up()

    @one_at_a_time
    def first_blocked(self, path: Cells) -> int:
        """Number of the first cell of a path on the map, as `Plan.walked`, that cannot be stepped
        on now; or -1.
        """
        return self._state.grid.walk(path, 0, np.empty(len(path)))

    @one_at_a_time
    def reach(self, start: Cell | None = None) -> Float2D:
        """As `Planner.reach`, by default from where the robot is. A search that goes on is
        dropped.
        """
        self._stop_searching()
        return self._reach(self._where() if start is None else start)

    @checked(InvalidQueryError)
    def move(self, start: Cell, heading_deg: float | None = None) -> None:
        """The robot is in this cell now; InvalidQueryError if it is not a cell, or the heading no
        number.

        The heading of a body is in degrees clockwise from grid north; by default it is the plan's.
        """
        _check_heading(heading_deg)
        self._start = as_cell(start, "start")
        self._heading_deg = heading_deg

    @one_at_a_time
    def standing(self) -> Standing:
        """State of the last path on the current map, from the robot's current cell."""
        return self._path.check(self._where(), self._direction)

    @one_at_a_time
    def passed(self, row: float, col: float, heading_deg: float) -> Departure | None:
        """Cell and heading that a body has passed last, where it drives along the arcs of the
        standing path at this place, (0, 0) being the middle of the first cell; else None.

        Arcs are longer than cells. A path from there goes on along the arc that the body is on,
        where one from its own cell would begin in the nearest of the sixteen headings.
        """
        return self._path.passed(row, col, heading_deg)

    @one_at_a_time
    def prepare(self) -> None:
        """Do now what the first answer would else do: pool the map, set D* Lite up, show the
        network the map.

        The system is made to back all of the planner's arrays with memory, so that no later answer
        waits for that.
        """
        if self._state.unseen is not None:  # memory goes by what is seen
            return
        memory = self._methods.astar.workspace
        touch(memory, memory.field or memory, self._path)
        self._methods.descent.touch()
        if self.method is DynamicMethod.DSTAR:
            self._methods.prepare_to_mend_map(self._goal)
        if self.method.mends_regions:
            self._methods.mending.prepare(self._goal)
        if self.method.base is Method.NNPP:
            self._methods.load_network()

    @checked(InvalidQueryError)
    @one_at_a_time
    def replan(
        self,
        *,
        method: str | None = None,
        time_limit_s: float = math.inf,
        keep_regions: bool = False,
        goes_on: bool = False,
    ) -> Plan:
        """A path from the robot's cell to the goal, on the current map.

        The path of a plan that is OK leads over passable cells of the newest map. Regions that fail
        are widened, then the whole map is searched: NO_PATH means that there is none. `method`
        stands in for the planner's own, for which alone `prepare` does all there is to do; time and
        regions as in `PlanOptions`.

        With `goes_on` a search that has no time left is kept, and the next call by the same method
        goes on with it, however the map and the start have changed: TIMEOUT until its path, from
        the robot's cell, can be walked on the map as it is then. After its first slice it begins
        anew from a place ahead on the standing path, see `searching_from`. Of ground that is known
        coarsely each call searches anew.

        Raises
        ------
        InvalidQueryError
            There is no such method, or the start is not known (`move`).
        ModelError
            The network is needed and cannot be loaded.
        """
        wanted = self.method if method is None else DynamicMethod(method)
        query = Query.of(
            self._where(),
            self._goal,
            Deadline.within(time_limit_s),
            direction=self._direction,
            wanted=self._arrivals(self._goal_heading_deg),
        )
        if goes_on and self._state.unseen is None:
            plan = self._in_slices(query, wanted, keep_regions)
        else:
            self._stop_searching()
            plan = self._planned(query, Work(), wanted, keep_regions)
        if plan.ok:
            self._path.set(plan)
            self._looks_ahead = True
        return self._freed(plan, deadline=query.deadline) if self._refines else plan

    def _planned(self, query: Query, work: Work, wanted: DynamicMethod, keep_regions: bool) -> Plan:
        methods = self._methods
        ways = self._by_figures(query) if wanted is DynamicMethod.AUTO else [methods.way(wanted)]
        if not wanted.whole_map:
            ways = [(DynamicMethod.CORRIDOR, _JOINED, self._rejoined), *ways]
        return methods.plan(query, work, wanted, ways, keep_regions=keep_regions)

    def _in_slices(self, query: Query, wanted: DynamicMethod, keep_regions: bool) -> Plan:
        """A plan by a search that goes on from call to call; TIMEOUT while it does."""
        under_way = self._under_way
        if under_way is not None and under_way.ahead >= 0:
            standing = self._path.check(query.start, query.direction)
            if standing.index < 0 or 0 <= standing.blocked <= under_way.ahead:
                under_way = None  # the robot cannot come to where the search started
        if under_way is None or under_way.method is not wanted or not under_way.call.is_here:
            under_way = self._begun(query, -1, wanted, keep_regions)
        self._under_way = None  # for good, if it raises
        under_way.work.resumes()
        plan = under_way.call.work(query.deadline)
        if plan is None:
            under_way.work.pauses()
            ahead = self._place_ahead(query) if under_way.new else None
            self._under_way = under_way._replace(new=False)
            if ahead is not None:
                # it takes long: so that the robot may drive on meanwhile, from where it will be
                self._begun(*ahead, wanted, keep_regions)
            return self._nothing_yet(under_way, _GOES_ON)
        changed = under_way.changes.read()
        before = under_way.query
        moved = (before.start, before.direction) != (query.start, query.direction)
        if not plan.ok and under_way.ahead >= 0:
            self._looks_ahead = False
            return self._nothing_yet(under_way, _NOT_FROM_AHEAD)
        if not plan.ok:
            # where cells have only become impassable, there is no path all the more
            opened = any(change.cheaper for change in changed)
            return self._nothing_yet(under_way, _CHANGED) if moved or opened else plan
        if not (moved or changed):
            return plan
        return self._from_here(plan, query, under_way) or self._nothing_yet(under_way, _CHANGED)

    def _begun(
        self, query: Query, ahead: int, wanted: DynamicMethod, keep_regions: bool
    ) -> _UnderWay:
        """A search that begins, in place of one that is under way."""
        self._stop_searching()
        work = Work()

        def search(slices: Deadline) -> Plan:
            in_slices = query._replace(deadline=slices)
            return self._planned(in_slices, work, wanted, keep_regions)

        changes = self._state.log.reader()
        new = self._looks_ahead and ahead < 0
        call = InSlices(search)
        self._under_way = _UnderWay(query, ahead, new, wanted, work, call, changes)
        return self._under_way

    def _place_ahead(self, query: Query) -> tuple[Query, int] | None:
        """Where the robot can be soon, following what is clear of the standing path: the query
        from there, and the number of that place; None without one.
        """
        standing = self._path.check(query.start, query.direction)
        plan = self._path.plan
        if plan is None or standing.index < 0:
            return None
        clear = len(plan.path) - 1 if standing.valid else standing.blocked - BEFORE_BLOCK
        at = min(standing.index + MOST_AHEAD, clear)
        if at <= standing.index:
            return None
        row, col = plan.path[at].tolist()
        # a body comes to a cell as it left the one before; on arcs its state is known
        heading = plan.headings_deg[at - 1 if plan.states is None else at]
        direction = self._state.grid.robot.direction(float(heading))
        return query._replace(start=(row, col), direction=direction), at

    def _from_here(self, plan: Plan, query: Query, under_way: _UnderWay) -> Plan | None:
        """A plan that was searched for while the map and the robot's place changed, from there on
        the map as it is; None where it cannot be driven.
        """
        before = self._path.plan
        standing = self._path.check(query.start, query.direction)
        work = under_way.work
        if before is not None and 0 <= standing.index <= under_way.ahead:
            # the standing path as far as where the search started, and on along the new one
            way = before.walked[standing.index : under_way.ahead]
            path = np.concatenate((way, plan.walked))
            bound = self._state.grid.least_cost(query.start, query.goal)
            return self._driven(Search(Status.OK, path, 0, bound), work)
        try:
            self._path.set(replace(plan, lower_bound=0.0))
        except InvalidQueryError:
            return None
        standing = self._path.check(query.start, query.direction)
        if standing.valid:
            rest = plan.rest(standing.index)
            known = replace(rest, cost=standing.cost, lower_bound=standing.lower_bound)
            return known.over(self._state)
        # the robot has gone on beside it meanwhile: a way there, which is short
        if self._methods.arcs is None:
            return self._joined(query, work)
        found = self._rejoined(query, work)
        return None if found is None else self._driven(found.search, work)

    def _driven(self, search: Search, work: Work) -> Plan | None:
        """The plan of a path that joins another; None where it cannot be driven."""
        if self._state.grid.walk(search.path, 0, np.empty(len(search.path))) >= 0:
            return None
        found = Found.of(self._state.grid, search, Source.STANDING, None, work)
        return found.plan(DynamicMethod.CORRIDOR, work, self._state, choice=_JOINED)

    def _joined(self, query: Query, work: Work) -> Plan | None:
        """A way to a place ahead on the standing path, and on along that; None where there is none
        soon.
        """
        rest = self._path.rest(query.start, query.direction)
        if rest is None:
            return None
        ahead = min(JOIN_AHEAD, len(rest.states) - 1)
        if ahead < len(rest.states) - 1:
            row, col = rest.states[ahead].tolist()
            query = query._replace(goal=(row, col), wanted=None)
        way = self._methods.astar.search(query, work, None, limit=AGAIN_EXPANSIONS)
        if way.status is not Status.OK:
            return None
        path = np.concatenate((way.path, rest.states[ahead + 1 :]))
        return self._driven(Search(Status.OK, path, 0, rest.bound), work)

    def _nothing_yet(self, under_way: _UnderWay, reason: str) -> Plan:
        """No plan, as a search has not ended, or in vain."""
        nothing = Found.too_late(Source.REGION)
        return nothing.plan(under_way.method, under_way.work, self._state, reason=reason)

    @checked(InvalidQueryError)
    @one_at_a_time
    def refined(self, plan: Plan) -> Plan:
        """A plan whose path can be walked on the map as it is now, such as what is left of the
        standing one, with its way points where the planner was made with `refine`, and with the
        numbers along it.
        """
        return self._freed(plan) if self._refines else plan.over(self._state)

    def _rejoined(self, query: Query, work: Work) -> Found | None:
        """A body's way along arcs to the standing path, and on along that; None without one."""
        arcs = self._methods.arcs
        rest = None if arcs is None else self._path.rest(query.start, query.direction)
        return None if arcs is None or rest is None else arcs.rejoin(query, work, rest)

    def _by_figures(self, query: Query) -> Sequence[Way]:
        """How ``auto`` finds a path, and why so."""
        methods = self._methods
        if query.apart < NEAR and methods.arcs is None:
            return methods.near_ways(_CORRIDOR)
        return [methods.way(DynamicMethod.CORRIDOR, _CORRIDOR)]

    @property
    def _direction(self) -> int:
        """In which a body heads; -1 of others, and where it is not given."""
        heading = self._heading_deg
        return -1 if heading is None else self._state.grid.robot.direction(heading)

    def _arrivals(self, heading_deg: float | None) -> Bool | None:
        """Directions in which the goal may be arrived at; None for any."""
        robot = self._state.grid.robot
        if heading_deg is None or robot.direction(heading_deg) < 0:
            return None
        return robot.ends(None, heading_deg, 0.0)[1]

    def _where(self) -> Cell:
        if self._start is None:
            raise InvalidQueryError("wanted a start (move) before the first plan, got none")
        return self._start


def _check_heading(heading_deg: float | None) -> None:
    if heading_deg is not None and not math.isfinite(heading_deg):
        raise InvalidQueryError(f"heading_deg must be a number of degrees, got {heading_deg}")
