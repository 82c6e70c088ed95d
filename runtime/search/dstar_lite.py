"""D* Lite: exact planning on a map that changes, towards one goal, from a start that moves.

Koenig and Likhachev, "D* Lite" (AAAI 2002), in its optimised form: it searches from the goal to the start,
keeps what it found, and after a change mends only what the change touched and the path needs.

Costs are counted in whole units, of which the map's cheapest step has about a million. Sums of them are exact
in float64, so the equalities and the order of keys that the algorithm's proof rests on hold to the letter.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Rectangle
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, Status
from nnpp_edge.runtime.kernels.dstar import (
    EXACT,
    SETTLED,
    SPARE_SLOTS,
    clear,
    descend,
    expand,
    least_known,
    mend,
    octile,
    read_map,
    read_rectangle,
    read_region,
)
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import StepCost
from nnpp_edge.runtime.memory import touch
from nnpp_edge.runtime.planners.plan import measure

_UNITS = float(1 << 20)
"""Units in the cheapest straight step: a step is rounded by at most 2 of them."""
_EXPANSIONS_BETWEEN_CHECKS = 4096
_MOST_UNREAD = 64


@dataclass(frozen=True)
class Replanned:
    """What planning anew came to."""

    status: Status
    """OK, NO_PATH (also where start or goal is impassable) or TIMEOUT."""
    path: NDArray[np.int32]
    """(N, 2) cells (row, col) from start to goal; empty without a path."""
    cost: float
    """Sum of the path's step costs; inf without a path."""
    expansions: int
    """Cells expanded for this answer."""


class DStarWorkspace:
    """Memory of one D* Lite search: what it knows of each node, and its open list."""

    def __init__(self, nodes: int) -> None:
        self.costs = np.full(nodes, np.inf, np.float32)
        """Weight of each node in units, whole numbers; inf where impassable or outside the region."""
        self.walls = np.ones(nodes, np.uint8)
        """Whether a node is impassable on the map itself, region or none: what corners are judged by."""
        self.inside = np.zeros(nodes, np.uint8)
        """Whether the region holds a node."""
        self.state = np.empty(2 * nodes, np.float64)
        """g of node n at 2n, rhs at 2n + 1."""
        self.position = np.empty(nodes, np.int32)
        """Where a node stands on the open list."""
        self.firsts = np.full(nodes + SPARE_SLOTS, np.inf)
        """First part of the key at each slot of the heap; inf where there is none."""
        self.seconds = np.zeros(nodes + SPARE_SLOTS)
        """Second part of it."""
        self.heap_nodes = np.empty(nodes, np.int32)
        self.changed = np.empty(nodes + 1, np.int32)
        """Nodes one of whose steps has changed since the last plan, each once, and a spare place."""
        self.is_changed = np.zeros(nodes, np.uint8)


