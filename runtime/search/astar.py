"""Exact A* on an eight-connected grid, over the whole map or inside a region.

The heuristic is the octile distance at the price of the map's cheapest cell, or with directed steps
of the cheapest metre over all slopes: no steps undercut it, and it is consistent. `landmarks`
sharpen it.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels import expansion as kernels
from nnpp_edge.runtime.kernels.lattice import (
    DIRECTION_COUNT,
    KNIGHT,
    expand_states,
    fill_field,
    least_of_cells,
    trace_states,
)
from nnpp_edge.runtime.kernels.nodes import (
    EXHAUSTED,
    FOUND,
    FULL,
    PAUSED,
    STAMP_SHIFT,
    octile,
)
from nnpp_edge.runtime.kernels.records import (
    BEST_NODE,
    DOWN,
    GOAL_STATE,
    RIGHT,
    Ends,
    Field,
    FieldRule,
    Frame,
    Hints,
    Legs,
    Limits,
    Packed,
    Prices,
    Rule,
    Seeds,
    StateRule,
)
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepCost
from nnpp_edge.runtime.tuning import (
    AROUND_GOAL,
    BUCKET_WIDTH,
    BUCKET_WIDTH_BY_LANDMARKS,
    DIRECTED_BUCKET_WIDTH,
    REOPENED_WITHIN,
    TURNS_IN_FIELD,
)

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid
    from nnpp_edge.runtime.robots.body.robot import States

_BETWEEN_LOOKS = 1 << 14
"""Expansions after which is looked whether enough is known."""
_WITHOUT_END = int(np.iinfo(np.int64).max >> 1)
Links = NDArray[np.uint8] | None
"""The directions in which each node may be left, as bits; None where passability decides."""
Parts = tuple[Any, ...]
_CORNER = 0
"""Of the border, which is impassable: the goal of a search that is to have none."""
_UNJUDGED: Packed = tuple(Legs(0.0, 0.0, 0.0))
"""Of a search that nothing guides."""
_ON = -1
"""In place of the node at which a search begins: go on where it stopped."""


class Search(NamedTuple):
    """The outcome of a search."""

    status: Status
    """OK, NO_PATH or TIMEOUT."""
    path: NDArray[np.int32]
    """(N, 2) cells (row, col) from start to goal; on TIMEOUT to the expanded cell nearest the
    goal. Of a body that drives arcs (N, 3), with the state on each cell."""
    expansions: int
    refused_f: float = math.inf
    """Least f of a cell that was refused for lying outside the region; inf if none was."""
    promised: float = math.inf
    """Cost of a body's path as the field had it that guided the search."""

    @classmethod
    def without_path(
        cls, status: Status, expansions: int = 0, refused_f: float = math.inf, columns: int = 2
    ) -> "Search":
        """A search that found no path."""
        return cls(status, np.empty((0, columns), np.int32), expansions, refused_f)


class LastMetres(NamedTuple):
    """Costs of the last metres to a goal with a heading, by a search of a few states from there.

    A way back, by a body that stands the other way round, costs what the way there does.
    """

    begun: Seeds
    """Cells at which the search stopped, from which all ways lead on to the goal."""
    settled: Seeds
    """Cells within."""
    exhausted: bool
    """Whether no way from other cells leads to the goal."""
    expansions: int

    def hold(self, node: int) -> bool:
        """Whether the search came to a cell."""
        return any(bool((cells.nodes == node).any()) for cells in (self.begun, self.settled))


