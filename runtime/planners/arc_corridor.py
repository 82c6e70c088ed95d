"""Plans of a body that drives arcs, in corridors."""

from collections.abc import Callable, Iterator

from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.planners.query import Found, Work
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.tuning import MOST_ABOVE_FIELD, MOST_IN_VAIN

SearchMap = Callable[[Query, Work, Source], Found]
"""The optimal path, by a search of the whole map; the source says why that was searched."""


def in_corridors(
    query: Query, work: Work, corridors: Iterator[Found], search_map: SearchMap
) -> Found:
    """A path in one of the corridors, else on the whole map.

    A path that costs much more than its field promised is doubted: there may be a smoother one in a
    wider corridor.
    """
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
        return found if doubted is None or found.cost < doubted.cost else doubted
    return doubted or search_map(query, work, Source.FALLBACK)


def _doubtful(found: Found) -> bool:
    """Whether a path has perhaps an arc too many."""
    return found.cost > MOST_ABOVE_FIELD * found.search.promised
