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

from nnpp_edge.runtime._jit import kernel
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, Status
from nnpp_edge.runtime.grid import Grid, StepCost
from nnpp_edge.runtime.planning.astar import Region
from nnpp_edge.runtime.planning.plan import measure

_SETTLED, _PAUSED = 0, 1
_ROW_STEP = (-1, 1, 0, 0, -1, -1, 1, 1)
_COL_STEP = (0, 0, -1, 1, -1, 1, -1, 1)
_ARITY = 4
_ABSENT = -1
_UNITS = float(1 << 20)
"""Units in the cheapest straight step: a step is rounded by at most 2 of them."""
_EXACT = float(1 << 52)
"""Sums of units are exact up to here: two thousand million of the cheapest steps."""
_CAUTION = 1.0 + 2.0**-40
"""Beyond that, keys this much above the start's are looked at too, so that rounding cannot hide one."""
_DEAREST = 1e38
"""No passable cell weighs more units, lest it read as impassable."""
_EXPANSIONS_BETWEEN_CHECKS = 4096


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
        self.heap_keys = np.empty(2 * nodes, np.float64)
        self.heap_nodes = np.empty(nodes, np.int32)
        self.changed = np.empty(nodes, np.int32)
        """Nodes one of whose steps has changed since the last plan, each once."""
        self.is_changed = np.zeros(nodes, np.uint8)


class DStarLite:
    """Plans on one grid towards one goal, again and again. Serves one thread at a time.

    Say what changed, then plan: `cells_changed` after every `Grid.update`, `set_region` when the region is
    another. Both take note only; `plan` mends the search.

    Parameters
    ----------
    grid : Grid
        The map; read when its cells are said to have changed, not otherwise.
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
        self.set_goal(goal)

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
        self._km += float(_octile(to_row - row, to_col - col, self._prices))
        if self._region is not self._everywhere:  # start and goal count as inside it
            for end in (left, node):
                self._revise((*self._cell(end), 1, 1))

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
            self._revise((row, col, rows, cols))

    def set_region(self, region: Region | None) -> None:
        """Search only there from now on; None for the whole map.

        Start and goal count as inside. The bitmap is read now and may be changed afterwards.
        """
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
        self._pending = _read_region(
            mask, region.row_block, region.col_block, rows_to_read, grid.weights, self._factor, grid.stride,
            self._start, self._goal, ws.costs, ws.walls, ws.inside, ws.changed, ws.is_changed, self._pending,
        )  # fmt: skip

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
        self._pending, self._km = 0, 0.0
        _read_map(grid.rows, grid.cols, grid.weights, self._factor, grid.stride, self._start, self._goal,
                  ws.costs, ws.walls, ws.inside)  # fmt: skip
        self._size = _clear(self._goal, ws.state, ws.position, ws.heap_keys, ws.heap_nodes)

    def _revise(self, part: tuple[int, int, int, int]) -> None:
        ws, grid = self._ws, self._grid
        self._pending = _read_rectangle(
            *part, grid.weights, self._factor, grid.stride, self._start, self._goal,
            ws.costs, ws.walls, ws.inside, ws.changed, ws.is_changed, self._pending,
        )  # fmt: skip

    def _search(self, deadline: float, cancelled: Callable[[], bool] | None) -> tuple[bool, int]:
        """Mend the search until the start is settled: whether it is, and the number of expansions."""
        ws, stride = self._ws, self._grid.stride
        if self._km > 0.5 * _EXACT:
            self._begin()
        self._size = _mend(
            self._pending, stride, self._start, self._goal, self._corner_cutting, self._steps, self._prices, self._km,
            ws.costs, ws.walls, ws.state, ws.position, ws.heap_keys, ws.heap_nodes, self._size, ws.changed,
            ws.is_changed,
        )  # fmt: skip
        self._pending = 0
        timed = deadline < math.inf or cancelled is not None
        most = _EXPANSIONS_BETWEEN_CHECKS if timed else np.iinfo(np.int64).max >> 1
        expansions = 0
        while True:
            code, expanded, self._size = _expand(
                stride, self._start, self._goal, self._corner_cutting, self._steps, self._prices, self._km,
                ws.costs, ws.walls, ws.state, ws.position, ws.heap_keys, ws.heap_nodes, self._size, most,
            )  # fmt: skip
            expansions += expanded
            if code == _SETTLED:
                return True, expansions
            if time.monotonic() > deadline or (cancelled is not None and cancelled()):
                return False, expansions

    def _trace(self) -> NDArray[np.int32]:
        """The path; empty if following g does not lead to the goal, which only rounding can bring about."""
        ws, length = self._ws, 0
        path = np.empty((256, 2), np.int32)
        for _ in range(2):
            length = _descend(
                self._grid.stride, self._start, self._goal, self._corner_cutting, self._steps,
                ws.costs, ws.walls, ws.state, self._grid.cells, path,
            )  # fmt: skip
            if length <= len(path):
                break
            path = np.empty((length, 2), np.int32)
        return path[:length].copy()


@kernel
def _octile(rows, cols, prices):
    """Octile distance between cells that lie so many rows and columns apart, in units."""
    rows, cols = abs(rows), abs(cols)
    near, far = min(rows, cols), max(rows, cols)
    return prices[1] * near + prices[0] * (far - near)


@kernel
def _read(node, weights, factor, start, goal, costs, walls, inside):
    """Read one node's weight; whether its steps have changed."""
    weight = weights[node]
    wall = weight == np.inf
    cost = np.float32(np.inf)
    if not wall and (inside[node] or node in (start, goal)):
        cost = np.float32(min(np.rint(factor * weight), _DEAREST))
    if cost == costs[node] and wall == walls[node]:
        return False
    costs[node] = cost
    walls[node] = wall
    return True


