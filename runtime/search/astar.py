"""Exact A* on an eight-connected grid, over the whole map or inside a region.

The heuristic is the octile distance at the price of the map's cheapest cell, or with directed steps of the cheapest
metre over all slopes: no steps undercut it, and it is consistent. `landmarks` sharpen it.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels import expansion as kernels
from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import StepCost
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import BUCKET_WIDTH, BUCKET_WIDTH_BY_LANDMARKS, DIRECTED_BUCKET_WIDTH

_BETWEEN_LOOKS = 1 << 14
"""Expansions after which is looked whether enough is known."""
_WITHOUT_END = int(np.iinfo(np.int64).max >> 1)
Links = NDArray[np.uint8] | None
"""The directions in which each node may be left, as bits; None where passability decides."""
Hints = tuple[NDArray[np.float32], NDArray[np.float32], float]
"""Sharpen the heuristic of a search to one goal, see `Landmarks.towards`."""


class Search(NamedTuple):
    """The outcome of a search."""

    status: Status
    """OK, NO_PATH or TIMEOUT."""
    path: NDArray[np.int32]
    """(N, 2) cells (row, col) from start to goal; on TIMEOUT to the expanded cell nearest the goal."""
    expansions: int
    refused_f: float = math.inf
    """Least f of a cell that was refused for lying outside the region; inf if none was."""

    @classmethod
    def without_path(cls, status: Status, expansions: int = 0, refused_f: float = math.inf) -> "Search":
        """A search that found no path."""
        return cls(status, np.empty((0, 2), np.int32), expansions, refused_f)


def astar(
    grid: Grid,
    start: Cell,
    goal: Cell,
    workspace: Workspace,
    region: Region | None = None,
    *,
    links: Links = None,
    hints: Hints | None = None,
    backwards: bool = False,
    beyond: float = 0.0,
    limit: int | None = None,
    deadline: Deadline = NEVER,
) -> Search:
    """Cheapest path between two passable cells of a grid.

    Parameters
    ----------
    start, goal : (row, col)
        Passable cells; with a region, which alone is searched, cells inside it.
    links : (nodes,) uint8
        The directions in which each cell may be left, as bits; by default all.
    hints
        Of landmarks on this grid and these links: fewer cells are expanded, for the same cost.
    backwards : bool
        On a coarse level with directed steps: the path found is the cheapest from `goal` to `start`, reversed.
    beyond : float
        Settle also every cell on a path that costs less than 1 + `beyond` times the optimum.
    limit, deadline
        Give up with TIMEOUT after about so many expansions, or then.

    Notes
    -----
    NNPP (arXiv 2308.04792v3), Eq. 2-4; the octile distance stands in for the paper's Euclidean one, which
    it exceeds without ever overestimating. g is kept in float32.
    """
    first, last = grid.node(*start), grid.node(*goal)
    if first == last:
        return Search(Status.OK, np.array([start], np.int32), 0)
    width = _bucket_width(grid) if hints is None else grid.prices[0] * BUCKET_WIDTH_BY_LANDMARKS
    rule = (*grid.prices, width, _successors(grid, links), 1.0 + beyond if beyond else kernels.BELOW)
    poses, edges = grid.steps.packed(backwards)
    allowed = kernels.NO_REGION if region is None else tuple(region)
    ways, landmarks = kernels.NO_LINKS if links is None else links, kernels.NO_HINTS if hints is None else hints
    ws, begin, limits = workspace, first, (limit or _WITHOUT_END, deadline.at)
    ws.next_stamp()
    while True:
        code, length, expansions, refused = kernels.expand(
            grid.packed, poses, edges, ways, allowed, landmarks, (begin, last), rule, ws.packed, limits
        )
        begin = -1
        if code != kernels.FULL or deadline.passed:
            break
        ws.grow()
    if code == kernels.EXHAUSTED:
        return Search.without_path(Status.NO_PATH, expansions, refused)
    end = last if code == kernels.FOUND else int(ws.counts[kernels.BEST_NODE])
    if code == kernels.FULL:  # out of time just when the open list had to grow
        length = kernels.trace(ws.meta, end, grid.stride, ws.path)
    if length > len(ws.path):
        ws.path = np.empty((length, 2), np.int32)
        kernels.trace(ws.meta, end, grid.stride, ws.path)
    status = Status.OK if code == kernels.FOUND else Status.TIMEOUT
    return Search(status, ws.path[length - 1 :: -1].copy(), expansions, refused)


def settle_all(grid: Grid, source: Cell, workspace: Workspace, links: Links = None) -> None:
    """Search from a passable cell until nothing is left: the workspace then holds every cell's cost from there."""
    for _ in _settling(grid, source, workspace, links):
        pass


