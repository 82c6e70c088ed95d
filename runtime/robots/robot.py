"""A robot: a stance, a price and its moves, composed.

*Stance*: where it may stand and go, what a patch touches, and why not. *Price*: what steps and
paths cost. *Moves*: what a search goes over; `CellMoves` goes over cells, a body's over states, and
only those have headings. Each is asked by way of a `Grid`, which they do not keep.
"""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from nnpp_edge.runtime.arrays import Bool, Cells, Float2D, Float32s, Floats
from nnpp_edge.runtime.cells import Cell, Rectangle, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP
from nnpp_edge.runtime.kernels.paths import measure, walk
from nnpp_edge.runtime.kernels.records import Hints, Packed
from nnpp_edge.runtime.options import CELLS
from nnpp_edge.runtime.search.astar import (
    Query,
    Search,
    Spreading,
    astar,
    cost_field,
    spreading,
)
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import SQRT2
from nnpp_edge.runtime.tuning import CORRIDOR, NEAR, WIDENED_CORRIDOR

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.changes import Change
    from nnpp_edge.runtime.map.grid import Grid
    from nnpp_edge.runtime.map.pyramid import Level
    from nnpp_edge.runtime.map.state import MapState
    from nnpp_edge.runtime.robots.body.attitude import PoseCheck
    from nnpp_edge.runtime.robots.body.poses import Poses
    from nnpp_edge.runtime.robots.body.search import States

Edges = Float32s
PathCosts = tuple[float, float, float]
"""Cost, length in cells and CC of a path, summed in float64."""
WAYS = tuple(zip(ROW_STEP, COL_STEP, strict=True))
"""(rows, columns) of the steps that lead from a cell to those beside it."""


class Stance:
    """Where a robot may stand and go: here, as a point, on a cell that is not shut."""

    reach: Cell = (0, 0)
    """Rows and columns from a cell to those that decide whether it may stand there."""

    checks = 0
    """Number of poses that have been checked so far."""

    def shut(self, point: "Grid", part: Rectangle) -> Bool | None:
        """(h, w) cells of a part of a point's map that are shut to it; None where it may go
        wherever a point may, or its moves' states decide.
        """
        return None

    def room(self, point: "Grid") -> Packed | None:
        """Obstacles of a point's map that its lines must keep away from, see `records.Room`."""
        return None

    def stands_at(self, grid: "Grid", *cells: Cell) -> list[bool]:
        """Whether each of these cells of the map can be stood on."""
        if grid.tiles is not None:
            for cell in cells:
                grid.tiles.open_at(*cell)
        return [math.isfinite(grid.weights[grid.node(*cell)]) for cell in cells]

    def touched(self, change: "Change", part: Rectangle, state: "MapState") -> "Change":
        """The change with all cells where it may stand or go otherwise than before."""
        return change

    def complete(self) -> None:
        """Check now all that is else checked where a search reads it."""

    def why_blocked(self, cell: Cell) -> str:
        """Why it cannot stand on a cell, where that is known better than by the cell's cost."""
        return ""


NO_EDGES = np.empty((0, len(WAYS)), np.float32)
"""Of steps that cost by the weights of their ends."""


