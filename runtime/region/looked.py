"""What a passage network says of a map: the prices of links between its blocks, looked up once and kept.

The network sees blocks of 4 × 4 cells. It says of each link to a neighbouring block with what chance there is a way,
and how dear that is. A link's price is what the way is expected to cost, more where there may be none.
"""

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.passage import shown_blocks
from nnpp_edge.runtime.network.passage_model import PassageModel

_REACH = 3
"""Blocks from one to the farthest that the network's answer on it depends on."""
_LENGTHS = np.array((1.0, 2.0**0.5, 1.0, 2.0**0.5), np.float32)[:, None, None] * np.float32(FACTOR)
NO_WAY, DOUBT = 400.0, 10
"""What a link costs more where there is certainly no way, in lengths of cells; and to what power the chance of that
is taken first. Where it is in doubt the check is to say: to miss a way is dearer than to look for one in vain."""


class LookedMap:
    """A map of heights, with a vehicle, as a passage network sees it. Serves one thread at a time."""

    def __init__(self, state: MapState, model: PassageModel) -> None:
        poses = state.grid.poses
        assert poses is not None
        self._state, self._network = state, model.of(poses.vehicle, poses.sides_m)
        self.grid: Grid = state.grid
        self.shape = state.shape
        self._changes = state.log.reader()
        rows, cols = (-(-n // FACTOR) for n in state.shape)
        self.answers = np.empty((16, rows, cols), np.float32)
        """Logits, see `model.passage`."""
        self._prices = np.empty((4, rows, cols), np.float32)
        self._look((0, 0, rows, cols))

    @property
    def prices(self) -> NDArray[np.float32]:
        """(4, R, C) float32 of the links, see `kernels.links`, of the map as it is now."""
        for change in self._changes.read() if self._changes.behind else ():
            row, col, rows, cols = change.part
            row0, col0 = (max(n // FACTOR - _REACH - 1, 0) for n in (row, col))
            row1 = min(-(-(row + rows) // FACTOR) + _REACH + 1, self._prices.shape[1])
            col1 = min(-(-(col + cols) // FACTOR) + _REACH + 1, self._prices.shape[2])
            self._look((row0, col0, row1 - row0, col1 - col0))
        return self._prices

    def _look(self, part: Rectangle) -> None:
        """Have the network answer for a rectangle of blocks: it is shown those within its reach, too."""
        row, col, rows, cols = part
        poses, tiles = self.grid.poses, self.grid.tiles
        assert poses is not None and tiles is not None
        most = self._prices.shape[1:]
        begin = max(row - _REACH, -1), max(col - _REACH, -1)
        end = min(row + rows + _REACH, most[0] + 1), min(col + cols + _REACH, most[1] + 1)
        shape = end[0] - begin[0], end[1] - begin[1]
        shown = shown_blocks(tiles.heights, poses.sides_m, poses.vehicle, begin, shape)
        found = self._network.answers(shown)
        inside = slice(row - begin[0], row - begin[0] + rows), slice(col - begin[1], col - begin[1] + cols)
        own = slice(row, row + rows), slice(col, col + cols)
        self.answers[:, *own] = found[:, *inside]
        self._prices[:, *own] = link_prices(self.answers[:, *own], self._state.grid.model.scale)


def link_prices(answers: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    """(4, R, C) prices of links by the network's (16, R, C) answers; `scale` is the weight of T = 1."""
    chance, dear = (np.float32(1.0) / (np.float32(1.0) + np.exp(-answers[at : at + 4])) for at in (8, 12))
    fine = np.float32(NO_WAY) * (np.float32(1.0) - chance) ** DOUBT
    prices: NDArray[np.float32] = _LENGTHS * (np.float32(1.0) + np.float32(4.0 * scale) * dear) + fine
    return prices
