"""Planning towards one goal on a map that changes, from a start that moves.

NNPP, section 5.5, Tables 3 and 4: a path is planned, the robot follows it, the map changes, and the
rest is planned anew. Every method answers on the newest map; they differ in what they keep from one
answer to the next.
"""

import math
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

import numpy as np

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Bool, Cells, Float2D, Int32
from nnpp_edge.runtime.cells import Cell, apart, as_cell, cell_of
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.options import PlannerOptions
from nnpp_edge.runtime.planners.joining import ON_IT, Joiner, nearest_on
from nnpp_edge.runtime.planners.on_map import OnMap, coarse_ground, one_at_a_time, split
from nnpp_edge.runtime.planners.plan import DynamicMethod, Plan, Source
from nnpp_edge.runtime.planners.query import Found, problem_with
from nnpp_edge.runtime.planners.searching import Options, Searching, find
from nnpp_edge.runtime.planners.standing_path import Departure, Footing, Standing, StandingPath
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import BEFORE_BLOCK, GOAL_MOVES, JOIN_MS, MOST_AHEAD

if TYPE_CHECKING:
    from nnpp_edge.runtime.terrain.traversability import Traversability

_JOINED = "the path planned before, joined to where the robot is"
_GOES_ON = "the search goes on"
_CHANGED = "the map changed while it was searched, which begins anew"
_NOT_FROM_AHEAD = "no way leads on from where the standing path is clear; it is searched from here"


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
        self._standing: Plan | None = None
        super().__init__(cost, cell_size_m=cell_size_m, **options)
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
        **options: Unpack[PlannerOptions],
    ) -> "DynamicPlanner":
        """A planner of ground that is known coarsely, as `Planner.of_coarse`."""
        ground, rest = coarse_ground(dem, cell_size_m, factor, traversability, options)
        return cls(ground, goal, **rest)

    _repeated = True
    goal: Cell
    """The cell that paths lead to; to be changed by `set_goal` alone."""
    goal_heading_deg: float | None = None
    """In which they arrive there; None for any."""
    _wanted: Bool | None = None
    """As `Query.wanted`, by that heading."""
    _start: Cell | None = None
    _direction = -1
    """As `Query.direction`, at the start."""
    _searching: Searching | None = None
    """A search that goes on."""
    _no_path: Searching | None = None
    """The last search, if it found none."""
    _looks_ahead = True
    """Whether searches may start ahead of the robot: not after one that led to nothing."""
    _aim: tuple[Cell, float | None] | None = None
    """What the standing path was planned to lead to: a goal, and the heading there."""
    _searched = 0
    """Version of the map on which the search for it began."""

    def _make(self) -> None:
        """As `OnMap._make`; the standing path stays, but no lower bound of its cost."""
        super()._make()
        self._path = StandingPath(self._state)
        self._joiner = Joiner(self._state.grid)
        if self._state.unseen is not None:
            _ = self._methods.blocks
        elif self.method.entry.needs:
            self._methods.descent.update()  # now, so that the first plan does not wait
        standing = self._standing
        if standing is not None and self._leads_to_goal:
            with suppress(InvalidQueryError):  # it may not be walkable any more
                self._path.set(replace(standing, lower_bound=0.0))

    def _begin_anew(self) -> None:
        self._searching = None
        self._standing = self._path.plan
        super()._begin_anew()

    def __getstate__(self) -> dict[str, object]:
        """The map, the model, the ends, and the standing path: a copy begins anew with these."""
        names = (
            "method",
            "goal",
            "goal_heading_deg",
            "_refines",
            "_start",
            "_direction",
            "_wanted",
            "_aim",
        )
        own = {name: getattr(self, name) for name in names}
        return super().__getstate__() | own | {"_standing": self._path.plan}

    @property
    def standing_plan(self) -> Plan | None:
        """The last plan that had a path to this goal, or for it."""
        return self._path.plan if self._leads_to_goal else None

    @property
    def has_path(self) -> bool:
        """Whether there is a path to follow, to this goal or to where it was before."""
        return self._path.plan is not None

    @property
    def _leads_to_goal(self) -> bool:
        return self._aim == (self.goal, self.goal_heading_deg)

    @checked(InvalidQueryError)
    @one_at_a_time
    def set_goal(self, goal: Cell, heading_deg: float | None = None) -> None:
        """Another goal, in which a body arrives as by `goal_heading_deg` of `PlanOptions`; the
        standing path is none to it. InvalidQueryError if it is outside the map, or the heading no
        number.

        A goal that has moved by less than a quarter of the robot's way to it keeps the search that
        goes on, see `replan`, and `joined` leads the path there.
        """
        cell = as_cell(goal, "goal")
        if not self._state.grid.holds(cell):
            raise InvalidQueryError(f"goal must lie inside the map of {self.shape}, got {cell}")
        self._wanted = None
        if heading_deg is not None and self._direction_of(heading_deg) >= 0:
            self._wanted = self._moves.ends(None, heading_deg, 0.0)[1]
        self.goal = cell
        self.goal_heading_deg = heading_deg
        self._looks_ahead = True
        if self._aim is not None and not self._moved_little(self._aim[0]):
            self._path.forget()
            self._aim = None
        if self._searching is not None and not self._moved_little(self._searching.query.goal):
            self._searching = None

    def _moved_little(self, before: Cell) -> bool:
        """Whether a path to the goal as it was leads near to the one that is now."""
        if self._start is None:
            return False
        moved = apart((*before, 1, 1), self.goal)
        return moved <= GOAL_MOVES * apart((*self._start, 1, 1), self.goal)

    @checked(InvalidQueryError)
    def move(self, start: Cell, heading_deg: float | None = None) -> None:
        """The robot is in this cell now; InvalidQueryError if it is not a cell, or the heading no
        number.

        The heading of a body is in degrees clockwise from grid north; by default it is the plan's.
        """
        direction = -1 if heading_deg is None else self._direction_of(heading_deg)
        self._start = as_cell(start, "start")
        self._direction = direction

    def _direction_of(self, heading_deg: float) -> int:
        """In which a body heads; -1 of others."""
        if not math.isfinite(heading_deg):
            raise InvalidQueryError(f"heading_deg must be a number of degrees, got {heading_deg}")
        return self._moves.direction(heading_deg)

    def _place(self, deadline: Deadline = NEVER) -> Query:
        """Where the robot is, and where it is to go."""
        if self._start is None:
            raise InvalidQueryError("wanted a start (move) before the first plan, got none")
        return Query(self._start, self.goal, math.inf, deadline, self._direction, self._wanted)

    @property
    def searching(self) -> bool:
        """Whether a search goes on that the next `replan` that `goes_on` takes up."""
        return self._searching is not None

    @property
    def search_due(self) -> bool:
        """Whether another path than the standing one is looked for, or is to be: one that leads
        elsewhere than to the goal, as no path led there, may be out of date.
        """
        if self._searching is not None or self.standing_plan is None:
            return True
        return self._path.end != self.goal and self._state.log.version != self._searched

    @one_at_a_time
    def go_on(self, time_limit_s: float) -> bool:
        """Use so much time for the search that goes on, of which the next `replan` gives the plan;
        False where there is nothing to do.
        """
        searching = self._searching
        if searching is None or searching.plan is not None or not searching.is_here:
            return False
        self._searching = None  # for good, if it raises
        searching.go_on(Deadline.within(time_limit_s))
        self._searching = searching
        return True

    def _changed(self) -> None:
        self._path.catch_up()

    @one_at_a_time
    def first_blocked(self, path: Cells) -> int:
        """Number of the first cell of a path on the map, as `Plan.walked`, that cannot be stepped
        on now; or -1.
        """
        return self._state.grid.walk(path, 0, np.empty(len(path)))

    @one_at_a_time
    def standing(self) -> Standing:
        """State of the last path on the current map, from the robot's current cell."""
        if not self._leads_to_goal:
            return Standing(Footing.NONE)
        return self._path.check(self._place().start, self._direction)

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
        self._load_kernels()
        if self._state.unseen is not None:  # memory goes by what is seen
            return
        memory = self._methods.astar.workspace
        touch(memory, memory.field or memory, self._path)
        self._methods.descent.touch()
        entry = self.method.entry
        if entry.keeps:
            mends = self._methods.mending if entry.needs else self._methods.mending_map
            mends.prepare(self.goal)
        if "network" in entry.needs:
            self._methods.load_network()

    def _load_kernels(self) -> None:
        """Load what puts a patch into the map and checks a path, by a patch that shows nothing."""
        state = self._state
        cell = (0, 0, 1, 1)
        heights = state.heights is not None
        layer = "heights" if heights else "cost"
        patch = np.ones((1, 1), np.float32)
        state.update(0, 0, patch, np.zeros((1, 1), np.bool_), layer)
        state.grid.robot.follow(Change(cell, 0), cell, state, heights=heights)
        self._path.prepare()

    @checked(InvalidQueryError)
    @one_at_a_time
    def replan(
        self,
        *,
        method: str | None = None,
        time_limit_s: float = math.inf,
        goes_on: bool = False,
        approach: bool = False,
    ) -> Plan:
        """A path from the robot's cell to the goal, on the current map.

        The path of a plan that is OK leads over passable cells of the newest map. Regions that fail
        are widened, then the whole map is searched: NO_PATH means that there is none. `method`
        stands in for the planner's own, for which alone `prepare` does all there is to do; the time
        as in `PlanOptions`.

        With `goes_on` a search that has no time left is kept, and goes on with `go_on` and the next
        call by the same method, however the map and the ends have changed: TIMEOUT until its path,
        from the robot's cell to the goal, can be walked on the map as it is then. After its first
        slice it begins anew from a place ahead on the standing path, see `clear_part`. Of ground
        that is known coarsely each call searches anew.

        With `approach` the path leads as near to the goal as there is a way, where none leads to
        it: see `approach.place_towards`.

        Raises
        ------
        InvalidQueryError
            There is no such method, or the start is not known (`move`).
        ModelError
            The network is needed and cannot be loaded.
        """
        wanted = self.method if method is None else DynamicMethod(method)
        options = Options(wanted, approach)
        place = self._place(Deadline.within(time_limit_s))
        plan = None
        joins = wanted is DynamicMethod.AUTO and not self._methods.repairs(place)
        if joins and not self.search_due:
            soon = place
            if time_limit_s < math.inf:
                soon = self._place(Deadline.within(1e-3 * JOIN_MS))
            plan = self._join(soon, as_good=True)
        if plan is None:
            plan = self._searched_for(place, options, goes_on=goes_on)
            if plan.ok:
                self._path.set(plan)
                self._aim = (self.goal, self.goal_heading_deg)
                self._looks_ahead = True
        return self._freed(plan, place.deadline) if self._refines else plan

    def _searched_for(self, place: Query, options: Options, *, goes_on: bool) -> Plan:
        """A plan by a search; by one that `goes_on` from call to call TIMEOUT while it does."""
        if not goes_on or self._state.unseen is not None:
            self._searching = None
            self._searched = self._state.log.version
            return find(self._methods, place, Work(), options, self._path.end)
        none_yet = self._no_path
        if none_yet is not None and options.shows_no_path and none_yet.shows_no_path(place):
            assert none_yet.plan is not None
            return none_yet.plan
        self._no_path = None
        searching = self._searching
        if searching is None or not self._serves(searching, place, options):
            searching = Searching(self._methods, place, options, self._path.end)
        self._searching = None  # for good, if it raises
        plan = searching.go_on(place.deadline)
        if plan is None:
            self._searching = self._from_ahead(searching, place) or searching
            return searching.nothing_yet(_GOES_ON)
        found = self._by_now(plan, searching, place)
        if isinstance(found, Plan):
            self._searched = searching.version
            return found
        self._searching = Searching(self._methods, place, options, self._path.end)
        return searching.nothing_yet(found)

    def _serves(self, searching: Searching, place: Query, options: Options) -> bool:
        """Whether a search can be gone on with: the robot must be able to come to its start."""
        if searching.options != options or not searching.is_here:
            return False
        return searching.lead is None or self._left_of(searching.lead, place) is not None

    def _left_of(self, path: Plan, place: Query) -> Plan | None:
        """The rest of a path from a place's start on, if that is on it and all of it is clear."""
        index, away = nearest_on(path.walked, place.start, place.direction)
        rest = path.rest(index)
        costs = np.empty(len(rest.path))
        if away != ON_IT or self._state.grid.walk(rest.walked, 0, costs) >= 0:
            return None
        return replace(rest, cost=float(costs[-1]), lower_bound=0.0)

    def _from_ahead(self, searching: Searching, place: Query) -> Searching | None:
        """In place of a search that takes long: one from where the robot can be soon, so that it
        may drive on meanwhile along what is clear of the standing path; None without such a place.
        """
        if not self._looks_ahead or searching.lead is not None or searching.slices > 1:
            return None
        standing = self._path.check(place.start, place.direction)
        plan = self._path.plan
        if plan is None or standing.index < 0:
            return None
        clear = len(plan.path) - 1 if standing.valid else standing.blocked - BEFORE_BLOCK
        at = min(standing.index + MOST_AHEAD, clear)
        if at <= standing.index:
            return None
        lead = plan.rest(standing.index, at + 1)
        direction = self._moves.arrival(lead.walked)
        ahead = place._replace(start=cell_of(lead.path[-1]), direction=direction)
        return Searching(self._methods, ahead, searching.options, self._path.end, lead)

    def _by_now(self, plan: Plan, searching: Searching, place: Query) -> Plan | str:
        """A plan that was searched for while the map, the robot and the goal moved, as it is by
        now; or why the search begins anew.
        """
        began = searching.query
        self._no_path = searching if plan.status is Status.NO_PATH else None
        ends = (began.start, began.direction, began.goal, str(began.wanted))
        moved = ends != (place.start, place.direction, place.goal, str(place.wanted))
        if not (moved or searching.changes.peek()):
            return plan
        if plan.ok:
            way = plan.walked
            if searching.lead is not None:
                way = np.concatenate((searching.lead.walked[:-1], way))
            moved_goal = began.goal != place.goal
            led = self._joined(way, place, plan.planner, searching.work, to_goal=moved_goal)
            return replace(led, source=plan.source) if led else _CHANGED
        if self._no_path is not None and searching.shows_no_path(place):
            return plan
        self._no_path = None
        if plan.status is problem_with(self._state.grid, place.start, place.goal):
            return plan
        self._looks_ahead = searching.lead is None
        return _CHANGED if self._looks_ahead else _NOT_FROM_AHEAD

    def _joined(
        self, way: Int32, place: Query, by: str, work: Work, *, to_goal: bool
    ) -> Plan | None:
        """A plan whose path is joined to a place, see `Joiner.join`; unless it is to be led
        `to_goal` it may end elsewhere, where it leads as near as there is a way.
        """
        grid = self._state.grid
        end = cell_of(way[-1])
        if not to_goal and end != place.goal:
            place = place._replace(goal=end, wanted=None)
        checked_before = grid.robot.stance.checks
        path = self._joiner.join(way, place)
        if path is None:
            return None
        # `Found.of` adds what the height between the ends is worth
        bound = float(octile.py_func(*place.start, *place.goal, *grid.prices))
        found = Found.of(grid, Search(Status.OK, path, 0, bound), Source.STANDING)
        return found.plan(DynamicMethod(by), work, self._state, checked_before, choice=_JOINED)

    def _join(self, place: Query, *, as_good: bool) -> Plan | None:
        """The standing path, joined to where the robot and the goal are and led around what blocks
        it; None where that is not possible soon, or with `as_good` a search may find a better one.
        """
        before = self._path.plan
        if before is None or self._state.unseen is not None:
            return None
        to_goal = not self._leads_to_goal
        plan = self._joined(before.walked, place, before.planner, Work(), to_goal=to_goal)
        if plan is None or not self._path.set_joined(plan, place, as_good=as_good):
            return None
        self._aim = (self.goal, self.goal_heading_deg)
        return plan

    @one_at_a_time
    def joined(self) -> Plan | None:
        """The standing path, led by short searches from where the robot is, around what blocks it,
        and to the goal that has moved; it is the standing one from now on. None where that is not
        possible in some milliseconds, and on ground that is known coarsely.
        """
        return self._join(self._place(Deadline.within(1e-3 * JOIN_MS)), as_good=False)

    @one_at_a_time
    def clear_part(self) -> Plan | None:
        """The standing path as far as the place ahead of the robot from which a search goes on: so
        far it may drive. None without one, and where that is not clear.
        """
        lead = None if self._searching is None else self._searching.lead
        part = None if lead is None else self._left_of(lead, self._place())
        return None if part is None or len(part.path) < 2 else part

    @checked(InvalidQueryError)
    @one_at_a_time
    def refined(self, plan: Plan) -> Plan:
        """A plan whose path can be walked on the map as it is now, such as what is left of the
        standing one, with its way points where the planner was made with `refine`, and with the
        numbers along it.
        """
        return self._freed(plan) if self._refines else plan.over(self._state)
