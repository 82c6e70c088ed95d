"""Patches of the map that wait for the loop: any thread brings them, and the loop takes them
between its searches.
"""

import math
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Float2D, Mask
from nnpp_edge.runtime.cells import Cell, Rectangle, common, enclosing, slices
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.map.state import MapState

_OVERHEAD_CELLS = 256
"""By how many cells a patch counts more than it has."""


class Waiting(NamedTuple):
    """New values of one layer of the map, on a rectangle inside it."""

    layer: str
    """As `MapState.update` takes it: ``heights`` or ``cost``."""
    part: Rectangle
    values: Float2D
    """(h, w) metres or costs."""
    seen: Mask | None
    """(h, w) the cells that get new values; None for all."""


class Patches:
    """Patches for a map, in each layer in the order in which they came. Any thread may call any
    method.

    Where so many wait that they have more cells than the map, those of a layer are made one: so
    they hold no more memory than a map or two.
    """

    def __init__(self, state: MapState) -> None:
        self._shape = state.shape
        self._model = state.grid.model
        self._takes_heights = state.heights is not None
        self._lock = threading.Lock()
        self._waiting: list[Waiting] = []
        self._cells = 0
        self.taken = 0
        """Patches that the map has."""
        self.counts: Counter[str] = Counter()
        """As in `Counters`: what was offered, clipped, rejected and merged."""

    def offer(self, patch: MapPatch) -> None:
        """Let a patch wait, as far as it lies on the map.

        A patch is rejected if it misses the map, if it holds heights and the map was made from
        costs, or if it holds a cost out of range.
        """
        of_heights = patch.cost is None
        corner = (patch.row, patch.col)
        part = common((*corner, *patch.shape), (0, 0, *self._shape))
        refused = not self._takes_heights if of_heights else self._model.refuses(patch.values)
        if part is None or refused:
            with self._lock:
                self.counts.update(("patches", "patches_rejected"))
            return
        values = patch.values[_inside(part, corner)]
        if of_heights:
            values = np.where(np.isfinite(values), values, np.float32(np.nan))
        # whether the map stays as it is where the patch is NaN
        tells_nothing = patch.keep_known or (self._takes_heights and not of_heights)
        seen = ~np.isnan(values) if tells_nothing else None
        with self._lock:
            self.counts["patches"] += 1
            self.counts["patches_clipped"] += values.shape != patch.shape
            layer = "heights" if of_heights else "cost"
            self._waiting.append(Waiting(layer, part, values, seen))
            self._cells += values.size + _OVERHEAD_CELLS
            if self._cells > math.prod(self._shape):
                self._waiting = self._merged(least_overlap=0.0)
                self._cells = 0

    @contextmanager
    def taking(self) -> Iterator[list[Waiting]]:
        """The patches that wait; after an exception they wait on.

        Those of a layer are one where they have more cells than the rectangle that holds them all.
        """
        with self._lock:
            taken = self._merged(least_overlap=1.0)
            self._waiting = []
            self._cells = 0
            accepted = self.counts["patches"] - self.counts["patches_rejected"]
        try:
            yield taken
        except BaseException:
            with self._lock:
                self._waiting[:0] = taken
            raise
        self.taken = accepted

    def _merged(self, least_overlap: float) -> list[Waiting]:
        """The patches that wait, those of heights first. Those of a layer are made one where they
        have more cells than so many times the rectangle that holds them all.
        """
        found: list[Waiting] = []
        for layer in ("heights", "cost"):
            patches = [one for one in self._waiting if one.layer == layer]
            cells = sum(one.values.size for one in patches)
            if len(patches) > 1:
                whole = enclosing([one.part for one in patches])
                if cells > least_overlap * math.prod(whole[2:]):
                    self.counts["patches_merged"] += len(patches) - 1
                    patches = [_as_one(patches, whole)]
            found += patches
        return found


def _as_one(patches: list[Waiting], whole: Rectangle) -> Waiting:
    """Patches of one layer, one after another, as one on the rectangle that holds them all."""
    values = np.full(whole[2:], np.nan, np.float32)
    seen = np.zeros(whole[2:], np.bool_)
    for one in patches:
        here = _inside(one.part, whole[:2])
        new = True if one.seen is None else one.seen
        np.copyto(values[here], one.values, where=new)
        seen[here] |= new
    return Waiting(patches[0].layer, whole, values, None if seen.all() else seen)


def _inside(part: Rectangle, corner: Cell) -> tuple[slice, slice]:
    """Rows and columns of a rectangle in an array whose first cell is this cell of the map."""
    row, col, rows, cols = part
    return slices((row - corner[0], col - corner[1], rows, cols))
