"""A map of heights, whose costs and coarse levels are computed tile by tile, where a search reads
them.

A robot gets heights again and again, and a search looks at a part of the map. So nothing is
computed when heights arrive. The kernels that expand a cell look whether its tile is open, which
takes a byte; if not, they compute the tile's weights and coarse cells, and those of the tiles
around it, and go on. What is computed does not depend on when it is: a plan on a map that is
computed as a whole beforehand is the same.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, close_border
from nnpp_edge.runtime.bands import in_bands, stripes
from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.kernels.by_address import address_of
from nnpp_edge.runtime.kernels.tiles import (
    ANY_TOLD,
    BLOCK_COLS,
    BLOCK_SIDE,
    CELLS_COSTED,
    COSTED,
    COUNT_SLOTS,
    FOUND_SLOTS,
    LINKED,
    POOLED,
    SURROUNDED,
    compute_rows,
    link_rows,
    open_along,
    open_tile,
    sample_planes,
    write_layer,
)
from nnpp_edge.runtime.kernels.traversability import RULE_SLOTS
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.memory import virtual_zeros
from nnpp_edge.runtime.tuning import TILE_COLS, TILE_ROWS

PackedTiles = tuple[NDArray[np.uint8], int, int, int, tuple[object, ...], int]
"""Tiles as the kernels take them, see `kernels.tiles`: (state, wanted, row_shift, col_shift,
source, address).
"""
_EVERYWHERE = 62
"""Bits by which a row is shifted to the one tile of a map that is there as a whole."""
_NONE = np.empty(0, np.float32)
_NO_LEVELS = _NONE, np.empty(0, np.uint16), np.empty(0, np.uint8)
_COUNTS = np.zeros((1, 4), np.int64), np.zeros(COUNT_SLOTS, np.int64), np.zeros(2, np.int64)
COMPLETE: PackedTiles = (
    np.full((1, 1), COSTED | SURROUNDED | POOLED | LINKED, np.uint8),
    SURROUNDED,
    _EVERYWHERE,
    _EVERYWHERE,
    (_NONE, np.zeros(RULE_SLOTS), _NONE, _COUNTS[0], *_NO_LEVELS, *_COUNTS[1:], _NONE, _NONE),
    0,
)
"""Of a grid whose weights are all there."""


@functools.cache
def _address() -> int:
    return int(address_of(open_tile, COMPLETE, 0, 0))  # type: ignore[no-untyped-call]  # as all of `kernels`


class Tiles:
    """Which parts of a map of heights have been computed, and what it takes to compute the others.

    `heights` (H, W) float32 in metres, not finite where unknown, are kept, and changed by `write`
    alone; `rule` as for `fill_weights`; `weights` and `corner_cutting` are those of the map's grid.
    Tiles consist of whole cells of the coarsest level, which are `coarsest` cells to the side.
    `told` as from `tell_from_now_on`, if anything was told before. `unseen` (2, I, J) float32 are
    the prices of blocks, and what is known of their heights, see `kernels.tiles.UNTOUCHED`, on a
    map of which blocks are known.
    """

    def __init__(
        self,
        heights: Float2D,
        rule: NDArray[np.float64],
        weights: NDArray[np.float32],
        corner_cutting: bool,
        coarsest: int,
        told: Float2D | None = None,
        unseen: NDArray[np.float32] | None = None,
    ) -> None:
        self.heights = heights
        self.rule = rule
        self._weights = weights
        self.told = _NONE
        """(H · W,) float32, costs that were told; empty where none ever was."""
        self.shape: tuple[int, int] = heights.shape
        high, wide = self._sides = max(TILE_ROWS, coarsest), max(TILE_COLS, coarsest)
        self.state = np.zeros((-(-self.shape[0] // high), -(-self.shape[1] // wide)), np.uint8)
        """(I, J) uint8, what has been computed of each tile, as bits."""
        self._levels = np.array(
            [(high.bit_length() - 1, wide.bit_length() - 1, corner_cutting, 0)], np.int64
        )
        self._coarse = _NO_LEVELS
        self._counts = np.zeros(COUNT_SLOTS, np.int64)
        self._unseen = _NONE
        if unseen is not None:
            self._unseen = unseen.reshape(-1)
            blocks = unseen.shape[2]
            self._counts[BLOCK_SIDE : BLOCK_COLS + 1] = self.shape[1] // blocks, blocks
        if told is not None:
            self.told = told.reshape(-1)
            self._counts[ANY_TOLD] = 1

    @property
    def cells_computed(self) -> int:
        """Cells whose weights there are."""
        return int(self._counts[CELLS_COSTED])

    def packed(self, number: int = 0) -> PackedTiles:
        """As kernels take them that look at the level of that number."""
        down, right = (side.bit_length() - 1 - 2 * number for side in self._sides)
        of_map = (self.heights.reshape(-1), self.rule, self._weights)
        counts = (self._counts, np.array(self.shape))
        source = *of_map, self._levels, *self._coarse, *counts, self.told, self._unseen
        return self.state, LINKED if number else SURROUNDED, down, right, source, _address()

    def add_levels(
        self, shapes: list[tuple[int, int]]
    ) -> list[tuple[NDArray[np.float32], NDArray[np.uint16], NDArray[np.uint8]]]:
        """Make room for coarse levels of these shapes, finest first: weights, pieces and links of
        each, padded.
        """
        sizes = [(rows + 2) * (cols + 2) for rows, cols in shapes]
        firsts = [0, *itertools.accumulate(sizes)]
        rows_of = [
            (rows, cols, cols + 2, first)
            for (rows, cols), first in zip(shapes, firsts, strict=False)
        ]
        self._levels = np.array([(*self._levels[0, :3], len(shapes)), *rows_of], np.int64)
        size = firsts[-1]
        weights = np.zeros(size, np.float32)
        pieces = np.zeros(size, np.uint16)
        links = np.zeros(size, np.uint8)
        self._coarse = weights, pieces, links
        parts = [slice(first, first + size) for first, size in zip(firsts, sizes, strict=False)]
        for part, (rows, cols) in zip(parts, shapes, strict=True):
            close_border(weights[part], rows, cols)
        return [(weights[part], pieces[part], links[part]) for part in parts]

    def open_at(self, row: int, col: int) -> None:
        """See to it that the weights of a cell and of those around it are there."""
        i = row // self._sides[0]
        j = col // self._sides[1]
        if not self.state[i, j] & SURROUNDED:
            open_tile(self.packed(), i, j)

    def open_along(self, path: NDArray[np.int32]) -> None:
        """As `open_at`, of the cells of a path (N, 2) inside the map."""
        open_along(self.packed(), path)

    def complete(self, deadline: Deadline = NEVER) -> None:
        """Compute the rest, on all cores where that pays; at the deadline OutOfTimeError: the next
        call goes on.
        """
        tiles = self.packed()
        rows, cols = self.shape
        high = self._sides[0]
        for work, done in ((compute_rows, COSTED | POOLED), (link_rows, LINKED)):
            wanted = done if self._levels[0, 3] else done & COSTED
            for first, last in stripes(rows, cols, high, whole=deadline.at == math.inf):
                state = self.state[first // high : -(-last // high)]
                if (state & wanted != wanted).any():
                    in_bands(partial(work, tiles), first, last, cols, high)
                    state |= wanted
                    deadline.check()
        self.state |= SURROUNDED
        self._counts[CELLS_COSTED] = rows * cols

    def tell_from_now_on(self) -> Float2D:
        """(H, W) float32, costs that were told, 0 where none was, inf where shut; to be had before
        any is written.
        """
        self.told = virtual_zeros(self.heights.size, np.float32)
        self._counts[ANY_TOLD] = 1
        return self.told.reshape(self.shape)

    def write(
        self,
        part: Rectangle,
        patch: Float2D,
        seen: NDArray[np.bool_],
        *,
        told: bool = False,
        keeps: bool = False,
    ) -> tuple[Change, Rectangle]:
        """Put heights into the map, or costs that are `told`, and bring up to date what has been
        computed.

        `patch` (h, w) float32 lies in a part of the map; `seen` (h, w) are its cells that are
        written, (0, 0) for all. Returns the change, which counts what has not been computed yet as
        changed, and the rectangle of new values, of no rows without any. With `keeps` old weights
        are kept, and computed first where there are none.
        """
        layer, rim = (self.told, 0) if told else (self.heights.reshape(-1), 1)
        room = (part[2] + 2 * rim) * (part[3] + 2 * rim) if keeps else 0
        found = np.empty(FOUND_SLOTS, np.int64)
        nodes = np.empty(room, np.int32)
        old = np.empty(room, np.float32)
        write_layer(
            self.packed(),
            layer,
            rim,
            np.ascontiguousarray(patch),
            seen,
            *part[:2],
            found,
            nodes,
            old,
        )
        cells, cheaper, *changed, noted, row0, col0, row1, col1 = found.tolist()
        top, left, bottom, end = changed if cells else (part[0], part[1], part[0], part[1])
        change = Change((top, left, bottom - top, end - left), cells, bool(cheaper))
        if keeps:
            change = change._replace(nodes=nodes[:noted].copy(), old_weights=old[:noted].copy())
        return change, (row0, col0, row1 - row0, col1 - col0)

    def planes(
        self,
        window: Rectangle,
        inner: tuple[int, int],
        parts: Sequence[Rectangle],
        out: NDArray[np.float32],
    ) -> None:
        """As `network.encoding.map_planes`, for parts of a window, from two rows of each network
        cell.
        """
        sample_planes(self.packed(), window, np.array(parts), inner, out)
