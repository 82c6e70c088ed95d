"""What the blocks of a map of heights are worth to a vehicle, before any of its poses is checked.

A coarse search needs a price for every block. To check all poses would take longer than the search itself, so prices
are guessed from what is cheap: the choice decides how many poses are checked later, and never what path is allowed.
"""

from enum import StrEnum

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.poses import Poses
from nnpp_edge.runtime.map.pyramid import Pyramid
from nnpp_edge.runtime.map.state import MapState


class Price(StrEnum):
    """By what blocks are priced."""

    EQ1 = "eq1"
    """Eq. 1 of each cell's own 3 × 3 patch, as for a point."""
    BODY_FIT = "body-fit"
    """The plane fitted to the cells under a body, and how far the ground stands out from it."""
    SAMPLED = "sampled"
    """The poses of one cell in each block of 4 × 4, all four headings."""
    NETWORK = "network"
    """What a passage network says of the ways from block to block, see `region.looked`."""


def sampled(poses: Poses) -> Float2D:
    """(H, W) float32 costs, alike in each block of 4 × 4: the mean of the passing ones of its middle's four poses.

    Failing ones count as 1; inf where all fail. A run of poses is checked at once, so all blocks of a row of them are
    asked together.
    """
    rows, cols = poses.shape
    middles = np.minimum(np.arange(-(-rows // FACTOR)) * FACTOR + FACTOR // 2, rows - 1)
    lines = np.minimum(np.arange(-(-cols // FACTOR)) * FACTOR + FACTOR // 2, cols - 1)
    costs = poses.costs(middles)[:, :, lines]
    passing = np.isfinite(costs)
    mean = np.where(passing, costs, np.float32(1.0)).mean(0)
    blocks = np.where(passing.any(0), np.minimum(mean, np.float32(1.0 - 1e-6)), np.float32(np.inf))
    whole = np.repeat(np.repeat(blocks, FACTOR, 0), FACTOR, 1)[:rows, :cols]
    return np.ascontiguousarray(whole, np.float32)


class PricedMap:
    """A map for a coarse-to-fine search whose coarse levels are made of another price than the map's own weights.

    Parameters
    ----------
    state : MapState
        Of heights, with a vehicle.
    price : Price
        Neither ``eq1``, which the state's own coarse levels are made of, nor ``network``, which has links in place of
        levels.
    """

    def __init__(self, state: MapState, price: Price) -> None:
        self._state, self._price = state, price
        self._changes = state.log.reader()
        self._priced, self._pyramid = self._made()

    @property
    def grid(self) -> Grid:
        """The map itself."""
        return self._state.grid

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self._state.shape

    def pyramid_by(self, deadline: Deadline) -> Pyramid:
        """As of `MapState`, but that prices are guessed in one go."""
        deadline.check()
        return self.pyramid

    @property
    def pyramid(self) -> Pyramid:
        """The coarse levels, as the map is now."""
        if self._changes.behind:
            self._changes.skip()
            cost, before = self._costs(), self._priced.map()
            weights = np.full_like(cost, np.inf)
            np.multiply(cost, np.float32(self._priced.model.scale), out=weights, where=cost < 1.0)
            rows, cols = np.nonzero(weights != before)
            if rows.size:
                part = cost[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
                change = self._priced.update(part, (int(rows.min()), int(cols.min())))
                self._pyramid.update(change.part)
        return self._pyramid

    def _made(self) -> tuple[Grid, Pyramid]:
        grid = Grid.of(self._costs(), self._state.grid.model, self._state.grid.corner_cutting)
        return grid, Pyramid(grid)

    def _costs(self) -> Float2D:
        poses, tiles = self._state.grid.poses, self._state.grid.tiles
        assert poses is not None and tiles is not None
        if self._price is Price.SAMPLED:
            return sampled(poses)
        from nnpp_edge.runtime.map.body_fit import body_fit  # OpenCV takes a tenth of a second to load

        return body_fit(tiles.heights, poses.vehicle, poses.sides_m)
