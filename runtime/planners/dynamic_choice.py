"""How ``auto`` plans on a map that changes: by what is the fastest from where the robot is."""

from nnpp_edge.runtime.cells import apart
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.map_planners import MapPlanners
from nnpp_edge.runtime.planners.plan import DynamicMethod, Source
from nnpp_edge.runtime.planners.query import Found, Query, Work
from nnpp_edge.runtime.planners.standing_path import StandingPath
from nnpp_edge.runtime.tuning import MEND_FROM, MEND_SHARE, MEND_WITHIN, MOST_DRIFT, NEAR


class DynamicChooser:
    """Picks a method for each query of a `DynamicPlanner`. Serves one thread at a time.

    Parameters
    ----------
    state : MapState
        The map.
    planners : MapPlanners
        What it picks from.
    path : StandingPath
        The path of the last answer.
    """

    def __init__(self, state: MapState, planners: MapPlanners, path: StandingPath) -> None:
        self._state, self._planners, self._path = state, planners, path
        self._changes = state.log.reader()
        """Since the last answer with a path."""
        self._drift = 1.0
        """What mended paths may cost, in times of what a new corridor's would."""

    def answered(self) -> None:
        """The path that was found stands from now on."""
        self._changes.skip()

    def find(self, query: Query, work: Work) -> tuple[Found, DynamicMethod, str]:
        """A path, the method that it was found by, and why that one. OutOfTimeError at the deadline."""
        if query.apart < NEAR and (found := self._planners.exact.find_briefly(query, work)) is not None:
            return found, DynamicMethod.ASTAR, f"the goal is less than {NEAR} cells away"
        if why_afresh := self._against_mending(query):
            self._drift = 1.0
            return self._planners.corridor.find(query, work), DynamicMethod.CORRIDOR, why_afresh
        reason = "little of the map has changed, and near the start"
        if self._planners.mender.knows_region(query.goal):
            drift, found = self._drift, self._mended(query, work)
            floor = self._path.check(query.start).floor
            if found.search.status is Status.OK and floor > 0.0:
                drift *= max(found.cost / floor, 1.0)
                if drift <= MOST_DRIFT:
                    self._drift = drift
                    return found, DynamicMethod.CORRIDOR_DSTAR, reason
            reason = "the path in the standing corridor costs too much by now"
        self._drift = 1.0
        return self._planners.corridor_mended.find(query, work), DynamicMethod.CORRIDOR_DSTAR, reason

    def _mended(self, query: Query, work: Work) -> Found:
        """The best path in the region that D* Lite knows."""
        search = self._planners.mender.search(query, work, None)
        return Found.of(self._state.grid, search, Source.REGION, None, work)

    def _against_mending(self, query: Query) -> str:
        """Why a search afresh is expected to be faster than repairing the last one; empty where it is not."""
        changes, reach = self._changes.peek(), MEND_WITHIN * query.apart
        if self._path.plan is None:
            return "there is no earlier search to repair"
        if query.apart < MEND_FROM:
            return f"the goal is less than {MEND_FROM} cells away"
        if sum(change.cells for change in changes) > MEND_SHARE * self._state.grid.cells:
            return "too much of the map has changed to repair the search"
        if any(apart(change.part, query.start) + max(change.part[2:]) > reach for change in changes):
            return "the map has changed too far from the start to repair the search"
        return ""
