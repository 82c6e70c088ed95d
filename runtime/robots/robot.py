"""What the map, the searches and the planners ask of a robot, and never which kind it is.

A `Robot` is a point: it stands on a cell, and its steps cost by the weights of their ends. The
others, in the rooms `slope` and `body`, answer the same questions. All are asked by way of a
`Grid`, which they do not keep.
"""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from nnpp_edge.runtime.arrays import Bool, Cells, Float32s, Floats
from nnpp_edge.runtime.cells import Cell, Rectangle, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP
from nnpp_edge.runtime.kernels.paths import measure, walk
from nnpp_edge.runtime.kernels.records import Hints
from nnpp_edge.runtime.search.astar import (
    Links,
    Query,
    Search,
    Spreading,
    astar,
    settle_all,
    spreading,
)
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import SQRT2
from nnpp_edge.runtime.tuning import CORRIDOR, WIDENED_CORRIDOR

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


class Robot:
    """A point, whose steps cost by the weights of their ends, see `terrain.step_cost`."""

    # --- what kind of search serves it

    states_a_node = 1
    """Places of a search on a node."""
    columns = 2
    """Numbers of a place on a path: its cell, and its state where that counts."""
    by_poses = False
    """Whether a search goes over poses, which are checked, rather than over cells."""
    by_slope = False
    """Whether steps cost otherwise one way than the other."""
    keeps_old_weights = True
    """Whether a change of the map is known by the weights of its cells before and after."""
    learned_region = True
    """Whether a network's region serves it."""
    corridors = CORRIDOR, WIDENED_CORRIDOR
    """Widths of the corridor in which a path is looked for first, and of the next."""
    corridors_to_heading = CORRIDOR, WIDENED_CORRIDOR
    """Those to a goal with a heading."""
    drives_arcs = False
    """Whether its path is one of states, and what guides its search is kept for the next."""
    corridor_tries = 1
    """How often coarse levels are searched, each time without the links that led nowhere."""
    weight_share = 1.0
    """Share of the cells' weight that counts on coarse levels, where the rest is not known."""
    line_refusal = ""
    """Why its paths cannot be freed from the grid; empty where they can."""
    reach: Cell = (0, 0)
    """Rows and columns from a cell to those that are below the robot on its way from there."""
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
    checks = 0
    """Number of poses that have been checked so far."""
    symmetric = True
    """Whether a path costs the same both ways, and is driven so."""
    has_landmarks = True
    """Whether landmarks serve its searches: its steps cost alike both ways, without turns."""
    repairs = True
    """Whether D* Lite plans for it."""
    ways = tuple(zip(ROW_STEP, COL_STEP, strict=True))
    """(rows, columns) of the steps that lead from a cell."""

    def edges(self, backwards: bool = False) -> Edges | None:
        """Costs of the steps, as searches take them; `backwards` of those that come to a cell, on a
        coarse level.

        None where steps cost by the weights of their ends.
        """
        return None

    def states(self) -> "States":
        """A body's motions, where a search goes over its poses."""
        raise NotImplementedError

    def turns_in_field(self, apart: int) -> float:
        """Share of what a body's turns cost that the costs to go in a corridor count, so many cells
        from start to goal.
        """
        raise NotImplementedError

    def states_by(self, edges: Edges, metre: float) -> "States":
        """As `states`, where legs cost by `edges`, and turns by what a metre of level
        ground does.
        """
        raise NotImplementedError

    def weights(self, grid: "Grid") -> Float32s:
        """Weights by which its steps may lead, inf where they may not; empty where others
        decide.
        """
        return grid.weights

    # --- its search

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
        start, goal, _, deadline, *_ = query
        place = (grid, start, goal, workspace, region)
        return astar(*place, hints=hints, limit=limit, deadline=deadline)

    def spreading(self, grid: "Grid", workspace: Workspace, links: Links = None) -> Spreading:
        """How its costs spread from a cell to all others."""
        return spreading(grid, links)

    # --- where it may stand, and what its paths cost

    def stands_at(self, grid: "Grid", cell: Cell) -> bool:
        """Whether a cell of the map can be stood on."""
        if grid.tiles is not None:
            grid.tiles.open_at(*cell)
        return math.isfinite(grid.weights[grid.node(*cell)])

    def walk(self, grid: "Grid", path: Cells, first: int, costs: Floats) -> int:
        """As `Grid.walk`."""
        if grid.tiles is not None:
            grid.tiles.open_along(path[first:])
        return int(walk(grid.packed, path, first, costs))

    def walk_turns(self, grid: "Grid", path: Cells, first: int, costs: Floats, metre: float) -> int:
        """As `walk`, where turns alone cost, by what a metre of level ground does."""
        blocked = self.walk(grid, path, first, costs)
        costs[first:] = 0.0
        return blocked

    def costs_of(self, grid: "Grid", path: Cells) -> PathCosts:
        """Cost, length in cells and CC of a path, summed in float64; inf for an empty one."""
        if not len(path):
            return math.inf, math.inf, math.inf
        if grid.tiles is not None:  # a search may not have read all of it
            grid.tiles.open_along(path)
        straight, diagonal, by_straight, by_diagonal, total = measure(
            grid.weights, grid.stride, path
        )
        length_s, length_d, weight_s, weight_d = grid.model.steps
        lengths = length_s * straight + length_d * diagonal
        weights = weight_s * by_straight + weight_d * by_diagonal
        scale = grid.model.scale
        return lengths + weights, straight + SQRT2 * diagonal, total / scale if scale else 0.0

    def prices(self, grid: "Grid") -> tuple[float, float]:
        """Cost of getting a straight and a diagonal step closer where all cells are as cheap as the
        cheapest: by these the octile distance is no more than any path's cost.
        """
        straight = grid.model.step(0, 2.0 * grid.least)
        diagonal = min(grid.model.step(1, 2.0 * grid.least), 2.0 * straight)
        return straight * self.shortest, diagonal * self.shortest

    def greatest(self, grid: "Grid") -> float:
        """No step costs more."""
        return grid.model.step(0, 2.0 * grid.greatest)

    def worth_of_height(self, start: Cell, goal: Cell) -> float:
        """By how much a path between two cells costs more than its steps as searches take them."""
        return 0.0

    def with_heights(self, field: Float32s, start: Cell) -> Float32s:
        """(H, W) costs from a cell to every other, given what a search sums up."""
        return field

    # --- what a change of the map touches

    def complete(self) -> None:
        """Compute now all that is else computed where a search reads it."""

    def follow(
        self, change: "Change", part: Rectangle, state: "MapState", *, heights: bool
    ) -> "Change":
        """The change with all cells whose steps may have changed, after one of the map's weights.

        `part` is where new heights, or else costs, were put; empty where none were new.
        """
        return change

    def coarse(self, shape: Cell, prices: tuple[float, float]) -> "Robot":
        """The robot on a coarse level of this shape."""
        return Robot()

    def pool(self, levels: Sequence["Level"], changed: Rectangle) -> Iterator[None]:
        """Bring the steps of coarse levels up to date above a rectangle of the map, stripe by
        stripe.
        """
        return iter(())

    # --- headings

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
        if start_deg is None and goal_deg is None:
            return -1, None
        raise InvalidQueryError(
            "start_heading_deg and goal_heading_deg want a vehicle's body on elevations"
        )

    # --- why not

    def why_blocked(self, cell: Cell) -> str:
        """Why it cannot stand on a cell, where that is known better than by the cell's cost."""
        return ""

    def came_to(
        self, grid: "Grid", start: Cell, memory: Workspace, deadline: Deadline = NEVER
    ) -> tuple[Bool, bool]:
        """Cells (H, W) to which the search came that has just found no path on the whole map, and
        whether from the start; else from the goal.
        """
        return grid.inner(memory.reached(deadline)), True

    def may_open(self, grid: "Grid", query: Query, memory: Workspace, part: Rectangle) -> bool:
        """Whether a way out of the places that a search came to, which found no path for a query,
        can have opened where a rectangle of the map has changed.
        """
        nodes = grid.nodes(widened(part, (2, 2), grid.shape))
        came = np.isfinite(memory.costs(nodes.ravel())).reshape(nodes.shape)
        around = sliding_window_view(np.pad(came, 1), (3, 3)).any((2, 3))
        beside = nodes[around & ~came]
        return any(self.stands_at(grid, grid.cell(node)) for node in beside.tolist())

    def costs_of_cells(
        self, grid: "Grid", start: Cell, memory: Workspace, deadline: Deadline
    ) -> Float32s:
        """(H, W) costs of ways from a cell to all others, inf where there are none; of a body they
        are those of cells, whatever the direction, and promise too little.
        """
        settle_all(grid, start, memory, deadline=deadline)
        return self.with_heights(grid.inner(memory.costs()), start)

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
