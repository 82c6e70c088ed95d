"""Where to go while no path leads to the goal: it may be unknown yet, or shut off."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import cv2
import numpy as np

from nnpp_edge.runtime.arrays import Float2D, Mask
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.search.astar import Query
from nnpp_edge.runtime.search.workspace import Workspace

if TYPE_CHECKING:
    from nnpp_edge.runtime.planners.methods import Methods

_BETTER = 5.0
"""Cells by which another place must be better than the present one: not each patch brings
another.
"""
_PLACES = 20
"""At most so many are tried, one after the other."""


def plan_towards(
    methods: "Methods", query: Query, present: Cell | None, plan_to: Callable[[Query], Plan]
) -> Plan:
    """The plan of a query that has no path, to where it is to go instead; NO_PATH without such a
    place.

    `present` as for `place_towards`. OutOfTimeError at the query's deadline.
    """
    state = methods.state
    grid = state.grid
    moves = grid.robot.moves
    memory = Workspace(len(grid.weights), moves.states_a_node, sparse=True)
    beyond = np.zeros(grid.shape, np.bool_)
    if grid.is_passable(query.goal):
        beyond = np.isfinite(moves.costs_of_cells(grid, query.goal, memory, query.deadline))
    beyond[query.goal] = True
    costs = moves.costs_of_cells(grid, query.start, memory, query.deadline)
    unknown = state.unknown((0, 0, *state.shape))
    margin = state.reach_cells + 2
    for _ in range(_PLACES):
        place = place_towards(query.goal, query.start, costs, beyond, unknown, margin, present)
        plan = plan_to(query._replace(goal=place, wanted=None))
        if plan.status is not Status.NO_PATH:
            break
        # by arcs there are fewer ways than the costs of cells promise: this search knows which not
        came, from_start = moves.came_to(grid, query.start, methods.exhausted, query.deadline)
        costs[came != from_start] = math.inf
    return plan


def place_towards(
    goal: Cell,
    start: Cell,
    costs: Float2D,
    beyond: Mask,
    unknown: Mask,
    margin: int,
    present: Cell | None,
) -> Cell:
    """A cell that can be reached, on the way to a goal that perhaps cannot; the goal itself, if it
    can.

    It lies at the edge of the unknown ground that may lead to the goal: where the way is shortest,
    if that ground could be crossed in a straight line. Where no such cell can be reached, it is the
    cell nearest to the goal.

    Parameters
    ----------
    costs : (H, W) float32
        Of the cheapest path from the start to each cell; inf where there is none.
    beyond : (H, W) bool
        The goal, and what is joined to it by paths that are known.
    unknown : (H, W) bool
        Cells of which nothing is known.
    margin : int
        Cells to unknown ground from which it counts as near: as near as a body can come to it.
    present : (row, col)
        An earlier answer. It is given again where it still serves and no other is better by 5
        cells.
    """
    reached = np.isfinite(costs)
    if reached[goal]:
        return goal
    count, pieces = cv2.connectedComponents(unknown.view(np.uint8))
    leads = np.zeros(
        count, np.bool_
    )  # by piece of unknown ground, if it comes near to what lies beyond; 0 is known
    leads[pieces[unknown & _grown(beyond, margin)]] = True
    edge = reached & _grown(leads[pieces], margin)
    served = edge if edge.any() else reached
    rows, cols = np.ogrid[: costs.shape[0], : costs.shape[1]]
    cells = np.hypot(rows - goal[0], cols - goal[1])
    if served is edge:
        from_start = np.hypot(rows - start[0], cols - start[1])
        usual = np.median((costs / np.maximum(from_start, 1.0))[reached])
        if usual > 0.0:  # of a cell; energy may be got back
            cells += costs / usual
    cells[~served] = math.inf
    best: Cell = divmod(int(cells.argmin()), costs.shape[1])
    if present is not None and served[present] and cells[present] <= cells[best] + _BETTER:
        return present
    return best


def _grown(cells: Mask, margin: int) -> Mask:
    around = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return cv2.dilate(cells.view(np.uint8), around).view(np.bool_)
