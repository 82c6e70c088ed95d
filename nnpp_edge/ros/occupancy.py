"""Costs as the occupancies of a nav_msgs/OccupancyGrid, and back: one rule for all that writes or reads such grids.

==========================  ==========  ====================
cost                        occupancy   read back as
==========================  ==========  ====================
NaN: unknown                -1          NaN
passable, at least 0, < 1   0 to 98     occupancy / 100
impassable: 1 or more, inf  100         inf
==========================  ==========  ====================

A passable cost is rounded to a hundredth, and to 0.98 at most: 99 is what costmaps write for cells that the robot's
body would touch, and is read as impassable.
"""

import numpy as np
from numpy.typing import NDArray

UNKNOWN, BODY_TOUCHES, IMPASSABLE = -1, 99, 100
_MOST_PASSABLE = 98


def as_occupancy(cost: NDArray[np.floating]) -> NDArray[np.int8]:
    """The occupancies of costs of any shape, by the rule of this module."""
    passable = np.minimum(np.rint(100.0 * cost), _MOST_PASSABLE)
    known = np.where(cost >= 1.0, float(IMPASSABLE), passable)
    return np.where(np.isnan(cost), float(UNKNOWN), known).astype(np.int8)


def as_cost(occupancy: NDArray[np.integer], occupied: int = BODY_TOUCHES) -> NDArray[np.float32]:
    """The costs of occupancies, by the rule of this module; `occupied` and more is impassable."""
    values = occupancy.astype(np.float32)
    known = np.where(values >= occupied, np.float32(np.inf), values / np.float32(100.0))
    return np.where(values < 0, np.float32(np.nan), known)
