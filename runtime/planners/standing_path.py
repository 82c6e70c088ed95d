"""Whether the path that stands still holds on a map that has changed, and how much worse it can
have become.

A robot on its way need not plan anew at every change of the map. What it must know is whether the
rest of its path can still be walked, what that costs now, and how much cheaper another path can
have become.

The bound. On the map as it was, no path from the robot's cell costs less than the bound that came
with the plan, less what the robot has walked since. A path on the map as it is now
- meets no cell that has become cheaper: then it costs what it did or more;
- meets such cells, but none that was impassable: then it cost at most the sum of their savings
  more, as each cell
  takes part in two steps;
- meets a cell that was impassable: then it costs at least the octile distance by way of it. With a
  vehicle, or with directed steps, old costs are not kept: a path that meets a rectangle in which
  heights have changed costs at least the octile distance by way of it; directed, that and what the
  height between its ends is worth. The least of the three bounds every path. Cells that became
  dearer change nothing.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from nnpp_edge.runtime.arrays import Floats, Int32
from nnpp_edge.runtime.cells import Cell, Rectangle, cell_of
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.kernels.paths import remember, savings
from nnpp_edge.runtime.map.changes import Change
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.joining import ON_IT, nearest_on
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.robots.body import arcs
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.tuning import MOST_CHANGED, MOST_DRIFT, ON_ARC, ON_ARC_DEG

Departure = tuple[Cell, float]
"""A cell, and the heading in degrees in which a body leaves it."""
_ROUNDING = 1e-6
"""Share by which a bound may be off, as the searches keep g in float32."""
_IN_STATE = 0.05
"""Cells from a cell's middle, and degrees from one of the sixteen headings, up to which a body is
exactly in a state."""


class Footing(StrEnum):
    """Whether a standing path can still be followed."""

    VALID = "valid"
    BLOCKED = "blocked"
    """A cell of what is left of it is impassable now, or a corner that it cuts may not be cut."""
    OFF_PATH = "off_path"
    """The robot is not on it."""
    NONE = "none"
    """There is none."""


@dataclass(frozen=True)
class Standing:
    """The rest of the standing path, on the map as it is now."""

    footing: Footing
    index: int = -1
    """Of the robot's cell on the path; -1 where it is not on it."""
    blocked: int = -1
    """Number on the path of the first cell that can no longer be stepped on."""
    cost: float = math.inf
    """Of what is left of the path; inf unless it is valid."""
    lower_bound: float = 0.0
    """No path from the robot's cell to the goal costs less now."""
    floor: float = 0.0
    """No path would cost less now, had the plan been optimal when it was made; 0 where the robot is
    off the path.
    """

    @property
    def valid(self) -> bool:
        """Whether the rest of the path can be walked."""
        return self.footing is Footing.VALID

    @property
    def added(self) -> float:
        """The rest of the path exceeds the optimum by at most so much more than the plan did when
        it was made.
        """
        return max(self.cost - self.floor, 0.0)

    @property
    def bound(self) -> float:
        """The rest of the path costs at most this many times the optimum."""
        if self.lower_bound > 0.0:
            return max(self.cost / self.lower_bound, 1.0)
        return 1.0 if self.cost == 0.0 else math.inf


