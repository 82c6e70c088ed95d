"""A vehicle's corridor goes by Eq. 1's means, and closes what its search did not get across."""

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner, Vehicle
from nnpp_edge.runtime.kernels.nodes import STAMP_SHIFT
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.coarse_to_fine import CoarseLevel
from nnpp_edge.runtime.planners.plan import Source
from nnpp_edge.runtime.search.workspace import Workspace

ROVER = Vehicle(length_m=1.5, width_m=1.2, clearance_m=0.05, max_step_m=0.04)
START, GOAL = (128, 20), (128, 236)


@pytest.fixture(scope="module")
def gaps():
    """A wall of rocks that a body cannot see through means: gaps too narrow for it in front, a wide one aside."""
    dem = np.zeros((256, 256), np.float32)
    dem[::4, 128] = 0.06  # a post in each block: cheap on average, and no body gets between two
    dem[20:44, 128] = 0.0
    return dem


def test_where_no_pose_passes_the_links_are_closed_and_the_next_region_leads_around(gaps, monkeypatch):
    closed = []
    close = CoarseLevel.close_dead_ends
    monkeypatch.setattr(
        CoarseLevel, "close_dead_ends", lambda self, *given: closed.append(close(self, *given)) or closed[-1]
    )
    planner = Planner.of_elevation(gaps, 0.25, vehicle=ROVER, warn=False)
    level = planner.state.pyramid.levels[1]
    exact = planner.plan(START, GOAL, method="astar")
    planner = Planner.of_elevation(gaps, 0.25, vehicle=ROVER, warn=False)
    plan = planner.plan(START, GOAL, method="corridor")
    assert exact.ok and plan.ok and plan.source in (Source.REGION, Source.WIDENED)
    assert any(closed) and plan.cost == pytest.approx(exact.cost, rel=0.01)
    whole = Planner.of_elevation(gaps, 0.25, vehicle=ROVER, warn=False, lazy=False).state.pyramid.levels[1]
    level = planner.state.pyramid.levels[1]
    planner.state.grid.tiles.complete()
    np.testing.assert_array_equal(level.links, whole.links)  # opened again


def test_a_search_that_mends_corrects_nothing(gaps):
    """What D* Lite reached is not in the memory by which dead ends are found."""
    planner = DynamicPlanner.of_elevation(gaps, 0.25, GOAL, method="corridor-dstar", vehicle=ROVER)
    planner.move(START)
    assert planner.replan().ok


def test_closed_links_are_opened_again_and_set_no_landmarks(gaps):
    state = Planner.of_elevation(gaps, 0.25, vehicle=ROVER, warn=False, lazy=False).state
    memory, coarse = Workspace(len(state.grid.weights)), CoarseLevel(state.pyramid.levels[1])
    links, stamp = coarse.level.links.copy(), memory.next_stamp()
    memory.meta[1 : memory.meta.size // 2 : 2] = stamp << STAMP_SHIFT  # the upper half was reached
    everywhere = np.ones((2 * coarse.grid.rows, 2 * coarse.grid.cols), np.int32)
    assert coarse.close_dead_ends(Region(everywhere, *state.pyramid.levels[0].quarters, 1), memory, state.shape)
    assert (coarse.level.links != links).any() and not (coarse.level.links & ~links).any()
    for _ in range(20):
        coarse.search((0, 0), (31, 63), None, beyond=0.0)
        coarse.invest()
    assert coarse.landmarks is None
    coarse.open_dead_ends()
    np.testing.assert_array_equal(coarse.level.links, links)
