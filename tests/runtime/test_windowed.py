"""Maps read by windows: costs, coarse levels and plans are those of the whole map in memory."""

import itertools
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime import Planner, Source, Traversability, plan_path, traversability_cost
from nnpp_edge.runtime.errors import InvalidMapError, Status
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.pyramid import Pyramid
from nnpp_edge.runtime.map.streamed import StreamedMap
from nnpp_edge.runtime.planners import windowed
from nnpp_edge.runtime.planners.windowed import WindowedPlanner, connected
from nnpp_edge.runtime.terrain import windows
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.runtime.terrain.windows import CostWindows
from nnpp_edge.terrain.synthetic import synthetic_terrain
from tests.strategies import cases, flat

LIMITS = Traversability(
    slope_limit_deg=20.0, hard_slope_deg=20.0, roughness_limit_m=2.0, step_limit_m=2.0
)


def test_no_path_leads_over_a_cliff_unless_the_papers_cost_is_asked_for():
    dem = flat(64, 64)
    dem[:, 30:] = 1.2
    ends = (30, 5), (30, 60)
    assert WindowedPlanner(ArrayWindows(dem)).plan(*ends).status is Status.NO_PATH
    assert WindowedPlanner(ArrayWindows(dem), Traversability()).plan(*ends).ok


class ArrayWindows:
    """Heights in memory, handed out by windows."""

    cell_size_m = 1.0
    cell_width_m = 1.5

    def __init__(self, heights, block=(16, 16)):
        self.heights = heights
        self.block = block
        self.read_parts = []

    @property
    def shape(self):
        return self.heights.shape

    def read(self, part):
        row, col, rows, cols = part
        self.read_parts.append(part)
        assert row >= 0 and col >= 0 and row + rows <= self.shape[0] and col + cols <= self.shape[1]
        return self.heights[row : row + rows, col : col + cols].copy()


def rough(rng, rows, cols, unknown=0.05):
    heights = np.cumsum(rng.normal(0.0, 0.3, (rows, cols)), axis=1).astype(np.float32)
    heights[rng.random(heights.shape) < unknown] = np.nan
    return heights


def cost_of(heights):
    return traversability_cost(heights, 1.0, LIMITS, cell_width_m=1.5, warn=False)


@pytest.fixture
def small_bands(monkeypatch):
    """Bands of about a block's height."""
    monkeypatch.setattr(windows, "BAND_CELLS", 1)


