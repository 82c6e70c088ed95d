"""How ``auto`` plans on a map that changes: by what is the fastest from where the robot is."""

from nnpp_edge.runtime.cells import apart
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.planners.methods import Methods
from nnpp_edge.runtime.planners.plan import DynamicMethod, Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.standing_path import StandingPath
from nnpp_edge.runtime.tuning import MEND_FROM, MEND_SHARE, MEND_WITHIN, MOST_DRIFT, NEAR


class DynamicChooser:
    """Picks one of the methods for each query, by what has changed since the path that stands was found."""

    def __init__(self, methods: Methods, path: StandingPath) -> None:
        self._methods, self._path = methods, path
        self._changes = methods.state.log.reader()
        """Since the last answer with a path."""
        self._drift = 1.0
        """The most that mended paths cost, in times of what a new corridor's would."""

    def answered(self) -> None:
        """The path that was found stands from now on."""
        self._changes.skip()

    def find(self, query: Query, work: Work) -> tuple[Found, DynamicMethod, str]:
        """A path, the method that it was found by, and why that one. OutOfTimeError at the deadline."""
        methods = self._methods
        if query.apart < NEAR and (near := methods.search_briefly(query, work)) is not None:
            return near, DynamicMethod.ASTAR, f"the goal is less than {NEAR} cells away"
        if why_afresh := self._against_mending(query):
            self._drift = 1.0
            return methods.corridor(query, work), DynamicMethod.CORRIDOR, why_afresh
        reason = "little of the map has changed, and near the start"
        if methods.mender.knows_region(query.goal):
            search = methods.mender.search(query, work, None)
            found = Found.of(methods.state.grid, search, Source.REGION, None, work)
            floor = self._path.check(query.start).floor
            if search.status is Status.OK and floor > 0.0:
                drift = self._drift * max(found.cost / floor, 1.0)
                if drift <= MOST_DRIFT:
                    self._drift = drift
                    return found, DynamicMethod.CORRIDOR_DSTAR, reason
            reason = "the path in the standing corridor costs too much by now"
        self._drift = 1.0
        return methods.corridor(query, work, methods.always_mending), DynamicMethod.CORRIDOR_DSTAR, reason

    def _against_mending(self, query: Query) -> str:
        """Why a search afresh is expected to be faster than repairing the last one; empty where it is not."""
        changes, reach = self._changes.peek(), MEND_WITHIN * query.apart
        if self._path.plan is None:
            return "there is no earlier search to repair"
        if query.apart < MEND_FROM:
            return f"the goal is less than {MEND_FROM} cells away"
        if sum(change.cells for change in changes) > MEND_SHARE * self._methods.state.grid.cells:
            return "too much of the map has changed to repair the search"
        if any(apart(change.part, query.start) + max(change.part[2:]) > reach for change in changes):
            return "the map has changed too far from the start to repair the search"
        return ""
