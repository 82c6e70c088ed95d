"""Costs of a map whose heights are read by windows: a band after another, or only where they are
wanted.
"""

import itertools
from _thread import start_new_thread
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Protocol, TypeVar

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost
from nnpp_edge.runtime.tuning import BAND_CELLS, BANDS_AHEAD

T = TypeVar("T")


class HeightWindows(Protocol):
    """Heights of a map, read a rectangle at a time."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""

    @property
    def cell_size_m(self) -> float:
        """Side of a cell along a column."""

    @property
    def cell_width_m(self) -> float:
        """Side of a cell along a row."""

    @property
    def block(self) -> tuple[int, int]:
        """Rows and columns of the blocks that are stored, and so read, as one."""

    def read(self, part: Rectangle) -> Float2D:
        """Heights of a rectangle inside the map: float32, metres, NaN where unknown. Not called
        twice at a time, but from other threads than the one that made it."""


class CostWindows:
    """Traversability costs of a map by windows, as in the cost map of the whole; by default by the
    paper's limits.
    """

    def __init__(
        self, heights: HeightWindows, traversability: Traversability | None = None
    ) -> None:
        self.heights = heights
        self._limits = traversability or Traversability()

    def bands(self) -> Iterator[tuple[int, Float2D, Float2D]]:
        """First row, heights and costs of bands of rows, from top to bottom; each height is read
        once.

        All bands but the last have a multiple of four rows, and nearly all a multiple or a part of
        a block's.
        """
        rows, cols = self.heights.shape
        step = _rows_per_band(self.heights.block[0], cols)
        parts = [(row, 0, min(step, rows - row), cols) for row in range(0, rows, step)]
        none = np.empty((0, cols), np.float32)
        above = none
        read = itertools.chain(_ahead(self.heights.read, parts), [((rows, 0, 0, 0), none)])
        for (part, heights), (_, below) in itertools.pairwise(read):
            cost = self._cost(np.concatenate([above, heights, below[:1]]))
            yield part[0], heights, cost[len(above) : len(above) + len(heights)]
            above = heights[-1:]

    def _cost(self, heights: Float2D) -> Float2D:
        size = self.heights.cell_size_m
        width = self.heights.cell_width_m
        return traversability_cost(heights, size, self._limits, cell_width_m=width, warn=False)


def _rows_per_band(block_rows: int, cols: int) -> int:
    """Rows of a block, halved or doubled until a band has about `BAND_CELLS`; a multiple
    of four.
    """
    rows = block_rows
    while rows % 8 == 0 and rows * cols > BAND_CELLS:
        rows //= 2
    while rows % 4 or 2 * rows * cols <= BAND_CELLS:
        rows *= 2
    return rows


def _ahead(
    read: Callable[[Rectangle], T], parts: Iterable[Rectangle]
) -> Iterator[tuple[Rectangle, T]]:
    """Each part with what is read for it, in order, by a thread that is a few parts ahead.

    They hand one another what they have by queues that are one step of the interpreter: a signal's
    exception in the middle of locks written in Python, as those of an executor, would leave the
    other thread to wait for ever.
    """
    wanted: SimpleQueue[Rectangle | None] = SimpleQueue()
    found: SimpleQueue[tuple[Rectangle, T | BaseException] | None] = SimpleQueue()

    def work() -> None:
        while (part := wanted.get()) is not None:
            try:
                found.put((part, read(part)))
            except BaseException as error:  # raised again where it is waited for
                found.put((part, error))
        found.put(None)

    def taken() -> tuple[Rectangle, T]:
        answer = found.get()
        assert answer is not None
        part, result = answer
        if isinstance(result, BaseException):
            raise result
        return part, result

    start_new_thread(work, ())
    waiting = 0
    try:
        for part in parts:
            wanted.put(part)
            waiting += 1
            if waiting > BANDS_AHEAD:
                waiting -= 1
                yield taken()
        for _ in range(waiting):
            yield taken()
    finally:
        with suppress(Empty):
            while True:
                wanted.get_nowait()
        wanted.put(None)
        while (
            found.get() is not None
        ):  # what it is at is read to the end: the file may be closed next
            pass
