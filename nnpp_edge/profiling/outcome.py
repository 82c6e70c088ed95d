"""What is said of a search in a region, by one definition wherever it is said: `train`, `quantize`,
`evaluate` and `reproduce`.

A query is *found* where the first region that is searched holds a path. The *gap* is a path's cost
above the optimum of the whole map. *MM* is the number of cells of the optimal path over those of
the region, found or not.
"""

from nnpp_edge.runtime.search.region import Region


def gap(cost: float, optimum: float) -> float:
    """By how much a cost is above the optimum, as a share of it; of its size where energy is got
    back.
    """
    return (cost - optimum) / abs(optimum) if optimum else 0.0


def of_region(region: Region, optimal_cells: int) -> dict[str, float]:
    """``mm`` of a region, for an optimal path of so many cells, and the ``share`` of the map that
    it covers.
    """
    area = region.area()
    return {"mm": optimal_cells / area, "share": area / region.cells}
