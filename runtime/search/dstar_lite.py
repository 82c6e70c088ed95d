"""D* Lite: exact planning on a map that changes, towards one goal, from a start that moves.

Koenig and Likhachev, "D* Lite" (AAAI 2002), in its optimised form. Costs are counted in whole
units, of which the map's cheapest step has about a million. Sums of them are exact in float64, so
the equalities and the order of keys that the algorithm's proof rests on hold to the letter.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Int32
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, Status
from nnpp_edge.runtime.kernels import dstar as kernels
from nnpp_edge.runtime.kernels.nodes import FOUND, octile
from nnpp_edge.runtime.kernels.records import (
    CostSource,
    DStarSearch,
    Heap,
    Known,
    Mask,
    Noted,
    Packed,
    UnitEdges,
)
from nnpp_edge.runtime.options import CELLS
from nnpp_edge.runtime.search.astar import Search
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.terrain.step_cost import StepCost
from nnpp_edge.runtime.tuning import MOST_RATIO_FOR_DSTAR

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid
    from nnpp_edge.runtime.map.state import MapState

UNITS = float(1 << 20)
"""Units in the cheapest straight step: a step is rounded by at most 2 of them."""


def serves(grid: "Grid") -> bool:
    """Whether D* Lite plans on this map: a point's or a disc's, with steps near enough to one
    another in cost.
    """
    return grid.robot.moves.over == CELLS and grid.step_ratio <= MOST_RATIO_FOR_DSTAR


class DStarMemory:
    """One D* Lite search's knowledge of each node that has been read, and its open list."""

    def __init__(self, nodes: int) -> None:
        self.costs = np.empty(nodes, np.float32)
        """Weight of each node in units, whole numbers; inf where impassable or outside
        the region.
        """
        self.walls = np.empty(nodes, np.uint8)
        self.inside = np.empty(nodes, np.uint8)
        """Whether the map itself is impassable there, which corners are judged by; whether it is in
        the region.
        """
        self.state = np.empty(2 * nodes, np.float64)
        """g of node n at 2n, rhs at 2n + 1."""
        self.position = np.empty(nodes, np.int32)
        self.heap_nodes = np.empty(nodes, np.int32)
        """Where a node stands on the open list, and the node at each place of it."""
        self.firsts = np.empty(nodes + kernels.SPARE_SLOTS)
        self.seconds = np.zeros(nodes + kernels.SPARE_SLOTS)
        """The two parts of the key at each place of the heap, the first inf where there is none."""
        self.changed = np.empty(nodes + 1, np.int32)
        self.is_changed = np.zeros(nodes, np.uint8)
        """Nodes one of whose steps has changed since the last plan, each once, and a
        spare place.
        """
        self.known = tuple(Known(self.costs, self.walls, self.inside))
        self.heap = tuple(Heap(self.position, self.firsts, self.seconds, self.heap_nodes))
        self.noted = tuple(Noted(self.changed, self.is_changed))


