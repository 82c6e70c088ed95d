"""Random maps, patches and queries for the property tests."""

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.kernels.nodes import COL_STEP, ROW_STEP
from nnpp_edge.runtime.kernels.poses import AXIS_COUNT, FAILS, MOST_CODE
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseToFine
from nnpp_edge.runtime.search.workspace import Workspace
from tests import oracles


def flat(rows, cols, value=0.0):
    """(rows, cols) float32 of one value."""
    return np.full((rows, cols), value, np.float32)


def uniform(seed, shape, least=0.0, most=1.0):
    """Random float32."""
    return np.random.default_rng(seed).uniform(least, most, shape).astype(np.float32)


def put(array, row, col, patch):
    """Write a patch into a map."""
    array[row : row + patch.shape[0], col : col + patch.shape[1]] = patch


KINDS = ("uniform", "equal", "levels", "steep")


def random_costs(rng, shape, step_cost="paper", kind="uniform", blocked=0.0, wall=np.inf):
    """Costs in a step-cost model, of one of `KINDS` or of ``any`` size; where they are equal, so
    are keys.
    """
    cost = rng.random(shape)
    if kind == "equal":
        cost[:] = cost.flat[0]
    elif kind == "levels":
        cost = np.round(cost * 3) / 4
    elif kind == "steep" and step_cost == "length":
        cost = 10.0 ** (6.0 * cost)
    elif kind == "any":
        decades = rng.choice((0.5, 12.0, 67.0))
        least = rng.uniform(-37.5, 29.5 - decades) if step_cost == "length" else -decades
        cost = 10.0 ** (least + decades * cost)
    if step_cost == "length" and kind != "any":
        cost = cost + 0.01
    cost = cost.astype(np.float32)
    cost[rng.random(shape) < blocked] = wall
    return cost


