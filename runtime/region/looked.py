"""What a passage network says of a map: the prices of links between its blocks, asked for where needed, and kept.

The network sees blocks of 4 × 4 cells. It says of each link to a neighbouring block with what chance there is a way,
and how dear that is. A link's price is what the way is expected to cost, more where there may be none.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.bands import in_bands
from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.kernels.links import price_links
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.network.passage import shown_blocks
from nnpp_edge.runtime.network.passage_model import ANSWER_MIDDLE, ANSWER_STEPS, PassageModel
from nnpp_edge.runtime.region.links import Links
from nnpp_edge.runtime.tuning import LOOK_THREADS_FROM

NOT_LOOKED_AT = 1e5
"""Price of a link of which the network has not been asked."""
_TILE = 16
"""Blocks to the side of a tile."""
_LOOKED_AT_ONCE = 4 * _TILE**2
"""Blocks that the network answers for between two looks at the clock."""
_FILLED_AT_ONCE = 2**15
"""Blocks whose links get a price between two looks at the clock."""
_REACH = 3
"""Blocks from one to the farthest that the network's answer on it depends on."""
_LENGTHS = np.array((1.0, 2.0**0.5, 1.0, 2.0**0.5), np.float32) * np.float32(FACTOR)
NO_WAY, DOUBT = 400.0, 10
"""What a link costs more where there is certainly no way, in lengths of cells; and to what power the chance of that
is taken first. Where it is in doubt the check is to say: to miss a way is dearer than to look for one in vain."""


class LookedMap:
    """A map of heights, with a vehicle, as a passage network sees it. Serves one thread at a time.

    The network looks at tiles of the map as they are needed. Links of others have a price that no path would pay.
    """

    def __init__(self, state: MapState, model: PassageModel) -> None:
        poses = state.grid.poses
        assert poses is not None
        self._network = model.of(poses.vehicle, poses.sides_m)
        self.grid: Grid = state.grid
        self.shape = state.shape
        self._changes = state.log.reader()
        rows, cols = self._blocks = -(-state.shape[0] // FACTOR), -(-state.shape[1] // FACTOR)
        self._links = Links.room_for(state.shape)
        self._filled = 0
        """Rows of blocks, with the border's, whose links have a price."""
        self._changed: list[Rectangle] = []
        """Rectangles of blocks to be looked at anew."""
        self.least = NOT_LOOKED_AT
        """No link that was looked at costs less for a cell's length."""
        self.looks = 0
        """How often the network has been asked: prices are the same as long as this is."""
        self._looked_at = np.zeros((-(-rows // _TILE), -(-cols // _TILE)), np.bool_)

    @property
    def links(self) -> Links:
        """All links of the map as it is now."""
        return self.links_within((0, 0, *self.shape))

    def links_within(self, part: Rectangle, deadline: Deadline = NEVER) -> Links:
        """The same, but that links outside a rectangle of cells may not have been looked at.

        At the deadline OutOfTimeError: the next call goes on from there.
        """
        while self._filled < self._blocks[0] + 2:
            deadline.check()
            last = self._filled + max(_FILLED_AT_ONCE // self._links.stride, 1)
            self._links.fill(NOT_LOOKED_AT, self._filled, last)
            self._filled = last
        for change in self._changes.read() if self._changes.behind else ():
            row, col, rows, cols = change.part
            row0, col0 = (max(n // FACTOR - _REACH - 1, 0) for n in (row, col))
            row1 = min(-(-(row + rows) // FACTOR) + _REACH + 1, self._blocks[0])
            col1 = min(-(-(col + cols) // FACTOR) + _REACH + 1, self._blocks[1])
            self._changed.append((row0, col0, row1 - row0, col1 - col0))
        most = self._blocks[0] * self._blocks[1] if deadline.at == math.inf else _LOOKED_AT_ONCE
        while self._changed:
            deadline.check()
            row, col, rows, cols = self._changed[-1]
            tall = min(rows, max(most // cols, 1))
            self._look((row, col, tall, cols))
            self._changed[-1:] = [(row + tall, col, rows - tall, cols)] if tall < rows else []
        row, col, rows, cols = part
        side = FACTOR * _TILE
        tiles = slice(row // side, -(-(row + rows) // side)), slice(col // side, -(-(col + cols) // side))
        looked_at = self._looked_at[tiles]
        while not looked_at.all():
            deadline.check()
            i, j, down, right = _first_rectangle(~looked_at)
            right = min(right, max(most // _TILE**2, 1))
            down = min(down, max(most // (_TILE**2 * right), 1))
            self._look_at_tiles(tiles[0].start + i, tiles[1].start + j, down, right)
            looked_at[i : i + down, j : j + right] = True
        return self._links

    def _look_at_tiles(self, row: int, col: int, rows: int, cols: int) -> None:
        row, col, rows, cols = _TILE * row, _TILE * col, _TILE * rows, _TILE * cols
        most = self._blocks
        self._look((row, col, min(rows, most[0] - row), min(cols, most[1] - col)))

    def _look(self, part: Rectangle) -> None:
        """Have the network answer for a rectangle of blocks."""
        row, col, rows, cols = part
        found: list[float] = []

        def look(begin: int, end: int) -> None:
            first, last = begin // FACTOR, -(-end // FACTOR)
            found.append(self._look_at_rows((row + first, col, last - first, cols)))

        in_bands(look, FACTOR * rows, FACTOR * cols, FACTOR, LOOK_THREADS_FROM)
        self.least = min(self.least, *found)
        self.looks += 1

    def _look_at_rows(self, part: Rectangle) -> float:
        """The same in one go: the network is shown those within its reach, too. The least price of a length."""
        row, col, rows, cols = part
        poses, tiles, most = self.grid.poses, self.grid.tiles, self._blocks
        assert poses is not None and tiles is not None
        begin = max(row - _REACH, -1), max(col - _REACH, -1)
        end = min(row + rows + _REACH, most[0] + 1), min(col + cols + _REACH, most[1] + 1)
        shape = end[0] - begin[0], end[1] - begin[1]
        shown = shown_blocks(tiles.heights, poses.sides_m, poses.vehicle, begin, shape)
        tables = _tables(self.grid.model.scale)
        return float(price_links(self._network.answers(shown), begin, part, tables, _LENGTHS, self._links))


def _first_rectangle(wanted: NDArray[np.bool_]) -> Rectangle:
    """The first cell that is wanted, as many to its right, and as many rows below: all wanted."""
    row, col = np.argwhere(wanted)[0].tolist()
    right = int(np.logical_and.accumulate(wanted[row, col:]).sum())
    down = int(np.logical_and.accumulate(wanted[row:, col : col + right].all(1)).sum())
    return row, col, down, right


@functools.cache
def _tables(scale: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What `price_links` reads prices from; `scale` is the weight of T = 1."""
    logits = (np.arange(256) - ANSWER_MIDDLE) / ANSWER_STEPS
    likely = 1.0 / (1.0 + np.exp(-logits))
    dear, fine = 1.0 + 4.0 * scale * likely, NO_WAY * (1.0 - likely) ** DOUBT
    return dear.astype(np.float32), fine.astype(np.float32)
