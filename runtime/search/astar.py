"""Exact A* on an eight-connected grid, over the whole map or inside a region.

The heuristic is the octile distance at the price of the map's cheapest cell, or with directed steps
of the cheapest metre over all slopes: no steps undercut it, and it is consistent. `landmarks`
sharpen it.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Cells, Float2D, UInt8
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels import expansion as kernels
from nnpp_edge.runtime.kernels.expansion import NO_LINKS
from nnpp_edge.runtime.kernels.nodes import EXHAUSTED, FOUND, FULL, PAUSED, WITHOUT_END
from nnpp_edge.runtime.kernels.records import (
    BEST_NODE,
    EXPANSIONS,
    Ends,
    FieldRule,
    Hints,
    Limits,
    Rule,
    StateRule,
)
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepCost
from nnpp_edge.runtime.tuning import (
    BUCKET_WIDTH,
    BUCKET_WIDTH_BY_LANDMARKS,
    DIRECTED_BUCKET_WIDTH,
)

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid

Parts = tuple[Any, ...]
NOWHERE = 0
"""Of the border, which is impassable: the goal of a search that is to have none."""
ON = -1
"""In place of the node at which a search begins: go on where it stopped."""


class Spreading(NamedTuple):
    """How costs spread from a cell to all others: what `run` takes."""

    kernel: Callable[..., Parts]
    before: Parts
    rule: Rule | FieldRule | StateRule


class Query(NamedTuple):
    """Where from and where to, how good, and until when."""

    start: Cell
    goal: Cell
    epsilon: float = math.inf
    """A path that is certain to cost at most 1 + `epsilon` times the optimum is good enough."""
    deadline: Deadline = NEVER
    """When to give up."""
    direction: int = -1
    """In which a body stands at the start, see `robots.body.motions.LEGS`; -1 where any will
    do.
    """
    wanted: Bool | None = None
    """(16,) directions in which it may arrive; None where any will do."""

    @property
    def apart(self) -> int:
        """Cells between start and goal, as the king moves."""
        rows = abs(self.start[0] - self.goal[0])
        cols = abs(self.start[1] - self.goal[1])
        return max(rows, cols)


class Search(NamedTuple):
    """The outcome of a search."""

    status: Status
    """OK, NO_PATH or TIMEOUT."""
    path: Cells
    """(N, 2) cells (row, col) from start to goal; on TIMEOUT to the expanded cell nearest the
    goal. Of a body that drives arcs (N, 3), with the state on each cell."""
    expansions: int
    refused_f: float = math.inf
    """Least f of a cell that was refused for lying outside the region; inf if none was."""
    exhausted: Workspace | None = None
    """Where there is no path, memory of a body's search that came to all that can be reached from
    one end.
    """

    @classmethod
    def without_path(
        cls, status: Status, expansions: int = 0, refused_f: float = math.inf, columns: int = 2
    ) -> "Search":
        """A search that found no path."""
        return cls(status, np.empty((0, columns), np.int32), expansions, refused_f)


def astar(
    grid: "Grid",
    start: Cell,
    goal: Cell,
    workspace: Workspace,
    region: Region | None = None,
    *,
    hints: Hints | None = None,
    limit: int | None = None,
    deadline: Deadline = NEVER,
) -> Search:
    """Cheapest path of a point between two passable cells of a grid; `Robot.search` is any robot's.

    Parameters
    ----------
    start, goal : (row, col)
        Passable cells; with a region, which alone is searched, cells inside it.
    hints
        Of landmarks on this grid: fewer cells are expanded, for the same cost.
    limit, deadline
        Give up with TIMEOUT after about so many expansions, or then.

    Notes
    -----
    NNPP (arXiv 2308.04792v3), Eq. 2-4; the octile distance stands in for the paper's Euclidean one,
    which it exceeds without ever overestimating. g is kept in float32.
    """
    rule = rule_of(grid, NO_LINKS, hints)
    landmarks = kernels.NO_HINTS if hints is None else tuple(hints)
    before = (grid.packed, NO_LINKS, allowed(region), landmarks, kernels.BELOW)
    ends = Ends(grid.node(*start), grid.node(*goal))
    found = run(kernels.expand, before, rule, ends, workspace, limit or WITHOUT_END, deadline)
    return traced(partial(kernels.trace, stride=grid.stride), workspace, *found)


def run(
    kernel: Callable[..., Parts],
    before: Parts,
    rule: Rule | FieldRule | StateRule,
    ends: Ends,
    workspace: Workspace,
    most: int,
    deadline: Deadline,
    *,
    anew: bool = True,
) -> Parts:
    """The outcome of a search's kernel after at most so many expansions more, or at the deadline;
    the open list grows as it needs. What the last search in this memory found stays, unless
    `anew`.
    """
    begun = 0
    if ends.start == ON:
        begun = int(workspace.control[EXPANSIONS])
    elif anew:
        workspace.next_stamp()
    left = most
    while True:
        limits = Limits(left, deadline.until)
        found: Parts = kernel(*before, tuple(ends), tuple(rule), workspace.packed, tuple(limits))
        code, *_ = found
        # it has ended, or done all that it may
        left = begun + most - int(workspace.control[EXPANSIONS])
        if code not in (FULL, PAUSED) or left <= 0:
            return found
        # it is late, or has no room; in slices it goes on later
        if not deadline.goes_on():
            return found
        if code == FULL:
            workspace.grow()
        ends = ends._replace(start=ON)


def traced(
    trace: Callable[..., int],
    ws: Workspace,
    code: int,
    length: int,
    spent: int,
    refused: float,
) -> Search:
    """The outcome of a search, with the path to where it ended."""
    if code == EXHAUSTED:
        return Search.without_path(Status.NO_PATH, spent, refused, ws.path.shape[1])
    if length > len(ws.path):
        ws.path = np.empty((length, ws.path.shape[1]), np.int32)
        trace(ws.meta, int(ws.control[BEST_NODE]), out=ws.path)
    status = Status.OK if code == FOUND else Status.TIMEOUT
    return Search(status, ws.path[length - 1 :: -1].copy(), spent, refused)


def allowed(region: Region | None) -> Parts:
    """A region as kernels take it; None is everywhere."""
    return kernels.NO_REGION if region is None else tuple(region)


def spreading(grid: "Grid") -> Spreading:
    """How a point's costs spread."""
    before = (grid.packed, NO_LINKS, kernels.NO_REGION, kernels.NO_HINTS, kernels.BELOW)
    rule = rule_of(grid, NO_LINKS)._replace(h_straight=0.0, h_diagonal=0.0)
    return Spreading(kernels.expand, before, rule)


