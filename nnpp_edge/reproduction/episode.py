"""The paper's dynamic scene (NNPP, section 5.5): a robot's way to its goal over a map that changes.

A path is planned; the robot follows it for 45 cells; rectangles of cost 1 appear across what is left of it, move on
or vanish; the rest is planned anew, until the goal is near. The robot follows exact A*'s path.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod
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
        """(H, W) traversability cost at a plan: the first map with all patches up to then. A copy."""
        cost = self.cost.copy()
        for earlier in self.steps[: step + 1]:
            for row, col, patch in earlier.patches:
                cost[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
        return cost


def make_episode(cost: Float2D, start: Cell, goal: Cell, seed: int, stride: int = STRIDE) -> Episode:
    """An episode on a cost map (H, W), the same for the same seed; start and goal are passable and connected.

    `stride` is the number of cells, 1 or more, that the robot walks between two plans. InvalidQueryError if the goal
    cannot be reached.
    """
    base = np.ascontiguousarray(cost, np.float32)
    planner, steps = DynamicPlanner(base, goal, DynamicMethod.ASTAR), [Step(start, ())]
    obstacles = Obstacles((base.shape[0], base.shape[1]), np.random.default_rng(seed))
    path = _exact(planner, start)
    if path is None:
        raise InvalidQueryError(f"an episode needs a goal that can be reached, got {start} to {goal}")
    while len(path) > stride + 1:
        rest = path[stride:]
        here, before = (int(rest[0, 0]), int(rest[0, 1])), obstacles.blocks
        for _ in range(_TRIES):
            obstacles.next_scene(here, goal, rest)
            patches = _change(planner, base, obstacles, before)
            if (found := _exact(planner, here)) is not None:
                break
            refused, obstacles.blocks = obstacles.blocks, before  # no way is left: restore the map, try others
            _change(planner, base, obstacles, refused)
        else:
            patches, found = (), _exact(planner, here)
            assert found is not None
        steps.append(Step(here, patches))
        path = found
    return Episode(base, goal, tuple(steps))


def _exact(planner: DynamicPlanner, start: Cell) -> NDArray[np.int32] | None:
    planner.move(start)
    plan = planner.replan()
    return plan.path if plan.ok else None


def _change(
    planner: DynamicPlanner, base: Float2D, obstacles: Obstacles, before: list[Rectangle]
) -> tuple[Patch, ...]:
    """Put the obstacles into the planner's map in place of those before; the patches."""
    parts = changed_parts(before, obstacles.blocks)
    patches = tuple((part[0], part[1], obstacles.cover(base, part)) for part in parts)
    for patch in patches:
        planner.update(*patch)
    return patches
