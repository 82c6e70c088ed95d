"""The search of a body's states, guided by the costs to go of cells.

The costs to go are found first, by a search of cells from the goal, the *field*; they tell soon
where there is no path. On the whole map turns are free in them, arcs are ways between cells like
legs, whatever the direction, and the answer is the best. In a region legs and their turns alone
count, which leaves few states to search, for an answer about as good.
"""

import math
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple
from weakref import proxy

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Float32s, Int64
from nnpp_edge.runtime.cells import Cell, Rectangle, slices, widened
from nnpp_edge.runtime.deadline import NEVER, Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels import expansion as kernels
from nnpp_edge.runtime.kernels.by_address import blank
from nnpp_edge.runtime.kernels.lattice import (
    DIRECTION_COUNT,
    KNIGHT,
    expand_states,
    fill_field,
    trace_states,
)
from nnpp_edge.runtime.kernels.nodes import (
    DIRECTION_BITS,
    EXHAUSTED,
    FOUND,
    OPEN_BIT,
    PAUSED,
    STAMP_SHIFT,
    WITHOUT_END,
    octile,
)
from nnpp_edge.runtime.kernels.records import (
    DOWN,
    RIGHT,
    Ends,
    Field,
    FieldRule,
    FrameRecord,
    Legs,
    Packed,
    Prices,
    Seeds,
    StateRule,
)
from nnpp_edge.runtime.search.astar import (
    NOWHERE,
    ON,
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
    AT_ENDS,
    BUCKET_WIDTH_BY_LANDMARKS,
    CHECKED_SHARE,
    DOUBTED_EVERY,
    LATE_IN_REGION,
    LATE_ON_MAP,
    MOST_ABOVE_FIELD,
    PROOF_SHARE,
    REOPENED_WITHIN,
    RISEN,
)

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.grid import Grid

NO_FIELD: Field = blank(Field)  # type: ignore[no-untyped-call]  # as all of `kernels`
"""Of a search that nothing guides."""


class States(NamedTuple):
    """A body's motions and what they cost."""

    poses: Packed
    """`records.PosesRecord`."""
    edges: Float32s
    """(nodes, 16) costs of legs; (0, 16) where they cost by their checks."""
    prices: Prices


def spreading(
    grid: "Grid",
    workspace: Workspace,
    starting: Bool,
    wanted: Bool,
    inside: Parts = kernels.NO_REGION,
    field: Field = NO_FIELD,
) -> Spreading:
    """How costs spread from the `starting` states (S,) of a cell to those that are `wanted` at
    another, guided by a field.
    """
    states = grid.robot.states()
    step, _ = grid.prices
    legs = Legs(0.0, 0.0, 0.0)
    width = bucket_width(grid)
    if field is not NO_FIELD:
        legs = _best(grid)
        width = step * BUCKET_WIDTH_BY_LANDMARKS
    again = step / REOPENED_WITHIN if len(field.between) else 0.0
    frame = _frame(grid, workspace)
    change = grid.robot.moves.readiness
    rule = StateRule(tuple(legs), width, kernels.BELOW, again, change, frame, starting, wanted)
    before = (states.poses, states.edges, tuple(states.prices), tuple(field), inside)
    return Spreading(expand_states, before, rule)


