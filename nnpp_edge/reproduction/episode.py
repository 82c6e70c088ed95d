"""The paper's dynamic scene (NNPP, section 5.5): a robot's way to its goal over a map that changes.

A path is planned; the robot follows it for 45 cells; rectangles of cost 1 appear across what is
left of it, move on or vanish; the rest is planned anew, until the goal is near. The robot follows
exact A*'s path.
"""

from dataclasses import dataclass

import numpy as np

from nnpp_edge.reproduction.regions import best_path, grid_of
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.obstacles import Obstacles, changed_parts

STRIDE = 45
"""Cells that the robot walks between two plans (the paper's)."""
_TRIES = 20

Patch = tuple[int, int, Float2D]
"""(row, col, new costs)."""


@dataclass(frozen=True)
class Step:
    """Events before a plan, and where from it is made."""

    start: Cell
    patches: tuple[Patch, ...]
    """To be put into the map in this order."""


@dataclass(frozen=True)
class Episode:
    """A robot's way to its goal over a map that changes."""

    cost: Float2D
    """(H, W) traversability cost at the first plan."""
    goal: Cell
    steps: tuple[Step, ...]
    """The first without patches."""

    def map_at(self, step: int) -> Float2D:
        """(H, W) traversability cost at a plan: the first map with all patches up to
        then. A copy.
        """
        cost = self.cost.copy()
        for earlier in self.steps[: step + 1]:
            for row, col, patch in earlier.patches:
                cost[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
        return cost


def make_episode(
    cost: Float2D,
    start: Cell,
    goal: Cell,
    seed: int,
    stride: int = STRIDE,
) -> Episode:
    """An episode on a cost map (H, W), the same for the same seed; start and goal are passable and
    connected.

    `stride` is the number of cells, 1 or more, that the robot walks between two plans.
    InvalidQueryError if the goal cannot be reached.
    """
    base = np.ascontiguousarray(cost, np.float32)
    obstacles = Obstacles((base.shape[0], base.shape[1]), np.random.default_rng(seed))
    path = best_path(grid_of(base), (start, goal)).path
    steps = [Step(start, ())]
    if not len(path):
        raise InvalidQueryError(
            f"an episode needs a goal that can be reached, got {start} to {goal}"
        )
    while len(path) > stride + 1:
        rest = path[stride:]
        here = tuple(rest[0].tolist())
        before = obstacles.blocks
        path = rest  # what is left of it, where no other scene leaves a way
        for _ in range(_TRIES):
            obstacles.next_scene(here, goal, rest)
            covered = obstacles.cover(base, (0, 0, *base.shape))
            found = best_path(grid_of(covered), (here, goal)).path
            if len(found):
                path = found
                break
            obstacles.blocks = before
        changed = changed_parts(before, obstacles.blocks)
        steps.append(
            Step(here, tuple((*part[:2], obstacles.cover(base, part)) for part in changed))
        )
    return Episode(base, goal, tuple(steps))
