"""What it costs a vehicle to get from block to block of a map all of whose poses have been checked."""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.kernels.crossing import connected_parts, crossing_costs, middles_of_blocks
from nnpp_edge.runtime.kernels.pooling import FACTOR


def costs_of_crossing(costs: NDArray[np.float32], weight: float) -> NDArray[np.float32]:
    """Cost from the middle of each block of 4 × 4 cells to the next one's, over a straight way's length.

    Parameters
    ----------
    costs : (4, H, W) float32
        T of all poses, inf where one fails, as `map.poses.pose_costs` gives them; H and W multiples of 4.
    weight : float
        Of T = 1.

    Returns
    -------
    (4, H / 4, W / 4) float32
        By the heading along which the block is left; inf where there is no way.
    """
    shape = costs.shape[1:]
    parts, queue, sizes = (np.zeros(n, np.int32) for n in (shape, shape[0] * shape[1], shape[0] * shape[1]))
    connected_parts(costs, parts, queue, sizes)
    middles = np.empty((shape[0] // FACTOR, shape[1] // FACTOR, 2), np.int32)
    middles_of_blocks(parts, sizes, middles)
    crossing = np.empty((4, *middles.shape[:2]), np.float32)
    crossing_costs(costs, np.float32(weight), middles, np.empty((12, 12), np.float32), crossing)
    return crossing
