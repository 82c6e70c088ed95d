"""A map of heights, whose costs and coarse levels are computed tile by tile, where a search reads
them.

A robot gets heights again and again, and a search looks at a part of the map. So nothing is
computed when heights arrive. The kernels that expand a cell look whether its tile is open, which
takes a byte; if not, they compute the tile's weights and coarse cells, and those of the tiles
around it, and go on. What is computed does not depend on when it is: a plan on a map that is
computed as a whole beforehand is the same.
"""

import copy
import functools
import itertools
import math
import mmap
from collections.abc import Sequence
from functools import partial

import numpy as np

from nnpp_edge.runtime.arrays import (
    Bool,
    Cells,
    Float2D,
    Float32s,
    close_border,
)
from nnpp_edge.runtime.bands import in_bands, stripes
from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.kernels import records
from nnpp_edge.runtime.kernels.by_address import RECORD_WORDS, address_of
from nnpp_edge.runtime.kernels.records import Packed, TileSource
from nnpp_edge.runtime.kernels.tiles import (
    COSTED,
    LINKED,
    NO_SOURCE,
    POOLED,
    SURROUNDED,
    compute_rows,
    keep_source,
    link_rows,
    open_tile,
    sample_planes,
    write_layer,
)
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.memory import mapping_of, release, virtual_zeros
from nnpp_edge.runtime.tuning import TILE_COLS, TILE_ROWS

_ROWS_OF_TILES = 4
"""That are in memory at once when a file is read through: cores get a share of them each."""
_EVERYWHERE = 62
"""Bits by which a row is shifted to the one tile of a map that is there as a whole."""
COMPLETE: Packed = tuple(
    records.TilesRecord(
        np.full((1, 1), COSTED | SURROUNDED | POOLED | LINKED, np.uint8),
        SURROUNDED,
        _EVERYWHERE,
        _EVERYWHERE,
        np.zeros(RECORD_WORDS, np.int64),
        0,
    )
)
"""Of a grid whose weights are all there."""


@functools.cache
def _address() -> int:
    return int(address_of(open_tile, COMPLETE, 0, 0))  # type: ignore[no-untyped-call]  # as all of `kernels`


def rectangle_of(area: tuple[int, int, int, int]) -> Rectangle:
    """First cell, rows and columns of a `records.Area`."""
    row0, row1, col0, col1 = area
    return row0, col0, row1 - row0, col1 - col0


class CoarseRoom:
    """Room for coarse levels of these shapes, finest first: weights, pieces and links, padded."""

    def __init__(self, shapes: list[tuple[int, int]]) -> None:
        sizes = [(rows + 2) * (cols + 2) for rows, cols in shapes]
        firsts = [0, *itertools.accumulate(sizes)]
        size = firsts[-1]
        self.weights = np.zeros(size, np.float32)
        self.pieces = np.zeros(size, np.uint16)
        self.links = np.zeros(size, np.uint8)
        self.parts = [slice(*ends) for ends in itertools.pairwise(firsts)]
        """Where each level lies in these."""
        levels = []
        for part, (rows, cols) in zip(self.parts, shapes, strict=True):
            close_border(self.weights[part], rows, cols)
            levels.append((rows, cols, cols + 2, part.start))
        self.levels = np.array(levels, np.int64)
        """As in `TileSource`."""


