import numpy as np
import pytest
from hypothesis import given, settings

from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.search import astar as module
from nnpp_edge.runtime.search.astar import astar, cost_field
from nnpp_edge.runtime.search.workspace import LAST_STAMP, Workspace
from tests import oracles
from tests.strategies import cases


def set_up(cost, step_cost="paper", corner_cutting=True):
    grid = Grid.of(cost, StepModel.of(step_cost), corner_cutting)
    return grid, Workspace(len(grid.weights))


def check_path(case, path, wanted):
    assert path.dtype == np.int32
    assert tuple(path[0]) == case.start
    assert tuple(path[-1]) == case.goal
    assert oracles.path_cost(path, case.cost, case.step_cost) == pytest.approx(wanted, rel=1e-5, abs=1e-6)
    assert np.isfinite(case.cost[tuple(path.T)]).all()
    if not case.corner_cutting:
        for (r, c), (i, j) in zip(path[:-1], path[1:], strict=True):
            assert np.isfinite(case.cost[r, j])
            assert np.isfinite(case.cost[i, c])


@settings(deadline=None, max_examples=400)
@given(cases())
def test_astar_finds_the_optimal_cost(case):
    grid, workspace = set_up(case.cost, case.step_cost, case.corner_cutting)
    wanted = oracles.dijkstra(case.cost, case.start, case.step_cost, case.corner_cutting)[case.goal]
    for _ in range(2):  # the second search meets what the first left behind
        found = astar(grid, case.start, case.goal, workspace)
        if np.isinf(wanted):
            assert found.status is Status.NO_PATH
            assert len(found.path) == 0
        else:
            assert found.status is Status.OK
            check_path(case, found.path, wanted)


@settings(deadline=None, max_examples=100)
@given(cases())
def test_a_cost_field_equals_dijkstras(case):
    grid, workspace = set_up(case.cost, case.step_cost, case.corner_cutting)
    found = cost_field(grid, case.start, workspace)
    wanted = oracles.dijkstra(case.cost, case.start, case.step_cost, case.corner_cutting)
    np.testing.assert_allclose(found, wanted, rtol=2e-5, atol=1e-6)


def region_of(mask):
    rows, cols = (np.arange(n, dtype=np.int32) for n in mask.shape)
    return Region(mask.astype(np.int32), rows, cols, 1)


@settings(deadline=None, max_examples=200)
@given(cases())
def test_a_region_is_searched_as_a_map_blocked_outside(case):
    rng = np.random.default_rng(case.cost.size)
    mask = rng.random(case.cost.shape) < 0.7
    mask[case.start] = mask[case.goal] = True
    grid, workspace = set_up(case.cost, case.step_cost)
    found = astar(grid, case.start, case.goal, workspace, region=region_of(mask))
    wanted = oracles.dijkstra(np.where(mask, case.cost, np.inf), case.start, case.step_cost)[case.goal]
    optimum = oracles.dijkstra(case.cost, case.start, case.step_cost)[case.goal]
    if np.isinf(wanted):
        assert found.status is Status.NO_PATH
        assert found.refused_f <= optimum * (1 + 1e-5)
        return
    cost = oracles.path_cost(found.path, case.cost, case.step_cost)
    assert cost == pytest.approx(wanted, rel=1e-5, abs=1e-6)
    assert min(cost, found.refused_f) <= optimum * (1 + 1e-5) + 1e-6


def test_a_full_region_changes_nothing():
    cost = np.random.default_rng(3).random((60, 50)).astype(np.float32)
    grid, workspace = set_up(cost)
    plain = astar(grid, (2, 3), (55, 44), workspace)
    inside = astar(grid, (2, 3), (55, 44), workspace, region=region_of(np.ones(cost.shape, bool)))
    np.testing.assert_array_equal(plain.path, inside.path)
    assert plain.expansions == inside.expansions
    assert np.isinf(inside.refused_f)


def test_a_region_reads_its_blocks_in_place():
    cost = np.full((40, 40), 0.1, np.float32)
    blocks = np.zeros((10, 10), np.int32)
    blocks[0, :] = blocks[:, 9] = 7
    lookup = np.arange(40, dtype=np.int32) // 4
    region = Region(blocks, lookup, lookup, 7)
    grid, workspace = set_up(cost)
    found = astar(grid, (0, 0), (39, 39), workspace, region=region)
    assert region.mask()[tuple(found.path.T)].all()
    assert region.area() == region.mask().sum() == 19 * 16
    assert region.holds(3, 39)
    assert not region.holds(4, 0)


