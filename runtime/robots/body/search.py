"""The search of a body's states, guided by the costs to go of cells.

The costs to go are found first, by a search of cells from the goal, the *field*; they tell soon
where there is no path. On the whole map turns are free in them, arcs are ways between cells like
legs, whatever the direction, and the answer is the best. In a region legs and their turns alone
count, which leaves few states to search, for an answer about as good.
"""

import math
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Float32s
from nnpp_edge.runtime.cells import Cell, Rectangle, widened
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
    DIRECTION_BITS,
    EXHAUSTED,
    FOUND,
    PAUSED,
    STAMP_SHIFT,
    octile,
)
from nnpp_edge.runtime.kernels.records import (
    BEST_NODE,
    DOWN,
    RIGHT,
    Ends,
    Field,
    FieldRule,
    Frame,
    Legs,
    Packed,
    Prices,
    Seeds,
    StateRule,
)
from nnpp_edge.runtime.search.astar import (
    NOWHERE,
    ON,
    WITHOUT_END,
    Parts,
    Query,
    Search,
    Spreading,
    allowed,
    bucket_width,
    run,
    traced,
)
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.tuning import (
    AGAIN_EXPANSIONS,
    AROUND_GOAL,
    BUCKET_WIDTH_BY_LANDMARKS,
    CHECKED_FROM,
    CHECKED_SHARE,
    REOPENED_WITHIN,
)

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid

_UNJUDGED: Packed = tuple(Legs(0.0, 0.0, 0.0))
"""Of a search that nothing guides."""


class States(NamedTuple):
    """A body's motions and what they cost."""

    poses: Packed
    """`records.Poses`."""
    edges: Float32s
    """(nodes, 16) costs of legs; (0, 16) where they cost by their checks."""
    prices: Prices

    @property
    def packed(self) -> Parts:
        """As kernels take them."""
        return self.poses, self.edges, tuple(self.prices)


