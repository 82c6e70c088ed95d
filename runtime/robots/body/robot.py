"""Robots with a body: legs and turns on the spot between sixteen directions, or arcs as well."""

import math
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Cells, Floats
from nnpp_edge.runtime.cells import Cell, Rectangle, Sides
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.lattice import KNIGHT
from nnpp_edge.runtime.kernels.records import BY_LENGTH, FIXED, Hints, Prices
from nnpp_edge.runtime.options import STATES
from nnpp_edge.runtime.robots.body import motions
from nnpp_edge.runtime.robots.body.arcs import direction_near, directions_within
from nnpp_edge.runtime.robots.body.attitude import PoseCheck, explain
from nnpp_edge.runtime.robots.body.poses import NOTHING, Poses
from nnpp_edge.runtime.robots.body.refusal import why_blocked, why_ended
from nnpp_edge.runtime.robots.body.search import (
    FromGoal,
    States,
    cells_reached,
    costs_of_cells,
    may_open,
    search_states,
    spreading,
)
from nnpp_edge.runtime.robots.robot import (
    CellMoves,
    PathCosts,
    Price,
    Robot,
    Stance,
)
from nnpp_edge.runtime.search.astar import Query, Search, Spreading
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.runtime.tuning import (
    ARC_CORRIDOR,
    ARC_TURNS_IN_FIELD,
    BODY_BAND_UP_TO,
    BODY_CORRIDOR,
    BODY_WEIGHT,
    MOST_ARC_CORRECTIONS,
    MOST_CORRECTIONS,
    MOST_SWING,
    ROOMY_ARC_CORRIDOR,
    SWING,
    TURNS_IN_FIELD,
    WIDENED_ARC_CORRIDOR,
    WIDENED_BODY_CORRIDOR,
)

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.changes import Change
    from nnpp_edge.runtime.map.grid import Grid
    from nnpp_edge.runtime.map.state import MapState


class BodyStance(Stance):
    """Where a body stands on the ground, by its checks."""

    def __init__(self, poses: Poses) -> None:
        self.poses = poses
        self.reach = poses.reach

    @property
    def checks(self) -> int:  # type: ignore[override]  # a number of the class in others
        return self.poses.checked

    def stands_at(self, grid: "Grid", *cells: Cell) -> list[bool]:
        return [self.poses.stands_at(cell) for cell in cells]

    def touched(self, change: "Change", part: Rectangle, state: "MapState") -> "Change":
        if not part[2]:
            return change
        ground = state.heights
        assert ground is not None
        known = ground.known(part)
        touched = self.poses.write(part, known, ground.shut(part), ground.added(part))
        return change._replace(part=touched, cells=touched[2] * touched[3], cheaper=True)

    def complete(self) -> None:
        self.poses.complete()

    def why_blocked(self, cell: Cell) -> str:
        return why_blocked(self.poses, cell)


class BodyPrice(Price):
    """A leg costs its length by what it is checked to be, a turn by its angle."""

    def __init__(self, poses: Poses) -> None:
        self.poses = poses

    def bounds(self, grid: "Grid", shortest: float) -> tuple[float, float, float]:
        straight, diagonal, _ = super().bounds(grid, shortest)
        return straight, diagonal, math.sqrt(5.0) * (1.0 + 2.0 * grid.model.scale)

    def walk(self, grid: "Grid", path: Cells, first: int, costs: Floats) -> int:
        return self.poses.walk(path, first, costs)

    def costs_of(self, grid: "Grid", path: Cells) -> PathCosts:
        if not len(path):
            return math.inf, math.inf, math.inf
        costs = np.zeros(len(path))
        cost = math.inf if self.poses.walk(path, 0, costs) >= 0 else float(costs[-1])
        lengths, rated = self.poses.cost_along(path)
        return cost, float(lengths.sum()), float((lengths * rated).sum())