@kernel
def _read_map(rows, cols, weights, factor, stride, start, goal, costs, walls, inside):
    """Read all of the map."""
    for r in range(rows):
        for c in range(cols):
            _read((r + 1) * stride + c + 1, weights, factor, start, goal, costs, walls, inside)


@kernel
def _revise(node, weights, factor, stride, start, goal, costs, walls, inside, changed, is_changed, pending):
    """Read one node's weight; if its steps have changed, put it and its neighbours down as changed."""
    if not _read(node, weights, factor, start, goal, costs, walls, inside):
        return pending
    for row_step in (-stride, 0, stride):
        for there in range(node + row_step - 1, node + row_step + 2):
            if not is_changed[there]:
                is_changed[there] = 1
                changed[pending] = there
                pending += 1
    return pending


@kernel
def _read_rectangle(
    row, col, rows, cols, weights, factor, stride, start, goal, costs, walls, inside, changed, is_changed, pending
):
    """Read a rectangle of the map; the number of nodes put down as changed so far."""
    for r in range(row, row + rows):
        for c in range(col, col + cols):
            pending = _revise(
                (r + 1) * stride + c + 1, weights, factor, stride, start, goal,
                costs, walls, inside, changed, is_changed, pending,
            )  # fmt: skip
    return pending


@kernel
def _read_region(
    mask, row_block, col_block, rows_to_read, weights, factor, stride, start, goal,
    costs, walls, inside, changed, is_changed, pending,
):  # fmt: skip
    """Read a region, as far as its rows may differ; the number of nodes put down as changed so far."""
    for r in range(len(row_block)):
        if not rows_to_read[row_block[r]]:
            continue
        for c in range(len(col_block)):
            node = (r + 1) * stride + c + 1
            now = mask[row_block[r], col_block[c]]
            if now != inside[node]:
                inside[node] = now
                pending = _revise(
                    node, weights, factor, stride, start, goal, costs, walls, inside, changed, is_changed, pending
                )
    return pending


@kernel
def _step(node, there, k, row_step, costs, walls, corner_cutting, steps):
    """Cost of the step in direction k, in units; inf where there is none."""
    pair = np.float64(costs[node]) + np.float64(costs[there])
    if k < 4:
        return steps[0] + pair
    if not corner_cutting and (walls[node + row_step] or walls[there - row_step]):
        return np.inf
    return steps[1] + np.floor(steps[2] * pair)


