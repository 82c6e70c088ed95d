"""What is told of obstacles comes before what heights say, or do not say."""

import numpy as np

from nnpp_edge.runtime import Planner, Vehicle
from tests.strategies import flat


def test_ground_that_a_body_may_pass_unknown_is_shut_where_told():
    heights = flat(40, 40)
    heights[20] = np.nan
    body = Vehicle(length_m=1.4, width_m=1.0, clearance_m=0.3, unknown_passes=True)
    planner = Planner.of_elevation(heights, 0.5, vehicle=body)
    assert planner.plan((5, 5), (34, 34)).ok
    planner.update(20, 0, np.ones((1, 40)))
    assert planner.plan((5, 5), (34, 34)).status == "NO_PATH"
    left = np.arange(40)[None] < 20
    planner.update(10, 0, np.ones((1, 40)), seen=left)
    assert ((planner.state.cost()[10] == np.inf) == left).all()
    planner.update(20, 0, np.zeros((1, 40)))
    assert planner.plan((5, 5), (34, 34)).ok
