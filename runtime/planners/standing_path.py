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

from nnpp_edge.runtime.arrays import Int32
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.lattice import DIRECTION_COUNT
from nnpp_edge.runtime.kernels.nodes import octile
from nnpp_edge.runtime.kernels.paths import remember, savings
from nnpp_edge.runtime.map.state import MapState
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.robots.body import arcs
from nnpp_edge.runtime.tuning import (
    JOIN_WITHIN,
    MOST_CHANGED,
    MOST_DRIFT,
    MOST_LOGGED_CHANGES,
    ON_ARC,
    ON_ARC_DEG,
)

Departure = tuple[Cell, float]
"""A cell, and the heading in degrees in which a body leaves it."""
_ROUNDING = 1e-6
"""Share by which a bound may be off, as the searches keep g in float32."""
_IN_STATE = 0.05
"""Cells from a cell's middle, and degrees from one of the sixteen headings, up to which a body is
exactly in a state."""
_MANY = 1 << 16
"""Changed cells that may wait to be read."""
_LAST_STAMP = int(np.iinfo(np.int32).max)


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
    blocked_at: Cell | None = None
    """First cell that can no longer be stepped on."""
    blocked: int = -1
    """Its number on the path."""
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

    What has changed it reads from the map's log when it is checked: that takes time by the cells of
    the path and those that changed, not by the map.
    """

    def __init__(self, state: MapState) -> None:
        self._grid = state.grid
        self._by_parts = not state.grid.robot.by_weights
        nodes = 0 if self._by_parts else len(state.grid.weights)
        self._changes = state.log.reader(keeps_old_weights=not self._by_parts)
        self._parts: list[Rectangle] = []
        """Where poses or directed steps have changed since the path was set: of these no old costs
        are kept.
        """
        self._before = np.empty(nodes, np.float32)
        """Weights of changed nodes when the path was set."""
        self._noted = np.zeros(nodes, np.int32)
        """The stamp, for nodes that stand in `_before`."""
        self._touched = np.empty(nodes, np.int32)
        self._stamp = 1
        self._count = 0
        self.plan: Plan | None = None
        """The plan whose path stands; to be changed by `set` and `forget` alone."""
        self._walked = self._scratch = np.empty(0)
        self._passed = 0
        """Number of the state that a body has passed last."""
        self._searched = self._excess = 0.0
        """What the path cost when it was last searched for, and by how much it costs more since
        it was joined.
        """
        self._changed = 0
        """Cells that have changed since then, where no old costs are kept."""

    def set(self, plan: Plan, excess: float | None = None) -> None:
        """Follow this plan's path from now on; the plan must have been made on the map as it is
        now. If it was not searched for, but joined to the one before, that has this `excess`.

        InvalidQueryError where it has no path to the goal, or the path cannot be walked.
        """
        if not plan.ok or not len(plan.path):
            raise InvalidQueryError(
                f"a standing path must lead to the goal, got a plan of status {plan.status}"
            )
        walked = np.empty(len(plan.path))
        if self._grid.walk(plan.walked, 0, walked) >= 0:
            raise InvalidQueryError("a standing path must be walkable on the map it was planned on")
        if excess is None:
            self._changed = 0
            excess = 0.0
        self._excess = excess
        self._searched = plan.cost - excess
        self.plan = plan
        self._walked = walked
        self._scratch = np.empty(len(walked))
        self._count = 0
        self._passed = 0
        self._parts = []
        self._changes.skip()
        if self._stamp == _LAST_STAMP:
            self._noted[:] = 0
            self._stamp = 0
        self._stamp += 1

    def forget(self) -> None:
        """There is no path to follow."""
        self.plan = None
        self._count = 0
        self._parts = []
        self._changes.skip()

    def catch_up(self) -> None:
        """Read what has changed now if so much waits to be read that it would hold memory."""
        unread = self._changes.peek()
        if (
            len(unread) > MOST_LOGGED_CHANGES // 2
            or sum(len(change.nodes) for change in unread) > _MANY
        ):
            self._read_changes()

    def check(self, at: Cell, direction: int = -1) -> Standing:
        """How the path stands for a robot in the cell `at`, heading in a direction; -1 where it is
        not given.
        """
        self._read_changes()
        if self.plan is None:
            return Standing(Footing.NONE)
        path = self.plan.path
        way = self.plan.walked
        grid = self._grid
        index = self.number_on(way, at, direction)
        if index < 0:
            return Standing(Footing.OFF_PATH)
        goal = (int(path[-1, 0]), int(path[-1, 1]))
        walked = float(self._walked[index])
        straight = grid.least_cost(at, goal)
        rest = float(self._walked[-1]) - walked, (1.0 - _ROUNDING) * self.plan.lower_bound - walked
        floor, lower = (
            max(bound, straight) for bound in self._bounds_now(rest, at, goal, direction)
        )
        blocked = self._grid.walk(way, index, self._scratch)
        if blocked >= 0:
            cell = int(path[blocked, 0]), int(path[blocked, 1])
            return Standing(Footing.BLOCKED, index, cell, blocked, lower_bound=lower, floor=floor)
        cost = float(self._scratch[-1])
        bounds = (min(lower, cost), min(floor, cost))
        return Standing(Footing.VALID, index, None, -1, cost, *bounds)

    @staticmethod
    def number_on(way: Int32, at: Cell, direction: int) -> int:
        """Number of the first state of a way, as `Plan.walked`, in which a robot is that heads in a
        direction; -1 where it is beside it.
        """
        here = (way[:, 0] == at[0]) & (way[:, 1] == at[1])
        if direction >= 0 and way.shape[1] > 2:  # such a path may cross itself
            here &= way[:, 2] % DIRECTION_COUNT == direction
        hits = np.flatnonzero(here)
        return int(hits[0]) if len(hits) else -1

    def near(self, way: Int32, at: Cell, direction: int) -> tuple[int, bool] | None:
        """Number of the state of a way from which a robot goes on along it, and whether the robot
        is beside it; None where it is far from it.
        """
        index = self.number_on(way, at, direction)
        if index >= 0:
            return index, False
        away = np.abs(way[:, :2] - np.array(at, np.int32)).max(1)
        index = int(away.argmin())
        return (index, True) if away[index] <= JOIN_WITHIN else None

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
        if not near.any():
            return None
        # the nearest pose of the first piece that is near: after a change of gear the path may
        # lead along itself
        first = int(near.argmax())
        farther = np.append(np.diff(away[first:]) > 0.0, True)
        index = int(leaving[first + farther.argmax()])
        self._passed = index
        if self._grid.walk(plan.walked[index : index + 2], 0, self._scratch) >= 0:
            return None
        at = int(plan.path[index, 0]), int(plan.path[index, 1])
        return at, float(plan.headings_deg[index])

    def excess(self, cost: float, index: int) -> float:
        """By how much a path that follows the rest from a state on, for the most part, costs more
        than that did when it was searched for.
        """
        return cost - self._searched + float(self._walked[index])

    def is_as_good(self, cost: float, excess: float, floor: float) -> bool:
        """Whether a path of this cost and `excess`, where none costs less than `floor`, is about as
        good as another search would find.

        Of a robot whose old costs are not kept a better path may open unnoticed, until much of the
        map has changed.
        """
        share = MOST_DRIFT - 1.0
        better = cost - floor > share * abs(cost)
        if self._by_parts:
            better = self._changed > MOST_CHANGED * self._grid.cells
        return not better and excess <= max(share * abs(cost), self._excess)

    def _read_changes(self) -> None:
        """Note what changed nodes weighed when the path was set."""
        if self.plan is None:
            self._changes.skip()
        for change in self._changes.read():
            if self._by_parts:
                self._changed += change.cells
                self._parts.append(change.part)
                continue
            self._count = remember(
                change.nodes,
                change.old_weights,
                self._before,
                self._noted,
                self._stamp,
                self._touched,
                self._count,
            )

    def _bounds_now(
        self, bounds: tuple[float, ...], at: Cell, goal: Cell, direction: int
    ) -> list[float]:
        """Bounds of the paths of now, given bounds of those on the map as it was."""
        grid = self._grid
        if self._by_parts:
            by_way = min(
                (self._by_way_of(part, at, goal) for part in self._parts), default=math.inf
            )
            if self.plan is not None and self.plan.states is not None and direction < 0:
                return [-math.inf for _ in bounds]  # another path may begin in any direction
            return [min(bound - grid.robot.readiness, by_way) for bound in bounds]
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
        saved *= 2.0 * max(grid.model.weight_term)
        if (
            not grid.corner_cutting
        ):  # beside a cell that was opened, a diagonal step may have become allowed
            by_opened -= 2.0 * grid.prices[0]
        return [min(bound, max(bound - saved, by_cheaper), by_opened) for bound in bounds]

    def _by_way_of(self, part: Rectangle, at: Cell, goal: Cell) -> float:
        """The least that a path by way of a rectangle's cells costs."""
        row, col, rows, cols = part
        cost = float(self._grid.robot.price.worth(at, goal))
        for end in (at, goal):
            near_row = min(max(end[0], row), row + rows - 1)
            near_col = min(max(end[1], col), col + cols - 1)
            cost += octile.py_func(*end, near_row, near_col, *self._grid.prices)
        return cost