def test_on_a_plain_map_little_more_than_the_path_is_expanded():
    grid, workspace = set_up(np.zeros((200, 300), np.float32))
    assert astar(grid, (0, 0), (199, 299), workspace).expansions < 900


def test_start_is_goal():
    grid, workspace = set_up(np.zeros((3, 3), np.float32))
    found = astar(grid, (1, 1), (1, 1), workspace)
    assert (found.status, found.path.tolist()) == (Status.OK, [[1, 1]])


def test_a_passed_deadline_gives_the_path_as_far_as_it_came():
    cost = np.random.default_rng(0).random((1200, 1200)).astype(np.float32)
    grid, workspace = set_up(cost)
    found = astar(grid, (0, 0), (1199, 1199), workspace, deadline=Deadline.within(0.0))
    assert found.status is Status.TIMEOUT
    assert tuple(found.path[0]) == (0, 0)
    assert 1 < len(found.path) < 1200
    assert np.isfinite(oracles.path_cost(found.path, cost))
    assert astar(grid, (0, 0), (1199, 1199), workspace).status is Status.OK


def test_the_searches_number_starts_again_without_harm():
    cost = np.random.default_rng(1).random((20, 20)).astype(np.float32)
    grid, workspace = set_up(cost)
    before = astar(grid, (0, 0), (19, 19), workspace)
    workspace.stamp = LAST_STAMP - 1
    for _ in range(3):
        np.testing.assert_array_equal(astar(grid, (0, 0), (19, 19), workspace).path, before.path)


def test_the_open_list_grows_when_it_must():
    cost = np.random.default_rng(1).random((150, 150)).astype(np.float32)
    grid, workspace = set_up(cost)
    before = astar(grid, (0, 0), (149, 149), workspace)
    small = Workspace(len(grid.weights))
    small.entries = np.empty(32, np.int32)
    np.testing.assert_array_equal(astar(grid, (0, 0), (149, 149), small).path, before.path)
    assert len(small.entries) > 32


def test_a_path_longer_than_the_room_for_it_is_whole():
    cost = np.full((41, 41), 0.1, np.float32)
    cost[1::4, :-1] = np.inf
    cost[3::4, 1:] = np.inf
    grid, workspace = set_up(cost)
    before = astar(grid, (0, 0), (40, 40), workspace)
    assert len(before.path) > 700
    workspace.path = np.empty((16, 2), np.int32)
    np.testing.assert_array_equal(astar(grid, (0, 0), (40, 40), workspace).path, before.path)
    small = Workspace(len(grid.weights))
    small.entries, small.path = np.empty(2 * 12, np.int32), np.empty((4, 2), np.int32)
    cut = astar(grid, (0, 0), (40, 40), small, deadline=Deadline.within(0.0))
    assert cut.status in (Status.TIMEOUT, Status.OK)
    assert tuple(cut.path[0]) == (0, 0)
    assert np.isfinite(oracles.path_cost(cut.path, cost))


def test_plain_python_gives_the_same_answer(monkeypatch):
    grid, workspace = set_up(np.random.default_rng(5).random((9, 9)).astype(np.float32))
    compiled = astar(grid, (0, 0), (8, 8), workspace)
    monkeypatch.setattr(module.kernels, "expand", module.kernels.expand.py_func)
    with np.errstate(over="ignore"):
        plain = astar(grid, (0, 0), (8, 8), workspace)
    np.testing.assert_array_equal(plain.path, compiled.path)


def test_memory_is_left_to_the_next_workspace_but_never_shared():
    cost = np.random.default_rng(3).random((60, 70)).astype(np.float32)
    grid, first = set_up(cost)
    wanted = astar(grid, (0, 0), (59, 69), first).path
    second = Workspace(len(grid.weights))
    assert not np.shares_memory(first.meta, second.meta)
    astar(grid, (59, 0), (0, 69), second)
    left, number = second.meta.__array_interface__["data"][0], second.stamp
    del second
    third = Workspace(len(grid.weights))
    assert third.meta.__array_interface__["data"][0] == left
    assert third.stamp == number > 0
    np.testing.assert_array_equal(astar(grid, (0, 0), (59, 69), third).path, wanted)
    assert not np.shares_memory(third.meta, Workspace(len(grid.weights)).meta)