def astar(
    grid: "Grid",
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
    direction: int = -1,
    wanted: NDArray[np.bool_] | None = None,
    last_metres: LastMetres | None = None,
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
        On a coarse level with directed steps: the path found is the cheapest from `goal` to
        `start`, reversed.
    beyond : float
        Settle also every cell on a path that costs less than 1 + `beyond` times the optimum.
    limit, deadline
        Give up with TIMEOUT after about so many expansions, or then.
    direction : int
        In which a body stands at the start, see `robots.body.motions.LEGS`; by default any.
    wanted : (16,) bool
        Directions in which it may arrive; by default all.
    last_metres
        Of a body, `last_metres_to` the goal: fewer states are expanded. The cells that were
        searched there are added to the region.

    Notes
    ----- NNPP (arXiv 2308.04792v3), Eq. 2-4; the octile distance stands in for the paper's
    Euclidean one, which it exceeds without ever overestimating. g is kept in float32.
    """
    first = grid.node(*start)
    last = grid.node(*goal)
    if first == last and (direction < 0 or wanted is None or wanted[direction]):
        there = (
            int(np.argmax(wanted)) if direction < 0 and wanted is not None else max(direction, 0)
        )
        return Search(Status.OK, np.array([(*start, there)[: grid.robot.columns]], np.int32), 0)
    if grid.robot.by_poses:
        ends = (first, last, direction)
        limits = Limits(limit or _WITHOUT_END, deadline.at)
        return _over_states(grid, ends, wanted, workspace, region, beyond, limits, last_metres)
    width = _bucket_width(grid, hints)
    rule = Rule(*grid.prices, width, _successors(grid, links), _beyond(beyond))
    landmarks = kernels.NO_HINTS if hints is None else tuple(hints)
    before = grid.packed, grid.robot.edges(backwards), _ways(links), _allowed(region), landmarks
    limits = Limits(limit or _WITHOUT_END, deadline.at)
    code, length, expansions, refused = _run(
        kernels.expand, before, Ends(first, last), rule, workspace, limits
    )
    end = last if code == FOUND else int(workspace.counts[BEST_NODE])
    trace = partial(kernels.trace, stride=grid.stride)
    return _traced(trace, workspace, code, end, length, expansions, refused)


def _over_states(
    grid: "Grid",
    ends: tuple[int, int, int],
    wanted: NDArray[np.bool_] | None,
    workspace: Workspace,
    region: Region | None,
    beyond: float,
    limits: Limits,
    last_metres: LastMetres | None,
) -> Search:
    """As `astar`, over a body's states, `ends` as for `expand_states`: guided by the costs to go of
    cells.

    These are found from the goal on, and tell soon where there is no path. On the whole map turns
    are free in them, arcs are ways between cells like legs, whatever the direction, and the answer
    is the best. In a region legs and their turns alone count, which leaves few states to look at,
    for an answer about as good; no path at all then costs less than the octile distance.
    """
    states = grid.robot.states()
    field = workspace.field
    first, last, _ = ends
    assert states is not None and field is not None
    prices = states.prices
    columns = grid.robot.columns
    if last_metres is not None and last_metres.hold(first):
        last_metres = None  # so near that the field may as well begin at the goal
    elif last_metres is not None and last_metres.exhausted:
        return Search.without_path(Status.NO_PATH, columns=columns)
    between = _turns_in_field(prices, region)
    refused_at_least = math.inf
    if region is not None:
        by_legs = prices.rays[:DIRECTION_COUNT], prices.ray_fares[:DIRECTION_COUNT]
        prices = prices._replace(rays=by_legs[0], ray_fares=by_legs[1])
        refused_at_least = float(octile.py_func(*grid.cell(first), *grid.cell(last), *grid.prices))
    seeds = Seeds(np.array([last], np.int32), np.zeros(1, np.float32), np.zeros(1, np.int32))
    if last_metres is not None:
        seeds = last_metres.begun
        while len(field.entries) < 4 * len(seeds.nodes):
            field.grow()
        if region is not None:
            for cells in last_metres.begun, last_metres.settled:
                row, col = np.divmod(cells.nodes, grid.stride)
                region.bitmap[region.row_block[row - 1], region.col_block[col - 1]] = region.stamp
    allowed = _allowed(region)
    rule = FieldRule(tuple(_best(grid)), _bucket_width(grid), between)
    before = (states.poses, states.edges, tuple(prices), allowed, tuple(seeds))
    code, spent, refused = _run(fill_field, before, Ends(last, first), rule, field, limits)
    if last_metres is not None:
        nodes, costs, onwards = last_metres.settled
        cheaper = costs < field.costs(nodes.astype(np.int64))
        field.g[2 * nodes[cheaper]] = costs[cheaper]
        field.meta[2 * nodes[cheaper] + 1] = (field.stamp << STAMP_SHIFT) | onwards[cheaper]
    if code != FOUND:
        status = Status.NO_PATH if code == EXHAUSTED else Status.TIMEOUT
        return Search.without_path(status, spent, min(refused, refused_at_least), columns)
    guide = first, float(field.g[2 * first]), between
    found = _by_field(grid, ends, wanted, workspace, allowed, guide, beyond, limits)
    if found.status is not Status.NO_PATH or found.refused_f < math.inf:
        found = found._replace(refused_f=refused_at_least)
    return found._replace(expansions=found.expansions + spent)


def last_metres_to(
    grid: "Grid",
    goal: Cell,
    wanted: NDArray[np.bool_],
    workspace: Workspace,
    deadline: Deadline = NEVER,
) -> LastMetres | None:
    """Costs of the last metres to a goal with a heading, for a body; None where legs cost otherwise
    one way than the other.
    """
    states = grid.robot.states()
    assert states is not None
    if len(states.edges):
        return None
    frame = _frame(grid, workspace)
    backwards = np.resize(np.roll(wanted, DIRECTION_COUNT // 2), workspace.states)
    nowhere = np.zeros_like(backwards)
    width = _bucket_width(grid)
    rule = StateRule(_UNJUDGED, width, kernels.BELOW, 0.0, frame, backwards, nowhere)
    before = (*_packed(states), _no_field(workspace), kernels.NO_REGION)
    limits = Limits(AROUND_GOAL, deadline.at)
    from_goal = Ends(grid.node(*goal), _CORNER)
    code, _, spent, _ = _run(expand_states, before, from_goal, rule, workspace, limits)
    longest = int(np.abs(states.prices.moves[..., [DOWN, RIGHT]]).max())
    reach = min(int(workspace.least_open / grid.prices[0]) + 2 * longest, spent * longest)
    row, col, rows, cols = widened((*goal, 1, 1), (reach, reach), grid.shape)
    area = (row + 1, row + rows + 1, col + 1, col + cols + 1)  # `records.Area`
    searched = (workspace.g, workspace.meta, workspace.stamp)  # `records.Searched`
    nodes, onwards = np.empty((2, 2, rows * cols), np.int32)
    costs = np.empty((2, rows * cols), np.float32)
    counts = least_of_cells(searched, frame, area, nodes, costs, onwards)
    begun, settled = (
        Seeds(nodes[at, :count], costs[at, :count], onwards[at, :count])
        for at, count in enumerate(counts)
    )
    return LastMetres(begun, settled, code == EXHAUSTED, spent)


def by_kept_field(
    grid: "Grid",
    start: Cell,
    goal: Cell,
    workspace: Workspace,
    region: Region | None,
    begun: Cell,
    promised: float,
    *,
    limit: int | None = None,
    deadline: Deadline = NEVER,
    direction: int = -1,
    wanted: NDArray[np.bool_] | None = None,
) -> Search:
    """As `astar` of a body, guided by the costs to go that the last search of the region, or the
    map, was guided by.

    That began at the cell `begun`, to be `promised` its cost to go. `goal` may be a cell on the way
    to its goal, and `wanted` (S,) the states that will do there. The map may have changed: what is
    driven is checked on it. At the `limit` the best path so far counts.
    """
    first = grid.node(*start)
    last = grid.node(*goal)
    states = grid.robot.states()
    assert states is not None
    between = _turns_in_field(states.prices, region)
    limits = Limits(limit or _WITHOUT_END, deadline.at)
    guide = (grid.node(*begun), promised, between)
    ends = (first, last, direction)
    found = _by_field(grid, ends, wanted, workspace, _allowed(region), guide, 0.0, limits)
    return found._replace(refused_f=float(octile.py_func(*start, *goal, *grid.prices)))


def _by_field(
    grid: "Grid",
    ends: tuple[int, int, int],
    wanted: NDArray[np.bool_] | None,
    workspace: Workspace,
    allowed: Parts,
    guide: tuple[int, float, NDArray[np.float32]],
    beyond: float,
    limits: Limits,
) -> Search:
    """The search over states, once the field is there; of that the start, the cost from there, and
    those of turns.
    """
    states = grid.robot.states()
    field = workspace.field
    begun, promised, between = guide
    assert states is not None and field is not None
    start = divmod(begun, grid.stride)
    judged = Field(field.g, field.meta, field.stamp, *start, promised, between)
    first, last, direction = ends
    (starting, at_goal), frame = np.ones((2, workspace.states), np.bool_), _frame(grid, workspace)
    if direction >= 0:
        starting[:] = np.arange(workspace.states) == direction
    if wanted is not None:
        at_goal[:] = np.resize(wanted, workspace.states)
    step, _ = grid.prices
    rule = StateRule(
        tuple(_best(grid)),
        step * BUCKET_WIDTH_BY_LANDMARKS,
        _beyond(beyond),
        step / REOPENED_WITHIN if len(between) else 0.0,
        frame,
        starting,
        at_goal,
    )
    code, length, expansions, refused = _run(
        expand_states,
        (*_packed(states), tuple(judged), allowed),
        Ends(first, last),
        rule,
        workspace,
        limits,
    )
    end = int(workspace.counts[BEST_NODE])
    trace = partial(trace_states, prices=tuple(states.prices), frame=frame)
    if code == PAUSED and limits.most < _WITHOUT_END and workspace.counts[GOAL_STATE] >= 0:
        code = FOUND
        end = int(workspace.counts[GOAL_STATE])
        length = trace(workspace.meta, end, out=workspace.path)
    found = _traced(trace, workspace, code, end, length, expansions, refused)
    path = found.path
    if grid.robot.columns == 2:  # cells alone, of those that it turns on one
        moved = np.any(np.diff(path[:, :2], axis=0, prepend=-1), axis=1)
        path = np.ascontiguousarray(path[moved, :2])
    return found._replace(path=path, promised=promised)


def _frame(grid: "Grid", workspace: Workspace) -> Packed:
    """How states are numbered."""
    return tuple(Frame(workspace.states.bit_length() - 1, grid.stride))


def _packed(states: "States") -> Parts:
    """A body's motions as kernels take them."""
    return states.poses, states.edges, tuple(states.prices)


def _turns_in_field(prices: Prices, region: Region | None) -> NDArray[np.float32]:
    """Costs of turns in the costs to go of cells; on the whole map they are free."""
    if region is None:
        return prices.turns[:0]
    turns: NDArray[np.float32] = np.float32(TURNS_IN_FIELD) * prices.turns
    return turns


def _run(
    kernel: Callable[..., Parts],
    before: Parts,
    ends: Ends,
    rule: Rule | FieldRule | StateRule,
    workspace: Workspace,
    limits: Limits,
) -> Parts:
    """The outcome of a search's kernel; the open list grows as it needs, unless it is late."""
    if ends.start != _ON:
        workspace.next_stamp()
    while True:
        found: Parts = kernel(*before, tuple(ends), tuple(rule), workspace.packed, tuple(limits))
        code, *_ = found
        if code != FULL or time.monotonic() >= limits.until:
            return found
        ends = ends._replace(start=_ON)
        workspace.grow()


def _traced(
    trace: Callable[..., int],
    ws: Workspace,
    code: int,
    end: int,
    length: int,
    spent: int,
    refused: float,
) -> Search:
    """The outcome of a search that came to `end`, with its path."""
    if code == EXHAUSTED:
        return Search.without_path(Status.NO_PATH, spent, refused, ws.path.shape[1])
    if code == FULL:  # out of time just when the open list had to grow
        length = trace(ws.meta, end, out=ws.path)
    if length > len(ws.path):
        ws.path = np.empty((length, ws.path.shape[1]), np.int32)
        trace(ws.meta, end, out=ws.path)
    status = Status.OK if code == FOUND else Status.TIMEOUT
    return Search(status, ws.path[length - 1 :: -1].copy(), spent, refused)


def _no_field(workspace: Workspace) -> Parts:
    """In place of a field, for a search of states that nothing guides."""
    nothing = np.empty((0, 0), np.float32)
    return tuple(Field(workspace.g[:0], workspace.meta[:0], 0, 0, 0, 0.0, nothing))


def _allowed(region: Region | None) -> Parts:
    return kernels.NO_REGION if region is None else tuple(region)


def _ways(links: Links) -> NDArray[np.uint8]:
    return kernels.NO_LINKS if links is None else links


def _beyond(share: float) -> float:
    return 1.0 + share if share else kernels.BELOW


def settle_all(grid: "Grid", source: Cell, workspace: Workspace, links: Links = None) -> None:
    """Search from a passable cell until nothing is left: the workspace then holds every cell's cost
    from there.
    """
    for _ in _settling(grid, source, workspace, links):
        pass


def _settling(
    grid: "Grid",
    source: Cell,
    workspace: Workspace,
    links: Links = None,
    most: int = _WITHOUT_END,
    deadline: Deadline = NEVER,
) -> Iterator[float]:
    """Search on, `most` expansions each time: the least cost that may yet fall, inf in the end; or
    OutOfTimeError.
    """
    width = _bucket_width(grid)
    anywhere = np.ones(workspace.states, np.bool_)
    kernel: Callable[..., Parts] = kernels.expand
    before: Parts = (
        grid.packed,
        grid.robot.edges(),
        _ways(links),
        kernels.NO_REGION,
        kernels.NO_HINTS,
    )
    rule: Rule | StateRule = Rule(0.0, 0.0, width, _successors(grid, links), kernels.BELOW)
    if (states := grid.robot.states()) is not None:
        kernel = expand_states
        before = (*_packed(states), _no_field(workspace), kernels.NO_REGION)
        frame = _frame(grid, workspace)
        rule = StateRule(_UNJUDGED, width, kernels.BELOW, 0.0, frame, anywhere, ~anywhere)
    begin = grid.node(*source)
    limits = Limits(most, deadline.at)
    code = PAUSED
    while code == PAUSED:
        code, *_ = _run(kernel, before, Ends(begin, _CORNER), rule, workspace, limits)
        begin = _ON
        if code != EXHAUSTED:
            deadline.check()
        yield math.inf if code == EXHAUSTED else workspace.least_open


def cost_field(grid: "Grid", source: Cell, workspace: Workspace) -> Float2D:
    """Cost of the cheapest path from a passable cell to every other: (H, W) float32, inf where
    there is none.
    """
    settle_all(grid, source, workspace)
    field = workspace.costs().reshape(-1, grid.stride)[1 : grid.rows + 1, 1 : grid.cols + 1]
    return grid.robot.with_heights(field, source)


def costs_to_nearest(
    grid: "Grid",
    stops: Sequence[Cell],
    count: int,
    workspace: Workspace,
    deadline: Deadline = NEVER,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Costs of the cheapest paths from each of N passable cells, but the last, to so many of the
    others.

    Returns (N, N) float64, what a path from one to another costs, and (N, N) bool, whether that is
    known; else it costs at least that. OutOfTimeError at the deadline.
    """
    nodes = np.array([grid.node(*stop) for stop in stops])
    costs = np.zeros((len(stops), len(stops)))
    known = np.eye(len(stops), dtype=np.bool_)
    for at, stop in enumerate(stops[:-1]):
        for within in _settling(grid, stop, workspace, most=_BETWEEN_LOOKS, deadline=deadline):
            found = workspace.costs(nodes)
            settled = found <= within * kernels.BELOW
            if settled.sum() > count:  # the cell itself is one of them
                break
        costs[at] = np.where(settled, found, within)
        costs[at] += [grid.robot.worth_of_height(stop, other) for other in stops]
        known[at] |= settled | (within == math.inf)
    return costs, known


def _bucket_width(grid: "Grid", hints: Hints | None = None) -> float:
    by_grid = DIRECTED_BUCKET_WIDTH if grid.robot.by_slope else BUCKET_WIDTH
    return grid.prices[0] * (by_grid if hints is None else BUCKET_WIDTH_BY_LANDMARKS)


def _best(grid: "Grid") -> Legs:
    """Least costs of legs, see `Grid.prices`."""
    straight, diagonal = grid.prices
    return Legs(straight / KNIGHT, diagonal / KNIGHT, straight + diagonal)


def _successors(grid: "Grid", links: Links) -> NDArray[np.int64]:
    """The steps from a cell that its best predecessor leaves to search."""
    if links is not None or grid.robot.by_slope:
        return kernels.SUCCESSORS[0]
    return kernels.SUCCESSORS[2 if grid.corner_cutting and grid.model.kind is StepCost.PAPER else 1]