class FromGoal:
    """A search of states from a query's goal, on the whole map, which nothing guides.

    A body that stands the other way round can go back wherever it can go there, at the same cost.
    """

    def __init__(self, grid: "Grid", query: Query, memory: Workspace) -> None:
        self.query = query
        self.memory = memory
        self.code = PAUSED
        self.expansions = 0
        self._grid = proxy(grid)  # which holds this, by its robot
        begun, ended = (_turned_round(states) for states in _at_ends(query, memory.states)[::-1])
        self._search = spreading(grid, memory, begun, ended)
        self._ends = Ends(grid.node(*query.goal), grid.node(*query.start))

    def go_on(self, most: int) -> int:
        """Go on to so many expansions in all, while it is open whether a way leads to the start;
        the expansions that it took.
        """
        before = self.expansions
        if self.code == PAUSED and most > before:
            found = run(*self._search, self._ends, self.memory, most - before, self.query.deadline)
            self.code, _, self.expansions, _ = found
            self._ends = self._ends._replace(start=ON)
        return self.expansions - before

    def shut_in(self, workspace: Workspace) -> tuple[Workspace | None, int]:
        """Memory of a search that came to all, few states, to which arcs lead from one end; and the
        expansions. To a goal with a heading it goes on to the last metres.
        """
        spent = 0
        few = AT_ENDS if self._grid.robot.moves.columns == 3 else 0
        if few and not self.expansions:
            flood = spreading(self._grid, workspace, *_at_ends(self.query, workspace.states))
            ends = Ends(self._ends.goal, self._ends.start)
            code, _, spent, _ = run(*flood, ends, workspace, few, self.query.deadline)
            if code == EXHAUSTED:
                return workspace, spent
        spent += self.go_on(few if self.query.wanted is None else AROUND_GOAL)
        return self.memory if self.code == EXHAUSTED else None, spent

    @cached_property
    def last_metres(self) -> tuple[Seeds, Seeds] | None:
        """Least costs of the cells that it came to: of those where it stopped, from which all ways
        lead on to the goal, and of those within; None where the start is one of them.
        """
        memory = self.memory
        reached = cells_reached(self._grid, self.query.goal, memory, self.query.deadline)
        if reached[self.query.start]:
            return None
        nodes = np.flatnonzero(np.pad(reached, 1))
        # g and word of each state of these cells
        found = memory.meta.reshape(-1, 2 * memory.states)[nodes]
        came = found[:, 1::2] >> STAMP_SHIFT == memory.stamp
        waits = found[:, 1::2] & OPEN_BIT > 0
        g = found.view(np.float32)[:, ::2]
        begun, within = (
            _least_of(nodes, np.where(came & chosen, g, np.float32(np.inf)))
            for chosen in (waits, ~waits)
        )
        return begun, within


