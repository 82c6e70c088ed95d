"""Whether two cells of a map are connected, by one pass over its rows, of which few are in memory at a time."""

from collections.abc import Iterable

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.kernels.connection import label_rows, renumber


def connected(bands: Iterable[Float2D], ends: Endpoints, *, corner_cutting: bool = True) -> bool:
    """Whether there is a path between two cells whose costs are below 1.

    `bands` are (h, w) float32 costs of the map's rows, from top to bottom, read no further than is needed. Without
    `corner_cutting` a diagonal step connects nothing that straight steps do not.
    """
    above = parents = numbers = np.empty(0, np.int32)
    found, used, row = np.zeros(2, np.int32), 1, 0
    for cost in bands:
        if not len(above):
            above = np.zeros(cost.shape[1], np.int32)
        if len(parents) < used + cost.size:
            parents = np.arange(len(above) + 4 + cost.size, dtype=np.int32)
            numbers = np.zeros(len(parents), np.int32)
        used = label_rows(cost, 1.0, corner_cutting, above, parents, used, row, ends, found)
        row += len(cost)
        used = renumber(parents, above, found, numbers)
        if found.all() and found[0] == found[1]:
            return True
        if any(label and label not in above for label in found):  # it ends above, and the other is not in it
            return False
    return False