def _settling(
    grid: Grid,
    source: Cell,
    workspace: Workspace,
    links: Links = None,
    most: int = _WITHOUT_END,
    deadline: Deadline = NEVER,
) -> Iterator[float]:
    """Search from a passable cell, so many expansions at a time: the least cost that may yet fall, inf in the end.

    OutOfTimeError at the deadline.
    """
    ws = workspace
    ws.next_stamp()
    rule = (0.0, 0.0, _bucket_width(grid), _successors(grid, links), kernels.BELOW)
    (poses, edges), limits = grid.steps.packed(), (most, deadline.at)
    ways, region, hints = kernels.NO_LINKS if links is None else links, kernels.NO_REGION, kernels.NO_HINTS
    corner_of_border = 0  # impassable, so never reached: the search runs until nothing is left
    begin, code = grid.node(*source), kernels.FULL
    while code in (kernels.FULL, kernels.PAUSED):
        ends = begin, corner_of_border
        code, *_ = kernels.expand(grid.packed, poses, edges, ways, region, hints, ends, rule, ws.packed, limits)
        begin = -1
        if code in (kernels.FULL, kernels.PAUSED):
            deadline.check()
        if code == kernels.FULL:
            ws.grow()
        yield math.inf if code == kernels.EXHAUSTED else ws.least_open


def cost_field(grid: Grid, source: Cell, workspace: Workspace) -> Float2D:
    """Cost of the cheapest path from a passable cell to every other: (H, W) float32, inf where there is none."""
    settle_all(grid, source, workspace)
    field = workspace.costs().reshape(-1, grid.stride)[1 : grid.rows + 1, 1 : grid.cols + 1]
    return grid.steps.with_heights(field, source)


def costs_to_nearest(
    grid: Grid, stops: Sequence[Cell], count: int, workspace: Workspace, deadline: Deadline = NEVER
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Costs of the cheapest paths from each of N passable cells, but the last, to so many of the others.

    Returns (N, N) float64, what a path from one to another costs, and (N, N) bool, whether that is known; else it
    costs at least that. OutOfTimeError at the deadline.
    """
    nodes = np.array([grid.node(*stop) for stop in stops])
    costs, known = np.zeros((len(stops), len(stops))), np.eye(len(stops), dtype=np.bool_)
    for at, stop in enumerate(stops[:-1]):
        for within in _settling(grid, stop, workspace, most=_BETWEEN_LOOKS, deadline=deadline):
            reached = workspace.meta[2 * nodes + 1] >> STAMP_SHIFT == workspace.stamp
            settled = reached & (workspace.g[2 * nodes] <= within * kernels.BELOW)
            if settled.sum() > count:  # the cell itself is one of them
                break
        costs[at] = np.where(settled, workspace.g[2 * nodes], within)
        costs[at] += [grid.steps.worth_of_height(stop, other) for other in stops]
        known[at] |= settled | (within == math.inf)
    return costs, known


def _bucket_width(grid: Grid) -> float:
    return grid.prices[0] * (DIRECTED_BUCKET_WIDTH if grid.steps.by_slope else BUCKET_WIDTH)


def _successors(grid: Grid, links: Links) -> NDArray[np.int64]:
    """The steps from a cell that its best predecessor leaves to search."""
    dominance = kernels.Dominance.NONE
    if links is None and not grid.steps.by_poses and not grid.steps.by_slope:
        diagonal = grid.corner_cutting and grid.model.kind is StepCost.PAPER
        dominance = kernels.Dominance.DIAGONAL if diagonal else kernels.Dominance.STRAIGHT
    return kernels.SUCCESSORS[dominance]