@pytest.mark.usefixtures("small_bands")
def test_costs_of_windows_bands_and_along_a_path_are_those_of_the_whole_map():
    heights = rough(np.random.default_rng(0), 90, 700)
    cost = cost_of(heights)
    source = CostWindows(ArrayWindows(heights), LIMITS)
    parts = [(0, 0, 90, 700), (0, 5, 1, 1), (89, 699, 1, 1), (30, 40, 17, 23)]
    for (row, col, rows, cols), found, costs in source.windows(parts):
        np.testing.assert_array_equal(found, heights[row : row + rows, col : col + cols])
        np.testing.assert_array_equal(costs, cost[row : row + rows, col : col + cols])
    path = np.stack([np.minimum(np.arange(700) // 7, 89), np.arange(700)], axis=1).astype(np.int32)
    for path_part in (path, path[:1], path[:0]):
        found, costs = source.along(path_part)
        np.testing.assert_array_equal(found, heights[tuple(path_part.T)])
        np.testing.assert_array_equal(costs, cost[tuple(path_part.T)])
    shapes = ((1, 1), (1, 40), (40, 1), (3, 9), (65, 30), (64, 7))
    for block_rows, shape in itertools.product((1, 3, 4, 8, 64), shapes):
        heights = rough(np.random.default_rng(block_rows), *shape)
        source = ArrayWindows(heights, (block_rows, 16))
        bands = list(CostWindows(source, LIMITS).bands())
        assert [row for row, *_ in bands] == np.cumsum([0, *(len(cost) for *_, cost in bands)])[
            :-1
        ].tolist()
        assert all(len(cost) % 4 == 0 for *_, cost in bands[:-1])
        np.testing.assert_array_equal(np.concatenate([each for _, each, _ in bands]), heights)
        np.testing.assert_array_equal(
            np.concatenate([cost for *_, cost in bands]), cost_of(heights)
        )
        assert (
            sum(rows * cols for _, _, rows, cols in source.read_parts) == heights.size
        )  # each once


@given(
    st.integers(0, 2**32),
    st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.8]),
    st.sampled_from([4, 8, 12, 100]),
    st.booleans(),
)
def test_coarse_levels_made_by_bands_are_those_of_the_whole_map(
    seed, blocked, rows_per_band, corner_cutting
):
    rng = np.random.default_rng(seed)
    rows = rng.integers(1, 90)
    cols = rng.choice([rng.integers(1, 60), 1100])
    cost = rng.random((rows, cols)).astype(np.float32) * 0.9
    cost[rng.random(cost.shape) < blocked] = np.inf
    cost[:, rng.integers(cols)] = np.inf  # a wall
    cost[rng.integers(rows)] = np.inf
    model = StepModel.of("paper")
    whole = Pyramid(Grid.of(cost, model, corner_cutting)).finish()
    streamed = StreamedMap(cost.shape, model, corner_cutting=corner_cutting)
    for row in range(0, rows, rows_per_band):
        streamed.take(cost[row : row + rows_per_band])
    streamed.finish()
    assert len(whole.levels) == len(streamed.levels)
    for one, other in zip(whole.levels[1:], streamed.levels[1:], strict=True):
        np.testing.assert_array_equal(one.grid.weights, other.grid.weights)
        np.testing.assert_array_equal(one.pieces, other.pieces)
        np.testing.assert_array_equal(one.links, other.links)
        assert (one.grid.least, one.grid.greatest) == (other.grid.least, other.grid.greatest)
    finest = whole.levels[0].grid
    assert (finest.least, finest.greatest) == (streamed.grid.least, streamed.grid.greatest)


@given(cases(most_side=30), st.sampled_from([1, 4, 7, 64]))
def test_whether_two_cells_are_connected_is_what_a_search_finds(case, rows_per_band):
    cost = np.where(np.isfinite(case.cost), np.float32(0.5), np.float32(np.nan))
    plan = plan_path(
        cost, case.start, case.goal, method="astar", corner_cutting=case.corner_cutting
    )
    bands = (cost[row : row + rows_per_band] for row in range(0, len(cost), rows_per_band))
    assert connected(bands, (case.start, case.goal), corner_cutting=case.corner_cutting) == plan.ok


def test_reading_ends_when_all_is_known():
    cost = flat(41, 41, 0.5)
    given_out = []
    cost[6] = np.inf

    def bands():
        for row in range(0, 41, 5):
            given_out.append(row)
            yield cost[row : row + 5]

    assert not connected(bands(), ((0, 0), (40, 40)))
    assert len(given_out) == 2


def test_a_corridor_without_a_path_is_widened_and_then_it_is_told_whether_there_is_one():
    heights = flat(300, 300)
    heights[150] = np.nan
    planner = WindowedPlanner(ArrayWindows(heights), LIMITS)
    plan = planner.plan((10, 10), (290, 290))
    assert (plan.status, plan.source, len(plan.path)) == (Status.NO_PATH, Source.WIDENED, 0)
    assert plan.lower_bound == 0.0 and plan.reason == "no path exists on the known map"
    # two ways into one coarse cell, of which it keeps the larger, and that leads nowhere
    heights[148:152] = np.nan
    heights[148:152, 100] = heights[148:151, 102:104] = 0.0
    planner = WindowedPlanner(ArrayWindows(heights))
    plan = planner.plan((10, 10), (290, 290))
    exact = Planner(traversability_cost(heights, 1.0, cell_width_m=1.5, warn=False)).plan(
        (10, 10), (290, 290), method="corridor"
    )
    assert exact.source is Source.FALLBACK and exact.ok
    assert plan.status is Status.UNKNOWN and "there is a path" in plan.reason


def test_ends_that_are_none_and_corridors_that_do_not_fit_are_refused_before_more_is_read(
    monkeypatch,
):
    heights = flat(300, 300)
    heights[20:23, 20:23] = np.nan
    source = ArrayWindows(heights)
    planner = WindowedPlanner(source)
    for start, goal, status in (
        ((300, 0), (1, 1), Status.START_OUTSIDE_MAP),
        ((1, 1), (21, 21), Status.GOAL_BLOCKED),
        ((0, 0), (0, 0), Status.OK),
    ):
        assert planner.plan(start, goal).status is status
    assert planner.any_passable
    assert not WindowedPlanner(ArrayWindows(flat(9, 9, np.nan))).any_passable
    monkeypatch.setattr(windowed, "available_bytes", lambda: 100_000)
    before = len(source.read_parts)
    with pytest.raises(
        InvalidMapError, match=r"cells under the corridor, got 0.00 GB: plan in several legs"
    ):
        planner.plan((10, 10), (290, 290))
    assert len(source.read_parts) <= before + 2  # start and goal


@pytest.mark.usefixtures("small_bands")
def test_plans_are_those_of_the_corridor_planner_in_memory():
    sources = Counter()
    for seed, (corner_cutting, block) in enumerate(
        ((True, (16, 16)), (False, (1, 300)), (True, (512, 512)))
    ):
        rng = np.random.default_rng(seed)
        heights = synthetic_terrain(rng, 300, 2.0)[
            : rng.integers(200, 300), : rng.integers(200, 300)
        ]
        heights[rng.random(heights.shape) < 0.02] = np.nan
        heights[heights.shape[0] // 2, : heights.shape[1] // 3] = np.nan
        cost = cost_of(heights)
        planner = Planner(cost, corner_cutting=corner_cutting)
        by_windows = WindowedPlanner(
            ArrayWindows(heights, block), LIMITS, corner_cutting=corner_cutting
        )
        passable = np.argwhere(np.isfinite(cost))
        for _ in range(5):
            start, goal = (
                tuple(each.tolist()) for each in passable[rng.integers(len(passable), size=2)]
            )
            epsilon = rng.choice([math.inf, 0.3])
            wanted = planner.plan(start, goal, method="corridor", epsilon=epsilon)
            plan = by_windows.plan(start, goal, epsilon=epsilon)
            sources[wanted.source] += 1
            if wanted.source is Source.FALLBACK:
                no_path = Status.UNKNOWN if wanted.ok else Status.NO_PATH
                assert plan.status is no_path or (
                    plan.ok and plan.lower_bound <= wanted.cost * (1 + 1e-6)
                )
                continue
            for name in ("status", "cost", "source", "lower_bound", "expansions"):
                assert getattr(plan, name) == getattr(wanted, name)
            np.testing.assert_array_equal(plan.path, wanted.path)
        assert by_windows.read_again > 0.0
    assert sources[Source.REGION]