def odd_heights(rng, shape, size, holes=(0.05, 0.15, 0.35, 0.5)):
    """Slopes and hills with rocks of about this size, walls, cliffs, holes and islands; `holes` are
    their shares.
    """
    rows, cols = shape
    row, col = np.mgrid[:rows, :cols]
    waves = np.sin(row / rng.uniform(2, 9)) + np.cos(col / rng.uniform(2, 9))
    dem = size * rng.choice((0.0, 0.1, 0.3, 1.0)) * waves
    dem += size * rng.choice((0.0, 0.0, 0.1)) * (row + rng.choice((0.0, 1.0)) * col)
    dem += size * rng.choice((0.0, 0.01, 0.05)) * rng.normal(size=shape)
    rocks = rng.random(shape) < rng.choice((0.0, 0.01, 0.04))
    dem[rocks] += size * rng.choice((0.6, 1.0, 2.0)) * rng.random(int(rocks.sum()))
    kind = rng.choice(("whole", "whole", "holes", "holes", "stripe", "wall", "cliff"))
    if kind == "holes":
        dem[rng.random(shape) < rng.choice(holes)] = np.nan
    elif kind == "stripe":
        dem[: rng.integers(rows + 1), cols // 2 :][:, : rng.choice((1, 1, 2, 9))] = np.nan
    elif kind == "wall":
        dem[rows // 2, rng.choice((0, cols // 3, cols // 2)) :] += 10.0 * size
    elif kind == "cliff":
        dem[:, cols // 2 :] += size * rng.choice((0.5, 5.0))
    dem += rng.choice((0.0, 0.0, -40.0 * size, 8000.0))
    return dem.astype(np.float32)


def random_cell(rng, shape):
    return int(rng.integers(shape[0])), int(rng.integers(shape[1]))


def random_patch(rng, cost, step_cost="paper", kind="uniform", blocked=0.3):
    """Where, and new costs: quite other ones, or the old ones raised, lowered, walled up
    or opened.
    """
    h, w = (int(rng.integers(1, min(n, 6) + 1)) for n in cost.shape)
    row, col = (int(rng.integers(n - k + 1)) for n, k in zip(cost.shape, (h, w), strict=True))
    new = random_costs(rng, (h, w), step_cost, kind, blocked)
    old = cost[row : row + h, col : col + w]
    what = rng.integers(6)
    if what == 0:
        new = np.where(np.isfinite(old), np.maximum(old, new), old)
    elif what == 1:
        new = np.where(np.isfinite(old), np.minimum(old, new), old)
    elif what == 2:
        new = np.where(rng.random((h, w)) < 0.5, np.float32(np.inf), old)
    elif what == 3:
        new = np.where(np.isinf(old), new, old)
    return row, col, new


def state_of(cost, step_cost="paper", corner_cutting=True):
    """The state of a planner's map of costs."""
    return Planner(cost, step_cost=step_cost, corner_cutting=corner_cutting).state


def descent_of(state):
    """What searches a map's coarse levels, and these, the map first."""
    descent = CoarseToFine(state, Workspace(len(state.grid.weights)))
    return descent, descent.update()


def costs_on(level, source):
    """(rows, cols) cost of the cheapest path from a cell to each of a coarse level, over its links."""
    grid = level.grid
    price = grid.robot.price
    ways = []
    for k, (down, right) in enumerate(zip(ROW_STEP, COL_STEP, strict=True)):
        here = np.flatnonzero((level.links >> k) & 1)
        there = here + down * grid.stride + right
        pair = grid.weights[here] + grid.weights[there]
        cost = price.edges()[here, k] if price.directed else grid.model.step(int(k >= 4), pair)
        ways.append((here, there, cost))
    shape = (grid.rows + 2, grid.stride)
    padded = oracles.costs_from(oracles.possible(ways), shape, np.add(source, 1))
    return padded[1:-1, 1:-1]


def scrambled(planner, seed):
    """(H, W, M) codes of a body's motions, which cost or fail at random in place of what was
    checked.
    """
    poses = planner.state.grid.robot.moves.poses
    rng = np.random.default_rng(seed)
    rows, cols = planner.shape
    poses.complete()
    shape = poses.codes.shape
    poses.codes[:] = rng.integers(1, MOST_CODE, shape)
    shares = rng.choice((0.05, 0.4), shape[1] // AXIS_COUNT).repeat(AXIS_COUNT)
    poses.codes[rng.random(shape) < shares] = FAILS + 1
    return poses.codes.reshape(rows + 2, cols + 2, -1)[1:-1, 1:-1]


@dataclass(frozen=True)
class Case:
    """A map in one of the two step-cost models, and two passable cells."""

    cost: np.ndarray
    start: tuple[int, int]
    goal: tuple[int, int]
    step_cost: str
    corner_cutting: bool

    def __repr__(self):
        """Short enough for hypothesis to print."""
        return (
            f"Case({self.cost.tolist()}, {self.start}, {self.goal}, {self.step_cost}, "
            f"{self.corner_cutting})"
        )


@st.composite
def cases(draw, most_side=24, any_size=True):
    """Maps of every shape, 1×1 and 1×N among them, of `KINDS` or with weights of any size."""
    shape = draw(st.integers(1, most_side)), draw(st.integers(1, most_side))
    step_cost = draw(st.sampled_from(["paper", "length"]))
    kind = draw(st.sampled_from([*KINDS, *["any"] * any_size]))
    blocked = draw(st.sampled_from([0.0, 0.15, 0.4, 0.7]))
    wall = draw(st.sampled_from([np.inf, np.nan]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    cost = random_costs(rng, shape, step_cost, kind, blocked, wall)
    if not np.isfinite(cost).any():
        cost[0, 0] = 0.5
    passable = np.argwhere(np.isfinite(cost))
    start, goal = (tuple(int(x) for x in passable[rng.integers(len(passable))]) for _ in range(2))
    return Case(cost, start, goal, step_cost, draw(st.booleans()))
