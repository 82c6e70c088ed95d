"""Labels by our own exact search: the optimal path, and how far from optimal each part of the map
is.
"""

import math
from itertools import combinations

import numpy as np
from numpy.random import Generator

from nnpp_edge.runtime.arrays import Cells, Float2D, UInt8, in_blocks
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.search.astar import astar, cost_field
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepModel

_TRIES = 100
EXCESS_STEP = 0.001
"""The excess is kept in steps of 0.1 %; level 255 stands for 25.5 % and more, and for out
of reach.
"""


Label = tuple[Cell, Cell, Cells, UInt8]
"""Of a query: start, goal, the optimal path (N, 2), and (blocks, blocks) the excess of the best
path through any cell of a block over the optimum, in steps of `EXCESS_STEP`.
"""


def random_points(rng: Generator, cost: Float2D, count: int) -> Cells:
    """Passable cells, each drawn at random: (count, 2) int32; none where no cell is passable."""
    passable = np.argwhere(cost < 1.0).astype(np.int32)
    return passable[rng.integers(0, len(passable), count)] if len(passable) else passable


def random_query(
    rng: Generator,
    cost: Float2D,
    least_distance: float,
) -> Endpoints | None:
    """A passable start and goal at least `least_distance` cells apart; None if none was found."""
    for _ in range(_TRIES):
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
    """Label every pair of points (N, 2) on (H, W) costs that are so far apart, and connected."""
    grid = Grid.of(cost, StepModel.of("paper", omega))
    workspace = Workspace(len(grid.weights))
    cells = [_cell(point) for point in points]
    fields = [cost_field(grid, cell, workspace) for cell in cells]
    out = []
    for (start, there), (goal, back) in combinations(zip(cells, fields, strict=True), 2):
        optimum = float(there[goal])
        if math.dist(start, goal) < least_distance or not math.isfinite(optimum):
            continue
        path = astar(grid, start, goal, workspace).path
        through = in_blocks(there + back, len(cost) // blocks).min(axis=(1, 3))
        steps = np.minimum((through / optimum - 1.0) / EXCESS_STEP, 255.0)
        excess = np.maximum(np.rint(steps), 0.0).astype(np.uint8)
        out.append((start, goal, path, excess))
    return out


def _cell(point: Cells) -> Cell:
    return int(point[0]), int(point[1])
