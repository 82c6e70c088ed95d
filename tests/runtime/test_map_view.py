"""What a network is shown: a map, or a window of it, and start and goal."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nnpp_edge.runtime import DynamicPlanner, NetworkModel, Planner
from nnpp_edge.runtime.kernels.encoding import fill_ends
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.network.encoding import Frame, encode_gaussian, map_planes
from nnpp_edge.runtime.region.map_view import MapView
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.runtime.tuning import UNSEEN_CHANGE
from tests.strategies import flat, state_of, uniform


def planes_of(cost, size, parts=None, out=None):
    grid = Grid.of(cost, StepModel.of("paper"))
    out = np.full((2, size, size), -1, np.float32) if out is None else out
    map_planes(grid, Frame(*cost.shape, size), out, parts)
    return out


def test_a_map_is_averaged_and_its_rest_is_shown_impassable():
    cost = uniform(0, (64, 128))
    cost[10:13, 20:22] = np.nan
    blocked = np.isnan(cost)
    seen = np.array((np.where(blocked, 1, cost), blocked))
    for size, side in ((32, 4), (128, 1)):
        planes = planes_of(cost, size)
        rows = 64 // side
        means = seen.reshape(2, rows, side, size, side).mean((2, 4))
        np.testing.assert_allclose(planes[0, :rows], means[0], atol=1e-6)
        assert np.array_equal(planes[1, :rows], means[1])
        assert (planes[:, rows:] == 1).all()
    # two and three columns to a cell
    np.testing.assert_allclose(planes_of(flat(100, 100, 0.5), 64)[0], 0.5)


@given(st.integers(1, 2000), st.integers(1, 2000), st.sampled_from([(64, 16), (256, 64)]))
def test_every_cell_has_a_block_and_neighbours_have_neighbouring_ones(rows, cols, sizes):
    size, blocks = sizes
    frame = Frame(rows, cols, size)
    for lookup, cells, inner in zip(frame.lookup(blocks), (rows, cols), frame.inner, strict=True):
        assert (
            lookup.dtype == np.int32
            and lookup[0] >= 0
            and lookup[-1] < blocks
            and (np.diff(lookup) >= 0).all()
        )
        if cells >= blocks:
            assert np.diff(lookup).max(initial=0) <= 1
        assert lookup[-1] <= (inner - 1) * blocks // size


def test_the_gaussian_is_equation_5_with_a_peak_of_one():
    out = np.empty((2, 64, 64), np.float32)
    encode_gaussian((10.0, 20.0), (50.0, 3.0), 16.0, out)
    i, j = np.mgrid[:64, :64]
    for plane, (r, c) in zip(out, ((10, 20), (50, 3)), strict=True):
        np.testing.assert_allclose(
            plane, np.exp(-((i - r) ** 2 + (j - c) ** 2) / (2 * 16**2)), atol=1e-6
        )


@given(st.floats(0.0, 63.0), st.floats(0.0, 63.0), st.floats(0.0, 63.0), st.floats(0.0, 63.0))
def test_an_end_is_read_off_the_points_and_the_way_leads_there(row_a, col_a, row_b, col_b):
    out = np.empty((15, 8, 8), np.float32)
    fill_ends(out, row_a, col_a, row_b, col_b, 8.0, 16.0)
    centres = 8.0 * np.arange(8) + 3.5
    for planes, row, col in ((out[:6], row_a, col_a), (out[6:12], row_b, col_b)):
        share = planes[0].astype(float)
        assert share.min() >= 0.0
        assert share.sum() == pytest.approx(1.0, abs=1e-5)
        inside = np.clip(
            (row, col), 3.5, 59.5
        )  # what lies beyond the outermost points is read off them
        assert ((share.sum(1) * centres).sum(), (share.sum(0) * centres).sum()) == pytest.approx(
            inside, abs=1e-3
        )
        down = row - centres[:, None]
        right = col - centres
        apart = np.hypot(down, right)
        wanted = (down + 0 * right, right + 0 * down, apart)
        np.testing.assert_allclose(planes[1:4], np.array(wanted) / 64.0, atol=1e-6)
        np.testing.assert_allclose(planes[4], np.exp(-(apart**2) / (2 * 16.0**2)), atol=1e-6)
        np.testing.assert_allclose(planes[5], np.exp(-(apart**2) / (2 * 4.0**2)), atol=1e-6)
    length = np.hypot(row_a - row_b, col_a - col_b)
    np.testing.assert_allclose(out[14], max(length, 8.0) / 64.0, atol=1e-6)
    back = np.empty_like(out)
    fill_ends(back, row_b, col_b, row_a, col_a, 8.0, 16.0)
    np.testing.assert_allclose(back, out[[*range(6, 12), *range(6), 12, 13, 14]], atol=1e-6)


def test_a_place_is_the_centre_of_the_map_cell():
    frame = Frame(512, 256, 256)
    assert frame.inner == (256, 128)
    assert frame.place((0, 0)) == pytest.approx((-0.25, -0.25))
    assert frame.place((511, 255)) == pytest.approx((255.25, 127.25))


def holds(window, *cells):
    """Whether a window holds all of these cells."""
    row, col, rows, cols = window
    return all(row <= r < row + rows and col <= c < col + cols for r, c in cells)


@pytest.mark.parametrize(
    ("shape", "edge"), [((700, 900), False), ((1024, 300), True), ((90, 1500), False)]
)
def test_near_ends_on_a_large_map_are_planned_in_a_window(network, shape, edge):
    network = NetworkModel("edge") if edge else network
    rng = np.random.default_rng(2)
    cost = rng.random(shape).astype(np.float32) * 0.9
    planner = Planner(cost, model=network, ask_from=0)
    view = MapView(planner.state, network)
    for _ in range(8):
        start = tuple(int(rng.integers(0, side)) for side in shape)
        goal = tuple(
            int(np.clip(x + rng.integers(-60, 61), 0, side - 1))
            for x, side in zip(start, shape, strict=True)
        )
        planner.update(0, 0, flat(3, 4, rng.random() * 0.9))
        plan = planner.plan(start, goal, method="nnpp", keep_regions=True)
        assert plan.ok
        view.show(start, goal)
        row, col, rows, cols = view.window
        assert max(rows, cols) <= 0.6 * max(shape)
        assert holds(view.window, start, goal)
        region = plan.network_region.mask()
        assert region[start] and region[goal]
        region[row : row + rows, col : col + cols] = False
        assert not region.any()
        assert plan.cost >= planner.plan(start, goal, method="astar").cost * (1 - 1e-5)
    far = (1, 1), (shape[0] - 2, shape[1] - 2)
    assert planner.plan(*far, method="nnpp").ok
    view.show(*far)
    assert view.window == (0, 0, *shape)


def watched_network():
    """The shipped network, of a class that counts how often one of its networks is shown a map."""

    class Watched(NetworkModel):
        shown = 0

        def set_map(self, planes):
            type(self).shown += 1
            super().set_map(planes)

    return Watched("edge")


def test_a_network_in_two_parts_is_shown_the_map_again_once_enough_has_changed():
    cost = uniform(4, (256, 256), 0.0, 0.4)
    dynamic = watched_network()
    static = watched_network()
    planners = DynamicPlanner(cost, (240, 240), "nnpp", model=dynamic), Planner(cost, model=static)
    seen = []
    for row, side, to in (
        (None, 0, 0),
        (100, 4, 0.9),
        (110, 16, 0.9),
        (20, 120, 0.9),
        (20, 120, 0.9),
        (20, 120, 0.8999),
    ):
        if row is not None:
            patch = flat(side, side, to)
            for planner in planners:
                planner.update(row, row, patch)
        planners[0].move((10, 10))
        assert planners[0].replan().ok
        assert planners[1].plan((10, 10), (240, 240), method="nnpp").ok
        seen.append((type(dynamic).shown, type(static).shown))
    assert [shown for shown, _ in seen] == [1, 1, 1, 2, 2, 2]
    assert [shown for _, shown in seen] == [
        1,
        2,
        3,
        4,
        4,
        5,
    ]  # the last patches say nothing, or next to nothing


@pytest.mark.parametrize("step_cost", ["paper", "length"])
def test_a_change_outside_its_window_is_not_shown_to_a_network_and_one_inside_is_shown_where_it_is(
    step_cost,
):
    rng = np.random.default_rng(5)
    cost = rng.random((700, 700)).astype(np.float32) * 0.8
    network = watched_network()
    ends = ((220, 120), (260, 160))
    cost += np.float32(0.01)
    state = state_of(cost, step_cost)
    view = MapView(state, network)
    view.show(*ends)
    for row, most, inside in (
        (600, 0.8, False),
        (270, 0.8, True),
        (210, 0.8, True),
        (10, 0.8, False),
        (10, 0.99, False),
    ):
        before = type(network).shown
        patch = rng.random((20, 30)).astype(np.float32) * most
        patch += np.float32(0.01) * (most < 0.9)
        patch[0, 0] = max(patch[0, 0], most)
        cost[row : row + 20, 150:180] = patch
        state.update(row, 150, patch)
        view.show(*ends)
        new = MapView(state_of(cost, step_cost), NetworkModel("edge"))
        new.show(*ends)
        rescaled = (
            step_cost == "length" and most > 0.9
        )  # all costs are shown relative to the greatest
        assert type(network).shown == before + (inside or rescaled)
        assert view.window == new.window
        np.testing.assert_allclose(view.planes, new.planes, atol=1e-6)


def test_how_much_has_changed_counts_by_the_window_not_by_the_map():
    network = watched_network()
    cost = uniform(7, (1400, 1400), 0.0, 0.3)
    state = state_of(cost)
    view = MapView(state, network, UNSEEN_CHANGE)
    ends = ((220, 120), (260, 160))
    view.show(*ends)
    side = view.window[2] // 2
    assert side**2 < 0.5 * UNSEEN_CHANGE * cost.size
    state.update(view.window[0], view.window[1], np.full((side, side), 0.99, np.float32))
    before = type(network).shown
    view.show(*ends)
    assert type(network).shown == before + 1


def test_small_changes_add_up_until_the_network_is_shown_the_map_again():
    network = watched_network()
    state = state_of(uniform(7, (256, 256), 0.0, 0.3))
    view = MapView(state, network, UNSEEN_CHANGE)
    shown = []
    for row in range(0, 200, 40):  # each changes the planes by 0.6 %
        state.update(row, 20, flat(31, 32, 0.99))
        view.show((10, 10), (240, 240))
        shown.append(type(network).shown)
    assert shown == [1, 1, 1, 1, 2]


def test_a_robot_on_its_way_keeps_its_window_while_that_serves():
    shape = (300, 1300)
    rng = np.random.default_rng(6)
    model = NetworkModel("edge")
    goal = tuple(x - 20 for x in shape)
    planner = DynamicPlanner(
        (rng.random(shape) * 0.5).astype(np.float32), goal, "nnpp", model=model
    )
    planner.prepare()
    view = MapView(planner.state, model, UNSEEN_CHANGE)
    windows = []
    start = (8, 9)
    for step in range(40):
        planner.move(start)
        plan = planner.replan()
        assert plan.ok
        view.show(start, goal)
        assert holds(view.window, start, goal)
        apart = max(abs(a - b) for a, b in zip(start, goal, strict=True))
        assert max(view.window[2:]) <= max(4 * (2 * apart + 64), 256)
        windows.append(view.window)
        if len(plan.path) <= 32:
            break
        start = tuple(int(x) for x in plan.path[30])
        planner.update(*(int(x) for x in plan.path[-20]), flat(3, 3, rng.random() * 0.9))
    assert windows[0] == (0, 0, *shape)
    changes = sum(a != b for a, b in itertools.pairwise(windows))
    assert 1 <= changes <= 4 < step
