import numpy as np
import pytest

from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.standing_path import Footing, StandingPath


def random_patch(rng, cost, step_cost):
    """Where, and new costs: others, dearer, cheaper, walls or openings."""
    h, w = (int(rng.integers(1, min(n, 6) + 1)) for n in cost.shape)
    row, col = (int(rng.integers(n - k + 1)) for n, k in zip(cost.shape, (h, w), strict=True))
    old = cost[row : row + h, col : col + w]
    new = (rng.random((h, w)) * 0.9 + (0.01 if step_cost == "length" else 0.0)).astype(np.float32)
    what = rng.integers(5)
    if what == 0:
        new = np.where(np.isfinite(old), np.maximum(old, new), old)
    elif what == 1:
        new = np.where(np.isfinite(old), np.minimum(old, new), old)
    elif what == 2:
        new = np.where(rng.random((h, w)) < 0.3, np.float32(np.inf), old)
    elif what == 3:
        new = np.where(np.isfinite(old), old, new)
    return row, col, new


def walkable(path, cost, corner_cutting):
    free = np.isfinite(cost) & (cost < np.inf)
    for n, (row, col) in enumerate(path):
        if not free[row, col]:
            return False
        if n and not corner_cutting and not (free[path[n - 1][0], col] and free[row, path[n - 1][1]]):
            return False
    return True


def corridor_of_ones(**options):
    """A free map of 20 × 60 cells, a straight path along its middle, and the planner."""
    cost = np.full((20, 60), 0.2, np.float32)
    planner = Planner(cost, **options)
    path = StandingPath(planner.state)
    plan = planner.plan((10, 0), (10, 59), method="astar")
    path.set(plan)

    def put(row, col, patch):
        planner.update(row, col, np.array(patch, np.float32, ndmin=2))

    return path, plan, put


def test_changes_behind_the_robot_do_not_matter():
    path, plan, put = corridor_of_ones()
    put(10, 5, np.inf)
    assert path.check((10, 0)).footing is Footing.BLOCKED
    assert path.check((10, 0)).blocked_at == (10, 5)
    later = path.check((10, 20))
    assert later.valid
    assert later.index == 20
    assert later.cost == pytest.approx(plan.cost * 39 / 59)
    assert later.bound == pytest.approx(1.0, rel=1e-5)
    assert later.added == pytest.approx(0.0, abs=1e-4)


def test_an_opened_cell_is_bounded_by_the_way_over_it():
    cost = np.full((30, 60), 0.2, np.float32)
    cost[29, 0] = np.inf
    planner = Planner(cost)
    path = StandingPath(planner.state)
    path.set(planner.plan((0, 0), (0, 59), method="astar"))
    planner.update(29, 0, np.array([[0.2]], np.float32))
    assert path.check((0, 0)).added == 0.0


def test_a_corner_that_may_not_be_cut_any_more_blocks():
    cost = np.full((6, 6), 0.2, np.float32)
    for corner_cutting, footing in ((True, Footing.VALID), (False, Footing.BLOCKED)):
        planner = Planner(cost, corner_cutting=corner_cutting)
        path = StandingPath(planner.state)
        plan = planner.plan((0, 0), (5, 5), method="astar")
        path.set(plan)
        planner.update(2, 3, np.array([[np.inf]], np.float32))
        assert path.check((0, 0)).footing is footing
        assert walkable(plan.path, planner.state.grid.map(), corner_cutting) == (footing is Footing.VALID)


def test_off_the_path_and_without_one():
    path, plan, _ = corridor_of_ones()
    assert path.check((3, 3)).footing is Footing.OFF_PATH
    path.forget()
    found = path.check((10, 0))
    assert (found.footing, found.valid, found.lower_bound) == (Footing.NONE, False, 0.0)


def test_only_a_path_to_the_goal_can_stand():
    cost = np.full((5, 5), 0.2, np.float32)
    cost[:, 2] = np.inf
    planner = Planner(cost)
    path = StandingPath(planner.state)
    with pytest.raises(InvalidQueryError, match="NO_PATH"):
        path.set(planner.plan((0, 0), (4, 4), method="astar"))
    plan = planner.plan((0, 0), (4, 0), method="astar")
    planner.update(2, 0, np.full((1, 2), np.inf, np.float32))
    with pytest.raises(InvalidQueryError, match="walkable"):
        path.set(plan)


def test_costs_that_rise_leave_the_bound_and_what_is_far_off_saves_nothing():
    path, plan, put = corridor_of_ones()
    put(0, 30, 0.15)
    assert path.check((10, 0)).added < 0.1 * plan.cost  # one cell's saving at most
    put(0, 30, 0.2)  # what was is what counts, not the order of changes
    assert path.check((10, 0)).added == pytest.approx(0.0, abs=1e-3)
    put(5, 0, np.full((10, 60), 0.3))  # other rows stay cheap, as the octile distance goes by the cheapest cell
    found = path.check((10, 0))
    assert found.lower_bound == pytest.approx(plan.cost, rel=1e-3)
    assert found.added == pytest.approx(0.1 * 2 * 2.805 * 59, rel=1e-3)
    path.set(plan)  # which forgets what changed before it
    assert path.check((10, 0)).added == pytest.approx(0.0, abs=1e-6)