class Price:
    """What steps and paths cost: here by the weights of a step's ends, see `terrain.step_cost`."""

    level_cell = 1.0
    """What a turn costs that is as dear as a cell's height of level ground."""

    def edges(self, backwards: bool = False) -> Edges:
        """(nodes, ways) costs of steps, or of those that come to a cell; (0, 8) where they cost by
        the weights of their ends: the same both ways, so that landmarks and any angle serve.
        """
        return NO_EDGES

    @property
    def directed(self) -> bool:
        """Whether steps cost by edges."""
        return len(self.edges()) > 0

    def weights(self, part: Rectangle) -> Float2D | None:
        """(h, w) weights of a part's cells, by which steps cost as with ``length``; None where they
        cost by the map's own weights, or by edges.
        """
        return None

    def bounds(self, grid: "Grid", shortest: float) -> tuple[float, float, float]:
        """Least cost of getting a straight and a diagonal step closer, and of the dearest step."""
        straight = grid.model.step(0, 2.0 * grid.least)
        diagonal = min(grid.model.step(1, 2.0 * grid.least), 2.0 * straight)
        return straight * shortest, diagonal * shortest, grid.model.step(0, 2.0 * grid.greatest)

    def walk(self, grid: "Grid", path: Cells, first: int, costs: Floats) -> int:
        """As `Grid.walk`."""
        return int(walk(grid.packed, path, first, costs))

    def costs_of(self, grid: "Grid", path: Cells) -> PathCosts:
        """Cost, length in cells and CC of a path, summed in float64; inf for an empty one."""
        if not len(path):
            return math.inf, math.inf, math.inf
        cost, straight, diagonal, total = measure(grid.packed, path)
        scale = grid.model.scale
        return cost, straight + SQRT2 * diagonal, total / scale if scale else 0.0

    def worth(self, start: Cell, end: Cell | None = None) -> Float32s | float:
        """By how much a path to `end`, or to each cell, costs more than its steps as searches take
        them.
        """
        return 0.0

    def follow(self, change: "Change", part: Rectangle, *, heights: bool) -> "Change":
        """The change with all cells whose steps cost otherwise than before."""
        return change

    def coarse(self, shape: Cell, prices: tuple[float, float]) -> "Price":
        """The price on a coarse level of this shape."""
        return Price()

    def pool(self, levels: Sequence["Level"], changed: Rectangle) -> Iterator[None]:
        """Bring coarse levels' steps up to date above a rectangle, stripe by stripe."""
        return iter(())


class CellMoves:
    """Searches over cells, eight ways from each. States' moves (`robots.body`) are a subclass,
    whose own members only the body's room asks for.
    """

    states_a_node = 1
    """Places of a search on a node."""
    columns = 2
    """Numbers of a place on a path: its cell, and of arcs its state."""
    over = CELLS
    """What a search goes over, by which methods are refused: see `options.METHODS`."""
    corridors = CORRIDOR, WIDENED_CORRIDOR
    """Widths of the corridor in which a path is looked for first, and of the next."""
    corridors_to_heading = corridors
    """Those to a goal with a heading."""
    corridor_tries = 1
    """How often coarse levels are searched, each time without the links that led nowhere."""
    most_levels = 64
    """Coarse levels that are searched, at most."""
    band_up_to = math.inf
    """Cells to the goal up to which a corridor has all of its band."""
    near = NEAR
    """Cells to a goal that is looked for on the whole map first."""
    weight_share = 1.0
    """Share of the cells' weight that counts on coarse levels, where the rest is not known."""
    line_refusal = ""
    """Why its paths cannot be freed from the grid; empty where they can."""
    shortest = 1.0
    """Length of the shortest way over that by straight and diagonal steps."""
    swing: Cell = (0, 0)
    """Rows and columns around an end that a corridor holds, too, where a heading is given there:
    the robot may have to turn round.
    """
    readiness = 0.0
    """By how much a robot on its way may have it cheaper than one that sets out from the same cell:
    as it need not turn round, or has the right gear in.
    """
    poses: "Poses | None" = None
    """Of a body: which have been checked, and with what result."""
    drives_both_ways = True
    """Whether a path is driven so both ways."""
    ways = WAYS

    def at_ends(self, query: Query) -> float:
        """By how much less a path may cost than a search's bound, as no steps are counted at ends
        with a heading.
        """
        return 0.0

    def turns_in_field(self, apart: int) -> float:
        """Share of what a body's turns cost that the costs to go in a corridor count, so many cells
        from start to goal.
        """
        raise NotImplementedError

    def states(self, price: Price) -> "States":
        """A body's motions, whose legs cost by the edges of a price, if it has any."""
        raise NotImplementedError

    def search(
        self,
        grid: "Grid",
        query: Query,
        workspace: Workspace,
        region: Region | None,
        hints: Hints | None = None,
        limit: int | None = None,
    ) -> Search:
        """The cheapest path of a query between passable cells, over the whole map or in a region.

        `hints` of landmarks spare expansions; after about `limit` expansions it gives up with
        TIMEOUT.
        """
        return astar(
            grid,
            query.start,
            query.goal,
            workspace,
            region,
            hints=hints,
            limit=limit,
            deadline=query.deadline,
        )

    def spreading(self, grid: "Grid", workspace: Workspace) -> Spreading:
        """How its costs spread from a cell to all others."""
        return spreading(grid)

    def walk_turns(
        self, grid: "Grid", path: Cells, first: int, costs: Floats, level_cell: float
    ) -> int:
        """As `walk`, where turns alone cost, see `Price.level_cell`."""
        blocked = Price().walk(grid, path, first, costs)
        costs[first:] = 0.0
        return blocked

    def direction(self, heading_deg: float) -> int:
        """The direction nearest to a heading, in degrees clockwise from grid north; -1 where none
        counts.
        """
        return -1

    def arrival(self, path: Cells) -> int:
        """Direction in which it comes to the end of a path, as `Plan.walked`; -1 where
        none counts.
        """
        return -1

    def ends(
        self, start_deg: float | None, goal_deg: float | None, tolerance_deg: float
    ) -> tuple[int, Bool | None]:
        """Directions at the start, -1 for any, and at the goal, None for any, as in `Query`.

        InvalidQueryError for headings of a robot that has none.
        """
        raise InvalidQueryError(
            "start_heading_deg and goal_heading_deg want a vehicle's body on elevations"
        )

    def came_to(
        self, grid: "Grid", start: Cell, memory: Workspace, deadline: Deadline = NEVER
    ) -> tuple[Bool, bool]:
        """Cells (H, W) to which the search came that has just found no path on the whole map, and
        whether from the start; else from the goal.
        """
        return memory.reached(grid.rows, deadline), True

    def may_open(self, grid: "Grid", query: Query, memory: Workspace, part: Rectangle) -> bool:
        """Whether a way out of the places that a search came to, which found no path for a query,
        can have opened where a rectangle of the map has changed.
        """
        nodes = grid.nodes(widened(part, (2, 2), grid.shape))
        came = np.isfinite(memory.costs(nodes.ravel())).reshape(nodes.shape)
        around = sliding_window_view(np.pad(came, 1), (3, 3)).any((2, 3))
        beside = nodes[around & ~came]
        return any(grid.is_passable(grid.cell(node)) for node in beside.tolist())

    def costs_of_cells(
        self, grid: "Grid", start: Cell, memory: Workspace, deadline: Deadline
    ) -> Float32s:
        """(H, W) costs of ways from a cell to all others, inf where there are none; of a body they
        are those of cells, whatever the direction, and promise too little.
        """
        return cost_field(grid, start, memory, deadline)

    def why_ended(
        self, grid: "Grid", start: Cell, goal: Cell, memory: Workspace, deadline: Deadline
    ) -> str:
        """Why the search of the whole map that has just ended got no farther; empty if unknown."""
        return ""

    def explain(self, cell: Cell, heading_deg: float) -> "PoseCheck":
        """How it stands on a cell with a heading, by each limit; InvalidQueryError
        without a body.
        """
        raise InvalidQueryError(
            "explain: wanted a vehicle with length, width and clearance on a map of elevations"
        )