class Guide(NamedTuple):
    """What is known of the field that guides a search."""

    begun: int
    """Node at which the field was to end: the start."""
    promised: float
    """What it costs from there."""
    turns: Float32s
    """(16, 16) costs of turns that count in it; (0, 16) where they are free."""


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

    @classmethod
    def to(
        cls, grid: "Grid", states: States, query: Query, workspace: Workspace
    ) -> "LastMetres | None":
        """Those to the goal of a query that has a heading there; None where legs cost otherwise one
        way than the other.
        """
        if query.wanted is None or query.start == query.goal or len(states.edges):
            return None
        # search a few states from the goal, the other way round
        backwards = np.resize(np.roll(query.wanted, DIRECTION_COUNT // 2), workspace.states)
        search = spreading(grid, states, workspace, backwards)
        from_goal = Ends(grid.node(*query.goal), NOWHERE)
        code, _, spent, _ = run(*search, from_goal, workspace, AROUND_GOAL, query.deadline)
        # what it came to lies in a rectangle around the goal
        longest = int(np.abs(states.prices.moves[..., [DOWN, RIGHT]]).max())
        reach = min(int(workspace.least_open / grid.prices[0]) + 2 * longest, spent * longest)
        row, col, rows, cols = widened((*query.goal, 1, 1), (reach, reach), grid.shape)
        area = (row + 1, row + rows + 1, col + 1, col + cols + 1)  # `records.Area`
        searched = (workspace.g, workspace.meta, workspace.stamp)  # `records.Searched`
        nodes, onwards = np.empty((2, 2, rows * cols), np.int32)
        costs = np.empty((2, rows * cols), np.float32)
        counts = least_of_cells(searched, _frame(grid, workspace), area, nodes, costs, onwards)
        begun, settled = (
            Seeds(nodes[at, :count], costs[at, :count], onwards[at, :count])
            for at, count in enumerate(counts)
        )
        return cls(begun, settled, code == EXHAUSTED, spent)

    def hold(self, node: int) -> bool:
        """Whether the search came to a cell."""
        return any(bool((cells.nodes == node).any()) for cells in (self.begun, self.settled))

    def mark(self, region: Region, stride: int) -> None:
        """Add the cells to a region."""
        for cells in (self.begun, self.settled):
            row, col = np.divmod(cells.nodes, stride)
            region.bitmap[region.row_block[row - 1], region.col_block[col - 1]] = region.stamp

    def put_into(self, field: Workspace) -> None:
        """Have a field tell the costs of the cells within, where they are less than it has them."""
        nodes, costs, onwards = self.settled
        cheaper = costs < field.costs(nodes.astype(np.int64))
        field.g[2 * nodes[cheaper]] = costs[cheaper]
        field.meta[2 * nodes[cheaper] + 1] = (field.stamp << STAMP_SHIFT) | onwards[cheaper]


def spreading(
    grid: "Grid",
    states: States,
    workspace: Workspace,
    starting: Bool,
    wanted: Bool | None = None,
    inside: Parts = kernels.NO_REGION,
) -> Spreading:
    """How costs spread from the `starting` states (S,) of a cell to those that are `wanted` at
    another, guided by nothing.
    """
    nothing = np.empty((0, 0), np.float32)
    no_field = tuple(Field(workspace.g[:0], workspace.meta[:0], 0, 0, 0, 0.0, nothing))
    before = (*states.packed, no_field, inside)
    frame = _frame(grid, workspace)
    nowhere = np.zeros_like(starting) if wanted is None else wanted
    width = bucket_width(grid)
    rule = StateRule(_UNJUDGED, width, kernels.BELOW, 0.0, frame, starting, nowhere)
    return Spreading(expand_states, before, rule)


class FromGoal:
    """A search from the goal, beside one from the start that takes long: is there a way at all?

    A body that stands the other way round can go back wherever it can go there. Nothing guides it.
    """

    def __init__(
        self,
        grid: "Grid",
        query: Query,
        workspace: Workspace,
        inside: Parts,
        starting: Bool,
        at_goal: Bool,
    ) -> None:
        states = grid.robot.states()
        self.memory = workspace.from_goal
        self.expansions = 0
        self.refused = math.inf
        begun, ended = (_turned_round(each) for each in (at_goal, starting))
        self._search = spreading(grid, states, self.memory, begun, ended, inside)
        self._ends = Ends(grid.node(*query.goal), grid.node(*query.start))
        self._deadline = query.deadline
        self._done = False

    def finds_none(self, most: int) -> bool:
        """Whether there is no way, once it has gone on to so many expansions in all; not where that
        is not known yet.
        """
        if self._done or most <= self.expansions:
            return False
        left = most - self.expansions
        found = run(*self._search, self._ends, self.memory, left, self._deadline)
        code, _, self.expansions, self.refused = found
        self._ends = self._ends._replace(start=ON)
        self._done = code != PAUSED
        return bool(code == EXHAUSTED)


def search_states(
    grid: "Grid",
    query: Query,
    workspace: Workspace,
    region: Region | None,
    last_metres: LastMetres | None,
    limit: int | None = None,
) -> Search:
    """The cheapest path over a body's states, as `robots.Robot.search`.

    `last_metres` to the goal, of a query with a heading there, spare expansions; their cells are
    added to the region. In a region no path costs less than the octile distance, which is all that
    is known of those that lead out of it.
    """
    robot = grid.robot
    field = workspace.field
    assert field is not None
    first = grid.node(*query.start)
    last = grid.node(*query.goal)
    if first == last and _may_stay(query):
        return Search(Status.OK, np.array([_at_once(query)[: robot.moves.columns]], np.int32), 0)
    if last_metres is not None and last_metres.hold(first):
        last_metres = None  # so near that the field may as well begin at the goal
    elif last_metres is not None and last_metres.exhausted:
        return Search.without_path(Status.NO_PATH, columns=robot.moves.columns)
    most = limit or WITHOUT_END
    refused_at_least = math.inf if region is None else octile_cost(grid, query)
    # where the field begins
    seeds = goal_alone(grid, query)
    if last_metres is not None:
        seeds = last_metres.begun
        while len(field.entries) < 4 * len(seeds.nodes):
            field.grow()
        if region is not None:
            last_metres.mark(region, grid.stride)
    # fill it, from the goal to the start
    turns = turns_in_field(grid, query, region)
    code, spent, refused = filled(grid, query, field, region, turns, seeds, most)
    if last_metres is not None:
        last_metres.put_into(field)
    if code != FOUND:
        status = Status.NO_PATH if code == EXHAUSTED else Status.TIMEOUT
        refused = min(refused, refused_at_least)
        nothing = Search.without_path(status, spent, refused, robot.moves.columns)
        return nothing._replace(exhausted=field if code == EXHAUSTED else None)
    # search the states by it, from the start to the goal
    guide = Guide(first, float(field.g[2 * first]), turns)
    found = by_field(grid, query, workspace, region, guide, most)
    if found.status is not Status.NO_PATH or found.refused_f < math.inf:
        found = found._replace(refused_f=refused_at_least)
    return found._replace(expansions=found.expansions + spent)


def goal_alone(grid: "Grid", query: Query) -> Seeds:
    """A field begins at the goal."""
    node, onwards = np.array([[grid.node(*query.goal)], [0]], np.int32)
    return Seeds(node, np.zeros(1, np.float32), onwards)


def filled(
    grid: "Grid",
    query: Query,
    field: Workspace,
    region: Region | None,
    turns: Float32s,
    seeds: Seeds,
    most: int = WITHOUT_END,
    *,
    anew: bool = True,
) -> Parts:
    """What filling the field of a region comes to: the code, the expansions, the least f of a cell
    that the region refused. Unless `anew` the field holds what it held.
    """
    states = grid.robot.states()
    prices = states.prices
    if region is not None:  # legs alone count
        rays = prices.rays[:DIRECTION_COUNT]
        prices = prices._replace(rays=rays, ray_fares=prices.ray_fares[:DIRECTION_COUNT])
    rule = FieldRule(tuple(_best(grid)), bucket_width(grid), turns)
    before = (states.poses, states.edges, tuple(prices), allowed(region), tuple(seeds))
    ends = Ends(grid.node(*query.goal), grid.node(*query.start))
    return run(fill_field, before, rule, ends, field, most, query.deadline, anew=anew)


def may_open(grid: "Grid", query: Query, memory: Workspace, part: Rectangle) -> bool:
    """As `Robot.may_open`. A field goes on from its cells near the change, as far as that leads; of
    a search of states it is known only where it came nowhere near.
    """
    near = grid.nodes(widened(part, grid.robot.stance.reach, grid.shape)).ravel()
    costs = memory.costs(near)
    came = np.isfinite(costs)
    if memory.states > 1 or not came.any():
        return bool(came.any())
    nodes = near[came].astype(np.int32)
    onwards = memory.meta[2 * nodes + 1] & DIRECTION_BITS
    while len(memory.entries) < 4 * len(nodes):
        memory.grow()
    seeds = Seeds(nodes, costs[came], onwards)
    free_turns = grid.robot.states().prices.turns[:0]
    query = query._replace(deadline=NEVER)
    most = AGAIN_EXPANSIONS
    code, *_ = filled(grid, query, memory, None, free_turns, seeds, most, anew=False)
    return bool(code != EXHAUSTED)


def costs_of_cells(grid: "Grid", start: Cell, memory: Workspace, deadline: Deadline) -> Float32s:
    """As `Robot.costs_of_cells`."""
    field = memory.field
    assert field is not None
    everywhere = Query(grid.cell(NOWHERE), start, deadline=deadline)
    free_turns = grid.robot.states().prices.turns[:0]
    filled(grid, everywhere, field, None, free_turns, goal_alone(grid, everywhere))
    deadline.check()
    return grid.inner(field.costs())


def by_field(
    grid: "Grid",
    query: Query,
    workspace: Workspace,
    region: Region | None,
    guide: Guide,
    most: int,
) -> Search:
    """The search over states, once the field is there."""
    states = grid.robot.states()
    field = workspace.field
    assert field is not None
    start = divmod(guide.begun, grid.stride)
    judge = Field(field.g, field.meta, field.stamp, *start, guide.promised, guide.turns)
    starting, at_goal = np.ones((2, workspace.states), np.bool_)
    if query.direction >= 0:
        starting[:] = np.arange(workspace.states) == query.direction
    if query.wanted is not None:
        at_goal[:] = np.resize(query.wanted, workspace.states)
    step, _ = grid.prices
    frame = _frame(grid, workspace)
    rule = StateRule(
        tuple(_best(grid)),
        step * BUCKET_WIDTH_BY_LANDMARKS,
        kernels.BELOW,
        step / REOPENED_WITHIN if len(guide.turns) else 0.0,
        frame,
        starting,
        at_goal,
    )
    ends = Ends(grid.node(*query.start), grid.node(*query.goal))
    inside = allowed(region)
    deadline = query.deadline
    before = (*states.packed, tuple(judge), inside)
    search = Spreading(expand_states, before, rule)
    unchecked = most if len(states.edges) else min(most, CHECKED_FROM)
    code, length, expansions, refused = run(*search, ends, workspace, unchecked, deadline)
    exhausted = workspace
    checked = 0
    if code == PAUSED and unchecked < most and not deadline.passed:
        # look from the goal, too, whether any way leads there, while this goes on
        check = FromGoal(grid, query, workspace, inside, starting, at_goal)
        while code == PAUSED and expansions < most and not deadline.passed:
            if check.finds_none(int(CHECKED_SHARE * expansions)):
                code = EXHAUSTED
                refused = check.refused
                exhausted = check.memory
                break
            ends = ends._replace(start=ON)
            more = min(expansions, most - expansions)
            code, length, expansions, refused = run(*search, ends, workspace, more, deadline)
        checked = check.expansions
    end = int(workspace.counts[BEST_NODE])
    trace = partial(trace_states, prices=tuple(states.prices), frame=frame)
    found = traced(trace, workspace, code, end, length, expansions + checked, refused)
    if code == EXHAUSTED:
        found = found._replace(exhausted=exhausted)
    path = found.path
    if grid.robot.moves.columns == 2:  # cells alone, of those that it turns on one
        moved = np.any(np.diff(path[:, :2], axis=0, prepend=-1), axis=1)
        path = np.ascontiguousarray(path[moved, :2])
    return found._replace(path=path, promised=guide.promised)


def _turned_round(states: Bool) -> Bool:
    """(S,) states in which a body stands the other way round, in any gear."""
    directions = states.reshape(-1, DIRECTION_COUNT).any(0)
    return np.resize(np.roll(directions, DIRECTION_COUNT // 2), len(states))


def _may_stay(query: Query) -> bool:
    """Whether a body that is at the goal need not turn."""
    return query.direction < 0 or query.wanted is None or bool(query.wanted[query.direction])


def _at_once(query: Query) -> tuple[int, int, int]:
    """The state in which a body that need not move stands at the goal."""
    if query.direction < 0 and query.wanted is not None:
        return *query.start, int(np.argmax(query.wanted))
    return *query.start, max(query.direction, 0)


def octile_cost(grid: "Grid", query: Query) -> float:
    return float(octile.py_func(*query.start, *query.goal, *grid.prices))


def _frame(grid: "Grid", workspace: Workspace) -> Packed:
    """How states are numbered."""
    return tuple(Frame(workspace.states.bit_length() - 1, grid.stride))


def turns_in_field(grid: "Grid", query: Query, region: Region | None) -> Float32s:
    """Costs of turns in the costs to go of cells; on the whole map they are free."""
    states = grid.robot.states()
    if region is None:
        return states.prices.turns[:0]
    share = grid.robot.moves.turns_in_field(query.apart)
    turns: Float32s = np.float32(share) * states.prices.turns
    return turns


def _best(grid: "Grid") -> Legs:
    """Least costs of legs, see `Grid.prices`."""
    straight, diagonal = grid.prices
    return Legs(straight / KNIGHT, diagonal / KNIGHT, straight + diagonal)