class Tiles:
    """Which parts of a map of heights have been computed, and what it takes to compute the others.

    `heights` (H, W) float32 in metres, not finite where unknown, are kept, and changed by `write`
    alone. Tiles consist of whole cells of the coarsest level, which are `coarsest` cells to the
    side. `source` are those fields of `TileSource` that are not made here.
    """

    def __init__(self, heights: Float2D, coarsest: int, source: dict[str, object]) -> None:
        self.heights = heights
        rows, cols = heights.shape
        high, wide = self._sides = max(TILE_ROWS, coarsest), max(TILE_COLS, coarsest)
        self.state = np.zeros((-(-rows // high), -(-cols // wide)), np.uint8)
        """(I, J) uint8, what has been computed of each tile, as bits."""
        of_heights = NO_SOURCE._replace(
            heights=heights.reshape(-1),
            rows=rows,
            cols=cols,
            row_shift=high.bit_length() - 1,
            col_shift=wide.bit_length() - 1,
            costed=np.zeros(1, np.int64),
            **source,
        )
        self._compute_by(of_heights)

    @property
    def cells_computed(self) -> int:
        """Cells whose weights there are."""
        return int(self._source.costed[0])

    @property
    def told(self) -> Float32s:
        """(H · W,) float32, costs that were told."""
        return self._source.told

    def packed(self, number: int = 0) -> Packed:
        """As kernels take them that look at the level of that number."""
        down = self._source.row_shift - 2 * number
        right = self._source.col_shift - 2 * number
        wanted = LINKED if number else SURROUNDED
        return tuple(records.TilesRecord(self.state, wanted, down, right, self._kept, _address()))

    def add_levels(self, room: CoarseRoom) -> None:
        """Have the tiles fill coarse levels, too."""
        source = self._source._replace(
            levels=room.levels, coarse=room.weights, pieces=room.pieces, links=room.links
        )
        self._compute_by(source)

    def _compute_by(self, source: TileSource) -> None:
        """Have the kernels compute by this source, which they read from memory."""
        self._source = source
        self._kept = np.empty(RECORD_WORDS, np.int64)
        keep_source(tuple(source), self._kept)

    def open_at(self, row: int, col: int) -> None:
        """See to it that the weights of a cell and of those around it are there."""
        i = row // self._sides[0]
        j = col // self._sides[1]
        if not self.state[i, j] & SURROUNDED:
            open_tile(self.packed(), i, j)

    def open_along(self, path: Cells) -> None:
        """As `open_at`, of the cells of a path (N, 2) inside the map."""
        crossed = np.zeros_like(self.state)
        crossed[tuple((path // self._sides).T)] = 1
        for cell in np.argwhere(crossed) * self._sides:
            self.open_at(*cell)

    def pool(self, deadline: Deadline = NEVER) -> None:
        """Compute the coarse levels of a map in a file, with few rows of it in memory at once: the
        weights that a search reads are computed again.

        OutOfTimeError at the deadline: then a search computes what is left where it reads it.
        """
        rows, cols = self.heights.shape
        weights = virtual_zeros((rows + 2) * (cols + 2), np.float32)
        passing = copy.copy(self)
        passing.state = np.zeros_like(self.state)
        passing._compute_by(self._source._replace(weights=weights))
        tiles = passing.packed()
        high = self._sides[0]
        linked = 0
        for first, last in stripes(rows, cols, _ROWS_OF_TILES * high):
            in_bands(partial(compute_rows, tiles), first, last, cols, high)
            # links lead into the next row of tiles
            end = last if last == rows else last - high
            in_bands(partial(link_rows, tiles), linked, end, cols, high)
            self.state[linked // high : -(-end // high)] |= POOLED | LINKED
            # the last row of these cells is looked at from the next one
            for array in (self.heights, weights):
                release(array, (end - 1) * cols)
            linked = end
            deadline.check()
        # or each tile that a search reads would bring much of its rows along
        mapping_of(self.heights).madvise(mmap.MADV_RANDOM)

    def complete(self, deadline: Deadline = NEVER) -> None:
        """Compute the rest, on all cores where that pays; at the deadline OutOfTimeError: the next
        call goes on.
        """
        tiles = self.packed()
        rows, cols = self.heights.shape
        high = self._sides[0]
        for work, done in ((compute_rows, COSTED | POOLED), (link_rows, LINKED)):
            wanted = done if len(self._source.levels) else done & COSTED
            for first, last in stripes(rows, cols, high, whole=deadline.at == math.inf):
                state = self.state[first // high : -(-last // high)]
                if (state & wanted != wanted).any():
                    in_bands(partial(work, tiles), first, last, cols, high)
                    state |= wanted
                    deadline.check()
        self.state |= SURROUNDED
        self._source.costed[0] = rows * cols

    def write(
        self,
        part: Rectangle,
        patch: Float2D,
        seen: Bool,
        *,
        into: str = "heights",
        keeps: bool = False,
    ) -> tuple[Change, Rectangle]:
        """Put heights into the map, or costs into what is ``told`` or ``added``, and bring up to
        date what has been computed.

        `patch` (h, w) float32 lies in a part of the map; `seen` (h, w) are its cells that are
        written, (0, 0) for all. Returns the change, which counts what has not been computed yet as
        changed, and the rectangle of new values, of no rows without any. With `keeps` old weights
        are kept, and computed first where there are none.
        """
        layer = getattr(self._source, into)
        rim = int(into == "heights")
        row, col, rows, cols = part
        room = (rows + 2 * rim) * (cols + 2 * rim) if keeps else 0
        nodes = np.empty(room, np.int32)
        old = np.empty(room, np.float32)
        patch = np.ascontiguousarray(patch)
        cells, cheaper, changed, noted, new = write_layer(
            self.packed(), layer, rim, patch, seen, row, col, nodes, old
        )
        within = rectangle_of(changed) if cells else (row, col, 0, 0)
        change = Change(within, cells, cheaper)
        if keeps:
            change = change._replace(nodes=nodes[:noted].copy(), old_weights=old[:noted].copy())
        return change, rectangle_of(new)

    def planes(
        self,
        window: Rectangle,
        inner: tuple[int, int],
        parts: Sequence[Rectangle],
        out: Float32s,
    ) -> None:
        """As `network.encoding.map_planes`, for parts of a window, from two rows of each network
        cell.
        """
        sample_planes(self.packed(), window, np.array(parts), inner, out)
