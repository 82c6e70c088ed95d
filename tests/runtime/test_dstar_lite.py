import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, Status
from nnpp_edge.runtime.kernels import dstar as kernels
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.runtime.search import dstar_lite as module
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.dstar_lite import DStarLite
from nnpp_edge.runtime.search.workspace import Workspace
from tests import oracles
from tests.strategies import cases


class Changing:
    """A map that changes, and D* Lite on it; every plan is held against a fresh search."""

    def __init__(self, cost, goal, step_cost="paper", corner_cutting=True):
        self.cost, self.step_cost, self.corner_cutting = np.array(cost, np.float32), step_cost, corner_cutting
        self.state = map_state(Ground(self.cost, step_cost=step_cost), corner_cutting=corner_cutting)
        self.grid = self.state.grid
        self.workspace = Workspace(len(self.grid.weights))
        self.goal, self.region = goal, None
        self.search = DStarLite(self.state, goal)

    def put(self, row, col, patch):
        patch = np.array(patch, np.float32, ndmin=2)
        self.cost[row : row + patch.shape[0], col : col + patch.shape[1]] = patch
        self.state.update(row, col, patch)

    def set_region(self, region):
        self.region = region
        self.search.set_region(region)

    def optimum(self, start):
        """By a fresh A*."""
        if not self.grid.is_passable(start) or not self.grid.is_passable(self.goal):
            return np.inf
        found = astar(self.grid, start, self.goal, self.workspace, region=self.region)
        return self.cost_of(found) if found.status is Status.OK else np.inf

    def cost_of(self, found):
        """What the path of a search costs; inf without one."""
        return self.grid.costs_of(found.path)[0]

    def slow_optimum(self, start):
        """By scipy's Dijkstra, of the whole map."""
        if not self.grid.is_passable(start) or not self.grid.is_passable(self.goal):
            return np.inf
        return oracles.dijkstra(self.cost, start, self.step_cost, self.corner_cutting)[self.goal]

    def plan(self, start, slowly=False):
        wanted = self.slow_optimum(start) if slowly else self.optimum(start)
        found = self.search.plan(start)
        assert found.path.dtype == np.int32
        if np.isinf(wanted):
            assert (found.status, found.path.shape) == (Status.NO_PATH, (0, 2))
            return found
        assert found.status is Status.OK
        assert self.cost_of(found) == pytest.approx(wanted, rel=1e-5, abs=1e-6)
        self.check(found, start)
        return found

    def check(self, found, start):
        path, (rows, cols) = found.path, found.path.T
        assert tuple(path[0]) == start
        assert tuple(path[-1]) == self.goal
        assert (np.abs(np.diff(path, axis=0)).max(axis=1) == 1).all()
        assert np.isfinite(self.grid.weights[self.grid.node(rows, cols)]).all()
        if self.region is not None:
            assert self.region.mask()[rows[1:-1], cols[1:-1]].all()
        if not self.corner_cutting:
            assert np.isfinite(self.cost[rows[:-1], cols[1:]]).all()
            assert np.isfinite(self.cost[rows[1:], cols[:-1]]).all()


def random_costs(rng, shape, step_cost, kind, blocked):
    cost = rng.random(shape)
    if kind == "equal":  # with walls alone, keys are equal everywhere
        cost[:] = 0.5
    elif kind == "levels":
        cost = np.round(cost * 3) / 4
    elif kind == "steep" and step_cost == "length":
        cost = 10.0 ** (6.0 * cost)
    cost = cost + (0.01 if step_cost == "length" else 0.0)
    cost[rng.random(shape) < blocked] = np.inf
    return cost.astype(np.float32)


def cells_of(rng, shape):
    return int(rng.integers(shape[0])), int(rng.integers(shape[1]))


