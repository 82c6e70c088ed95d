"""D* Lite after each change of the map, against a fresh search."""

import numpy as np
import pytest

from nnpp_edge.runtime import Region, Status
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.dstar_lite import DStarLite
from nnpp_edge.runtime.search.workspace import Workspace
from tests import oracles
from tests.strategies import KINDS, random_cell, random_costs, random_patch, state_of


class Changing:
    """A map that changes, and D* Lite on it; every plan is held against a fresh search."""

    def __init__(self, cost, goal, step_cost="paper", corner_cutting=True):
        self.cost = np.array(cost, np.float32)
        self.step_cost = step_cost
        self.corner_cutting = corner_cutting
        self.state = state_of(self.cost, step_cost, corner_cutting)
        self.grid = self.state.grid
        self.workspace = Workspace(len(self.grid.weights))
        self.goal = goal
        self.region = None
        self.search = DStarLite(self.state, goal)

    def put(self, row, col, patch):
        patch = np.array(patch, np.float32, ndmin=2)
        self.cost[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
        self.state.update(row, col, patch)

    def set_goal(self, goal):
        self.goal = goal
        self.search.set_goal(goal, self.region)

    def set_region(self, region):
        self.region = region
        self.search.set_region(region or Region.everywhere(*self.grid.shape))

    def optimum(self, start, slowly):
        """By a fresh A*, or by scipy's Dijkstra, of the whole map."""
        if not self.grid.is_passable(start) or not self.grid.is_passable(self.goal):
            return np.inf
        if slowly:
            return oracles.dijkstra(self.cost, start, self.step_cost, self.corner_cutting)[
                self.goal
            ]
        return self.cost_of(astar(self.grid, start, self.goal, self.workspace, region=self.region))

    def cost_of(self, found):
        """What the path of a search costs; inf without one."""
        return self.grid.costs_of(found.path)[0]

    def plan(self, start, slowly=False):
        found = self.search.plan(start)
        wanted = self.optimum(start, slowly)
        assert found.path.dtype == np.int32
        if np.isinf(wanted):
            assert (found.status, found.path.shape) == (Status.NO_PATH, (0, 2))
            return found
        assert found.status is Status.OK
        assert self.cost_of(found) == pytest.approx(wanted, rel=1e-5, abs=1e-6)
        passable = np.where(np.isfinite(self.grid.map()), self.cost, np.inf)
        assert (
            oracles.path_problem(found.path, passable, start, self.goal, self.corner_cutting) == ""
        )
        if self.region is not None:
            assert self.region.mask()[tuple(found.path[1:-1].T)].all()
        return found


def random_region(rng, shape, before=None):
    """Coarse blocks, each a random multiple of rows and columns; at times one block of the last one
    flipped.
    """
    blocks = max(min(shape) // 2, 1)
    if before is not None and rng.random() < 0.7:
        bitmap = before.bitmap.copy()
        bitmap[random_cell(rng, bitmap.shape)] ^= 5
    else:
        bitmap = np.where(rng.random((blocks, blocks)) < 0.8, 5, 0).astype(np.int32)
    return Region(bitmap, *((np.arange(n) * blocks // n).astype(np.int32) for n in shape), 5)


@pytest.mark.parametrize("step_cost", ["paper", "length"])
def test_after_each_of_thousands_of_changes_it_equals_a_fresh_search(step_cost):
    """It moves and plans again, at times with another region or goal, or broken off before."""
    for seed in range(70):
        rng = np.random.default_rng([seed, step_cost == "paper"])
        kind = rng.choice(KINDS)
        blocked = rng.choice([0.0, 0.15, 0.3, 0.5])
        shape = (int(rng.integers(1, 20)), int(rng.integers(1, 20)))
        cost = random_costs(rng, shape, step_cost, kind, blocked)
        world = Changing(cost, random_cell(rng, shape), step_cost, corner_cutting=seed % 2 == 0)
        start = random_cell(rng, shape)
        found = world.plan(start)
        for n in range(50):
            if len(found.path) > 1 and rng.random() < 0.7:
                start = tuple(found.path[: rng.integers(2, 5)][-1].tolist())
            elif rng.random() < 0.1:
                start = random_cell(rng, shape)
            if rng.random() < 0.03:
                world.set_goal(random_cell(rng, shape))
            for _ in range(rng.integers(1, 3)):
                world.put(*random_patch(rng, world.cost, step_cost, kind, blocked))
            if (draw := rng.random()) < 0.05:
                world.set_region(None)
            elif draw < 0.4:
                world.set_region(random_region(rng, shape, world.region))
            if n % 5 == 0:
                world.search.plan(start, deadline=Deadline.within(0.0))
            found = world.plan(start, slowly=world.region is None and n % 10 == 0)


@pytest.mark.parametrize("stride", [5, 20, 1000])
def test_a_start_that_goes_far_does_not_leave_stale_keys_behind(stride):
    """On larger maps the open list outlives the moves; a wall rises before the start at
    every turn.
    """
    for seed in range(12):
        rng = np.random.default_rng([seed, stride])
        step_cost = ("paper", "length")[seed % 2]
        cost = random_costs(rng, (50, 60), step_cost, "uniform", 0.1 * (seed % 5)) * np.float32(0.3)
        world = Changing(cost, (25, 30), step_cost)
        found = world.plan(random_cell(rng, (50, 60)))
        for _ in range(30):
            start = random_cell(rng, (50, 60))
            if len(found.path) > stride + 6:
                start = tuple(found.path[stride].tolist())
                row, col = np.maximum(found.path[stride + 3] - 3, 0)
                patch = world.cost[row : row + 6, col : col + 6].copy()
                patch[rng.random(patch.shape) < 0.7] = np.inf
                world.put(row, col, patch)
            found = world.plan(start)


def test_cells_cheaper_than_any_before_are_made_use_of_with_another_goal():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        world = Changing(np.full((12, 15), 0.9), (11, 14), ("paper", "length")[seed % 2])
        for most in (0.6, 0.05, 0.01):
            world.plan((0, 0))
            world.put(0, 0, rng.uniform(0.1 * most, most, (12, 15) if seed % 3 else (12, 4)))
            world.set_goal(random_cell(rng, (12, 15)))
            world.plan((0, 0), slowly=True)


def test_what_the_path_does_not_need_costs_little():
    rng = np.random.default_rng(1)
    world = Changing(rng.random((120, 120)), (110, 110))
    first = world.plan((10, 10))
    for cell in first.path[1:9]:  # along the path
        step = tuple(int(x) for x in cell)
        assert world.plan(step).expansions == 0
    world.put(step[0] + 3, step[1] + 3, np.full((4, 4), 0.9))
    assert world.plan(step).expansions < first.expansions / 10
    world.put(0, 110, np.full((4, 4), np.inf))
    assert world.plan(step).expansions == 0


def test_a_region_holds_start_and_goal_whatever_its_bitmap_which_may_be_numbered_anew_in_place():
    rng = np.random.default_rng(6)
    world = Changing(rng.random((40, 40)), (38, 37))
    bitmap = np.zeros((10, 10), np.int32)
    lookup = np.arange(40, dtype=np.int32) // 4
    for stamp in range(1, 40):
        bitmap[rng.random((10, 10)) < 0.75] = stamp
        bitmap[0, 0] = bitmap[9, 9] = 0
        world.set_region(Region(bitmap, lookup, lookup, stamp))
        world.plan((1, 2) if stamp % 3 else (5, 5))
    world = Changing(np.full((12, 12), 0.1), (11, 11))
    bitmap = np.ones((12, 12), np.int32)
    bitmap[0, 0] = bitmap[11, 11] = bitmap[5, 5] = 0
    world.set_region(Region(bitmap, *[np.arange(12, dtype=np.int32)] * 2, 1))
    for start in ((0, 0), (5, 5), (1, 1), (0, 0)):  # only as long as it starts there
        assert ([5, 5] in world.plan(start).path.tolist()) == (start == (5, 5))
