"""The loop's map keeps apart what heights say and what was told, and is the map that `plan` would
have.
"""

import pickle

import numpy as np
import pytest

from nnpp_edge.runtime import (
    DynamicPlanner,
    Goal,
    Ground,
    MapPatch,
    Navigator,
    Planner,
    Pose,
    Status,
    Traversability,
    Vehicle,
    pose_costs,
)
from nnpp_edge.runtime.planners.methods import Methods
from tests.strategies import flat

CELL_M = 0.5
SIDE = 40
BODY = Vehicle(length_m=1.4, width_m=1.0, clearance_m=0.3)
DISC = Vehicle(radius_m=0.7)
VEHICLES = {"point": None, "disc": DISC, "body": BODY}
LIMITS = Traversability(hard_slope_deg=20.0)
FLAT = flat(SIDE, SIDE)
WALL = np.ones((1, SIDE))
ENDS = ((5, 5), (34, 34))


def rough(seed):
    """Gentle ground with ridges that are too steep."""
    rng = np.random.default_rng(seed)
    heights = np.cumsum(rng.normal(0.0, 0.015, (SIDE, SIDE)), axis=1)
    for _ in range(10):
        row, col = rng.integers(0, SIDE - 8, 2).tolist()
        rows, cols = ((1, 8), (8, 1))[int(rng.integers(2))]
        heights[row : row + rows, col : col + cols] += 0.6
    return heights.astype(np.float32)


def loop(heights, vehicle, method="auto", **step):
    ground = Ground.of_elevation(heights, CELL_M, LIMITS, vehicle=vehicle, **step)
    nav = Navigator(ground, method, tolerance=1e-4, snap_radius=0)
    nav.offer(Pose(*ENDS[0]))
    nav.offer(Goal(*ENDS[1]))
    return nav


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)
def test_what_was_told_outlives_copies_and_interrupts(vehicle, monkeypatch):
    planner = Planner.of_elevation(FLAT, CELL_M, LIMITS, vehicle=vehicle)
    planner.update(20, 0, WALL)
    copy = pickle.loads(pickle.dumps(planner))
    moving = DynamicPlanner.of_elevation(rough(3), CELL_M, ENDS[1], LIMITS, "astar")
    moving.move(ENDS[0])
    before = moving.replan()

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Methods, "search_map", interrupted)
        for call in (lambda: planner.plan(*ENDS, method="astar"), moving.replan):
            with pytest.raises(KeyboardInterrupt):
                call()
    for one in (copy, planner):
        assert one.plan(*ENDS).status is Status.NO_PATH
        one.update(20, 0, 0.0 * WALL)
        assert one.plan(*ENDS).ok
    standing = (
        moving.standing()
    )  # what is computed anew after it is computed before it is walked on
    assert standing.valid and standing.cost == pytest.approx(before.cost)


def test_steps_follow_heights_whose_weights_stay():
    heights = rough(4)
    planner = Planner.of_elevation(heights, CELL_M, step_cost="tobler", omega=0.0)
    heights[10:20, 10:20] += np.linspace(0.0, 2.0, 10, dtype=np.float32)
    planner.update_elevation(10, 10, heights[10:20, 10:20])
    fresh = Planner.of_elevation(heights, CELL_M, step_cost="tobler", omega=0.0)
    plans = [each.plan((15, 2), (15, 38), method="astar") for each in (planner, fresh)]
    assert plans[0].cost == pytest.approx(plans[1].cost, rel=1e-6)


def test_ground_that_a_body_may_pass_unknown_is_shut_where_told():
    """What is told comes before what is not known, also where unknown ground may be driven on."""
    heights = flat(SIDE, SIDE)
    heights[20] = np.nan
    body = Vehicle(length_m=1.4, width_m=1.0, clearance_m=0.3, unknown_passes=True)
    nav = loop(heights, body)
    assert nav.tick().ok
    nav.offer(MapPatch(20, 0, cost=np.ones((1, SIDE))))
    assert nav.tick().outcome is Status.NO_PATH
    assert np.isinf(
        pose_costs(np.where(np.arange(SIDE)[:, None] == 20, np.nan, heights), CELL_M, BODY)[:, 20]
    ).all()
