"""Patches of the map that wait for the loop: any thread brings them, and the loop takes them between its searches."""

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle, enclosing
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.map.state import MapState

_OVERHEAD_CELLS = 256
"""By how many cells a patch counts more than it has."""


class Waiting(NamedTuple):
    """New values of one layer of the map, on a rectangle inside it."""

    of_heights: bool
    """Whether they are heights; else costs."""
    part: Rectangle
    values: Float2D
    """(h, w) metres or costs."""
    seen: NDArray[np.bool_] | None
    """(h, w) the cells that get new values; None for all."""
    patches: int = 1
    """So many it was made of."""


class Patches:
    """Patches for a map in the order in which they came. Any thread may call any method.

    Where so many wait that they have more cells than the map, those of a layer are made one: so they hold no more
    memory than a map or two.
    """

    def __init__(self, state: MapState) -> None:
        self._shape, self._model = state.shape, state.grid.model
        self._takes_heights = state.has_heights
        self._lock = threading.Lock()
        self._waiting: list[Waiting] = []
        self._cells = 0
        self.taken = 0
        """Patches that the map has."""
        self.counts: Counter[str] = Counter()
        """As in `Counters`: what was offered, clipped, rejected and merged."""

    def offer(self, patch: MapPatch) -> None:
        """Let a patch wait, as far as it lies on the map.

        A patch is rejected if it misses the map, if it holds heights and the map was made from costs, or if it holds
        a cost out of range.
        """
        values = patch.elevation if patch.cost is None else patch.cost
        assert values is not None
        (rows, cols), of_heights = patch.shape, patch.cost is None
        top, left = max(patch.row, 0), max(patch.col, 0)
        bottom, right = min(patch.row + rows, self._shape[0]), min(patch.col + cols, self._shape[1])
        refused = not self._takes_heights if of_heights else self._model.refuses(values)
        if top >= bottom or left >= right or refused:
            with self._lock:
                self.counts.update(("patches", "patches_rejected"))
            return
        values = values[top - patch.row : bottom - patch.row, left - patch.col : right - patch.col]
        if of_heights:
            values = np.where(np.isfinite(values), values, np.float32(np.nan))
        tells_nothing = patch.keep_known or (self._takes_heights and not of_heights)  # where it is NaN
        seen = ~np.isnan(values) if tells_nothing else None
        one = Waiting(of_heights, (top, left, bottom - top, right - left), values, seen)
        with self._lock:
            self.counts.update(("patches", "patches_clipped") if values.shape != (rows, cols) else ("patches",))
            self._waiting.append(one)
            self._cells += values.size + _OVERHEAD_CELLS
            if self._cells > self._shape[0] * self._shape[1]:
                self._merge()

    @contextmanager
    def taking(self) -> Iterator[list[Waiting]]:
        """The patches that wait, those of a layer as one where they overlap much; after an exception they wait on."""
        if not self._waiting:
            yield []
            return
        with self._lock:
            if any(_overlap(layer) for layer in self._by_layer()):
                self._merge()
            taken, self._waiting, self._cells = self._waiting, [], 0
        try:
            yield taken
        except BaseException:
            with self._lock:
                self._waiting[:0] = taken
            raise
        self.taken += sum(one.patches for one in taken)

    def _by_layer(self) -> list[list[Waiting]]:
        layers = ([one for one in self._waiting if one.of_heights is which] for which in (True, False))
        return [layer for layer in layers if layer]

    def _merge(self) -> None:
        """Make the patches of each layer one."""
        merged = [_as_one(layer) for layer in self._by_layer()]
        self.counts["patches_merged"] += len(self._waiting) - len(merged)
        self._waiting, self._cells = merged, 0


def _as_one(patches: list[Waiting]) -> Waiting:
    """Patches of one layer, one after another, as one."""
    if len(patches) == 1:
        return patches[0]
    row, col, rows, cols = whole = enclosing([one.part for one in patches])
    values, seen = np.full((rows, cols), np.nan, np.float32), np.zeros((rows, cols), np.bool_)
    for one in patches:
        here = _at(one.part, (row, col))
        new = True if one.seen is None else one.seen
        np.copyto(values[here], one.values, where=new)
        seen[here] |= new
    count = sum(one.patches for one in patches)
    return Waiting(patches[0].of_heights, whole, values, None if seen.all() else seen, count)


def _at(part: Rectangle, origin: Cell) -> tuple[slice, slice]:
    row, col = part[0] - origin[0], part[1] - origin[1]
    return slice(row, row + part[2]), slice(col, col + part[3])


def _overlap(patches: list[Waiting]) -> bool:
    """Whether patches together have more cells than the rectangle that holds them all."""
    _, _, rows, cols = enclosing([one.part for one in patches])
    return sum(one.values.size for one in patches) > rows * cols
