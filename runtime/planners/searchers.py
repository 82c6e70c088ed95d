"""Searches of the map at full resolution: what the planners are given to look for a path with."""

from typing import TYPE_CHECKING, Protocol

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.expansion import MOST_LANDMARKS
from nnpp_edge.runtime.map.changes import ChangeReader
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.tuning import MOST_RATIO_FOR_LANDMARKS

if TYPE_CHECKING:
    from nnpp_edge.runtime.search.landmarks import Landmarks


class Searcher(Protocol):
    """Searches a region of the map at full resolution."""

    def search(self, query: Query, work: Work, region: Region) -> Search:
        """Look for a path inside the region; expansions and time are added to `work`."""


class AStarSearcher:
    """A* afresh for each query, over the whole map or a region. Serves one thread at a time."""

    def __init__(self, state: MapState) -> None:
        self.grid = grid = state.grid
        self.workspace = Workspace(len(grid.weights), grid.robot.moves.states_a_node)
        self._log = state.log
        self._landmarks: Landmarks | None = None
        self._changes: ChangeReader | None = None
        """Since landmarks were set: without any, nothing has to be kept for it."""

    def search(
        self, query: Query, work: Work, region: Region | None, limit: int | None = None
    ) -> Search:
        """As `Searcher`; without a region the whole map, and after `limit` expansions it gives up
        with TIMEOUT.
        """
        hints = self.landmarks.towards(query.goal) if self.landmarks else None
        robot = self.grid.robot
        found = robot.moves.search(self.grid, query, self.workspace, region, hints, limit)
        work.stage_ends("search", found.expansions)
        return found

    @property
    def landmarks(self) -> "Landmarks | None":
        """From `prepare`; None before, after a cell has become cheaper, and where weights lie far
        apart.
        """
        if self._changes is None:
            return None
        if any(change.cheaper for change in self._changes.read()):
            self._landmarks = self._changes = None
        return self._landmarks if self.grid.step_ratio <= MOST_RATIO_FOR_LANDMARKS else None

    def prepare(self, landmarks: int) -> None:
        """Set so many landmarks, spread over the map; errors as of `Planner.prepare`."""
        if landmarks and not self.grid.robot.by_weights:
            raise InvalidQueryError(
                "landmarks need steps that cost alike both ways, without turns: wanted "
                "step_cost='paper' and no body"
            )
        if not 0 <= landmarks <= MOST_LANDMARKS:
            raise InvalidQueryError(f"landmarks must be at most {MOST_LANDMARKS}, got {landmarks}")
        from nnpp_edge.runtime.search.landmarks import Landmarks

        self._changes = self._log.reader()
        self._landmarks = Landmarks(self.grid, self.workspace, landmarks)