def random_region(rng, shape, before=None):
    """Coarse blocks, each a random multiple of rows and columns; at times one block of the last one flipped."""
    blocks = max(min(shape) // 2, 1)
    if before is not None and rng.random() < 0.7:
        bitmap = before.bitmap.copy()
        bitmap[cells_of(rng, bitmap.shape)] ^= 5
    else:
        bitmap = np.where(rng.random((blocks, blocks)) < 0.8, 5, 0).astype(np.int32)
    rows, cols = ((np.arange(n) * blocks // n).astype(np.int32) for n in shape)
    return Region(bitmap, rows, cols, 5)


def random_patch(rng, world, kind, blocked):
    """Where, and new costs: quite other ones, or the old ones raised, lowered, walled up or opened."""
    shape = world.cost.shape
    h, w = (int(rng.integers(1, min(n, 5) + 1)) for n in shape)
    row, col = (int(rng.integers(n - k + 1)) for n, k in zip(shape, (h, w), strict=True))
    new = random_costs(rng, (h, w), world.step_cost, kind, blocked)
    old = world.cost[row : row + h, col : col + w]
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


def live_through(world, rng, changes, kind, blocked, slowly_each):
    """Change, move and plan again, so many times."""
    shape = world.cost.shape
    start = cells_of(rng, shape)
    found = world.plan(start)
    for n in range(changes):
        if len(found.path) > 1 and rng.random() < 0.7:
            start = tuple(int(x) for x in found.path[min(rng.integers(1, 4), len(found.path) - 1)])
        elif rng.random() < 0.1:
            start = cells_of(rng, shape)
        if rng.random() < 0.2:
            world.search.move_start(start)
        for _ in range(rng.integers(1, 3)):
            world.put(*random_patch(rng, world, kind, blocked))
        if (draw := rng.random()) < 0.05:
            world.set_region(None)
        elif draw < 0.4:
            world.set_region(random_region(rng, shape, world.region))
        found = world.plan(start, slowly=world.region is None and n % slowly_each == 0)


def check_open_list(search):
    """A heap in order, of exactly those nodes whose g and rhs differ; nothing in its unused slots."""
    memory, size = search.memory, search.open_nodes
    listed = memory.heap_nodes[:size]
    g, rhs = memory.state[::2], memory.state[1::2]
    assert sorted(listed) == np.flatnonzero(g != rhs).tolist()
    assert (memory.position[listed] == np.arange(size)).all()
    assert (memory.position != kernels.ABSENT).sum() == size
    keys = list(zip(memory.firsts[:size].tolist(), memory.seconds[:size].tolist(), strict=True))
    assert all(keys[(i - 1) // 4] <= keys[i] for i in range(1, size))
    assert np.isinf(memory.firsts[size:]).all()
    np.testing.assert_array_equal(memory.seconds[:size], np.minimum(g, rhs)[listed])


@pytest.mark.parametrize("kind", ["uniform", "equal", "steep"])
def test_the_open_list_stays_in_order(kind):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        shape, step_cost = (30, 40), ("paper", "length")[seed % 2]
        world = Changing(random_costs(rng, shape, step_cost, kind, 0.2), (15, 20), step_cost, corner_cutting=seed < 4)
        for _ in range(20):
            start = cells_of(rng, shape)
            world.search.plan(start, deadline=Deadline.within(0.0))
            world.plan(start)
            check_open_list(world.search)
            world.put(*random_patch(rng, world, kind, 0.2))


@pytest.mark.parametrize("corner_cutting", [True, False])
@pytest.mark.parametrize("step_cost", ["paper", "length"])
def test_after_each_of_thousands_of_changes_it_equals_a_fresh_search(step_cost, corner_cutting):
    for seed in range(60):
        rng = np.random.default_rng([seed, corner_cutting, step_cost == "paper"])
        kind, blocked = rng.choice(["uniform", "equal", "levels", "steep"]), rng.choice([0.0, 0.15, 0.3, 0.5])
        shape = (int(rng.integers(1, 20)), int(rng.integers(1, 20)))
        cost = random_costs(rng, shape, step_cost, kind, blocked)
        world = Changing(cost, cells_of(rng, shape), step_cost, corner_cutting)
        live_through(world, rng, 50, kind, blocked, slowly_each=25)


@settings(deadline=None, max_examples=60)
@given(cases(most_side=9, any_size=False), st.integers(0, 2**32))
def test_after_a_change_it_finds_what_dijkstra_does(case, seed):
    rng = np.random.default_rng(seed)
    world = Changing(case.cost, case.goal, case.step_cost, case.corner_cutting)
    start = case.start
    for _ in range(4):
        found = world.plan(start, slowly=True)
        if len(found.path) > 2:
            start = tuple(int(x) for x in found.path[1])
        world.put(*random_patch(rng, world, "uniform", 0.3))
    world.plan(start, slowly=True)


@pytest.mark.parametrize("stride", [5, 20, 1000])
def test_a_start_that_goes_far_does_not_leave_stale_keys_behind(stride):
    """On larger maps the open list outlives the moves; a wall rises before the start at every turn."""
    for seed in range(12):
        rng = np.random.default_rng([seed, stride])
        shape, step_cost = (50, 60), ("paper", "length")[seed % 2]
        world = Changing(random_costs(rng, shape, step_cost, "uniform", 0.1 * (seed % 5)) * 0.3, (25, 30), step_cost)
        found = world.plan(cells_of(rng, shape))
        for _ in range(30):
            start = cells_of(rng, shape)
            if len(found.path) > stride + 6:
                start = tuple(int(x) for x in found.path[stride])
                row, col = (max(int(x) - 3, 0) for x in found.path[stride + 3])
                patch = world.cost[row : row + 6, col : col + 6].copy()
                patch[rng.random(patch.shape) < 0.7] = np.inf
                world.put(row, col, patch)
            row, col = cells_of(rng, (44, 54))
            world.put(row, col, random_costs(rng, (6, 6), step_cost, "uniform", 0.1) * 0.3)
            found = world.plan(start)


def test_walking_along_the_path_expands_nothing():
    world = Changing(np.random.default_rng(0).random((60, 60)), (55, 50))
    first = world.plan((3, 4))
    assert first.expansions > 100
    for cell in first.path[1:]:
        assert world.plan(tuple(int(x) for x in cell)).expansions == 0


def test_a_change_that_the_path_does_not_need_costs_little():
    rng = np.random.default_rng(1)
    world = Changing(rng.random((120, 120)), (110, 110))
    first = world.plan((10, 10))
    step = tuple(int(x) for x in first.path[8])
    world.put(step[0] + 3, step[1] + 3, np.full((4, 4), 0.9))
    assert world.plan(step).expansions < first.expansions / 10
    world.put(0, 110, np.full((4, 4), np.inf))
    assert world.plan(step).expansions == 0


def test_changes_reach_as_far_as_the_one_nearest_to_the_goal():
    world = Changing(np.full((30, 101), 0.3), (15, 100))
    search = world.search
    assert search.reach() == 0.0
    search.plan((15, 10))
    world.put(15, 14, [[0.9]])
    assert search.reach() == pytest.approx(5 / 90, abs=1e-3)  # its neighbour, one cell on
    world.put(15, 25, [[0.9]])
    assert search.reach() == pytest.approx(16 / 90, abs=1e-3)
    search.move_start((15, 50))
    assert search.reach() == 0.0  # behind the start
    world.put(15, 80, [[0.9]])
    assert search.reach() == pytest.approx(31 / 50, abs=1e-3)
    search.plan((15, 50))
    assert search.reach() == 0.0
    search.move_start((0, 0))  # where no search has come
    world.put(15, 80, [[0.3]])
    assert search.reach() == 1.0


def test_walls_one_cell_thick_open_and_close():
    cost = np.full((15, 15), 0.2)
    cost[7] = np.inf
    for corner_cutting in (True, False):
        world = Changing(cost, (14, 7), corner_cutting=corner_cutting)
        assert world.plan((0, 7)).status is Status.NO_PATH
        for gap in (0, 14, 7, 3):
            world.put(7, gap, 0.1)
            assert [7, gap] in world.plan((0, 7)).path.tolist()
            world.put(7, gap, np.inf)
            assert world.plan((1, 6)).status is Status.NO_PATH


def test_a_corner_is_closed_by_a_wall_beside_it():
    world = Changing([[0.0, 0.0], [0.0, 0.0]], (1, 1), corner_cutting=False)
    assert len(world.plan((0, 0)).path) == 2
    world.put(0, 1, np.inf)
    assert len(world.plan((0, 0)).path) == 3
    world.put(1, 0, np.inf)
    assert world.plan((0, 0)).status is Status.NO_PATH
    world.put(0, 1, 0.0)
    world.put(1, 0, 0.0)
    assert len(world.plan((0, 0)).path) == 2


def test_going_to_and_fro_before_a_door_stays_exact():
    cost = np.full((21, 21), 0.1)
    cost[10] = np.inf
    cost[10, 2] = cost[10, 18] = 0.1
    world = Changing(cost, (20, 10))
    for n in range(40):  # a door shuts as one comes up to it
        door, shut = (2, 18) if n % 2 else (18, 2)
        world.put(10, door, 0.1)
        world.put(10, shut, np.inf)
        assert [10, door] in world.plan((9, shut)).path.tolist()


@pytest.mark.parametrize("shape", [(1, 12), (12, 1), (1, 1), (2, 2)])
def test_narrow_maps(shape):
    start, goal = (0, 0), (shape[0] - 1, shape[1] - 1)
    world = Changing(np.full(shape, 0.3), goal)
    assert len(world.plan(start).path) == max(shape)
    if max(shape) > 2:
        middle = (shape[0] // 2, shape[1] // 2)
        world.put(*middle, np.inf)
        assert world.plan(start).status is Status.NO_PATH
        world.put(*middle, 0.9)
        assert len(world.plan(start).path) == max(shape)


def test_start_is_goal():
    world = Changing(np.zeros((3, 3)), (1, 1))
    assert world.plan((1, 1)).path.tolist() == [[1, 1]]
    assert world.cost_of(world.plan((1, 1))) == 0.0
    world.put(1, 1, np.inf)
    assert world.plan((1, 1)).status is Status.NO_PATH
    world.put(1, 1, 0.5)
    assert world.plan((1, 1)).path.tolist() == [[1, 1]]


@pytest.mark.parametrize("blocked", [(2, 2), (17, 15)])
def test_a_blocked_start_or_goal_has_no_path_until_it_opens(blocked):
    world = Changing(np.random.default_rng(2).random((20, 20)), (17, 15))
    cost_before = world.cost_of(world.plan((2, 2)))
    world.put(*blocked, np.nan)
    world.put(9, 9, 0.0)
    found = world.plan((2, 2))
    assert (found.status, found.expansions) == (Status.NO_PATH, 0)
    assert world.plan((2, 3)).status is (Status.NO_PATH if blocked == world.goal else Status.OK)
    world.put(*blocked, 0.0)
    assert world.cost_of(world.plan((2, 2))) < cost_before


def test_walled_in_and_let_out():
    for walled in ((3, 3), (12, 12)):
        world = Changing(np.full((16, 16), 0.4), (12, 12))
        world.plan((3, 3))
        ring = np.full((5, 5), np.inf)
        ring[1:-1, 1:-1] = 0.4
        world.put(walled[0] - 2, walled[1] - 2, ring)
        assert world.plan((3, 3)).status is Status.NO_PATH
        world.put(walled[0] - 2, walled[1], 0.4)
        assert world.plan((3, 3)).status is Status.OK


def test_a_map_without_a_passable_cell_fills_up():
    for step_cost in ("paper", "length"):
        world = Changing(np.full((6, 8), np.inf), (5, 7), step_cost)
        assert world.plan((0, 0)).status is Status.NO_PATH
        world.put(0, 0, np.full((6, 8), 1e-3))
        assert world.plan((0, 0)).status is Status.OK


@pytest.mark.parametrize("step_cost", ["paper", "length"])
def test_cells_cheaper_than_any_before_are_made_use_of(step_cost):
    world = Changing(np.full((30, 30), 0.9), (28, 28), step_cost)
    world.plan((1, 1))
    for n, cost in enumerate((0.6, 0.5, 0.3, 0.05, 0.01, 0.001)):
        world.put(0, 4 * n, np.full((30, 1), cost))
        world.put(29 - n, 0, np.full((1, 30), cost))
        world.plan((1, 1), slowly=True)


def test_weights_many_orders_of_magnitude_apart():
    rng = np.random.default_rng(8)
    for exponent in (8, 12, 15):
        cost = 10.0 ** (exponent * rng.random((30, 30)))
        cost[0] = cost[:, -1] = 1e15
        world = Changing(cost, (29, 29), "length")
        for _ in range(10):
            world.plan((0, 0))
            world.put(int(rng.integers(25)), int(rng.integers(25)), 10.0 ** (exponent * rng.random((5, 5))))


def test_a_region_that_leaves_start_and_goal_outside_holds_them_all_the_same():
    world = Changing(np.full((12, 12), 0.1), (11, 11))
    bitmap = np.ones((12, 12), np.int32)
    bitmap[0, 0] = bitmap[11, 11] = bitmap[5, 5] = 0
    lookup = np.arange(12, dtype=np.int32)
    world.set_region(Region(bitmap, lookup, lookup, 1))
    assert len(world.plan((0, 0)).path) == 13
    found = world.plan((5, 5))
    world.plan((1, 1))
    assert found.status is Status.OK
    assert [5, 5] not in world.plan((0, 0)).path.tolist()
    world.set_region(None)
    assert len(world.plan((0, 0)).path) == 12


def test_a_regions_bitmap_may_be_numbered_anew_in_place():
    rng = np.random.default_rng(6)
    world = Changing(rng.random((40, 40)), (38, 37))
    bitmap, lookup = np.zeros((10, 10), np.int32), np.arange(40, dtype=np.int32) // 4
    for stamp in range(1, 40):
        bitmap[rng.random((10, 10)) < 0.75] = stamp
        world.set_region(Region(bitmap, lookup, lookup, stamp))
        world.plan((1, 2))


def test_a_region_lets_a_path_pass_the_corners_of_cells_outside_it():
    bitmap, lookup = np.eye(6, dtype=np.int32), np.arange(6, dtype=np.int32)
    world = Changing(np.full((6, 6), 0.2), (5, 5), corner_cutting=False)
    world.set_region(Region(bitmap, lookup, lookup, 1))
    assert len(world.plan((0, 0)).path) == 6
    world.put(2, 3, np.inf)
    assert world.plan((0, 0)).status is Status.NO_PATH


def test_another_goal():
    world = Changing(np.random.default_rng(7).random((25, 25)), (20, 20))
    world.plan((2, 2))
    world.put(10, 10, np.full((3, 3), np.inf))
    world.goal = (3, 20)
    world.search.set_goal(world.goal)
    assert world.search.goal == (3, 20)
    world.plan((2, 2))


@pytest.mark.parametrize("step_cost", ["paper", "length"])
@pytest.mark.parametrize("goal_first", [True, False])
def test_another_goal_while_cells_became_cheaper_than_any_before(step_cost, goal_first):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        world = Changing(np.full((12, 15), 0.9), (11, 14), step_cost)
        world.plan((0, 0))
        cheaper = rng.uniform(0.001, 0.01, (12, 15))
        world.goal = (int(rng.integers(12)), int(rng.integers(15)))
        if goal_first:
            world.search.set_goal(world.goal)
            world.put(0, 0, cheaper)
        else:
            world.put(0, 0, cheaper)
            world.search.set_goal(world.goal)
        world.plan((0, 0), slowly=True)


def test_a_passed_deadline_is_reported_and_the_search_goes_on_from_there():
    world = Changing(np.random.default_rng(0).random((300, 300)), (299, 299))
    found = world.search.plan((0, 0), deadline=Deadline.within(0.0))
    assert (found.status, len(found.path)) == (Status.TIMEOUT, 0)
    assert world.search.plan((0, 0), deadline=Deadline.within(0.0)).status is Status.TIMEOUT
    rest = world.plan((0, 0))
    whole = DStarLite(world.state, world.goal).plan((0, 0))
    assert rest.expansions + 2 * found.expansions == whole.expansions


def test_long_travels_do_not_wear_out_the_keys(monkeypatch):
    """What a start's moves have added to the keys is forgotten before sums of it are rounded."""
    cost = np.random.default_rng(3).random((20, 20))
    ends, world = ((0, 0), (0, 19)), Changing(cost, (15, 15))
    for start in 4 * ends:
        world.plan(start)
    assert world.search.restarts == 1
    monkeypatch.setattr(kernels, "EXACT", 100.0 * module.UNITS)
    before = world.search.restarts
    for n, start in enumerate(4 * ends):
        world.put(5, 5, np.full((4, 4), np.inf if n % 2 else 0.4))
        world.plan(start)
    assert 2 <= world.search.restarts - before <= 4


def test_cells_beyond_the_map_are_refused():
    world = Changing(np.zeros((4, 5)), (3, 3))
    with pytest.raises(InvalidMapError, match="inside the map"):
        world.state.update(2, 3, np.zeros((1, 3)))
    with pytest.raises(InvalidQueryError, match="start must lie inside"):
        world.search.plan((4, 0))
    with pytest.raises(InvalidQueryError, match="goal must lie inside"):
        DStarLite(world.state, (0, -1))


def test_plain_python_gives_the_same_answer(monkeypatch):
    def answers():
        rng = np.random.default_rng(5)
        world = Changing(rng.random((9, 9)), (8, 8))
        found = [world.plan((0, 0))]
        world.put(3, 3, np.full((3, 3), np.inf))
        return [*found, world.plan((1, 0))]

    compiled = answers()
    plain = {name: kernel.py_func for name, kernel in vars(kernels).items() if hasattr(kernel, "py_func")}
    for name, function in plain.items():
        monkeypatch.setattr(kernels, name, function)
    for slow, fast in zip(answers(), compiled, strict=True):
        np.testing.assert_array_equal(slow.path, fast.path)
        assert slow.expansions == fast.expansions
