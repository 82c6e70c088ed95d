"""Whether the path that stands still holds on a map that has changed, and how much worse it can have become.

A robot on its way need not plan anew at every change of the map. What it must know is whether the rest of its
path can still be walked, what that costs now, and how much cheaper another path can have become.

The bound. On the map as it was, no path from the robot's cell costs less than the bound that came with the plan,
less what the robot has walked since. A path on the map as it is now
- meets no cell that has become cheaper: then it costs what it did or more;
- meets such cells, but none that was impassable: then it cost at most the sum of their savings more, as each cell
  takes part in two steps;
- meets a cell that was impassable: then it costs at least the octile distance by way of it.
The least of the three bounds every path. Cells that became dearer change nothing.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.kernels.expansion import octile
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.planners.plan import Plan

_ROUNDING = 1e-6
"""Share by which a bound may be off, as the searches keep g in float32."""
_MOST_UNTOLD = 64
_LAST_STAMP = int(np.iinfo(np.int32).max)


class Footing(StrEnum):
    """How a standing path stands."""

    VALID = "valid"
    BLOCKED = "blocked"
    """A cell of what is left of it is impassable now, or a corner that it cuts may not be cut."""
    OFF_PATH = "off_path"
    """The robot is not on it."""
    NONE = "none"
    """There is none."""


@dataclass(frozen=True)
class Standing:
    """What is left of the standing path, on the map as it is now."""

    footing: Footing
    index: int = -1
    """Of the robot's cell on the path; -1 where it is not on it."""
    blocked_at: Cell | None = None
    """First cell that can no longer be stepped on."""
    cost: float = math.inf
    """Of what is left of the path; inf unless it is valid."""
    lower_bound: float = 0.0
    """No path from the robot's cell to the goal costs less now."""
    floor: float = 0.0
    """No path would cost less now, had the plan been optimal when it was made; 0 where the robot is off the path."""

    @property
    def valid(self) -> bool:
        """Whether the rest of the path can be walked."""
        return self.footing is Footing.VALID

    @property
    def added(self) -> float:
        """The rest of the path exceeds the optimum by at most so much more than the plan did when it was made."""
        return max(self.cost - self.floor, 0.0)

    @property
    def bound(self) -> float:
        """The rest of the path costs at most this many times the optimum."""
        if self.lower_bound > 0.0:
            return max(self.cost / self.lower_bound, 1.0)
        return 1.0 if self.cost == 0.0 else math.inf


@kernel
def _remember(weights, first, stride, rows, cols, was, noted, stamp, touched, count):
    """Note what the weights of a rectangle's nodes were, unless that is noted; how many nodes are now."""
    for row in range(rows):
        for col in range(cols):
            node = first + row * stride + col
            if noted[node] != stamp:
                noted[node] = stamp
                was[node] = weights[row * cols + col]
                touched[count] = node
                count += 1
    return count


@kernel
def _savings(weights, was, touched, count, stride, row, col, goal_row, goal_col, straight, diagonal, out):
    """Weight saved by the nodes that became cheaper, and the least octile distance by way of one of them.

    out = (sum over those that were passable, least distance by way of these, by way of those that were not).
    """
    out[0], out[1], out[2] = 0.0, np.inf, np.inf
    for n in range(count):
        node = np.int64(touched[n])
        now, before = np.float64(weights[node]), np.float64(was[node])
        if now < before:
            r, c = node // stride - 1, node % stride - 1
            by_way = octile(row, col, r, c, straight, diagonal) + octile(r, c, goal_row, goal_col, straight, diagonal)
            if before < np.inf:
                out[0] += before - now
                out[1] = min(out[1], by_way)
            else:
                out[2] = min(out[2], by_way)


@kernel
def _walk(weights, stride, path, first, corner_cutting, lengths, shares, costs):
    """Costs of a path from its cell `first` to each of the later ones; the first that cannot be stepped on, or -1."""
    total = 0.0
    for n in range(first, len(path)):
        node = (path[n, 0] + 1) * stride + path[n, 1] + 1
        if weights[node] == np.inf:
            return n
        if n > first:
            up, left = path[n, 0] - path[n - 1, 0], path[n, 1] - path[n - 1, 1]
            kind = 1 if up != 0 and left != 0 else 0
            before = node - up * stride - left
            corners = weights[node - up * stride] == np.inf or weights[node - left] == np.inf
            if kind == 1 and not corner_cutting and corners:
                return n
            total += lengths[kind] + shares[kind] * (np.float64(weights[before]) + np.float64(weights[node]))
        costs[n] = total
    return -1


def first_blocked(grid: Grid, path: NDArray[np.int32], corner_cutting: bool = True) -> int:
    """Index of the first cell of a path that cannot be stepped on; -1 where it can be walked to its end.

    Parameters
    ----------
    grid : Grid
        The map.
    path : (N, 2) int32
        Cells of the map, each the neighbour of the one before.
    corner_cutting : bool
        Whether a diagonal step may pass an impassable cell on either side of it.
    """
    model = grid.model
    costs = np.empty(len(path))
    return int(_walk(grid.weights, grid.stride, path, 0, corner_cutting, model.length_term, model.weight_term, costs))


