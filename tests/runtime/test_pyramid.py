"""Coarse levels: pooled as by hand, updated as if made anew, and bands around coarse paths."""

from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime import Status
from nnpp_edge.runtime.deadline import NEVER
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import Pyramid, coarse_shapes
from nnpp_edge.runtime.search.astar import Query, astar
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.runtime.tuning import ANOTHER_LEVEL_FROM, CORRIDOR, CorridorWidth
from tests.strategies import costs_on, descent_of, flat, state_of, uniform


def pyramid_of(cost, corner_cutting=True):
    return Pyramid(Grid.of(cost, StepModel.of("paper"), corner_cutting)).finish()


@given(st.integers(0, 2**32), st.sampled_from([0.1, 0.3, 0.5]), st.booleans(), st.booleans())
def test_what_a_coarse_search_finds_can_be_walked_inside_the_cells_it_crosses(
    seed, blocked, corner_cutting, upper
):
    rng = np.random.default_rng(seed)
    cost = rng.random((64, 1030 if upper else 300)).astype(np.float32)
    cost[rng.random(cost.shape) < blocked] = np.inf
    state = state_of(cost, corner_cutting=corner_cutting)
    descent, levels = descent_of(state)
    top = 1 + upper
    on_top = [
        levels[top].grid.cell(node)
        for node in rng.choice(np.flatnonzero(levels[top].pieces), 2).tolist()
    ]
    ends = []
    for row, col in on_top:
        for level in levels[top:0:-1]:  # into the piece that the cell stands for
            bit = int(level.pieces[level.grid.node(row, col)]).bit_length() - 1
            row = row * FACTOR + bit // FACTOR
            col = col * FACTOR + bit % FACTOR
        ends.append((row, col))
    region = descent.corridor(Query(*ends), Work(), top, None, CorridorWidth(0, 0.0, 0.0))
    joined = costs_on(levels[top], on_top[0])[on_top[1]] < np.inf
    assert (region is not None) == joined
    if joined:
        assert astar(state.grid, *ends, descent.workspace(0), region).status is Status.OK


@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.1, 0.4]), st.sampled_from([0.003, 0.03, 0.3]))
def test_the_band_is_every_coarse_cell_on_a_path_that_costs_little_more(seed, blocked, band):
    rng = np.random.default_rng(seed)
    cost = rng.random((120, 90)).astype(np.float32) * 0.9
    cost[rng.random(cost.shape) < blocked] = np.inf
    descent, levels = descent_of(state_of(cost))
    grid = levels[1].grid
    passable = np.flatnonzero(np.isfinite(grid.weights))
    start, goal = map(grid.cell, rng.choice(passable, 2).tolist())
    query = Query(*(tuple(FACTOR * at for at in end) for end in (start, goal)))
    there = costs_on(levels[1], start)
    back = costs_on(levels[1], goal)
    region = descent.corridor(query, Work(), 1, None, CorridorWidth(0, band, 0.0))
    if region is None:
        assert np.isinf(there[goal])
        return
    quarters = (region.bitmap == region.stamp).reshape(grid.rows, 2, grid.cols, 2)
    inside = quarters[:, 0, :, 0]
    assert (quarters == inside[:, None, :, None]).all()
    through = there + back
    limit = (1.0 + band) * there[goal]
    past_the_start = back > (there + there[goal]) * (1 - 1e-5)  # the way there leads through it
    assert inside[(through < limit * (1 - 1e-4)) & ~past_the_start].all()
    assert (through[inside] <= limit * (1 + 1e-4) + 1e-6).all()


def test_a_descent_goes_on_after_pauses_and_full_lists_and_is_of_the_newest_map():
    cost = uniform(5, (300, 1100), 0.5, 0.9)
    state = state_of(cost)
    kept, _ = descent_of(state)
    for coarse in kept.coarse_levels:
        coarse.workspace.entries = np.empty(64, np.int32)
    pausing = Mock(until=0.0, at=1e18, passed=False, goes_on=Mock(side_effect=[True] * 99))
    for value in (0.9, 0.1):  # cheaper than all, then
        state.update(40, 0, np.full((50, 1100), value))
        found = []
        for descent, until in ((descent_of(state)[0], NEVER), (kept, pausing)):
            descent.update()
            work = Work()
            ends = Query((5, 5), (290, 1090), deadline=until)
            region = descent.corridor(ends, work, 2, None, CORRIDOR)
            found.append((work.expansions, region.blocks().tobytes()))
        assert found[0] == found[1] and pausing.goes_on.call_count > 9


def test_a_wall_one_cell_thick_is_a_wall_on_every_level_and_a_gap_a_gap():
    cost = flat(1030, 256, 0.1)
    cost[130, :] = np.inf
    cost[130, 77] = 0.1
    pyramid = pyramid_of(cost)
    assert len(pyramid.levels) == 3
    for number, level in enumerate(pyramid.levels[1:], 1):
        through = costs_on(level, (0, 0)) + costs_on(level, (level.grid.rows - 1, 0))
        assert through[130 // FACTOR**number].argmin() == 77 // FACTOR**number
    cost[130, 77] = np.inf
    for number, level in enumerate(pyramid_of(cost).levels[1:], 1):
        beyond = costs_on(level, (0, 0))[130 // FACTOR**number + 1 :]
        assert np.isinf(beyond).all()


def test_a_coarse_weight_is_the_mean_with_walls_as_obstacles():
    cost = flat(8, 200, 0.5)
    cost[0, :4] = 1.0
    coarse = pyramid_of(cost).levels[1].grid
    scale = coarse.model.scale
    assert coarse.weights[coarse.node(0, 0)] == pytest.approx(scale * (12 * 0.5 + 4) / 16)
    assert coarse.weights[coarse.node(1, 30)] == pytest.approx(scale * 0.5)


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