class BodyMoves(CellMoves):
    """Legs, and turns on the spot between sixteen directions."""

    over = STATES
    most_levels = 1
    band_up_to = BODY_BAND_UP_TO
    corridors = corridors_to_heading = BODY_CORRIDOR, WIDENED_BODY_CORRIDOR
    corridor_tries = MOST_CORRECTIONS
    weight_share = BODY_WEIGHT
    line_refusal = "is for points and discs: a body's legs lead in 16 directions"
    ways = motions.LEGS

    poses: Poses

    def __init__(self, poses: Poses) -> None:
        self.poses = poses
        self.states_a_node = len(poses.prices.moves)
        self.shortest = KNIGHT * poses.shortest
        self.readiness = float(poses.prices.turns.max())
        self._from_goal: FromGoal | None = None
        """Of the newest query."""

    def at_ends(self, query: Query) -> float:
        turns = int(query.direction >= 0) + int(query.wanted is not None)
        return turns * self.readiness

    def turns_in_field(self, apart: int) -> float:
        return TURNS_IN_FIELD

    def states(self, price: Price) -> States:
        prices = self._turns_by(price.level_cell) if price.directed else self.poses.prices
        return States(self.poses.packed, price.edges(), prices)

    def _turns_by(self, level_cell: float) -> Prices:
        """The prices of its motions, where turns cost by `Price.level_cell`."""
        prices = self.poses.prices
        fares = prices.fares.copy()
        fares[..., FIXED] *= level_cell
        return prices._replace(fares=fares, turns=prices.turns * np.float32(level_cell))

    def search(
        self,
        grid: "Grid",
        query: Query,
        workspace: Workspace,
        region: Region | None,
        hints: Hints | None = None,
        limit: int | None = None,
    ) -> Search:
        """As `Robot.search`; one search from the goal serves all regions of a query, but for
        a short search and where legs cost otherwise one way than the other.
        """
        from_goal = None
        if limit is None and not grid.robot.price.directed:
            from_goal = self._from_goal
            if from_goal is None or from_goal.query is not query:
                from_goal = self._from_goal = FromGoal(grid, query, workspace.from_goal)
        return search_states(grid, query, workspace, region, from_goal, limit)

    def spreading(self, grid: "Grid", workspace: Workspace) -> Spreading:
        everywhere = np.ones(workspace.states, np.bool_)
        return spreading(grid, workspace, everywhere, ~everywhere)

    def walk_turns(
        self, grid: "Grid", path: Cells, first: int, costs: Floats, level_cell: float
    ) -> int:
        prices = self._turns_by(level_cell)
        prices.fares[..., BY_LENGTH] = 0.0
        prices = prices._replace(unit=np.float32(0.0))
        return self.poses.walk(path, first, costs, prices=prices)

    def direction(self, heading_deg: float) -> int:
        return direction_near(heading_deg, self.poses.sides_m)

    def arrival(self, path: Cells) -> int:
        if len(path) < 2:
            return -1
        down, right = (path[-1, :2] - path[-2, :2]).tolist()
        return motions.LEGS.index((down, right))

    def ends(
        self, start_deg: float | None, goal_deg: float | None, tolerance_deg: float
    ) -> tuple[int, Bool | None]:
        headings = start_deg, goal_deg
        finite = all(each is None or math.isfinite(each) for each in headings)
        if not finite or not tolerance_deg >= 0.0:
            raise InvalidQueryError(
                f"headings must be numbers of degrees, got {headings}, {tolerance_deg}"
            )
        begin = -1 if start_deg is None else self.direction(start_deg)
        if goal_deg is None:
            return begin, None
        return begin, directions_within(goal_deg, tolerance_deg, self.poses.sides_m)

    def came_to(
        self, grid: "Grid", start: Cell, memory: Workspace, deadline: Deadline = NEVER
    ) -> tuple[Bool, bool]:
        from_goal = self._from_goal
        if memory.states == 1:
            return memory.reached(grid.rows, deadline), False
        if from_goal and memory is from_goal.memory:
            return cells_reached(grid, from_goal.query.goal, memory, deadline), False
        return cells_reached(grid, start, memory, deadline), True

    may_open = staticmethod(may_open)
    costs_of_cells = staticmethod(costs_of_cells)

    def why_ended(
        self, grid: "Grid", start: Cell, goal: Cell, memory: Workspace, deadline: Deadline
    ) -> str:
        reached, from_start = self.came_to(grid, start, memory, deadline)
        end = goal if from_start else start
        by_legs = memory.states == 1
        return why_ended(self.poses, reached, end, by_legs=by_legs, from_goal=not from_start)

    def explain(self, cell: Cell, heading_deg: float) -> PoseCheck:
        return explain(self.poses, cell, heading_deg)


class ArcMoves(BodyMoves):
    """Arcs too: the path is one of states."""

    columns = 3
    near = 0
    corridor_tries = MOST_ARC_CORRECTIONS
    drives_both_ways = False
    corridors = ARC_CORRIDOR, WIDENED_ARC_CORRIDOR
    corridors_to_heading = ROOMY_ARC_CORRIDOR, WIDENED_ARC_CORRIDOR

    def __init__(self, poses: Poses) -> None:
        super().__init__(poses)
        self._radius = (poses.vehicle.turning_radius_m or 0.0) / min(poses.sides_m)
        """Its turning radius, in cells."""
        if poses.vehicle.reverse_cost:
            swing = min(int(SWING * self._radius), MOST_SWING)
            self.swing = swing, swing
        else:
            self.corridors = self.corridors_to_heading
        self.readiness = poses.vehicle.gear_change_m / poses.sides_m[0]

    def at_ends(self, query: Query) -> float:
        return 0.0

    def turns_in_field(self, apart: int) -> float:
        far = apart * self._radius
        return next(share for within, share in ARC_TURNS_IN_FIELD if far <= within)

    def arrival(self, path: Cells) -> int:
        return int(path[-1, 2]) % len(motions.LEGS)


def body_on(state: "MapState", vehicle: Vehicle, sides_m: Sides) -> Robot:
    """The robot of a vehicle with a body, by its poses."""
    heights = state.heights
    assert heights is not None
    whole = (0, 0, *state.shape)
    blocks = NOTHING if heights.unseen is None else heights.unseen.layers[0]
    poses = Poses(
        heights.known(whole),
        sides_m,
        vehicle,
        heights.limits.body_weights,
        state.grid.model.scale,
        heights.shut(whole),
        blocks,
        heights.added(whole),
    )
    moves = BodyMoves if vehicle.turning_radius_m is None else ArcMoves
    return Robot(BodyStance(poses), BodyPrice(poses), moves(poses))
