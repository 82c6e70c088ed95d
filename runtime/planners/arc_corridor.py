"""Plans of a body that drives arcs: in corridors, and by what earlier searches found out."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.planners.standing_path import Rest
from nnpp_edge.runtime.robots.body.kept_field import KeptField
from nnpp_edge.runtime.search.astar import Query, Search
from nnpp_edge.runtime.tuning import (
    JOIN_AHEAD,
    JOIN_BEHIND,
    JOIN_EXPANSIONS,
    MOST_ABOVE_FIELD,
    MOST_DRIFT,
    MOST_IN_VAIN,
)

SearchMap = Callable[[Query, Work, Source], Found]
"""The optimal path, by a search of the whole map; the source says why that was searched."""


class ArcCorridor:
    """Finds paths of arcs on a map; `repeated` queries lead to one goal.

    For these the costs to go that guided a search are kept. A path that costs much more than they
    promised is doubted: there may be a smoother one in a wider corridor.
    """

    def __init__(self, state: MapState, astar: AStarSearcher, repeated: bool) -> None:
        self._grid = state.grid
        self._repeated = repeated
        self._kept = KeptField(state.grid, astar.workspace, state.log)

    def find(
        self, query: Query, work: Work, corridors: Iterator[Found], search_map: SearchMap
    ) -> Found:
        """A path in one of the corridors, else on the whole map."""
        found = self._in_corridors(query, corridors)
        return found or self._on_whole_map(query, work, search_map)

    def rejoin(self, query: Query, work: Work, rest: Rest) -> Found | None:
        """A way to a place ahead on the standing path, and on along that; None where a search is
        due.

        Where no such way is found soon, the robot goes on along the path, if it is on it and all of
        it is clear.
        """
        promised = self._kept.cost_from(query)
        if promised == math.inf:
            work.expansions += self._kept.refill(query)
            promised = self._kept.cost_from(query)
        if promised == math.inf:
            return None
        ahead = rest.clear + JOIN_BEHIND if rest.clear else JOIN_AHEAD
        ahead = min(ahead, len(rest.states) - 1)
        search = work.searched(self._kept.search(query, rest.states[ahead], JOIN_EXPANSIONS))
        way = rest.states
        if search.status is Status.OK:
            way = np.concatenate((search.path, rest.states[ahead + 1 :]))
        elif not rest.valid:
            return None
        joined = Search(Status.OK, way, 0, rest.bound)
        found = Found.of(self._grid, joined, Source.STANDING, None, work)
        most = promised * max(MOST_ABOVE_FIELD, self._kept.above)
        if way is rest.states:  # what it cost too much may lie ahead as a whole
            most = max(most, promised + self._kept.extra)
        return found if found.cost <= MOST_DRIFT * most else None

    def _in_corridors(self, query: Query, corridors: Iterator[Found]) -> Found | None:
        """The first path that is good enough; None where a search of the whole map is due."""
        doubted: Found | None = None
        for found in corridors:
            if not found.suffices(query):
                if found.search.status is Status.NO_PATH and (
                    found.search.expansions > MOST_IN_VAIN * query.apart**2
                ):
                    break  # a wider corridor would take as long as the whole map
                continue
            if found.search.status is not Status.OK:
                return doubted or found
            if not doubted and _doubtful(found):
                doubted = found
                continue
            if found.region is not None:
                self._keep(query, found)
            return found if doubted is None or found.cost < doubted.cost else doubted
        return doubted

    def _on_whole_map(self, query: Query, work: Work, search_map: SearchMap) -> Found:
        """The optimal path, whose costs to go are kept."""
        found = search_map(query, work, Source.FALLBACK)
        if found.search.status is Status.OK:
            self._keep(query, found)
        return found

    def _keep(self, query: Query, found: Found) -> None:
        if self._repeated:
            self._kept.keep(query, found.region, found.search, found.cost)


def _doubtful(found: Found) -> bool:
    """Whether a path has perhaps an arc too many."""
    return found.cost > MOST_ABOVE_FIELD * found.search.promised