class DStarLite:
    """Plans on one grid towards one goal, again and again. Serves one thread at a time.

    Say what changed, then plan: `cells_changed` after every `Grid.update`, `set_region` when the region is
    another. Both take note only; `plan` mends the search.

    Parameters
    ----------
    grid : Grid
        The map; read where its cells are said to have changed, not otherwise.
    goal : (row, col)
        A cell of the map.
    corner_cutting : bool
        Whether a diagonal step may pass an impassable cell on either side of it.

    Notes
    -----
    The heuristic is the octile distance at the price of the map's cheapest cell. When a cheaper one turns up
    it would overestimate, so the search starts afresh with half that price: this happens a few times at most.
    """

    def __init__(self, grid: Grid, goal: tuple[int, int], *, corner_cutting: bool = True) -> None:
        self._grid = grid
        self._corner_cutting = corner_cutting
        self._ws = DStarWorkspace(len(grid.weights))
        self._everywhere = Region(
            np.ones((1, 1), np.int32), np.zeros(grid.rows, np.int32), np.zeros(grid.cols, np.int32)
        )
        self._region, self._mask = self._everywhere, np.ones((1, 1), np.bool_)
        self._ws.inside[:] = 1
        self._least = grid.least if math.isfinite(grid.least) else 0.0
        self._pending, self._size, self._km = 0, 0, 0.0
        self._unread: list[Rectangle] = []
        """Parts of the grid that may have changed since they were read; that is done when somebody asks."""
        self.beginnings = 0
        """How often all that was found has been forgotten: with a new goal, or as cells became too cheap."""
        self.set_goal(goal)

    def touch(self) -> None:
        """Have the system back all arrays with memory now."""
        touch(self._ws)

    @property
    def goal(self) -> tuple[int, int]:
        """The cell that paths lead to."""
        return self._cell(self._goal)

    def set_goal(self, goal: tuple[int, int]) -> None:
        """Another goal: the search starts afresh."""
        self._goal = self._start = self._node(goal, "goal")
        self._begin()

    def move_start(self, start: tuple[int, int]) -> None:
        """Paths lead from `start` from now on."""
        node = self._node(start, "start")
        if node == self._start:
            return
        left, self._start = self._start, node
        (row, col), (to_row, to_col) = self._cell(left), self._cell(node)
        self._km += float(octile(to_row - row, to_col - col, self._prices))
        if self._region is not self._everywhere:  # start and goal count as inside it
            for end in (left, node):
                self._note((*self._cell(end), 1, 1))

    def cells_changed(self, row: int, col: int, rows: int, cols: int) -> None:
        """The grid's weights may have changed in this rectangle.

        Raises
        ------
        InvalidMapError
            The rectangle does not lie inside the map.
        """
        grid = self._grid
        if min(row, col, rows, cols) < 0 or row + rows > grid.rows or col + cols > grid.cols:
            raise InvalidMapError(
                f"a rectangle must lie inside the map of {(grid.rows, grid.cols)}, got {(row, col, rows, cols)}"
            )
        if grid.least < self._least:
            self._least = 0.5 * grid.least
            if grid.model.kind is StepCost.PAPER and self._least < 1e-2:
                self._least = 0.0
            self._begin()
        elif self._prices[0] == 0.0 < grid.least:  # the first passable cells of the `length` model
            self._least = grid.least
            self._begin()
        else:
            self._note((row, col, rows, cols))

    def set_region(self, region: Region | None) -> None:
        """Search only there from now on; None for the whole map.

        Start and goal count as inside. The bitmap is read now and may be changed afterwards.
        """
        self._read()
        region = region or self._everywhere
        mask = region.bitmap == region.stamp
        known = self._region
        comparable = (
            mask.shape == self._mask.shape
            and (region.row_block is known.row_block or np.array_equal(region.row_block, known.row_block))
            and (region.col_block is known.col_block or np.array_equal(region.col_block, known.col_block))
        )
        rows_to_read = (mask != self._mask).any(axis=1) if comparable else np.ones(len(mask), np.bool_)
        self._region, self._mask = region, mask
        ws, grid = self._ws, self._grid
        self._pending = read_region(
            mask, region.row_block, region.col_block, rows_to_read, grid.weights, self._factor, grid.stride,
            self._start, self._goal, ws.costs, ws.walls, ws.inside, ws.changed, ws.is_changed, self._pending,
        )  # fmt: skip

    def reach(self) -> float:
        """How far changes reach: the share of the way, by cost, that lies between the start and the farthest of them.

        Returns
        -------
        float
            From 0 (none matters: all lie behind the start, or where no search has come) to 1 (at the goal, or the
            start lies where no search has come, and a change does not). What was found on that part of the way may
            have to be mended.
        """
        self._read()
        ws = self._ws
        nearest = least_known(ws.changed, self._pending, ws.inside, ws.state)
        whole = min(ws.state[2 * self._start : 2 * self._start + 2].tolist())
        if not math.isfinite(nearest):
            return 0.0
        return min(max(1.0 - nearest / whole, 0.0), 1.0) if 0.0 < whole < math.inf else 1.0

    def plan(
        self,
        start: tuple[int, int],
        *,
        deadline: float = math.inf,
        cancelled: Callable[[], bool] | None = None,
    ) -> Replanned:
        """Cheapest path from `start` to the goal on the map as last told.

        Parameters
        ----------
        start : (row, col)
            A cell of the map.
        deadline : float
            Reading of `time.monotonic` at which to give up with TIMEOUT. The next call goes on from there.
        cancelled : callable
            Asked now and then; True ends the search as a deadline does.

        Returns
        -------
        Replanned
            What a fresh search would find, and where several paths cost the same perhaps another of them.
        """
        self.move_start(start)
        self._read()
        expansions = 0
        if math.isfinite(self._ws.costs[self._start]) and math.isfinite(self._ws.costs[self._goal]):
            for fresh in (False, True):
                if fresh:
                    self._begin()
                settled, expanded = self._search(deadline, cancelled)
                expansions += expanded
                if not settled:
                    return Replanned(Status.TIMEOUT, np.empty((0, 2), np.int32), math.inf, expansions)
                if not math.isfinite(self._ws.state[2 * self._start + 1]):
                    break
                if len(path := self._trace()):
                    return Replanned(Status.OK, path, measure(self._grid, path)[0], expansions)
            else:
                raise InvalidMapError("weights must not lie more than a factor of about 1e15 apart")
        return Replanned(Status.NO_PATH, np.empty((0, 2), np.int32), math.inf, expansions)

    def _node(self, cell: tuple[int, int], name: str) -> int:
        if not (0 <= cell[0] < self._grid.rows and 0 <= cell[1] < self._grid.cols):
            raise InvalidQueryError(
                f"{name} must lie inside the map of {(self._grid.rows, self._grid.cols)}, got {tuple(cell)}"
            )
        return self._grid.node(int(cell[0]), int(cell[1]))

    def _cell(self, node: int) -> tuple[int, int]:
        return node // self._grid.stride - 1, node % self._grid.stride - 1

    def _begin(self) -> None:
        """Forget the search, and take the whole map over at the present prices."""
        self.beginnings += 1
        model = self._grid.model
        straight = model.step(0, 2.0 * self._least)
        scale = _UNITS / straight if straight > 0.0 else _UNITS
        self._factor = scale * model.weight_term[0]
        diagonal_per_straight = model.weight_term[1] / model.weight_term[0]
        self._steps = (*(float(round(scale * x)) for x in model.length_term), diagonal_per_straight)
        cheapest = 2.0 * float(np.float32(np.rint(self._factor * self._least)))
        straight = self._steps[0] + cheapest
        diagonal = self._steps[1] + math.floor(diagonal_per_straight * cheapest)
        self._prices = (straight, min(diagonal, 2.0 * straight))
        ws, grid = self._ws, self._grid
        ws.is_changed[:] = 0
        self._unread.clear()
        self._pending, self._km = 0, 0.0
        read_map(
            grid.rows, grid.cols, grid.weights, self._factor, grid.stride, self._start, self._goal,
            ws.costs, ws.walls, ws.inside,
        )  # fmt: skip
        self._size = clear(self._goal, ws.state, ws.position, ws.firsts, ws.seconds, ws.heap_nodes)

    def _note(self, part: Rectangle) -> None:
        self._unread.append(part)
        if len(self._unread) > _MOST_UNREAD:
            self._read()

    def _read(self) -> None:
        """Take over what the grid says now of the parts noted."""
        ws, grid = self._ws, self._grid
        for part in self._unread:
            self._pending = read_rectangle(
                *part, grid.weights, self._factor, grid.stride, self._start, self._goal,
                ws.costs, ws.walls, ws.inside, ws.changed, ws.is_changed, self._pending,
            )  # fmt: skip
        self._unread.clear()

    def _search(self, deadline: float, cancelled: Callable[[], bool] | None) -> tuple[bool, int]:
        """Mend the search until the start is settled: whether it is, and the number of expansions."""
        ws, stride = self._ws, self._grid.stride
        if self._km > 0.5 * EXACT:
            self._begin()
        self._size = mend(
            self._pending, stride, self._start, self._goal, self._corner_cutting, self._steps, self._prices, self._km,
            ws.costs, ws.walls, ws.state, ws.position, ws.firsts, ws.seconds, ws.heap_nodes, self._size, ws.changed,
            ws.is_changed,
        )  # fmt: skip
        self._pending = 0
        timed = deadline < math.inf or cancelled is not None
        most = _EXPANSIONS_BETWEEN_CHECKS if timed else np.iinfo(np.int64).max >> 1
        expansions = 0
        while True:
            code, expanded, self._size = expand(
                stride, self._start, self._goal, self._corner_cutting, self._steps, self._prices, self._km,
                ws.costs, ws.walls, ws.state, ws.position, ws.firsts, ws.seconds, ws.heap_nodes, self._size, most,
            )  # fmt: skip
            expansions += expanded
            if code == SETTLED:
                return True, expansions
            if time.monotonic() > deadline or (cancelled is not None and cancelled()):
                return False, expansions

    def _trace(self) -> NDArray[np.int32]:
        """The path; empty if following g does not lead to the goal, which only rounding can bring about."""
        ws, length = self._ws, 0
        path = np.empty((256, 2), np.int32)
        for _ in range(2):
            length = descend(
                self._grid.stride, self._start, self._goal, self._corner_cutting, self._steps,
                ws.costs, ws.walls, ws.state, self._grid.cells, path,
            )  # fmt: skip
            if length <= len(path):
                break
            path = np.empty((length, 2), np.int32)
        return path[:length].copy()
