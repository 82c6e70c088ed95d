"""What is said of an answer to a query, by one definition and one function wherever it is said:
`train`, `quantize`, `evaluate` and `reproduce`.
"""

import math

from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.search.region import Region


def outcome(
    cost: float,
    optimum: float,
    optimal_cells: int = 0,
    region: Region | None = None,
    source: Source | None = Source.REGION,
) -> dict[str, float]:
    """Figures of a path of this `cost` (inf without one) beside the optimum of the whole map.

    ``found`` is 1 where the first region that is searched holds a path, else 0: `source` is where
    the path was found. ``gap`` is the path's cost above the optimum, as a share of it. Of a region
    ``mm`` is the number of cells of the optimal path over those of the region, whether a path was
    found or not, and ``share`` that of the map which the region covers.
    """
    path = cost < math.inf
    of = {"found": float(path and source in (Source.MAP, Source.REGION))}
    if path:
        of["gap"] = gap(cost, optimum)
    if region is not None:
        area = region.area()
        of |= {"mm": optimal_cells / area, "share": region.mask().mean()}
    return of


def gap(cost: float, optimum: float) -> float:
    """By how much a cost is above the optimum, as a share of it; of its size where energy is got
    back.
    """
    return (cost - optimum) / abs(optimum) if optimum else 0.0
