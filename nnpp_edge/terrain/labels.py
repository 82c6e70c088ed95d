"""Labels by our own exact search: the optimal path, and how far from optimal each part of the map
is.
"""

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.search.astar import astar, cost_field
from nnpp_edge.runtime.search.workspace import Workspace

EXCESS_STEP = 0.001
"""The excess is kept in steps of 0.1 %; level 255 stands for 25.5 % and more, and for out
of reach.
"""


class Label(NamedTuple):
    """Labels of one query by the exact search: its optimal path, and how much worse each block's
    best path is.
    """

    start: Cell
    goal: Cell
    path: Cells
    """(N, 2) the optimal path."""
    excess: NDArray[np.uint8]
    """(blocks, blocks) of the best path through any cell of a block over the optimum, in steps of
    `EXCESS_STEP`.
    """


def random_points(rng: np.random.Generator, cost: Float2D, count: int) -> Cells:
    """Passable cells, each drawn at random: (count, 2) int32; none where no cell is passable."""
    passable = np.argwhere(cost < 1.0).astype(np.int32)
    return passable[rng.integers(0, len(passable), count)] if len(passable) else passable


def random_query(
    rng: np.random.Generator, cost: Float2D, least_distance: float, tries: int = 100
) -> Endpoints | None:
    """A passable start and goal at least `least_distance` cells apart; None if none was found."""
    for _ in range(tries):
        points = random_points(rng, cost, 2)
        if len(points) == 2 and math.dist(points[0], points[1]) >= least_distance:
            return _cell(points[0]), _cell(points[1])
    return None


def label_queries(
    cost: Float2D,
    points: Cells,
    least_distance: float,
    blocks: int,
    omega: float,
) -> list[Label]:
    """The labels of every pair of points (N, 2) on (H, W) costs that is so many cells apart, and
    connected.
    """
    grid = Grid.of(cost, StepModel.of("paper", omega))
    workspace = Workspace(len(grid.weights))
    cells = [_cell(point) for point in points]
    fields = [cost_field(grid, cell, workspace) for cell in cells]
    side = cost.shape[0] // blocks
    out = []
    for a, b in combinations(range(len(points)), 2):
        start = cells[a]
        goal = cells[b]
        optimum = float(fields[a][goal])
        if math.dist(start, goal) < least_distance or not math.isfinite(optimum):
            continue
        found = astar(grid, start, goal, workspace)
        assert found.status is Status.OK
        through = (fields[a] + fields[b]).reshape(blocks, side, blocks, side).min(axis=(1, 3))
        excess = np.minimum((through / optimum - 1.0) / EXCESS_STEP, 255.0)
        out.append(
            Label(start, goal, found.path, np.maximum(np.rint(excess), 0.0).astype(np.uint8))
        )
    return out


def _cell(point: Cells) -> Cell:
    return int(point[0]), int(point[1])