@kernel
def _best_rhs(node, stride, costs, walls, corner_cutting, steps, state):
    """The least cost to the goal by way of a neighbour, and the direction of that neighbour."""
    best, direction = np.inf, -1
    if costs[node] == np.inf:
        return best, direction
    row_steps = (-stride, stride, 0, 0, -stride, -stride, stride, stride)
    for k in range(8):
        there = node + row_steps[k] + _COL_STEP[k]
        if state[2 * there] < best:
            by_way = _step(node, there, k, row_steps[k], costs, walls, corner_cutting, steps) + state[2 * there]
            if by_way < best:
                best, direction = by_way, k
    return best, direction


@kernel
def _sift_up(keys, nodes, position, i, first, second, node):
    """Put a node at slot i of the heap or above."""
    while i > 0:
        p = (i - 1) // _ARITY
        if not (first < keys[2 * p] or (first == keys[2 * p] and second < keys[2 * p + 1])):
            break
        keys[2 * i], keys[2 * i + 1], nodes[i] = keys[2 * p], keys[2 * p + 1], nodes[p]
        position[nodes[i]] = i
        i = p
    keys[2 * i], keys[2 * i + 1], nodes[i] = first, second, node
    position[node] = i


@kernel
def _sift_down(keys, nodes, position, size, i, first, second, node):
    """Put a node at slot i of the heap or below."""
    while True:
        child = _ARITY * i + 1
        if child >= size:
            break
        least, a, b = child, keys[2 * child], keys[2 * child + 1]
        for c in range(child + 1, min(child + _ARITY, size)):
            if keys[2 * c] < a or (keys[2 * c] == a and keys[2 * c + 1] < b):
                least, a, b = c, keys[2 * c], keys[2 * c + 1]
        if not (a < first or (a == first and b < second)):
            break
        keys[2 * i], keys[2 * i + 1], nodes[i] = a, b, nodes[least]
        position[nodes[i]] = i
        i = least
    keys[2 * i], keys[2 * i + 1], nodes[i] = first, second, node
    position[node] = i


@kernel
def _put(keys, nodes, position, size, first, second, node):
    """Put a node on the open list, or give one that is there another key; the new size."""
    i = np.int64(position[node])
    if i == _ABSENT:
        _sift_up(keys, nodes, position, size, first, second, node)
        return size + 1
    if first < keys[2 * i] or (first == keys[2 * i] and second < keys[2 * i + 1]):
        _sift_up(keys, nodes, position, i, first, second, node)
    else:
        _sift_down(keys, nodes, position, size, i, first, second, node)
    return size


