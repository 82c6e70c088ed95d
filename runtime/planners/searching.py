"""A search for a path that goes on from one call to the next."""

from dataclasses import replace
from typing import NamedTuple

from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan
from nnpp_edge.runtime.planners.slices import InSlices
from nnpp_edge.runtime.planners.standing_path import StandingPath
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.stopwatch import Work

_NEARER = "no path leads to the goal: as near to it as there is a way"


class Options(NamedTuple):
    """How a path is looked for."""

    method: DynamicMethod
    keep_regions: bool
    approach: bool
    """Whether the path leads as near to the goal as there is a way, where none leads to it."""

    @property
    def shows_no_path(self) -> bool:
        """Whether the last search is one to the goal, whose memory shows that there is no path."""
        return not self.approach and self.method is not DynamicMethod.DSTAR


class Finder(NamedTuple):
    """What finds a path to a goal. It is no planner: that is free once nobody uses it, though a
    search that pauses holds all that it needs.
    """

    methods: Methods
    path: StandingPath

    def plan(self, query: Query, work: Work, options: Options) -> Plan:
        """The plan of a query; with `approach` its path may end elsewhere."""
        plan = self._to_goal(query, work, options)
        if not options.approach or plan.status not in (Status.NO_PATH, Status.GOAL_BLOCKED):
            return plan
        from nnpp_edge.runtime.planners.approach import plan_towards

        standing = self.path.plan
        present = None if standing is None else tuple(standing.path[-1].tolist())

        def plan_to(query: Query) -> Plan:
            return self._to_goal(query, work, options)

        instead = plan_towards(self.methods, query, present, plan_to)
        return replace(instead, choice=_NEARER) if instead.ok else plan

    def _to_goal(self, query: Query, work: Work, options: Options) -> Plan:
        return self.methods.plan(query, work, options.method, keep_regions=options.keep_regions)


class Searching:
    """A search that goes on from one call to the next, while the map, the robot and the goal may
    move.

    `ahead` is the number on the standing path of the place where it starts; -1 where that was the
    robot's.
    """

    def __init__(self, finder: Finder, query: Query, options: Options, ahead: int = -1) -> None:
        work = Work()

        def search(slices: Deadline) -> Plan:
            return finder.plan(query._replace(deadline=slices), work, options)

        self.query = query
        """As it was when the search began; there it starts."""
        self.options = options
        self.ahead = ahead
        self.work = work
        log = finder.methods.state.log
        self.version = log.version
        """Of the map, as it was when the search began."""
        self.changes = log.reader()
        """Since then."""
        self.slices = 0
        """How many it has had."""
        self._call = InSlices(search)

    @property
    def is_here(self) -> bool:
        """Whether this thread can go on with it."""
        return self._call.is_here

    @property
    def ended(self) -> bool:
        """Whether its plan is there."""
        return self._call.ended

    def go_on(self, until: Deadline) -> Plan | None:
        """Search until then; the plan, once that is there."""
        self.work.resumes()
        plan = self._call.work(until)
        self.work.pauses()
        self.slices += 1
        return plan

    def nothing_yet(self, reason: str) -> Plan:
        """TIMEOUT, as there is no plan yet that can be driven."""
        method = self.options.method
        return Plan(
            Status.TIMEOUT,
            Method(method.entry.keeps or method),
            planner=method,
            expansions=self.work.expansions,
            reason=reason,
        )
