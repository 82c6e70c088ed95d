"""Planning on a map larger than memory, whose heights are read by windows.

Each height is read once, to make the coarse levels. These are searched in memory, from the coarsest
down, and only what lies under the last corridor is read again, and searched at full resolution.
"""

import itertools
import math
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import (
    Cell,
    Endpoints,
    Rectangle,
    as_cell,
    common,
    enclosing,
    slices,
    widened,
)
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidMapError, Status
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.runtime.map.streamed import StreamedMap
from nnpp_edge.runtime.memory import available_bytes, small_pages, virtual_zeros
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan, Source
from nnpp_edge.runtime.planners.query import Found, Work, problem_with, told
from nnpp_edge.runtime.planners.tour import Tour, tour
from nnpp_edge.runtime.robots.slope.cost import Mobility
from nnpp_edge.runtime.search.astar import Query, Search, astar
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Stopwatch
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA, StepModel
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.windows import CostWindows, HeightWindows
from nnpp_edge.runtime.tuning import LEAST_WINDOW

_PAGE = 4096
_NO_CORRIDOR = (
    "there is a path, but neither corridor holds one: to find it would take a search "
    "of the whole map"
)
_NO_TIME = "neither corridor holds a path, and no time was left to find out whether there is one"


class VirtualWorkspace(Workspace):
    """Scratch memory that takes room where a search goes."""

    def __init__(self, nodes: int) -> None:
        super().__init__(1)
        state = virtual_zeros(2 * nodes, np.int32)
        self.g = state.view(np.float32)
        self.meta = state
        self._searches = [0]


