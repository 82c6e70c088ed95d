"""A search for a path that goes on from one call to the next."""

from dataclasses import replace
from typing import NamedTuple

from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan
from nnpp_edge.runtime.planners.query import Work
from nnpp_edge.runtime.planners.slices import InSlices
from nnpp_edge.runtime.search.astar import Query

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


def find(
    methods: Methods, query: Query, work: Work, options: Options, present: Cell | None
) -> Plan:
    """The plan of a query; with `approach` its path may end elsewhere, if possible where the
    `present` one does.
    """

    def plan_to(query: Query) -> Plan:
        ways = methods.ways(options.method, query)
        return methods.plan(query, work, options.method, ways, keep_regions=options.keep_regions)

    plan = plan_to(query)
    if not options.approach or plan.status not in (Status.NO_PATH, Status.GOAL_BLOCKED):
        return plan
    from nnpp_edge.runtime.planners.approach import plan_towards

    instead = plan_towards(methods, query, present, plan_to)
    return replace(instead, choice=_NEARER) if instead.ok else plan


class Searching:
    """A search that goes on from one call to the next, while the map, the robot and the goal may
    move. It holds no planner: that is free once nobody uses it.

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

        def search(slices: Deadline) -> Plan:
            return find(methods, query._replace(deadline=slices), work, options, present)

        self.query = query
        """As it was when the search began; there it starts."""
        self.options = options
        self.lead = lead
        self.work = work
        self.version = methods.state.log.version
        """Of the map, as it was when the search began."""
        self.changes = methods.state.log.reader()
        """Since then."""
        self.slices = 0
        """How many it has had."""
        self.call = InSlices(search)

    def go_on(self, until: Deadline) -> Plan | None:
        """Search until then; the plan, once that is there."""
        self.work.resumes()
        plan = self.call.work(until)
        self.work.pauses()
        self.slices += 1
        return plan

    def nothing_yet(self, reason: str) -> Plan:
        """TIMEOUT, as there is no plan yet that can be driven."""
        method = self.options.method
        expansions = self.work.expansions
        known = Method(method.entry.keeps or method)
        return Plan(Status.TIMEOUT, known, planner=method, expansions=expansions, reason=reason)
