import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nnpp_edge.runtime import Planner, Status
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.planners.query import Query, Work
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.search.landmarks import Landmarks
from nnpp_edge.runtime.search.workspace import Workspace
from tests import oracles
from tests.strategies import cases


@settings(deadline=None, max_examples=200)
@given(cases(40), st.integers(0, 7), st.booleans())
def test_with_landmarks_the_optimum_stays_the_optimum(case, count, at_the_goal):
    planner = Planner(case.cost, step_cost=case.step_cost, corner_cutting=case.corner_cutting)
    planner.prepare(landmarks=count, goals=[case.goal] if at_the_goal else [])
    plan = planner.plan(case.start, case.goal, method="astar")
    optimum = oracles.dijkstra(case.cost, case.start, case.step_cost, case.corner_cutting)[case.goal]
    if np.isinf(optimum):
        assert plan.status is Status.NO_PATH
    else:
        assert plan.cost == pytest.approx(optimum, rel=1e-5, abs=1e-6)


@settings(deadline=None, max_examples=60)
@given(cases(24), st.integers(1, 8))
def test_a_landmarks_bound_is_never_above_the_cost(case, count):
    grid = Grid.of(case.cost, StepModel.of(case.step_cost), case.corner_cutting)
    landmarks = Landmarks(grid, Workspace(len(grid.weights)))
    landmarks.spread(count)
    fields, at_goal, slack = landmarks.towards(case.goal)
    with np.errstate(invalid="ignore"):
        apart = np.abs(fields - at_goal)
    bounds = np.where(np.isnan(apart), 0.0, apart).max(axis=1) - slack
    bounds = bounds.reshape(grid.rows + 2, grid.stride)[1:-1, 1:-1]
    cost = oracles.dijkstra(case.cost, case.goal, case.step_cost, case.corner_cutting)
    passable = np.isfinite(grid.map())
    assert (bounds[passable] <= cost[passable] * (1 + 1e-6)).all()


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32), st.booleans())
def test_landmarks_outlive_what_makes_cells_dearer_and_nothing_else(seed, dearer):
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0.45, 0.5, (50, 60)).astype(np.float32)
    state = map_state(Ground(cost))
    searcher = AStarSearcher(state)
    searcher.prepare(4, [])
    for _ in range(4):
        row, col = rng.integers(0, 40, 2)
        patch = cost[row : row + 8, col : col + 8]
        patch *= np.float32(1.2 if dearer else 0.8)
        patch[rng.random(patch.shape) < 0.1] = np.inf if dearer else 0.05
        state.update(int(row), int(col), patch)
        assert (searcher.landmarks is not None) == dearer
        ends = [tuple(int(x) for x in end) for end in rng.choice(np.argwhere(cost < 1.0), 2)]
        found = searcher.search(Query(*ends), Work(), None)
        optimum = oracles.dijkstra(cost, ends[0], "paper", True)[ends[1]]
        assert state.grid.costs_of(found.path)[0] == pytest.approx(optimum, rel=1e-5, abs=1e-6)


def test_landmarks_save_work():
    cost = np.random.default_rng(3).random((256, 256)).astype(np.float32) * 0.9
    plain, prepared = Planner(cost), Planner(cost)
    prepared.prepare(landmarks=7, goals=[(240, 230)])
    start = (20, 15)
    long = plain.plan(start, (240, 30), method="astar")
    assert prepared.plan(start, (240, 30), method="astar").expansions < long.expansions / 2
    to_goal = prepared.plan(start, (240, 230), method="astar")
    assert to_goal.expansions < 2 * len(to_goal.path)


def test_more_landmarks_than_there_is_room_for_or_a_goal_in_a_wall_is_refused():
    cost = np.full((9, 9), 0.1, np.float32)
    cost[4, 4] = np.inf
    planner = Planner(cost)
    with pytest.raises(InvalidQueryError, match="at most 8"):
        planner.prepare(landmarks=8, goals=[(0, 0)])
    with pytest.raises(InvalidQueryError, match=r"goal \(4, 4\): blocked"):
        planner.prepare(goals=[(4, 4)])
    with pytest.raises(InvalidQueryError, match="outside map"):
        planner.prepare(goals=[(4, 40)])
    planner.prepare(landmarks=8)
    assert planner.plan((0, 0), (8, 8), method="astar").ok


def test_a_map_without_a_passable_cell_gets_no_landmark():
    grid = Grid(5, 5, StepModel.of("paper"))
    landmarks = Landmarks(grid, Workspace(len(grid.weights)))
    landmarks.spread(3)
    assert landmarks.cells == []