class WindowedPlanner:
    """Plans by the corridor method on a map that is read by windows. Serves one thread at a time.

    Paths, costs and bounds are those of `Planner` with ``method="corridor"`` on the same map, as
    long as one of its two corridors holds a path. Where neither does, the map is read once more to
    tell whether start and goal are connected: the answer is NO_PATH or, as the whole map is not
    searched, UNKNOWN.

    Parameters
    ----------
    traversability, omega, corner_cutting, mobility
        As for `Planner.of_elevation`.
    progress : callable
        Called with what the map is read for, and the number of rows that have been read.

    Raises
    ------
    InvalidMapError
        The map is empty, or has more cells than nodes have numbers.
    """

    def __init__(
        self,
        heights: HeightWindows,
        traversability: Traversability | None = None,
        *,
        omega: float = PAPER_OMEGA,
        corner_cutting: bool = True,
        mobility: Mobility | None = None,
        progress: Callable[[str, int], None] = lambda what, rows: None,
    ) -> None:
        watch = Stopwatch()
        self._progress = progress
        self._mobility = mobility or Mobility()
        self.costs = CostWindows(heights, traversability or Traversability.safe())
        with small_pages():
            self._map = StreamedMap(
                heights.shape, StepModel.of("paper", omega), corner_cutting=corner_cutting
            )
            for row, _, cost in self.costs.bands():
                self._map.take(cost)
                progress("coarse levels", row + len(cost))
            self._map.finish()
            workspace = VirtualWorkspace(len(self._map.grid.weights))
            self._descent = CoarseToFine(self._map, workspace)
        self._corridor = CorridorCells(self._map, self.costs, workspace)
        self.map_ms = watch.total_ms()
        """Milliseconds for reading all heights once and making the coarse levels."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self._map.shape

    def coarse_costs(self, most_cells: int) -> tuple[int, Float2D]:
        """Mean costs of the finest coarse level with at most so many cells a side, or of the
        coarsest.

        Cells of the map to the side of one of the level's; float32, inf where none of them is
        passable.
        """
        levels = self._map.levels
        scale = np.float32(self._map.grid.model.scale or 1.0)
        number = next(
            (n for n in range(1, len(levels)) if max(levels[n].grid.shape) <= most_cells),
            len(levels) - 1,
        )
        return FACTOR**number, np.asarray(levels[number].grid.map() / scale)

    @property
    def any_passable(self) -> bool:
        """Whether there is a cell to stand on."""
        return math.isfinite(self._map.grid.least)

    @property
    def read_again(self) -> float:
        """Heights that were read again so far, as a share of the map's cells."""
        rows, cols = self.shape
        return self.costs.cells_read / (rows * cols) - 1.0

    def plan(
        self, start: Cell, goal: Cell, *, epsilon: float = math.inf, time_limit_s: float = math.inf
    ) -> Plan:
        """A path from start to goal.

        As `Planner.plan`, but that the wide corridor is the last: what it holds is taken, whatever
        `epsilon`, and `Plan.bound` says how good it is. UNKNOWN where there is a path, but not in a
        corridor, or no time to find out. InvalidMapError where the cells under the corridor need
        more memory than there is.
        """
        return self._over(self._plan(start, goal, epsilon, Deadline.within(time_limit_s)))

    def _plan(self, start: Cell, goal: Cell, epsilon: float, deadline: Deadline) -> Plan:
        work = Work()
        query = Query.of(start, goal, deadline, epsilon)
        grid = self._map.grid
        found = None
        with small_pages():
            for cell in (query.start, query.goal):
                if grid.holds(cell):
                    self._corridor.put([(*cell, 1, 1)])
            if problem := problem_with(grid, query.start, query.goal):
                reason = told(problem, query, grid.robot)
                return Plan(problem, Method.CORRIDOR, planner=Method.CORRIDOR, reason=reason)
            try:
                for found in self._descent.corridors(query, work, self._corridor):
                    if found.suffices(query):
                        break
            except OutOfTimeError:
                found = Found.too_late(Source.REGION)
        reason = ""
        if found is None:
            status, reason = self._without_corridor(query)
            work.stage_ends("connection")
            found = Found.of(grid, Search.without_path(status), Source.WIDENED, None, work)
        return found.plan(DynamicMethod.CORRIDOR, work, self._map, reason=reason)

    def plan_via(
        self,
        start: Cell,
        goal: Cell,
        via: Sequence[Cell],
        *,
        best_order: bool = False,
        epsilon: float = math.inf,
        time_limit_s: float = math.inf,
    ) -> Tour:
        """As `Planner.plan_via`; for the best order more corridors are read than lie along it."""
        deadline = Deadline.within(time_limit_s)
        between = [as_cell(cell, f"via {at}") for at, cell in enumerate(via, 1)]
        found = tour(
            partial(self._plan, epsilon=epsilon, deadline=deadline),
            [start, *between, goal],
            self._map.grid,
            best_order=best_order,
            finish=self._over,
            deadline=deadline,
        )
        return replace(found, plan=self._over(found.plan))

    def _over(self, plan: Plan) -> Plan:
        """The plan with the numbers along its way; the heights below it are read for that."""
        heights, _ = self.costs.along(plan.path)
        source = self.costs.heights
        sides = source.cell_size_m, source.cell_width_m
        return replace(plan, along=Along(plan.path, heights, sides, self._mobility))

    def _without_corridor(self, query: Query) -> tuple[Status, str]:
        """Whether there is a path where no corridor holds one, and in words."""

        def bands() -> Generator[Float2D, None, None]:
            for row, _, cost in self.costs.bands():
                query.deadline.check()
                yield cost
                self._progress("connection", row + len(cost))

        ends = (query.start, query.goal)
        cutting = self._map.grid.corner_cutting
        try:
            with closing(bands()) as costs:
                there_is_one = connected(costs, ends, corner_cutting=cutting)
        except OutOfTimeError:
            return Status.UNKNOWN, _NO_TIME
        return (Status.UNKNOWN, _NO_CORRIDOR) if there_is_one else (Status.NO_PATH, "")