class Robot(NamedTuple):
    """A stance, a price and moves."""

    stance: Stance = Stance()
    price: Price = Price()
    moves: CellMoves = CellMoves()

    @property
    def symmetric(self) -> bool:
        """Whether a path costs the same both ways, and is driven so."""
        return not self.price.directed and self.moves.drives_both_ways

    def follow(
        self, change: "Change", part: Rectangle, state: "MapState", *, heights: bool
    ) -> "Change":
        """The change with all cells whose steps may have changed, after one of the map's weights.

        `part` is where new heights, or else costs, were put; empty where none were new.
        """
        change = self.stance.touched(change, part, state)
        return self.price.follow(change, part, heights=heights)

    @property
    def readiness(self) -> float:
        """By how much a robot on its way may have it cheaper than one that sets out there."""
        return self.moves.readiness * self.price.level_cell

    @property
    def by_weights(self) -> bool:
        """Whether its searches go over cells, by their weights: landmarks serve them, and old
        weights tell what a change of the map is worth.
        """
        return not self.price.directed and self.moves.over == CELLS

    @property
    def line_refusal(self) -> str:
        """Why its paths cannot be freed from the grid; empty where they can."""
        if not self.price.directed:
            return self.moves.line_refusal
        return (
            "prices lines by the map's cost: wanted step_cost='paper' or 'length', got steps that "
            "cost by their slope"
        )

    def at_ends(self, query: Query) -> float:
        """By how much less a path may cost than a search's bound, see `CellMoves.at_ends`."""
        return self.moves.at_ends(query) * self.price.level_cell

    def states(self) -> "States":
        """A body's motions."""
        return self.moves.states(self.price)
