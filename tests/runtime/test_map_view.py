import itertools

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, NetworkModel, Planner
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.runtime.region.map_view import MapView
from nnpp_edge.runtime.tuning import UNSEEN_CHANGE


def holds(window, *cells):
    """Whether a window holds all of these cells."""
    row, col, rows, cols = window
    return all(row <= r < row + rows and col <= c < col + cols for r, c in cells)


@pytest.mark.parametrize(("shape", "edge"), [((700, 900), False), ((1024, 300), True), ((90, 1500), False)])
def test_near_ends_on_a_large_map_are_planned_in_a_window(network, shape, edge):
    network = NetworkModel("edge") if edge else network
    rng = np.random.default_rng(2)
    cost = rng.random(shape).astype(np.float32) * 0.9
    planner = Planner(cost, model=network, ask_from=0)
    view = MapView(planner.state, network)
    for _ in range(8):
        start = tuple(int(rng.integers(0, side)) for side in shape)
        goal = tuple(
            int(np.clip(x + rng.integers(-60, 61), 0, side - 1)) for x, side in zip(start, shape, strict=True)
        )
        planner.update(0, 0, np.full((3, 4), rng.random() * 0.9, np.float32))
        plan = planner.plan(start, goal, method="nnpp", keep_regions=True)
        assert plan.ok
        view.show(start, goal)
        row, col, rows, cols = view.window
        assert max(rows, cols) <= 0.6 * max(shape)
        assert holds(view.window, start, goal)
        region = plan.network_region.mask()
        assert region[start]
        assert region[goal]
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
    rng = np.random.default_rng(4)
    cost = (rng.random((256, 256)) * 0.4).astype(np.float32)
    dynamic, static = watched_network(), watched_network()
    planners = DynamicPlanner(cost, (240, 240), "nnpp", model=dynamic), Planner(cost, model=static)
    seen = []
    for row, side in ((None, 0), (100, 4), (110, 16), (20, 120), (20, 120)):
        if row is not None:
            patch = np.full((side, side), 0.9, np.float32)
            for planner in planners:
                planner.update(row, row, patch)
        planners[0].move((10, 10))
        assert planners[0].replan().ok
        assert planners[1].plan((10, 10), (240, 240), method="nnpp").ok
        seen.append((type(dynamic).shown, type(static).shown))
    assert [shown for shown, _ in seen] == [1, 1, 1, 2, 2]
    assert [shown for _, shown in seen] == [1, 2, 3, 4, 4]  # the last patch says nothing new


def test_a_change_outside_its_window_is_not_shown_to_a_network():
    cost = np.random.default_rng(5).random((700, 700)).astype(np.float32) * 0.9
    network, state, ends = watched_network(), map_state(Ground(cost)), ((20, 20), (60, 60))
    view = MapView(state, network)
    view.show(*ends)
    before = type(network).shown
    state.update(600, 600, np.full((20, 20), 0.5))
    view.show(*ends)
    assert type(network).shown == before
    state.update(70, 70, np.full((20, 20), 0.5))
    view.show(*ends)
    assert type(network).shown == before + 1


def test_a_robot_on_its_way_keeps_its_window_while_that_serves():
    shape = (300, 1300)
    rng, model = np.random.default_rng(6), NetworkModel("edge")
    goal = tuple(x - 20 for x in shape)
    planner = DynamicPlanner((rng.random(shape) * 0.5).astype(np.float32), goal, "nnpp", model=model)
    planner.prepare()
    view, windows, start = MapView(planner.state, model, UNSEEN_CHANGE), [], (8, 9)
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
        planner.update(*(int(x) for x in plan.path[-20]), np.full((3, 3), rng.random() * 0.9, np.float32))
    assert windows[0] == (0, 0, *shape)
    changes = sum(a != b for a, b in itertools.pairwise(windows))
    assert 1 <= changes <= 4 < step
