"""Exact A* on an eight-connected grid, over the whole map or inside a region.

The heuristic is the octile distance at the price of the map's cheapest cell: with n_d diagonal and n_s
straight steps on an empty map it is n_d·step(diagonal, 2·w_min) + n_s·step(straight, 2·w_min). It never
overestimates and is consistent. Landmarks sharpen it, see `landmarks`.
"""

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
from nnpp_edge.runtime.kernels.open_list import COARSE, FINE
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import StepCost
from nnpp_edge.runtime.search.workspace import Workspace

if TYPE_CHECKING:
    from nnpp_edge.runtime.search.landmarks import Landmarks

_EXPANSIONS_BETWEEN_CHECKS = 100_000
_BUCKET, _BUCKET_BY_LANDMARKS = 1.0 / 4.0, 1.0 / 256.0
"""Width of a bucket, in cheapest steps. By landmarks, nearly optimal cells have nearly the same f: a wide bucket,
which is not in order within, would expand many of them again and again."""
_WITHOUT_END = int(np.iinfo(np.int64).max >> 1)
_NO_LANDMARKS = (None, None, 0.0)
_EVERYWHERE = (None, None, None, 0)


class Search(NamedTuple):
    """What a search came to."""

    status: Status
    path: NDArray[np.int32]
    """(N, 2) cells (row, col) from start to goal; on TIMEOUT to the expanded cell nearest the goal."""
    expansions: int
    refused_f: float
    """Least f of a cell that was refused for lying outside the region; inf if none was."""


def _dominance(grid: Grid, links: NDArray[np.uint8] | None, corner_cutting: bool) -> Dominance:
    if links is not None:
        return Dominance.NONE
    return Dominance.DIAGONAL if corner_cutting and grid.model.kind is StepCost.PAPER else Dominance.STRAIGHT


def _bucket_width(grid: Grid, share: float) -> float:
    """Width δ of a bucket: that share of the cheapest step, or what lets every f ahead fit into the ring."""
    furthest = 2.0 * grid.model.step(1, 2.0 * max(grid.greatest, 0.0))
    return max(share * grid.prices[0], 1.01 * furthest / (FINE * (COARSE - 2)), 1e-30)


def astar(
    grid: Grid,
    start: tuple[int, int],
    goal: tuple[int, int],
    workspace: Workspace,
    *,
    region: Region | None = None,
    links: NDArray[np.uint8] | None = None,
    landmarks: "Landmarks | None" = None,
    corner_cutting: bool = True,
    beyond: float = 0.0,
    limit: int | None = None,
    deadline: float = math.inf,
    cancelled: Callable[[], bool] | None = None,
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
    landmarks : Landmarks
        Of this grid and these links: fewer cells are expanded, for the same cost.
    corner_cutting : bool
        Whether a diagonal step may pass an impassable cell on either side of it.
    beyond : float
        Settle also every cell on a path that costs less than 1 + `beyond` times the optimum.
    limit : int
        Give up with TIMEOUT after about so many expansions.
    deadline : float
        Reading of `time.monotonic` at which to give up with TIMEOUT.
    cancelled : callable
        Asked now and then; True ends the search with TIMEOUT.

    Returns
    -------
    Search
        OK, NO_PATH or TIMEOUT.

    Notes
    -----
    NNPP (arXiv 2308.04792v3), Eq. 2-4; the octile distance stands in for the paper's Euclidean one, which
    it exceeds without ever overestimating. g is kept in float32.
    """
    width = _bucket_width(grid, _BUCKET if landmarks is None else _BUCKET_BY_LANDMARKS)
    steps = (*grid.steps, *grid.prices, 1.0 / width)
    first, last = grid.node(*start), grid.node(*goal)
    if first == last:
        return Search(Status.OK, np.array([start], np.int32), 0, math.inf)
    ws, stamp = workspace, workspace.next_stamp()
    hints = _NO_LANDMARKS if landmarks is None else landmarks.towards(last)
    where = _EVERYWHERE if region is None else (region.bitmap, region.row_block, region.col_block, region.stamp)
    successors = SUCCESSORS[_dominance(grid, links, corner_cutting)]
    timed = deadline < math.inf or cancelled is not None
    most = limit or (_EXPANSIONS_BETWEEN_CHECKS if timed else _WITHOUT_END)
    factor = 1.0 + beyond if beyond else BELOW
    begin = first
    while True:
        code, length, expansions, refused = expand(
            grid.weights, links, grid.stride, begin, last, steps, *hints, successors, corner_cutting, *where, ws.g,
            ws.meta, stamp, ws.heads, ws.entries, ws.control, ws.reals, ws.counts, ws.path, factor, most,
        )  # fmt: skip
        begin = -1
        if code == FULL:
            ws.grow()
        elif code != PAUSED or limit:
            break
        if timed and (time.monotonic() > deadline or (cancelled is not None and cancelled())):
            break
    if code == EXHAUSTED:
        return Search(Status.NO_PATH, np.empty((0, 2), np.int32), expansions, refused)
    end = last if code == FOUND else int(ws.counts[BEST_NODE])
    if code == FULL:  # out of time just when the open list had to grow
        length = trace(ws.meta, end, grid.stride, ws.path)
    if length > len(ws.path):
        ws.path = np.empty((length, 2), np.int32)
        trace(ws.meta, end, grid.stride, ws.path)
    status = Status.OK if code == FOUND else Status.TIMEOUT
    return Search(status, ws.path[length - 1 :: -1].copy(), expansions, refused)


def settle_all(
    grid: Grid,
    source: tuple[int, int],
    workspace: Workspace,
    *,
    links: NDArray[np.uint8] | None = None,
    corner_cutting: bool = True,
) -> None:
    """Search from a passable cell until nothing is left: the workspace then holds every cell's cost from there."""
    ws, stamp = workspace, workspace.next_stamp()
    steps = (*grid.steps, 0.0, 0.0, 1.0 / _bucket_width(grid, _BUCKET))
    successors = SUCCESSORS[_dominance(grid, links, corner_cutting)]
    corner_of_border = 0  # impassable, so never reached: the search runs until nothing is left
    begin = grid.node(*source)
    while expand(
        grid.weights, links, grid.stride, begin, corner_of_border, steps, *_NO_LANDMARKS, successors, corner_cutting,
        *_EVERYWHERE, ws.g, ws.meta, stamp, ws.heads, ws.entries, ws.control, ws.reals, ws.counts, ws.path, BELOW,
        _WITHOUT_END,
    )[0] == FULL:  # fmt: skip
        ws.grow()
        begin = -1


def cost_field(
    grid: Grid, source: tuple[int, int], workspace: Workspace, *, corner_cutting: bool = True
) -> NDArray[np.float32]:
    """Cost of the cheapest path from a passable cell to every other: (H, W) float32, inf where there is none."""
    settle_all(grid, source, workspace, corner_cutting=corner_cutting)
    field = np.empty((grid.rows, grid.cols), np.float32)
    read_field(workspace.g, workspace.meta, workspace.stamp, grid.stride, field)
    return field