class StandingPath:
    """The path that a robot follows, on a map that changes under it. Serves one thread at a time.

    Say what has changed, with the weights that stood there (`changed`, `Grid.update`), and `check` whenever
    wanted: that takes time by the cells of the path and those that changed, not by the map.

    Parameters
    ----------
    grid : Grid
        The map; read, never written.
    corner_cutting : bool
        Whether a diagonal step may pass an impassable cell on either side of it.
    """

    def __init__(self, grid: Grid, *, corner_cutting: bool = True) -> None:
        nodes = len(grid.weights)
        self._grid, self._corner_cutting = grid, corner_cutting
        self._was = np.empty(nodes, np.float32)
        self._noted = np.zeros(nodes, np.int32)
        self._touched = np.empty(nodes, np.int32)
        self._stamp, self._count = 1, 0
        self._untold: list[tuple[Rectangle, NDArray[np.float32]]] = []
        """Changes that are noted cell by cell when somebody asks: a new path makes that needless."""
        self._plan: Plan | None = None
        self._walked = self._scratch = np.empty(0)

    @property
    def plan(self) -> Plan | None:
        """The plan whose path stands."""
        return self._plan

    def set(self, plan: Plan) -> None:
        """Follow this plan's path from now on; to be called before the map changes again.

        Raises
        ------
        InvalidQueryError
            The plan has no path to the goal.
        """
        if not plan.ok or not len(plan.path):
            raise InvalidQueryError(f"a standing path must lead to the goal, got a plan of status {plan.status}")
        self._walked, self._scratch = np.empty(len(plan.path)), np.empty(len(plan.path))
        if self._costs_from(plan.path, 0, self._walked) >= 0:
            raise InvalidQueryError("a standing path must be walkable on the map it was planned on")
        self._plan, self._count = plan, 0
        self._untold.clear()
        if self._stamp == _LAST_STAMP:
            self._noted[:] = 0
            self._stamp = 0
        self._stamp += 1

    def forget(self) -> None:
        """There is no path to follow."""
        self._plan, self._count = None, 0
        self._untold.clear()

    def changed(self, part: Rectangle, was: NDArray[np.float32]) -> None:
        """The grid's weights in this rectangle are other ones; `was` are those that stood there, row by row."""
        if self._plan is None:
            return
        self._untold.append((part, was))
        if len(self._untold) > _MOST_UNTOLD:
            self._remember()

    def _remember(self) -> None:
        grid = self._grid
        for (row, col, rows, cols), was in self._untold:
            self._count = _remember(
                was, grid.node(row, col), grid.stride, rows, cols, self._was, self._noted, self._stamp,
                self._touched, self._count,
            )  # fmt: skip
        self._untold.clear()

    def check(self, at: Cell) -> Standing:
        """How the path stands for a robot in the cell `at`."""
        if self._plan is None:
            return Standing(Footing.NONE)
        self._remember()
        path, grid = self._plan.path, self._grid
        hits = np.flatnonzero((path[:, 0] == at[0]) & (path[:, 1] == at[1]))
        if not len(hits):
            return Standing(Footing.OFF_PATH)
        index, goal = int(hits[0]), (int(path[-1, 0]), int(path[-1, 1]))
        walked, straight = float(self._walked[index]), octile.py_func(*at, *goal, *grid.prices)
        then = float(self._walked[-1]) - walked, (1.0 - _ROUNDING) * self._plan.lower_bound - walked
        floor, lower = (max(bound, straight) for bound in self._now(then, at, goal))
        blocked = self._costs_from(path, index, self._scratch)
        if blocked >= 0:
            cell = int(path[blocked, 0]), int(path[blocked, 1])
            return Standing(Footing.BLOCKED, index, cell, lower_bound=lower, floor=floor)
        cost = float(self._scratch[-1])
        return Standing(Footing.VALID, index, None, cost, min(lower, cost), min(floor, cost))

    def _now(self, bounds: tuple[float, ...], at: Cell, goal: Cell) -> list[float]:
        """What bounds the paths of now, given bounds of those on the map as it was."""
        grid, saved = self._grid, np.empty(3)
        straight, diagonal = grid.prices
        _savings(
            grid.weights, self._was, self._touched, self._count, grid.stride, *at, *goal, straight, diagonal, saved
        )
        savings = 2.0 * max(grid.model.weight_term) * float(saved[0])
        by_cheaper, by_opened = float(saved[1]), float(saved[2])
        if not self._corner_cutting:  # beside a cell that was opened, a diagonal step may have become allowed
            by_opened -= 2.0 * straight
        return [min(bound, max(bound - savings, by_cheaper), by_opened) for bound in bounds]

    def _costs_from(self, path: NDArray[np.int32], first: int, costs: NDArray[np.float64]) -> int:
        model, grid = self._grid.model, self._grid
        return int(
            _walk(
                grid.weights, grid.stride, path, first, self._corner_cutting, model.length_term, model.weight_term,
                costs,
            )
        )  # fmt: skip