class CorridorCells:
    """A `Searcher` that reads what lies under a corridor before it searches there."""

    def __init__(self, state: StreamedMap, costs: CostWindows, workspace: Workspace) -> None:
        self._map = state
        self._costs = costs
        self._workspace = workspace
        block_rows, block_cols = costs.heights.block
        self._unit = (
            max(block_rows, LEAST_WINDOW),
            max(min(block_cols, 4 * LEAST_WINDOW), LEAST_WINDOW),
        )
        self._known: dict[Cell, Rectangle] = {}
        """Rectangles that have been read, by the row and column of the unit that it lies in."""

    def search(self, query: Query, work: Work, region: Region) -> Search:
        """A* inside the region, whose cells, and those beside them, are read first."""
        parts = self._under(region)
        cells = sum(rows * cols for _, _, rows, cols in parts)
        wanted = 12 * cells + 2 * _PAGE * sum(rows for _, _, rows, _ in parts)
        if wanted > (room := available_bytes()):
            raise InvalidMapError(
                f"wanted {wanted / 1e9:.2f} GB of memory for the {cells} cells under the "
                f"corridor, got {room / 1e9:.2f} GB: plan in several legs"
            )
        self.put(parts, query.deadline)
        work.stage_ends("read")
        place = (self._map.grid, query.start, query.goal, self._workspace, region)
        return work.searched(astar(*place, deadline=query.deadline))

    def put(self, parts: Iterable[Rectangle], deadline: Deadline = NEVER) -> None:
        """Read rectangles, each inside one unit, as far as they are not known; OutOfTimeError at
        the deadline.
        """
        unread = []
        for part in parts:
            unit = part[0] // self._unit[0], part[1] // self._unit[1]
            known = self._known.get(unit, part)
            whole = enclosing([part, known])
            if unit not in self._known or whole != known:
                unread.append(whole)
        for part, _, cost in self._costs.windows(unread):
            self._map.put(np.ascontiguousarray(cost), part[:2])
            self._known[part[0] // self._unit[0], part[1] // self._unit[1]] = part
            deadline.check()

    def _under(self, region: Region) -> list[Rectangle]:
        """For each unit of the map the least rectangle that holds its cells in the region and
        beside it.
        """
        high, wide = self._unit
        shape = self._map.shape
        inside = region.blocks().view(np.uint8)
        found = []
        for corner in itertools.product(range(0, shape[0], high), range(0, shape[1], wide)):
            unit = (*corner, high, wide)
            around = widened(unit, (1, 1), shape)
            down, right = slices(around)
            rows = region.row_block[down]
            cols = region.col_block[right]
            # the blocks inside, then their cells
            blocks = inside[rows[0] : rows[-1] + 1]
            blocks = blocks[:, cols[0] : cols[-1] + 1]
            left, top, width, height = cv2.boundingRect(blocks)
            top += rows[0]
            left += cols[0]
            row, end_row = np.searchsorted(region.row_block, (top, top + height)).tolist()
            col, end_col = np.searchsorted(region.col_block, (left, left + width)).tolist()
            cells = common((row, col, end_row - row, end_col - col), around)
            if cells and (part := common(widened(cells, (1, 1), shape), unit)):
                found.append(part)
        return found


def connected(bands: Iterable[Float2D], ends: Endpoints, *, corner_cutting: bool = True) -> bool:
    """Whether there is a path between two cells whose costs are below 1.

    `bands` are (h, w) float32 costs of the map's rows, from top to bottom, read no further than is
    needed. Without `corner_cutting` a diagonal step connects nothing that straight steps do not.
    """
    # (0 or 1, W) the component of each cell of the row above, 0 of those that are shut
    above = np.empty((0, 0), np.int64)
    found = [0, 0]
    row = 0
    for cost in bands:
        above = above.reshape(-1, cost.shape[1])
        passable = np.vstack((above > 0, cost < 1.0)).view(np.uint8)
        count, labels = cv2.connectedComponents(passable, connectivity=8 if corner_cutting else 4)
        # components that hang together above are one
        root = np.arange(count)
        first: dict[int, int] = {}
        touching = np.stack((above, labels[: len(above)]), -1).reshape(-1, 2)
        for old, new in np.unique(touching, axis=0).tolist():
            known = first.setdefault(old, new)
            root[root == root[new]] = root[known]
        found = [int(root[first.get(label, 0)]) for label in found]
        for n, (end_row, end_col) in enumerate(ends):
            if row <= end_row < row + len(cost):
                found[n] = int(root[labels[end_row - row + len(above), end_col]])
        above = root[labels[-1:]]
        row += len(cost)
        if all(found) and found[0] == found[1]:
            return True
        if any(label and label not in above for label in found):
            return False  # it ends above, and the other is not in it
    return False