class DStarLite:
    """Plans on one map towards one goal, again and again, in a region if given. Serves one thread
    at a time.

    It reads from the map's log what changed, and repairs its search when a path is asked for.

    Notes
    -----
    The heuristic is the octile distance at the price of the map's cheapest cell. When a cheaper one
    turns up it would overestimate, so the search starts afresh with half that price: this happens a
    few times at most. With directed steps the price is that of the cheapest metre over all slopes,
    and never changes.
    """

    def __init__(self, state: "MapState", goal: Cell, region: Region | None = None) -> None:
        self._grid = state.grid
        directed = self._grid.robot.price.edges()
        self._edges: Packed | None = None
        if directed is not None:
            self._edges = tuple(UnitEdges(directed, UNITS / self._grid.prices[0]))
        self._changes = state.log.reader()
        self.memory = DStarMemory(len(self._grid.weights))
        """To be read only."""
        self.open_nodes = 0
        """Number of nodes on the open list."""
        self._region = region or Region.everywhere(*self._grid.shape)
        self._blocks = self._region.blocks()
        self._rows_left = np.full(self._grid.rows + 2, kernels.UNREAD, np.uint8)
        self._least = self._grid.least if math.isfinite(self._grid.least) else 0.0
        self._pending = 0
        self._km = 0.0
        self.restarts = 0
        """How often all that was found has been forgotten: cells too cheap, a new goal."""
        self._begun = False
        self.set_goal(goal)

    @property
    def goal(self) -> Cell:
        """The cell that paths lead to."""
        return self._grid.cell(self._goal)

    def set_goal(self, goal: Cell) -> None:
        """Another goal: the search starts afresh."""
        self._goal = self._start = self._node(goal, "goal")
        # a cell may have become too cheap for the prices, which a restart keeps
        self._read_changes()
        self._restart()

    def move_start(self, start: Cell) -> None:
        """Paths lead from `start` from now on."""
        node = self._node(start, "start")
        if node == self._start:
            return
        left = self._start
        self._start = node
        ends = self._grid.cell(left), self._grid.cell(node)
        self._km += float(octile.py_func(*ends[0], *ends[1], *self._prices))
        for cell in ends:  # start and goal count as inside the region
            self._read_rectangle((*cell, 1, 1))

    def set_region(self, region: Region) -> None:
        """Search only there from now on; start and goal count as inside. The bitmap may be changed
        afterwards.
        """
        self._read_changes()
        blocks = region.blocks()
        differs = np.ones(len(blocks), np.bool_)
        if region.shares_blocks(self._region):
            differs = (blocks != self._blocks).any(axis=1)
        self._region = region
        self._blocks = blocks
        rows = self._rows_left[1:-1]
        np.maximum(
            rows, np.where(differs[region.row_block], kernels.STALE, 0), out=rows, casting="unsafe"
        )

    def read(self, deadline: Deadline = NEVER) -> None:
        """Read the rest of the map, or of another region; at the deadline OutOfTimeError: the next
        call goes on.
        """
        if not self._rows_left.any():
            return
        self._grid.complete(deadline)
        memory = self.memory
        mask = Mask(self._blocks, self._region.row_block, self._region.col_block)
        ground = (tuple(mask), self._source)
        found = (memory.known, memory.state, memory.heap, memory.noted)
        self._pending = kernels.read_rows(
            self._rows_left, *ground, *found, self._pending, deadline.at
        )
        if self._rows_left.any():
            raise OutOfTimeError
        if not self._begun:
            self.open_nodes = kernels.begin(self._goal, memory.state, memory.heap)
            self._begun = True

    def plan(self, start: Cell, *, deadline: Deadline = NEVER) -> Search:
        """Cheapest path from `start` to the goal on the map as it is now.

        Where several cost the same it may be another than a fresh search's. NO_PATH also where
        start or goal is impassable; TIMEOUT at the deadline, from where the next call goes on.
        """
        self.move_start(start)
        self._read_changes()
        expansions = 0
        memory = self.memory
        try:
            self.read(deadline)
            if not np.isfinite(memory.costs[[self._start, self._goal]]).all():
                return Search.without_path(Status.NO_PATH)
            for afresh in (False, True):
                if afresh:
                    self._restart()
                settled, expanded = self._expand(deadline)
                expansions += expanded
                if not settled:
                    break
                if not math.isfinite(memory.state[2 * self._start + 1]):
                    return Search.without_path(Status.NO_PATH, expansions)
                if len(path := self._trace()):
                    return Search(Status.OK, path, expansions)
            else:
                raise InvalidMapError(
                    f"no step may cost more than {MOST_RATIO_FOR_DSTAR:g} times the cheapest"
                )
        except OutOfTimeError:
            pass
        return Search.without_path(Status.TIMEOUT, expansions)

    def _node(self, cell: Cell, name: str) -> int:
        if not self._grid.holds(cell):
            raise InvalidQueryError(
                f"{name} must lie inside the map of {self._grid.shape}, got {tuple(cell)}"
            )
        return self._grid.node(int(cell[0]), int(cell[1]))

    @property
    def _source(self) -> Packed:
        """Where costs are read from, as kernels take it."""
        grid = self._grid
        return tuple(CostSource(grid.weights, self._factor, grid.stride, self._start, self._goal))

    @property
    def _search(self) -> Packed:
        """What is searched, as kernels take it."""
        grid = self._grid
        ends = grid.stride, self._start, self._goal, grid.corner_cutting
        return tuple(DStarSearch(*ends, *self._steps, *self._prices, self._km))

    def _restart(self) -> None:
        """Forget the search, and read the whole map at the present prices."""
        self.restarts += 1
        self._set_prices()
        memory = self.memory
        memory.is_changed[memory.changed[: self._pending]] = 0
        memory.firsts[-kernels.SPARE_SLOTS :] = np.inf
        self._changes.skip()
        self._pending = 0
        self._km = 0.0
        self.open_nodes = 0
        self._begun = False
        self._rows_left[:] = kernels.UNREAD

    def _set_prices(self) -> None:
        """Units, and the heuristic's prices in them, by the least weight that is reckoned with."""
        model = self._grid.model
        if self._edges is not None:
            self._factor = 0.0
            self._steps = (0.0, 0.0, 1.0)
            units = UNITS / self._grid.prices[0]
            straight, diagonal = (float(np.rint(units * price)) for price in self._grid.prices)
        else:
            straight = model.step(0, 2.0 * self._least)
            scale = UNITS / straight if straight > 0.0 else UNITS
            self._factor = scale * model.weight_term[0]
            diagonal_per_straight = model.weight_term[1] / model.weight_term[0]
            straight, diagonal = (float(round(scale * length)) for length in model.length_term)
            self._steps = straight, diagonal, diagonal_per_straight
            cheapest = 2.0 * float(np.float32(np.rint(self._factor * self._least)))
            straight = straight + cheapest
            diagonal = diagonal + math.floor(diagonal_per_straight * cheapest)
        self._prices = (straight, min(diagonal, 2.0 * straight))

    def _read_changes(self) -> None:
        """Read what has changed on the map since the last time; start afresh where a cell became
        too cheap.
        """
        changes = self._changes.read()
        least = self._grid.least
        if not changes:
            return
        step = self._grid.model.step
        by_weight = self._edges is None
        # whether units of the present prices cannot tell apart what the dearest steps cost
        too_coarse = step(0, 2.0 * self._grid.greatest) > MOST_RATIO_FOR_DSTAR * step(
            0, 2.0 * self._least
        )
        if by_weight and least < self._least:
            self._least = 0.5 * least
            if self._grid.model.kind is StepCost.PAPER and self._least < 1e-2:
                self._least = 0.0
            self._restart()
        elif by_weight and self._least < least and too_coarse:
            self._least = least
            self._restart()
        else:
            for change in changes:
                self._read_rectangle(change.part)

    def _read_rectangle(self, part: Rectangle) -> None:
        memory = self.memory
        row, col, rows, cols = part
        area = (row, row + rows, col, col + cols)  # `records.Area`
        ground = (self._rows_left, self._source, self._edges is not None)
        self._pending = kernels.read_rectangle(
            area, *ground, memory.known, memory.noted, self._pending
        )

    def _expand(self, deadline: Deadline) -> tuple[bool, int]:
        """Mend the search until the start is settled: whether it is, and the number of
        expansions.
        """
        memory = self.memory
        if self._km > 0.5 * kernels.EXACT:
            self._restart()
        self.read(deadline)
        search = self._search
        known = (memory.known, self._edges, memory.state, memory.heap)
        at = deadline.at
        size = self.open_nodes
        self._pending, size = kernels.mend(self._pending, search, *known, size, memory.noted, at)
        self.open_nodes = size
        if self._pending:
            return False, 0
        code, expansions, self.open_nodes = kernels.expand(search, *known, size, at)
        return code == FOUND, expansions

    def _trace(self) -> Int32:
        """The path; empty if following g does not lead to the goal, which only rounding can bring
        about.
        """
        search = self._search
        path = np.empty((256, 2), np.int32)
        known = search, self.memory.known, self._edges, self.memory.state
        while (length := kernels.descend(*known, self._grid.cells, path)) > len(path):
            path = np.empty((length, 2), np.int32)
        return path[:length].copy()