def settle_all(
    grid: "Grid",
    source: Cell,
    workspace: Workspace,
    deadline: Deadline = NEVER,
) -> None:
    """Search from a passable cell until nothing is left: the workspace then holds every cell's cost
    from there. OutOfTimeError at the deadline.
    """
    search = grid.robot.moves.spreading(grid, workspace)
    code, *_ = run(*search, Ends(grid.node(*source), NOWHERE), workspace, WITHOUT_END, deadline)
    if code != EXHAUSTED:
        deadline.check()


def cost_field(
    grid: "Grid", source: Cell, workspace: Workspace, deadline: Deadline = NEVER
) -> Float2D:
    """Cost of the cheapest path from a passable cell to every other: (H, W) float32, inf where
    there is none. OutOfTimeError at the deadline.
    """
    settle_all(grid, source, workspace, deadline=deadline)
    field: Float2D = grid.inner(workspace.costs()) + grid.robot.price.worth(source)
    return field


def rule_of(grid: "Grid", links: UInt8, hints: Hints | None = None) -> Rule:
    """How a search for the optimum goes over a grid, by landmarks if it has any."""
    linked = len(links) > 0 or grid.robot.price.directed
    by_paper = grid.corner_cutting and grid.model.kind is StepCost.PAPER
    apart = 0 if linked else 1 + by_paper  # of `SUCCESSORS`
    return Rule(*grid.prices, bucket_width(grid, hints), kernels.SUCCESSORS[apart])


def bucket_width(grid: "Grid", hints: Hints | None = None) -> float:
    """Of a bucket of the open list at first, in units of f."""
    by_grid = DIRECTED_BUCKET_WIDTH if grid.robot.price.directed else BUCKET_WIDTH
    return grid.prices[0] * (by_grid if hints is None else BUCKET_WIDTH_BY_LANDMARKS)
