"""A search for a path that is worked at in slices of time, with pauses between them in which the
map may change.

It stops where a slice ends, in the middle of what it does, and goes on there in the next one. So no
code on the way has to know of it. What it finds on a map that changes meanwhile is to be checked on
the newest.
"""

import math
import sys
import threading
from dataclasses import replace
from typing import NamedTuple, cast

from greenlet import getcurrent, greenlet

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.stopwatch import Work

_NEARER = "no path leads to the goal: as near to it as there is a way"


class Options(NamedTuple):
    """How a path is looked for."""

    method: DynamicMethod
    approach: bool
    """Whether the path leads as near to the goal as there is a way, where none leads to it."""

    @property
    def shows_no_path(self) -> bool:
        """Whether the last search is one to the goal, whose memory shows that there is no path."""
        return not self.approach and self.method is not DynamicMethod.DSTAR


def find(
    methods: Methods, query: Query, work: Work, options: Options, present: Cell | None
) -> Plan:
    """The plan of a query; with `approach` its path may end elsewhere, if possible where the
    `present` one does.
    """

    def plan_to(query: Query) -> Plan:
        return methods.plan(query, work, options.method)

    plan = plan_to(query)
    if not options.approach or plan.status not in (Status.NO_PATH, Status.GOAL_BLOCKED):
        return plan
    from nnpp_edge.runtime.planners.approach import plan_towards

    instead = plan_towards(methods, query, present, plan_to)
    return replace(instead, choice=_NEARER) if instead.ok else plan


class _Slices(Deadline):
    """The deadline of a search in slices: it never passes, but the search pauses by it."""

    slice = NEVER

    def begin(self, slice: Deadline) -> None:
        """Work until then."""
        self.slice = slice
        self.until = slice.at

    def goes_on(self) -> bool:
        """True, after a pause if the slice is over."""
        if self.slice.passed:
            parent = getcurrent().parent
            assert parent is not None
            parent.switch(None)
        return True


class Searching:
    """A search that goes on from one call to the next, in one thread alone, while the map, the
    robot and the goal may move.

    Where it is dropped before it has ended, it lets go of all that it holds, once what it had to
    tidy up is done. It holds no planner: that is free once nobody uses it.

    `present` as for `find`. `lead` is the part of the standing path to the place where the search
    starts; None where that is the robot's.
    """

    def __init__(
        self,
        methods: Methods,
        query: Query,
        options: Options,
        present: Cell | None,
        lead: Plan | None = None,
    ) -> None:
        work = Work()
        log = methods.state.log

        def search(slices: Deadline) -> Plan:
            return find(methods, query._replace(deadline=slices), work, options, present)

        self.query = query
        """As it was when the search began; there it starts."""
        self.options = options
        self.lead = lead
        self.work = work
        self.version = log.version
        """Of the map, as it was when the search began."""
        self.changes = log.reader()
        """Since then."""
        self.slices = 0
        """How many it has had."""
        self.plan: Plan | None = None
        """What it found, once it has ended."""
        self._methods = methods
        self._slices = _Slices()
        self._search = greenlet(search)
        self._thread = threading.get_ident()

    @property
    def is_here(self) -> bool:
        """Whether this thread began it: no other can go on with it."""
        return self._thread == threading.get_ident()

    def go_on(self, until: Deadline) -> Plan | None:
        """Search until then; the plan, once that is there."""
        if self.plan is None:
            self._slices.begin(until)
            self._search.parent = getcurrent()
            self.work.resumes()
            self.plan = cast(Plan | None, self._search.switch(self._slices))
            self.work.pauses()
            self.slices += 1
            self._memory = self._methods.exhausted
            self._stamp = self._memory.stamp
        return self.plan

    def shows_no_path(self, place: Query) -> bool:
        """Whether it is certain that a place has no path on the map as it is now, by a search that
        found none for its own; once False, for good.

        That knows all places to which ways from one end lead. Where the map changes, ways that lead
        on from there can only have opened where it did: so these places are searched, and not all.
        Another search in its memory ends what is known.
        """
        grid = self._methods.state.grid
        memory = self._memory
        same_goal = (place.goal, str(place.wanted)) == (self.query.goal, str(self.query.wanted))
        if not (same_goal and self.options.shows_no_path and memory.stamp == self._stamp):
            return False
        # it came to all places that can be reached from the start, or else from the goal
        inside = self._cost_of(place.start) == math.inf
        if self._cost_of(self.query.start) == 0.0:
            inside = memory.came_to(grid.node(*place.start), place.direction)
        return inside and not any(
            change.cheaper and grid.robot.moves.may_open(grid, place, memory, change.part)
            for change in self.changes.read()
        )

    def _cost_of(self, cell: Cell) -> float:
        """As the search has it, which has ended."""
        node = self._methods.state.grid.node(*cell)
        return float(self._memory.costs(slice(node, node + 1))[0])

    def __del__(self) -> None:
        # where the process ends nothing needs to be tidied up
        if self.is_here and not (sys.is_finalizing() or self._search.dead):
            self._search.parent = getcurrent()  # perhaps another search
            self._search.throw()

    def nothing_yet(self, reason: str) -> Plan:
        """TIMEOUT, as there is no plan yet that can be driven."""
        method = self.options.method
        known = Method(method.entry.keeps or method)
        return Plan(
            Status.TIMEOUT,
            known,
            planner=method,
            expansions=self.work.expansions,
            reason=reason,
        )