@kernel
def _remove(keys, nodes, position, size, node):
    """Take a node off the open list; the new size."""
    i = np.int64(position[node])
    position[node] = _ABSENT
    size -= 1
    if i < size:
        last = np.int64(nodes[size])
        position[last] = i
        first, second = keys[2 * size], keys[2 * size + 1]
        keys[2 * i], keys[2 * i + 1] = first, second
        if i > 0 and (
            first < keys[2 * ((i - 1) // _ARITY)]
            or (first == keys[2 * ((i - 1) // _ARITY)] and second < keys[2 * ((i - 1) // _ARITY) + 1])
        ):
            _sift_up(keys, nodes, position, i, first, second, last)
        else:
            _sift_down(keys, nodes, position, size, i, first, second, last)
    return size


@kernel
def _update_vertex(node, ahead, state, position, keys, nodes, size):
    """Have a node on the open list exactly if its g and rhs differ; `ahead` is h + km. The new size."""
    g, rhs = state[2 * node], state[2 * node + 1]
    if g != rhs:
        least = min(g, rhs)
        return _put(keys, nodes, position, size, least + ahead, least, node)
    if position[node] != _ABSENT:
        return _remove(keys, nodes, position, size, node)
    return size


@kernel
def _clear(goal, state, position, keys, nodes):
    """A search that knows the goal alone; the size of its open list."""
    state[:] = np.inf
    position[:] = _ABSENT
    state[2 * goal + 1] = 0.0
    _sift_up(keys, nodes, position, 0, 0.0, 0.0, goal)
    return 1


@kernel
def _mend(
    pending, stride, start, goal, corner_cutting, steps, prices, km,
    costs, walls, state, position, keys, nodes, size, changed, is_changed,
):  # fmt: skip
    """Work out rhs anew wherever a step has changed; the open list's new size."""
    start_row, start_col = start // stride, start % stride
    for n in range(pending):
        node = np.int64(changed[n])
        is_changed[node] = 0
        if node != goal:
            rhs, _ = _best_rhs(node, stride, costs, walls, corner_cutting, steps, state)
            if rhs != state[2 * node + 1]:
                state[2 * node + 1] = rhs
                ahead = km + _octile(node // stride - start_row, node % stride - start_col, prices)
                size = _update_vertex(node, ahead, state, position, keys, nodes, size)
    return size


@kernel
def _expand(
    stride, start, goal, corner_cutting, steps, prices, km,
    costs, walls, state, position, keys, nodes, size, most,
):  # fmt: skip
    """ComputeShortestPath: expand until the start is settled or `most` expansions are done.

    The code, the number of expansions and the open list's size.
    """
    row_steps = (-stride, stride, 0, 0, -stride, -stride, stride, stride)
    start_row, start_col = start // stride, start % stride
    inverse_stride = 1.0 / stride
    expansions = 0
    while size > 0:
        g, rhs = state[2 * start], state[2 * start + 1]
        second = min(g, rhs)
        first = second + km
        if first > _EXACT:
            first *= _CAUTION
        if rhs <= g and not (keys[0] < first or (keys[0] == first and keys[1] < second)):
            break
        if expansions == most:
            return _PAUSED, expansions, size
        node = np.int64(nodes[0])
        g, rhs = state[2 * node], state[2 * node + 1]
        second = min(g, rhs)
        row = np.int64((node + 0.5) * inverse_stride)
        rows, cols = row - start_row, node - row * stride - start_col
        ahead = km + _octile(rows, cols, prices)
        first = second + ahead
        if keys[0] < first or (keys[0] == first and keys[1] < second):
            _sift_down(keys, nodes, position, size, 0, first, second, node)
            continue
        expansions += 1
        if g > rhs:
            state[2 * node] = rhs
            size = _remove(keys, nodes, position, size, node)
            for k in range(8):
                there = node + row_steps[k] + _COL_STEP[k]
                if state[2 * there + 1] <= rhs:
                    continue
                by_way = _step(node, there, k, row_steps[k], costs, walls, corner_cutting, steps) + rhs
                if by_way < state[2 * there + 1]:
                    state[2 * there + 1] = by_way
                    ahead = km + _octile(rows + _ROW_STEP[k], cols + _COL_STEP[k], prices)
                    size = _update_vertex(there, ahead, state, position, keys, nodes, size)
            continue
        state[2 * node] = np.inf
        size = _update_vertex(node, ahead, state, position, keys, nodes, size)
        for k in range(8):
            there = node + row_steps[k] + _COL_STEP[k]
            if there == goal or state[2 * there + 1] <= g or state[2 * there + 1] == np.inf:
                continue
            if state[2 * there + 1] == _step(node, there, k, row_steps[k], costs, walls, corner_cutting, steps) + g:
                rhs, _ = _best_rhs(there, stride, costs, walls, corner_cutting, steps, state)
                if rhs != state[2 * there + 1]:
                    state[2 * there + 1] = rhs
                    ahead = km + _octile(rows + _ROW_STEP[k], cols + _COL_STEP[k], prices)
                    size = _update_vertex(there, ahead, state, position, keys, nodes, size)
    return _SETTLED, expansions, size


@kernel
def _descend(stride, start, goal, corner_cutting, steps, costs, walls, state, cells, path):
    """Write the path that follows the least cost to the goal, as far as `path` reaches; its length.

    0 if it does not lead to the goal.
    """
    node, n = start, 0
    while n < cells:
        if n < len(path):
            path[n, 0], path[n, 1] = node // stride - 1, node % stride - 1
        n += 1
        if node == goal:
            return n
        _, k = _best_rhs(node, stride, costs, walls, corner_cutting, steps, state)
        if k < 0:
            return 0
        node += _ROW_STEP[k] * stride + _COL_STEP[k]
    return 0
