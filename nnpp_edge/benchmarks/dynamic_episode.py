"""The paper's dynamic scene (NNPP, section 5.5): a robot's way to its goal over a map that changes.

A path is planned; the robot follows it for 45 cells; rectangles of cost 1 appear across what is left of it, move on
or vanish; the rest is planned anew, until the goal is near. The robot follows exact A*'s path.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import Case, TerrainSuite
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod

STRIDE = 45
"""Cells that the robot walks between two plans (the paper's)."""
OBSTACLE = 1.0
"""Traversability cost of the rectangles (the paper's)."""
LEAST_DISTANCE = 0.7
"""Between start and goal, as a share of the map's side: four plans or more at 256²."""
_SIDES = (1 / 20, 1 / 8)
"""Sides of a rectangle, as shares of the map's."""
_ON_PATH = (0.15, 0.85)
"""Where on what is left of the path a rectangle appears, as a share of it."""
_CLEAR = 3
"""Cells around robot and goal that no rectangle covers."""
_VANISHES, _MOVES = 0.25, 0.35
"""Chances of a rectangle at each step."""
_TRIES = 20

Patch = tuple[int, int, NDArray[np.float32]]
Block = tuple[int, int, int, int]


@dataclass(frozen=True)
class Step:
    """What happens before a plan, and where from it is made."""

    start: Cell
    patches: tuple[Patch, ...]
    """(row, col, new costs), to be put into the map in this order."""


@dataclass(frozen=True)
class Episode:
    """A robot's way to its goal over a map that changes."""

    cost: NDArray[np.float32]
    """(H, W) traversability cost at the first plan."""
    goal: Cell
    steps: tuple[Step, ...]
    """The first without patches."""

    def map_at(self, step: int) -> NDArray[np.float32]:
        """(H, W) traversability cost at a plan: the first map with all patches up to then. A copy."""
        cost = self.cost.copy()
        for earlier in self.steps[: step + 1]:
            for row, col, patch in earlier.patches:
                cost[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
        return cost


def make_episode(cost: NDArray[np.float32], start: Cell, goal: Cell, seed: int, stride: int = STRIDE) -> Episode:
    """An episode on a map, the same for the same seed.

    Parameters
    ----------
    cost : (H, W) float
        Traversability cost; left as it is.
    start, goal : (row, col)
        Passable cells that are connected.
    seed : int
        Of where rectangles appear, how large they are, and what becomes of them.
    stride : int
        Cells that the robot walks between two plans, at least 1.

    Raises
    ------
    InvalidQueryError
        The goal cannot be reached from the start, or the stride is less than 1.
    """
    if stride < 1:
        raise InvalidQueryError(f"the stride must be at least 1 cell, got {stride}")
    rng, base = np.random.default_rng(seed), np.ascontiguousarray(cost, np.float32)
    planner, steps, blocks = DynamicPlanner(base, goal, DynamicMethod.ASTAR), [Step(start, ())], list[Block]()
    path = _exact(planner, start)
    if path is None:
        raise InvalidQueryError(f"an episode needs a goal that can be reached, got {start} to {goal}")
    while len(path) > stride + 1:
        rest = path[stride:]
        here = (int(rest[0, 0]), int(rest[0, 1]))
        for _ in range(_TRIES):
            wanted = _next_blocks(rng, blocks, rest, base.shape, (here, goal))
            patches = _patches(base, blocks, wanted)
            for row, col, patch in patches:
                planner.update(row, col, patch)
            if (found := _exact(planner, here)) is not None:
                break
            for row, col, patch in _patches(base, wanted, blocks):  # no way is left: take it back, try another
                planner.update(row, col, patch)
        else:
            wanted, patches, found = blocks, (), _exact(planner, here)
            assert found is not None
        steps.append(Step(here, patches))
        blocks, path = wanted, found
    return Episode(base, goal, tuple(steps))


def terrain_episodes(
    suite: TerrainSuite, name: str, size: int, count: int, stride: int = STRIDE
) -> Iterator[Episode]:
    """Episodes on random crops of terrain, one a crop; `suite.least_distance` decides how long they are."""
    yield from islice(episodes_of(suite.cases(suite.load(), name, size), suite.seed, stride), count)


def episodes_of(cases: Iterable[Case], seed: int, stride: int = STRIDE) -> Iterator[Episode]:
    """An episode for the first query of each case; cases whose goal cannot be reached are passed over."""
    for at, case in enumerate(cases):
        start, goal = case.queries[0]
        with suppress(InvalidQueryError):
            yield make_episode(case.cost, start, goal, seed=seed + at, stride=stride)


def _exact(planner: DynamicPlanner, start: Cell) -> NDArray[np.int32] | None:
    planner.move(start)
    plan = planner.replan()
    return plan.path if plan.ok else None


def _next_blocks(
    rng: np.random.Generator, blocks: Sequence[Block], rest: NDArray[np.int32], shape: tuple[int, ...],
    free: tuple[Cell, Cell],
) -> list[Block]:  # fmt: skip
    """The rectangles of the next step: some gone, some moved on, and one more across the path."""
    out = []
    for row, col, rows, cols in blocks:
        fate = rng.random()
        if fate < _VANISHES:
            continue
        if fate < _VANISHES + _MOVES:
            row = int(np.clip(row + rng.integers(-rows, rows + 1), 0, shape[0] - rows))
            col = int(np.clip(col + rng.integers(-cols, cols + 1), 0, shape[1] - cols))
        out.append((row, col, rows, cols))
    side = max(shape)
    rows, cols = (min(max(int(rng.uniform(*_SIDES) * side), 2), n) for n in shape)
    at = rest[int(rng.uniform(*_ON_PATH) * (len(rest) - 1))]
    row, col = (int(np.clip(c - n // 2, 0, m - n)) for c, n, m in zip(at, (rows, cols), shape, strict=True))
    out.append((row, col, rows, cols))
    return [block for block in out if not any(_covers(block, cell) for cell in free)]


def _covers(block: Block, cell: Cell) -> bool:
    """Whether a rectangle comes nearer to a cell than may be."""
    row, col, rows, cols = block
    return row - _CLEAR <= cell[0] < row + rows + _CLEAR and col - _CLEAR <= cell[1] < col + cols + _CLEAR


def _patches(base: NDArray[np.float32], before: Sequence[Block], after: Sequence[Block]) -> tuple[Patch, ...]:
    """What to put into the map where its rectangles become others: those that left, then those that came."""
    now = base.copy()
    for row, col, rows, cols in after:
        now[row : row + rows, col : col + cols] = np.maximum(now[row : row + rows, col : col + cols], OBSTACLE)
    changed = [block for block in before if block not in after] + [block for block in after if block not in before]
    return tuple((r, c, now[r : r + rows, c : c + cols].copy()) for r, c, rows, cols in changed)
