"""Coarse levels: pooled as by hand, updated as if made anew, and bands around coarse paths."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime import Source, Status
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import Pyramid, coarse_shapes
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel, CoarseToFine
from nnpp_edge.runtime.planners.searchers import AStarSearcher
from nnpp_edge.runtime.search.astar import Query, astar, settle_all
from nnpp_edge.runtime.search.landmarks import Landmarks
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.runtime.tuning import ANOTHER_LEVEL_FROM, CORRIDOR
from tests.strategies import flat, state_of, uniform


def pyramid_of(cost, corner_cutting=True):
    return Pyramid(Grid.of(cost, StepModel.of("paper"), corner_cutting)).finish()


def search(level, start, goal):
    """A* on one level."""
    return astar(level.grid, start, goal, Workspace(len(level.grid.weights)), links=level.links)


@given(st.integers(0, 2**32), st.sampled_from([0.1, 0.3, 0.5]), st.booleans(), st.booleans())
def test_what_a_coarse_search_finds_can_be_walked_inside_the_cells_it_crosses(
    seed, blocked, corner_cutting, upper
):
    rng = np.random.default_rng(seed)
    cost = rng.random((64, 1030 if upper else 300)).astype(np.float32)
    cost[rng.random(cost.shape) < blocked] = np.inf
    fine, level = pyramid_of(cost, corner_cutting).levels[upper : upper + 2]
    coarse = CoarseLevel(level)
    workspace = Workspace(len(fine.grid.weights))
    a, b = (int(node) for node in rng.choice(np.flatnonzero(level.pieces), 2))
    ends = [level.grid.cell(node) for node in (a, b)]
    found = coarse.search(*ends[::-1], None, beyond=0.0)
    if found.status is not Status.OK:
        return
    walk = []
    for node, (r, c) in zip((a, b), ends, strict=True):
        bit = int(level.pieces[node]).bit_length() - 1
        walk.append((r * FACTOR + bit // FACTOR, c * FACTOR + bit % FACTOR))
    region = coarse.around(found, ends[0], 0, 0.0, fine, workspace)
    assert astar(fine.grid, *walk, workspace, region=region, links=fine.links).status is Status.OK


@given(
    st.integers(0, 2**32),
    st.sampled_from([0.0, 0.1, 0.4]),
    st.sampled_from([0.003, 0.03, 0.3]),
    st.booleans(),
)
def test_the_band_is_every_coarse_cell_on_a_path_that_costs_little_more(
    seed, blocked, band, with_landmarks
):
    rng = np.random.default_rng(seed)
    cost = rng.random((120, 90)).astype(np.float32) * 0.9
    cost[rng.random(cost.shape) < blocked] = np.inf
    fine, level = pyramid_of(cost).levels[:2]
    coarse, grid, scratch = CoarseLevel(level), level.grid, Workspace(len(level.grid.weights))
    ends = [
        grid.cell(int(node)) for node in rng.choice(np.flatnonzero(np.isfinite(grid.weights)), 2)
    ]
    fields = []
    for end in ends:
        settle_all(grid, end, scratch, level.links)
        fields.append(scratch.costs().reshape(-1, grid.stride)[1:-1, 1 : grid.cols + 1])
    if with_landmarks:
        coarse.landmarks = Landmarks(grid, coarse.workspace, level.links)
        coarse.landmarks.spread(4)
    found = coarse.search(*ends[::-1], None, beyond=band)
    if found.status is not Status.OK:
        assert np.isinf(fields[0][ends[1]])
        return
    region = coarse.around(found, ends[0], 0, band, fine, Workspace(len(fine.grid.weights)))
    quarters = (region.bitmap == region.stamp).reshape(grid.rows, 2, grid.cols, 2)
    inside = quarters[:, 0, :, 0]
    assert (quarters == inside[:, None, :, None]).all()
    through = fields[0] + fields[1]
    limit = (1.0 + band) * fields[0][ends[1]]
    assert inside[tuple(found.path.T)].all()
    past_the_start = fields[1] > (fields[0] + fields[0][ends[1]]) * (
        1 - 1e-5
    )  # the way from there leads through it
    assert inside[(through < limit * (1 - 1e-4)) & ~past_the_start].all()
    assert (through[inside] <= limit * (1 + 1e-4) + 1e-6).all()


def test_a_wall_one_cell_thick_is_a_wall_on_every_level_and_a_gap_a_gap():
    cost = flat(1030, 256, 0.1)
    cost[130, :] = np.inf
    cost[130, 77] = 0.1
    pyramid = pyramid_of(cost)
    assert len(pyramid.levels) == 3
    for level, at in enumerate(pyramid.levels):
        found = search(at, (0, 0), (at.grid.rows - 1, 0))
        assert found.status is Status.OK
        crossing = found.path[found.path[:, 0] == 130 // FACTOR**level]
        assert 77 // FACTOR**level in crossing[:, 1]
    cost[130, 77] = np.inf
    for at in pyramid_of(cost).levels:
        assert search(at, (0, 0), (at.grid.rows - 1, 0)).status is Status.NO_PATH


def test_a_coarse_weight_is_the_mean_with_walls_as_obstacles():
    cost = flat(8, 200, 0.5)
    cost[0, :4] = 1.0
    coarse = pyramid_of(cost).levels[1].grid
    scale = coarse.model.scale
    assert coarse.weights[coarse.node(0, 0)] == pytest.approx(scale * (12 * 0.5 + 4) / 16)
    assert coarse.weights[coarse.node(1, 30)] == pytest.approx(scale * 0.5)


@pytest.mark.parametrize(("side", "wanted_landmarks"), [(256, 3), (8, None)])
def test_a_level_that_is_searched_often_gets_landmarks_until_the_map_changes(
    side, wanted_landmarks
):
    cost = uniform(4, (side, side)) * 0.9
    start = (side - 2, 0)
    goal = (1, side - 2)
    if side == 8:
        cost[:, 4:] = np.inf
        goal = (1, 3)
    state = state_of(cost)
    searcher = AStarSearcher(state)
    coarse_to_fine = CoarseToFine(state, searcher.workspace)
    coarse_to_fine.update()
    coarse = coarse_to_fine.coarse_levels[0]
    query = Query(start, goal)
    top = 1

    def cost_of_corridor():
        found = coarse_to_fine.find(query, Work(), searcher, top, None, CORRIDOR, Source.REGION)
        return found.cost

    wanted = cost_of_corridor()
    for _ in range(40):
        assert cost_of_corridor() == pytest.approx(wanted)
    before = coarse.landmarks
    assert (before and len(before.cells)) == wanted_landmarks
    for _ in range(40):
        cost_of_corridor()
    assert coarse.landmarks is before
    state.update(0, 0, cost[:1, :1] + np.float32(0.01))
    cost_of_corridor()
    assert coarse.landmarks is None


def test_there_is_another_level_as_long_as_one_is_large():
    assert coarse_shapes(1, 1) == [(1, 1)]
    assert coarse_shapes(4096, 4096) == [(1024, 1024), (256, 256), (64, 64)]
    size = 1021  # the smallest map with a second coarse level
    for narrow in (1, 40, 1000):
        assert [len(coarse_shapes(side, narrow)) for side in (size - 1, size)] == [1, 2]
        levels = Pyramid(Grid(size, narrow, StepModel.of("paper"))).levels
        assert max(levels[1].grid.shape) >= ANOTHER_LEVEL_FROM > max(levels[2].grid.shape)


def test_a_cell_that_is_dearer_than_any_weighs_in_all_obstacles_of_a_map_of_lengths():
    cost = uniform(3, (80, 90), 1.0, 2.0)
    cost[uniform(4, cost.shape) < 0.2] = np.inf
    state = state_of(cost, "length")
    assert state.pyramid
    cost[0, 0] = 9.0
    state.update(0, 0, cost[:1, :1])
    fresh = state_of(cost, "length")
    for one, other in zip(state.pyramid.levels, fresh.pyramid.levels, strict=True):
        np.testing.assert_array_equal(one.grid.weights, other.grid.weights)