def _least_of(nodes: Int64, costs: Float32s) -> Seeds:
    """The least costs of nodes (N,) by states (N, S) that a search from the goal came to."""
    states = costs.argmin(1)
    # a way on leaves it the other way round than the search came to it, but in reverse
    onwards = np.where(states < DIRECTION_COUNT, states + DIRECTION_COUNT // 2, states)
    onwards %= DIRECTION_COUNT
    least = costs.min(1)
    found = least < np.inf
    return Seeds(nodes[found].astype(np.int32), least[found], onwards[found].astype(np.int32))


def cells_reached(grid: "Grid", begin: Cell, memory: Workspace, deadline: Deadline) -> Bool:
    """(H, W) cells to which a search of states came that began in one. It pauses as searches do."""
    most = int(np.abs(grid.robot.states().prices.moves[..., [DOWN, RIGHT]]).max())
    reached = np.zeros(grid.shape, np.bool_)
    here = (*begin, 1, 1)
    radius = most
    while True:
        part = slices(widened(here, (most + radius, most + radius), grid.shape))
        reached[part] = memory.reached(grid.rows, deadline, part)
        # no primitive leads further than `most`: are all within the rim?
        if reached.sum() == reached[slices(widened(here, (radius, radius), grid.shape))].sum():
            return reached
        radius *= 2


def search_states(
    grid: "Grid",
    query: Query,
    workspace: Workspace,
    region: Region | None,
    from_goal: FromGoal | None,
    limit: int | None = None,
) -> Search:
    """The cheapest path over a body's states, as `robots.Robot.search`.

    The search `from_goal` goes on meanwhile, as far as that pays; cells of its last metres are
    added to the region. In a region no path costs less than the octile distance, which is all that
    is known of those that lead out of it. A query's first region is given up for a wider one where
    paths of arcs cost much more than it promised.
    """
    starting, at_goal = _at_ends(query, workspace.states)
    stays = starting & at_goal
    if query.start == query.goal and stays.any():
        place = (*query.start, int(stays.argmax()))
        return Search(Status.OK, np.array([place[: grid.robot.moves.columns]], np.int32), 0)
    ends = Ends(grid.node(*query.start), grid.node(*query.goal))
    most = limit or WITHOUT_END
    spent = 0
    by_arcs = grid.robot.moves.columns == 3
    doubted = False
    late = most
    if from_goal is not None:
        doubted = by_arcs and region is not None and not from_goal.expansions
        late = LATE_IN_REGION if by_arcs and region is not None else LATE_ON_MAP
        shut_in, spent = from_goal.shut_in(workspace)
        if shut_in is not None:
            return _no_path(grid, spent, math.inf, shut_in)
    # fill the field, from the goal to the start
    at_least = math.inf
    if region is not None:
        at_least = float(octile.py_func(*query.start, *query.goal, *grid.prices))
    guide_in = partial(_guide, grid, query, region, from_goal, most)
    code, filling, field = guide_in(workspace.field)
    spent += filling
    if code == EXHAUSTED:
        return _no_path(grid, spent, at_least, workspace.field)
    if code != FOUND:
        return Search.without_path(Status.TIMEOUT, spent, at_least, grid.robot.moves.columns)
    # search the states by it, from the start to the goal
    until = max(late, filling)
    promised = field.floor
    guided_by = partial(spreading, grid, workspace, starting, at_goal, allowed(region))
    search = guided_by(field)
    onwards = ends
    expansions = 0
    while True:
        more = until - expansions
        if doubted:
            more = min(more, DOUBTED_EVERY)
        found = run(*search, onwards, workspace, more, query.deadline)
        code, length, expansions, refused = found
        if code == EXHAUSTED:
            beyond = math.inf if refused == math.inf else at_least
            # another region may take as long: does no way lead out of the goal?
            if beyond < math.inf and from_goal and from_goal.expansions >= AROUND_GOAL:
                spent += from_goal.go_on(int(PROOF_SHARE * expansions))
                if from_goal.code == EXHAUSTED:
                    return _no_path(grid, spent + expansions, math.inf, from_goal.memory)
            return _no_path(grid, spent + expansions, beyond, workspace)
        if code == FOUND or expansions >= most or query.deadline.passed:
            path = _traced(grid, workspace, code, length)
            return path._replace(expansions=spent + expansions, refused_f=at_least)
        onwards = ends._replace(start=ON)
        dearer = workspace.least_open > MOST_ABOVE_FIELD * promised
        if doubted and dearer and expansions < 2 * LATE_IN_REGION:
            return _no_path(grid, spent + expansions, at_least, None)
        if expansions < until:
            continue
        # it takes long: the search from the goal goes on, too, of arcs for the last metres at first
        assert from_goal is not None
        until = 2 * expansions
        first = by_arcs and from_goal.expansions < AROUND_GOAL
        spent += from_goal.go_on(AROUND_GOAL if first else int(CHECKED_SHARE * expansions))
        if from_goal.code == EXHAUSTED:
            return _no_path(grid, spent + expansions, math.inf, from_goal.memory)
        if first and from_goal.last_metres is not None:
            memory = from_goal.memory.field
            code, filling, field = guide_in(memory)
            spent += filling
            if code == EXHAUSTED:
                return _no_path(grid, spent + expansions, at_least, memory)
            if code == FOUND and field.floor > RISEN * promised:
                search = guided_by(field)
                onwards = ends
                spent += expansions
                expansions = 0


def _no_path(grid: "Grid", spent: int, refused: float, exhausted: Workspace | None) -> Search:
    """There is none, as all places that are left are in this memory."""
    nothing = Search.without_path(Status.NO_PATH, spent, refused, grid.robot.moves.columns)
    return nothing._replace(exhausted=exhausted)


def _traced(grid: "Grid", workspace: Workspace, code: int, length: int) -> Search:
    """The path that the search of the states came to."""
    prices = tuple(grid.robot.states().prices)
    trace = partial(trace_states, prices=prices, frame=_frame(grid, workspace))
    found = traced(trace, workspace, code, length, 0, math.inf)
    path = found.path
    if grid.robot.moves.columns == 2:  # cells alone, of those that it turns on one
        moved = np.any(np.diff(path[:, :2], axis=0, prepend=-1), axis=1)
        path = np.ascontiguousarray(path[moved, :2])
    return found._replace(path=path)


def _at_ends(query: Query, count: int) -> tuple[Bool, Bool]:
    """States (S,) in which a body may start, and those that will do at the goal."""
    starting, at_goal = np.ones((2, count), np.bool_)
    if query.direction >= 0:
        starting[:] = np.arange(count) == query.direction
    if query.wanted is not None:
        at_goal[:] = np.resize(query.wanted, count)
    return starting, at_goal


def _turned_round(states: Bool) -> Bool:
    """(S,) states in which a body stands the other way round, in any gear."""
    directions = states.reshape(-1, DIRECTION_COUNT).any(0)
    return np.resize(np.roll(directions, DIRECTION_COUNT // 2), len(states))


def _guide(
    grid: "Grid",
    query: Query,
    region: Region | None,
    from_goal: FromGoal | None,
    most: int,
    memory: Workspace | None,
) -> tuple[int, int, Field]:
    """The field that guides a search: what filling it comes to, the expansions, and the field. It
    begins with the last metres, where these are known.
    """
    assert memory is not None
    seeds = None
    within = None
    if from_goal is not None and from_goal.expansions >= AROUND_GOAL and from_goal.last_metres:
        seeds, within = from_goal.last_metres
        if region is not None:
            row, col = np.divmod(np.concatenate((seeds.nodes, within.nodes)), grid.stride)
            region.bitmap[region.row_block[row - 1], region.col_block[col - 1]] = region.stamp
    code, spent = _filled(grid, query, memory, region, seeds, most)
    if within is not None:  # where these cost less than the field has them
        cheaper = within.costs < memory.costs(within.nodes.astype(np.int64))
        memory.g[2 * within.nodes[cheaper]] = within.costs[cheaper]
        words = (memory.stamp << STAMP_SHIFT) | within.onwards[cheaper]
        memory.meta[2 * within.nodes[cheaper] + 1] = words
    start = grid.node(*query.start)
    place = divmod(start, grid.stride)
    turns = _turns_in_field(grid, query, region)
    promised = float(memory.g[2 * start])
    return code, spent, Field(memory.g, memory.meta, memory.stamp, *place, promised, turns)


def _filled(
    grid: "Grid",
    query: Query,
    field: Workspace,
    region: Region | None,
    seeds: Seeds | None = None,
    most: int = WITHOUT_END,
    *,
    anew: bool = True,
) -> tuple[int, int]:
    """What filling the field of a region, from these seeds or the goal, comes to: the code, and the
    expansions. Unless `anew` the field holds what it held.
    """
    goal = grid.node(*query.goal)
    if seeds is None:
        nothing = np.zeros(1, np.int32)
        seeds = Seeds(np.array([goal], np.int32), nothing.astype(np.float32), nothing)
    states = grid.robot.states()
    prices = states.prices
    if region is not None:  # legs alone count
        rays = prices.rays[:DIRECTION_COUNT]
        prices = prices._replace(rays=rays, ray_fares=prices.ray_fares[:DIRECTION_COUNT])
    while len(field.entries) < 4 * len(seeds.nodes):
        field.grow()
    width = bucket_width(grid)
    rule = FieldRule(tuple(_best(grid)), width, _turns_in_field(grid, query, region))
    before = (states.poses, states.edges, tuple(prices), allowed(region), tuple(seeds))
    ends = Ends(goal, grid.node(*query.start))
    code, spent, _ = run(fill_field, before, rule, ends, field, most, query.deadline, anew=anew)
    return code, spent


def _turns_in_field(grid: "Grid", query: Query, region: Region | None) -> Float32s:
    """Costs of turns in the costs to go of cells; on the whole map they are free."""
    turns = grid.robot.states().prices.turns
    if region is None:
        return turns[:0]
    return np.float32(grid.robot.moves.turns_in_field(query.apart)) * turns


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
    seeds = Seeds(nodes, costs[came], memory.meta[2 * nodes + 1] & DIRECTION_BITS)
    query = query._replace(deadline=NEVER)
    code, _ = _filled(grid, query, memory, None, seeds, AGAIN_EXPANSIONS, anew=False)
    return code != EXHAUSTED


def costs_of_cells(grid: "Grid", start: Cell, memory: Workspace, deadline: Deadline) -> Float32s:
    """As `Robot.costs_of_cells`."""
    field = memory.field
    assert field is not None
    everywhere = Query(grid.cell(NOWHERE), start, deadline=deadline)
    _filled(grid, everywhere, field, None)
    deadline.check()
    return grid.inner(field.costs())


def _frame(grid: "Grid", workspace: Workspace) -> Packed:
    """How states are numbered."""
    return tuple(FrameRecord(workspace.states.bit_length() - 1, grid.stride))


def _best(grid: "Grid") -> Legs:
    """Least costs of legs, see `Grid.prices`."""
    straight, diagonal = grid.prices
    return Legs(straight / KNIGHT, diagonal / KNIGHT, straight + diagonal)
