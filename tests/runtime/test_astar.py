"""A* over a grid: in regions, with landmarks and over all that can be reached, against Dijkstra's
algorithm.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nnpp_edge.runtime import Planner, Region
from nnpp_edge.runtime.deadline import Deadline
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.nodes import LAST_STAMP
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.search.astar import Query, astar, cost_field
from nnpp_edge.runtime.search.landmarks import Landmarks
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.terrain.step_cost import StepModel
from tests import oracles
from tests.strategies import cases, flat, state_of, uniform

CLOSE = {"rel": 1e-5, "abs": 1e-6}


def set_up(cost, step_cost="paper", corner_cutting=True):
    grid = Grid.of(cost, StepModel.of(step_cost), corner_cutting)
    return grid, Workspace(len(grid.weights))


def region_of(mask):
    return Region(mask.astype(np.int32), *(np.arange(n, dtype=np.int32) for n in mask.shape), 1)


def check(case, found, wanted, corner_cutting):
    """The outcome of a search is the optimum, by a path that may be driven."""
    assert found.status is (Status.OK if np.isfinite(wanted) else Status.NO_PATH)
    assert found.path.dtype == np.int32 and (len(found.path) > 0) == np.isfinite(wanted)
    if np.isfinite(wanted):
        assert oracles.path_cost(found.path, case.cost, case.step_cost) == pytest.approx(
            wanted, **CLOSE
        )
        assert (
            oracles.path_problem(found.path, case.cost, case.start, case.goal, corner_cutting) == ""
        )


@settings(max_examples=150)
@given(cases(30), st.integers(0, 8))
def test_searches_and_fields_are_dijkstras_with_landmarks_and_without(case, count):
    grid, workspace = set_up(case.cost, case.step_cost, case.corner_cutting)
    field = oracles.dijkstra(case.cost, case.start, case.step_cost, case.corner_cutting)
    for _ in range(2):  # the second search meets what the first left behind
        check(
            case,
            astar(grid, case.start, case.goal, workspace),
            field[case.goal],
            case.corner_cutting,
        )
    np.testing.assert_allclose(cost_field(grid, case.start, workspace), field, rtol=2e-5, atol=1e-6)
    planner = Planner(case.cost, step_cost=case.step_cost, corner_cutting=case.corner_cutting)
    planner.prepare(landmarks=count)
    check(
        case,
        planner.plan(case.start, case.goal, method="astar"),
        field[case.goal],
        case.corner_cutting,
    )


@settings(max_examples=120)
@given(cases())
def test_a_region_is_searched_as_a_map_blocked_outside(case):
    rng = np.random.default_rng(case.cost.size)
    mask = rng.random(case.cost.shape) < 0.7
    mask[case.start] = mask[case.goal] = True
    grid, workspace = set_up(case.cost, case.step_cost)
    found = astar(grid, case.start, case.goal, workspace, region=region_of(mask))
    wanted = oracles.dijkstra(np.where(mask, case.cost, np.inf), case.start, case.step_cost)[
        case.goal
    ]
    optimum = oracles.dijkstra(case.cost, case.start, case.step_cost)[case.goal]
    check(case, found, wanted, True)
    assert min(wanted, found.refused_f) <= optimum * (1 + 1e-5) + 1e-6


@settings(max_examples=25)
@given(st.integers(0, 2**32), st.booleans())
def test_landmarks_outlive_what_makes_cells_dearer_and_nothing_else(seed, dearer):
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0.45, 0.5, (50, 60)).astype(np.float32)
    state = state_of(cost)
    searcher = AStarSearcher(state)
    searcher.prepare(4)
    for _ in range(4):
        row, col = rng.integers(0, 40, 2)
        patch = cost[row : row + 8, col : col + 8]
        patch *= np.float32(1.2 if dearer else 0.8)
        patch[rng.random(patch.shape) < 0.1] = np.inf if dearer else 0.05
        state.update(int(row), int(col), patch)
        assert (searcher.landmarks is not None) == dearer
        ends = [tuple(int(x) for x in end) for end in rng.choice(np.argwhere(cost < 1.0), 2)]
        found = searcher.search(Query(*ends), Work(), None)
        assert state.grid.costs_of(found.path)[0] == pytest.approx(
            oracles.dijkstra(cost, ends[0])[ends[1]], **CLOSE
        )


def test_landmarks_save_work():
    cost = uniform(3, (256, 256)) * 0.9
    plain = Planner(cost)
    prepared = Planner(cost)
    start = (20, 15)
    prepared.prepare(landmarks=8)
    long = plain.plan(start, (240, 30), method="astar")
    assert prepared.plan(start, (240, 30), method="astar").expansions < long.expansions / 2
    grid = Grid(5, 5, StepModel.of("paper"))  # without a passable cell
    assert Landmarks(grid, Workspace(len(grid.weights)), 3).cells == []


def test_on_a_plain_map_little_more_than_the_path_is_expanded():
    grid, workspace = set_up(flat(200, 300))
    assert astar(grid, (0, 0), (199, 299), workspace).expansions < 900
    assert astar(grid, (1, 1), (1, 1), workspace).path.tolist() == [[1, 1]]


def test_searches_outgrow_their_memory_and_their_numbers():
    snake = flat(41, 41, 0.1)
    snake[1::4, :-1] = snake[3::4, 1:] = np.inf  # a path longer than the room for it
    for cost, goal in ((snake, (40, 40)), (uniform(1, (150, 150)), (149, 149))):
        grid, workspace = set_up(cost)
        before = astar(grid, (0, 0), goal, workspace)
        small = Workspace(len(grid.weights))
        small.entries = np.empty(32, np.int32)
        small.path = np.empty((4, 2), np.int32)
        cut = astar(grid, (0, 0), goal, small, deadline=Deadline.within(0.0))
        assert cut.status in (Status.TIMEOUT, Status.OK) and tuple(cut.path[0]) == (0, 0)
        assert np.isfinite(oracles.path_cost(cut.path, cost))
        np.testing.assert_array_equal(astar(grid, (0, 0), goal, small).path, before.path)
        assert len(small.entries) > 32 or len(before.path) > 700
        workspace.meta[:] = 0
        astar(grid, goal, (0, 0), workspace)  # of number 1, as the next but one
        workspace.meta[0] = LAST_STAMP
        again = astar(grid, (0, 0), goal, workspace)
        np.testing.assert_array_equal(again.path, before.path)
        assert again.expansions == before.expansions


def test_memory_is_left_to_the_next_workspace_but_never_shared():
    cost = uniform(3, (60, 70))
    grid, first = set_up(cost)
    wanted = astar(grid, (0, 0), (59, 69), first).path
    second = Workspace(len(grid.weights))
    assert not np.shares_memory(first.meta, second.meta)
    astar(grid, (59, 0), (0, 69), second)
    left = second.meta.__array_interface__["data"][0]
    number = second.stamp
    del second
    third = Workspace(len(grid.weights))
    assert third.meta.__array_interface__["data"][0] == left
    assert third.stamp == number > 0
    np.testing.assert_array_equal(astar(grid, (0, 0), (59, 69), third).path, wanted)
    assert not np.shares_memory(third.meta, Workspace(len(grid.weights)).meta)


# --- the grid's weights


def test_the_whole_map_taken_over_narrows_its_bounds():
    grid = Grid.of(np.array([[0.1, 0.9]]), StepModel.of("paper"))
    assert grid.update(np.array([[0.4, 0.5]])).cells == 2
    assert (grid.least, grid.greatest) == pytest.approx(
        tuple(grid.model.scale * x for x in (0.4, 0.5))
    )
    change = grid.update(np.array([[0.4, 0.6]]), keep_old_weights=True)  # of which one cell changes
    assert (change.cells, change.part, change.cheaper) == (1, (0, 1, 1, 1), False)
    assert change.nodes.tolist() == [grid.node(0, 1)]
    assert change.old_weights == pytest.approx([0.5 * grid.model.scale])
