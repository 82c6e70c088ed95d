"""The adaptive threshold and its region, against a loop over all thresholds."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import Level, Pyramid
from nnpp_edge.runtime.network.encoding import Frame
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.region.learned import LearnedRegions, RegionFinder, probability_of
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.stopwatch import Work
from nnpp_edge.runtime.terrain.step_cost import StepModel
from tests import oracles
from tests.strategies import flat, state_of, uniform


@given(st.integers(1, 16), st.integers(0, 2**32), st.sampled_from([4, 256]), st.data())
def test_the_threshold_equals_the_loop_over_thresholds(side, seed, levels, data):
    rng = np.random.default_rng(seed)
    finder = RegionFinder(side)
    probability = (rng.integers(0, levels, (side, side)) / levels).astype(np.float32)
    start, goal = (
        (data.draw(st.integers(0, side - 1)), data.draw(st.integers(0, side - 1))) for _ in range(2)
    )
    finder.read(probability)
    roots = np.sqrt(np.sqrt(probability))
    np.testing.assert_array_equal(finder.levels, np.minimum(roots * 256, 255).astype(np.uint8))
    assert finder.threshold(start, goal) == oracles.threshold_by_loop(finder.levels, start, goal)


def test_a_marked_region_holds_what_is_above_and_both_ends():
    finder = RegionFinder(5)
    probability = np.zeros((5, 5), np.float32)
    probability[2] = 0.5
    finder.read(probability)
    level = int(256 * 0.5**0.25)
    blocks = (np.arange(5, dtype=np.int32),) * 2
    finder.mark(level, (0, 0), (2, 4))
    first = finder.region(blocks)
    assert first.area() == first.mask().sum() == 6 and first.mask()[2, 3] and not first.mask()[1, 1]
    finder.mark(level + 1, (0, 0), (2, 4), radius=1)
    assert finder.region(blocks).area() == 4 + 6


@given(st.integers(1, 5), st.integers(1, 4), st.integers(0, 2**32), st.booleans(), st.data())
def test_the_walkable_threshold_is_the_highest_at_which_a_search_of_the_region_succeeds(
    side, per_block, seed, corner_cutting, data
):
    rng = np.random.default_rng(seed)
    rows = side * per_block
    cols = max(side * per_block - data.draw(st.integers(0, per_block - 1)), 1)
    cost = rng.random((rows, cols)).astype(np.float32) * 0.9
    cost[rng.random((rows, cols)) < 0.35] = np.inf
    start, goal = (
        (data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, cols - 1))) for _ in range(2)
    )
    cost[start] = cost[goal] = 0.1
    grid = Grid.of(cost, StepModel.of("paper"), corner_cutting)
    blocks = (
        np.arange(rows, dtype=np.int32) // per_block,
        np.arange(cols, dtype=np.int32) // per_block,
    )
    finder = RegionFinder(side)
    workspace = Workspace(len(grid.weights))
    probability = (rng.integers(0, 8, (side, side)) / 8).astype(np.float32)
    ends = tuple((int(blocks[0][r]), int(blocks[1][c])) for r, c in (start, goal))
    query = (start, goal), ends, 0.0625

    def succeeds(threshold):
        finder.mark(threshold, *ends)
        region = finder.region(blocks)
        return (
            astar(grid, start, goal, Workspace(len(grid.weights)), region=region).status
            is Status.OK
        )

    level = Level(grid)
    td = finder.first(probability, level, workspace, blocks, *query)
    if td < 0:
        assert not succeeds(0)
    else:
        at_td = finder.at_td == finder.stamp
        wider = finder.bitmap == finder.stamp
        stamp = finder.stamp
        finder.mark(td, *ends)
        np.testing.assert_array_equal(at_td, finder.bitmap == stamp + 1)
        if td:
            finder.mark(lowered(td, 0.0625), *ends)
            np.testing.assert_array_equal(wider, finder.bitmap == stamp + 2)
        assert succeeds(td)
        lower = min(int(finder.levels[block]) for block in ends)
        assert td >= lower or not succeeds(td + 1)
    for touching in (False, True):
        assert finder.first(probability, level, workspace, blocks, *query, touching=touching) == td


@settings(max_examples=30)
@given(st.integers(2, 5), st.integers(0, 3), st.integers(0, 3), st.integers(0, 2**32))
def test_cells_that_the_network_is_not_shown_belong_to_no_region(side, above, left, seed):
    rng = np.random.default_rng(seed)
    inside = 3 * side
    shape = (above + inside + 2, left + inside + 2)
    cost = rng.random(shape) * 0.5
    lookup = tuple(np.full(cells, side, np.int32) for cells in shape)
    for blocks, first in zip(lookup, (above, left), strict=True):
        blocks[first : first + inside] = np.arange(inside) // 3
    shown = (slice(above, above + inside), slice(left, left + inside))
    cost[shown][rng.random((inside, inside)) < 0.3] = np.inf
    start = (above, left)
    goal = (above + inside - 1, left + inside - 1)
    cost[start] = cost[goal] = 0.1
    probability = (rng.random((side, side)) ** 2).astype(np.float32)
    finder = RegionFinder(side)

    def first(cost, lookup, start, goal):
        grid = Grid.of(cost, StepModel.of("paper"))
        place = Workspace(len(grid.weights)), lookup, (start, goal), ((0, 0), (side - 1, side - 1))
        return finder.first(probability, Level(grid), *place, 0.1, touching=True)

    corner = inside - 1
    alone = np.arange(inside, dtype=np.int32) // 3
    td = first(np.ascontiguousarray(cost[shown]), (alone, alone), (0, 0), (corner, corner))
    assert max(td, 0) == max(first(cost, lookup, start, goal), 0)
    if td > 0:
        assert not (finder.bitmap[-1] == finder.stamp).any()
        assert not (finder.bitmap[:, -1] == finder.stamp).any()


@settings(max_examples=30)
@given(st.integers(70, 400), st.integers(70, 400), st.integers(0, 2**32))
def test_on_coarse_cells_the_bound_by_blocks_changes_nothing(rows, cols, seed):
    rng = np.random.default_rng(seed)
    level = (
        Pyramid(Grid.of(rng.random((rows, cols)) * 0.5, StepModel.of("paper"))).finish().levels[1]
    )
    lookup = Frame(rows, cols, 64).lookup(16)
    coarse = []
    for blocks, cells in zip(lookup, (level.grid.rows, level.grid.cols), strict=True):
        coarse.append(blocks[np.minimum(np.arange(cells) * 4 + 2, len(blocks) - 1)])
    probability = rng.random((16, 16)).astype(np.float32)
    cells = [(int(rng.integers(0, rows)), int(rng.integers(0, cols))) for _ in range(2)]
    ends = tuple((row // 4, col // 4) for row, col in cells)
    blocks = tuple((int(lookup[0][row]), int(lookup[1][col])) for row, col in cells)
    finder = RegionFinder(16)
    place = (Workspace(len(level.grid.weights)), tuple(coarse), ends, blocks)
    found = {
        finder.first(probability, level, *place, 0.2, touching=touching)
        for touching in (False, True)
    }
    assert len(found) == 1


def test_of_a_map_with_fewer_cells_than_blocks_the_threshold_is_that_of_the_cells_blocks(
    network, monkeypatch
):
    state = state_of(flat(5, 6, 0.2))
    blocks = network.metadata.blocks
    rows, cols = Frame(*state.shape, network.metadata.input_size).lookup(blocks)
    place = Level(state.grid), 0, Workspace(len(state.grid.weights)), Work()
    for seed in range(20):
        probability = uniform(seed, (blocks, blocks))
        monkeypatch.setattr(NetworkModel, "answer", lambda *_, answer=probability: answer)
        td, *_ = LearnedRegions(state, network).regions((0, 0), (4, 5), *place)
        levels = np.minimum(np.sqrt(np.sqrt(probability)) * 256, 255).astype(np.uint8)
        levels = levels[np.ix_(rows, cols)]
        assert td == probability_of(oracles.threshold_by_loop(levels, (0, 0), (4, 5)))


def test_levels_reach_far_down_and_factors_are_those_of_probabilities():
    assert probability_of(-1) == probability_of(0) == 0.0
    assert probability_of(1) < 1e-9
    assert probability_of(256) == 1.0
    for level in (40, 100, 255):
        for factor in (1.0, 0.5, 0.2):
            found = probability_of(lowered(level, factor))
            assert (
                found
                <= factor * probability_of(level) * (1 + 1e-12)
                < probability_of(lowered(level, factor) + 1)
            )
    assert lowered(1, 0.01) == 1
