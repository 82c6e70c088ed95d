"""Exact A* on an eight-connected grid, over the whole map or inside a region.

The heuristic is the octile distance at the price of the map's cheapest cell: with n_d diagonal and n_s
straight steps on an empty map it is n_d·step(diagonal, 2·w_min) + n_s·step(straight, 2·w_min). It never
overestimates and is consistent. Landmarks sharpen it, see `landmarks`. With directed steps the price is that of the
cheapest metre over all slopes (`map.directed`), which no steps undercut.
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
from nnpp_edge.runtime.kernels.expansion import (
    BELOW,
    BEST_NODE,
    EXHAUSTED,
    FOUND,
    FULL,
    PAUSED,
    SUCCESSORS,
    Dominance,
    expand,
    read_field,
    trace,
)
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
"""What sharpens the heuristic of a search to one goal, see `Landmarks.towards`."""


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
    grid : Grid
        The map.
    start, goal : (row, col)
        Passable cells; with a region, cells inside it.
    workspace : Workspace
        Scratch memory of the grid's size.
    region : Region
        Search only there.
    links : (nodes,) uint8
        The directions in which each cell may be left, as bits; by default all.
    hints
        Of landmarks on this grid and these links: fewer cells are expanded, for the same cost.
    backwards : bool
        On a coarse level with directed steps: the path found is the cheapest from `goal` to `start`, reversed.
    beyond : float
        Settle also every cell on a path that costs less than 1 + `beyond` times the optimum.
    limit : int
        Give up with TIMEOUT after about so many expansions.
    deadline : Deadline
        When to give up with TIMEOUT.

    Notes
    -----
    NNPP (arXiv 2308.04792v3), Eq. 2-4; the octile distance stands in for the paper's Euclidean one, which
    it exceeds without ever overestimating. g is kept in float32.
    """
    first, last = grid.node(*start), grid.node(*goal)
    if first == last:
        return Search(Status.OK, np.array([start], np.int32), 0)
    width = _bucket_width(grid) if hints is None else grid.prices[0] * BUCKET_WIDTH_BY_LANDMARKS
    rule = (*grid.prices, width, SUCCESSORS[_dominance(grid, links)], 1.0 + beyond if beyond else BELOW)
    poses, edges = grid.steps.packed(backwards)
    allowed = None if region is None else tuple(region)
    ws, begin, limits = workspace, first, (limit or _WITHOUT_END, deadline.at)
    ws.next_stamp()
    while True:
        code, length, expansions, refused = expand(
            grid.packed, poses, edges, links, allowed, hints, (begin, last), rule, ws.packed, limits
        )
        begin = -1
        if code != FULL or deadline.passed:
            break
        ws.grow()
    if code == EXHAUSTED:
        return Search.without_path(Status.NO_PATH, expansions, refused)
    end = last if code == FOUND else int(ws.counts[BEST_NODE])
    if code == FULL:  # out of time just when the open list had to grow
        length = trace(ws.meta, end, grid.stride, ws.path)
    if length > len(ws.path):
        ws.path = np.empty((length, 2), np.int32)
        trace(ws.meta, end, grid.stride, ws.path)
    status = Status.OK if code == FOUND else Status.TIMEOUT
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
    rule = (0.0, 0.0, _bucket_width(grid), SUCCESSORS[_dominance(grid, links)], BELOW)
    (poses, edges), limits = grid.steps.packed(), (most, deadline.at)
    corner_of_border = 0  # impassable, so never reached: the search runs until nothing is left
    begin, code = grid.node(*source), FULL
    while code in (FULL, PAUSED):
        ends = begin, corner_of_border
        code, *_ = expand(grid.packed, poses, edges, links, None, None, ends, rule, ws.packed, limits)
        begin = -1
        if code in (FULL, PAUSED):
            deadline.check()
        if code == FULL:
            ws.grow()
        yield math.inf if code == EXHAUSTED else ws.least_open


def cost_field(grid: Grid, source: Cell, workspace: Workspace) -> Float2D:
    """Cost of the cheapest path from a passable cell to every other: (H, W) float32, inf where there is none."""
    settle_all(grid, source, workspace)
    field = np.empty(grid.shape, np.float32)
    read_field(workspace.g, workspace.meta, workspace.stamp, grid.stride, field)
    return grid.steps.with_heights(field, source)


def costs_to_nearest(
    grid: Grid, stops: Sequence[Cell], count: int, workspace: Workspace, deadline: Deadline = NEVER
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Costs of the cheapest paths from each of N passable cells, but the last, to so many of the others.

    OutOfTimeError at the deadline.

    Returns
    -------
    (N, N) float64, (N, N) bool
        What a path from one to another costs, and whether that is known; else it costs at least that.
    """
    nodes = np.array([grid.node(*stop) for stop in stops])
    costs, known = np.zeros((len(stops), len(stops))), np.eye(len(stops), dtype=np.bool_)
    for at, stop in enumerate(stops[:-1]):
        for within in _settling(grid, stop, workspace, most=_BETWEEN_LOOKS, deadline=deadline):
            reached = workspace.meta[2 * nodes + 1] >> STAMP_SHIFT == workspace.stamp
            settled = reached & (workspace.g[2 * nodes] <= within * BELOW)
            if settled.sum() > count:  # the cell itself is one of them
                break
        costs[at] = np.where(settled, workspace.g[2 * nodes], within)
        costs[at] += [grid.steps.worth_of_height(stop, other) for other in stops]
        known[at] |= settled | (within == math.inf)
    return costs, known


def _bucket_width(grid: Grid) -> float:
    return grid.prices[0] * (DIRECTED_BUCKET_WIDTH if grid.steps.by_slope else BUCKET_WIDTH)


def _dominance(grid: Grid, links: Links) -> Dominance:
    if links is not None or grid.steps.by_poses or grid.steps.by_slope:
        return Dominance.NONE
    diagonal = grid.corner_cutting and grid.model.kind is StepCost.PAPER
    return Dominance.DIAGONAL if diagonal else Dominance.STRAIGHT