class StandingPath:
    """The path that a robot follows, on a map that changes under it. Serves one thread at a time.

    What has changed it reads from the map's log: to check it takes time by the cells of the path
    and those that changed, not by the map.
    """

    plan: Plan | None = None
    """The plan whose path stands; to be changed by the methods alone."""
    end: Cell | None = None
    """Where the path leads."""

    # of that path, from `set` on
    _way: Int32
    _walked: Floats
    """Costs from the start to each state."""
    _least: Floats
    """Costs of the path had the plan been optimal, and by its bound."""
    _passed: int
    """Number of the state that a body has passed last."""
    _searched: float
    _excess: float
    """What the path cost when it was last searched for, and by how much it costs more since it was
    joined.
    """
    _changed: int
    """Cells that have changed since then, where no old costs are kept."""
    _parts: list[Rectangle]
    """Where poses or directed steps have changed since the path was set: of these no old costs are
    kept.
    """

    def __init__(self, state: MapState) -> None:
        self._grid = state.grid
        self._by_parts = not state.grid.robot.by_weights
        nodes = 0 if self._by_parts else len(state.grid.weights)
        self._changes = state.log.reader(keeps_old_weights=not self._by_parts)
        self._before = np.empty(nodes, np.float32)
        """Weights of changed nodes when the path was set."""
        self._noted = np.zeros(nodes, np.bool_)
        """The nodes that stand in `_before`."""
        self._touched = np.empty(nodes, np.int32)
        self._count = 0

    def set(self, plan: Plan) -> None:
        """Follow this plan's path from now on; the plan must have been made on the map as it is
        now.

        InvalidQueryError where the path cannot be walked.
        """
        way = plan.walked
        walked = np.empty(len(way))
        if self._grid.walk(way, 0, walked) >= 0:
            raise InvalidQueryError("a standing path must be walkable on the map it was planned on")
        self.plan = plan
        self.end = cell_of(way[-1])
        self._way = way
        self._walked = walked
        self._least = np.array((walked[-1], (1.0 - _ROUNDING) * plan.lower_bound))
        self._searched = plan.cost
        self._excess = 0.0
        self._changed = self._passed = 0
        self._parts = []
        self._noted[self._touched[: self._count]] = False
        self._count = 0
        self._changes.skip()

    def set_joined(self, plan: Plan, place: Query, *, as_good: bool) -> bool:
        """Follow the path of a plan from now on that was joined to this one. False, and this one
        stands, where with `as_good` a search may find a better one.

        Of a robot whose old costs are not kept a better path may open unnoticed, until much of the
        map has changed.
        """
        index, _ = nearest_on(self._way, place.start, place.direction)
        excess = plan.cost - self._searched + float(self._walked[index])
        if as_good:
            drift = (MOST_DRIFT - 1.0) * abs(plan.cost)
            better = plan.cost - self.check(place.start, place.direction).floor > drift
            if self._by_parts:
                better = self._changed > MOST_CHANGED * self._grid.cells
            if better or excess > max(drift, self._excess):
                return False
        changed = self._changed
        self.set(plan)
        self._searched -= excess
        self._excess = excess
        self._changed = changed
        return True

    def forget(self) -> None:
        """There is no path to follow."""
        self.plan = self.end = None

    def check(self, at: Cell, direction: int = -1) -> Standing:
        """How the path stands for a robot in the cell `at`, heading in a direction; -1 where it is
        not given.
        """
        self.catch_up()
        if self.plan is None:
            return Standing(Footing.NONE)
        way = self._way
        index, away = nearest_on(way, at, direction)
        if away != ON_IT:
            return Standing(Footing.OFF_PATH)
        floor, lower = self._bounds(index, at, direction)
        costs = np.empty(len(way))
        blocked = self._grid.walk(way, index, costs)
        if blocked >= 0:
            return Standing(Footing.BLOCKED, index, blocked, math.inf, lower, floor)
        cost = float(costs[-1])
        return Standing(Footing.VALID, index, -1, cost, min(lower, cost), min(floor, cost))

    def passed(self, row: float, col: float, heading_deg: float) -> Departure | None:
        """The state that a body has passed last, where it drives along the path's arcs and the one
        that it is on is clear; else None.

        Never one before the last that was given: a path may come by the same place again.
        """
        plan = self.plan
        if plan is None or plan.drive is None or plan.along is None:
            return None
        poses = plan.drive.poses
        sides_m = plan.along.sides_m
        # exactly in a state a path may as well begin there: where the path comes by twice, in
        # another gear, the body would be sent back each time
        nearest = arcs.heading_deg(arcs.direction_near(heading_deg, sides_m), sides_m)
        turn = math.remainder(heading_deg - nearest, 360.0)
        if max(abs(row - round(row)), abs(col - round(col)), abs(turn)) < _IN_STATE:
            return None
        offsets = poses[:, 1::-1] - np.multiply((row, col), sides_m)
        turned = np.abs((poses[:, 2] - heading_deg + 180.0) % 360.0 - 180.0)
        within_m = ON_ARC * max(*sides_m, arcs.POSES_EVERY_M)
        away = np.hypot(*offsets.T) / within_m + turned / ON_ARC_DEG
        leaving = np.append(plan.drive.steps[1:], len(plan.path) - 1)
        near = (away <= 1.0) & (leaving >= self._passed)
        # the nearest pose of the first piece that is near: after a change of gear the path may
        # lead along itself
        first = int(near.argmax())
        if not near[first]:
            return None
        farther = np.append(np.diff(away[first:]) > 0.0, True)
        index = int(leaving[first + farther.argmax()])
        self._passed = index
        piece = self._way[index : index + 2]
        if self._grid.walk(piece, 0, np.empty(len(piece))) >= 0:
            return None
        return cell_of(piece[0]), arcs.heading_deg(int(piece[0, 2]), sides_m)

    def catch_up(self) -> None:
        """Read what has changed, so that it does not wait: note what changed nodes weighed when the
        path was set.
        """
        if self.plan is None:
            self._changes.skip()
        for change in self._changes.read():
            if self._by_parts:
                self._changed += change.cells
                self._parts.append(change.part)
                continue
            self._note(change)

    def prepare(self) -> None:
        """Load the kernels that read changes and bound paths."""
        if not self._by_parts:
            self._note(Change((0, 0, 0, 0), 0))
            self._savings((0, 0), (0, 0))

    def _note(self, change: Change) -> None:
        self._count = remember(
            change.nodes,
            change.old_weights,
            self._before,
            self._noted,
            self._touched,
            self._count,
        )

    def _savings(self, at: Cell, goal: Cell) -> tuple[float, float, float]:
        grid = self._grid
        saved, by_cheaper, by_opened = savings(
            grid.weights,
            self._before,
            self._touched,
            self._count,
            grid.stride,
            at,
            goal,
            grid.prices,
        )
        if not grid.corner_cutting:
            # beside a cell that was opened, a diagonal step may have become allowed
            by_opened -= 2.0 * grid.prices[0]
        return saved * 2.0 * max(grid.model.weight_term), by_cheaper, by_opened

    def _bounds(self, index: int, at: Cell, direction: int) -> tuple[float, float]:
        """No path from a state of the path on costs less now: had the plan been optimal when it was
        made, and by its own bound.
        """
        grid = self._grid
        goal = self.end
        assert goal is not None
        bounds = self._least - self._walked[index]
        if self._by_parts:
            if self._way.shape[1] > 2 and direction < 0:
                bounds[:] = -math.inf  # another path may begin in any direction
            bounds -= grid.robot.readiness
            for part in self._parts:
                bounds = np.minimum(bounds, self._by_way_of(part, at, goal))
        else:
            saved, by_cheaper, by_opened = self._savings(at, goal)
            cheaper = np.maximum(bounds - saved, by_cheaper)
            bounds = np.minimum(np.minimum(bounds, cheaper), by_opened)
        floor, lower = np.maximum(bounds, grid.least_cost(at, goal)).tolist()
        return floor, lower

    def _by_way_of(self, part: Rectangle, at: Cell, goal: Cell) -> float:
        """The least that a path by way of a rectangle's cells costs."""
        row, col, rows, cols = part
        cost = float(self._grid.robot.price.worth(at, goal))
        for end in (at, goal):
            near_row = min(max(end[0], row), row + rows - 1)
            near_col = min(max(end[1], col), col + cols - 1)
            cost += octile.py_func(*end, near_row, near_col, *self._grid.prices)
        return cost
