import numpy as np
import pytest

from nnpp_edge.reproduction.planners import OneMap
from nnpp_edge.reproduction.regions import (
    BAND,
    CONTROLS,
    CORRIDOR,
    NETWORK,
    Networks,
    PaperRegions,
    all_regions,
)
from nnpp_edge.reproduction.rows import Rows
from nnpp_edge.runtime import NetworkModel

QUERY = ((5, 8), (118, 110))


@pytest.fixture
def cost():
    return np.random.default_rng(3).uniform(0.0, 0.8, (128, 128)).astype(np.float32)


def joined(blocks, maker):
    """Whether blocks that touch join start and goal."""
    ends = [(maker.lookup[0][row], maker.lookup[1][col]) for row, col in QUERY]
    reached = set()
    waiting = [ends[0]] if blocks[ends[0]] else []
    while waiting:
        row, col = waiting.pop()
        if (
            (row, col) in reached
            or not (0 <= row < len(blocks) and 0 <= col < len(blocks))
            or not blocks[row, col]
        ):
            continue
        reached.add((row, col))
        waiting += [(row + i, col + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return ends[1] in reached


def test_the_papers_region_is_all_at_a_factor_of_the_greatest_threshold_that_joins_start_and_goal(
    tiny_model, cost
):
    maker = PaperRegions(cost, NetworkModel(tiny_model))
    region = maker.find(QUERY)
    levels = maker.finder.levels.astype(int)
    td = max(level for level in range(256) if joined(levels >= level, maker))
    assert maker.inference_s > 0.0
    assert td > 0 and (region.blocks()[:-1, :-1] == (levels >= int(td * 0.5**0.25))).all()
    assert (region.blocks()[:-1, :-1] > (levels >= td)).any()


def test_controls_are_as_large_as_the_networks_region_and_join_start_and_goal(tiny_model, cost):
    model = NetworkModel(tiny_model)
    maker = PaperRegions(cost, model)
    regions = all_regions(maker, QUERY)
    assert set(regions) == {NETWORK, *CONTROLS}
    for name in (CORRIDOR, BAND):
        assert regions[name].area() == regions[NETWORK].area()
        assert joined(regions[name].blocks()[:-1, :-1], maker)
    here = OneMap(cost, QUERY, Networks(model, model))
    found = here.searched({kind: kind for kind in regions})
    assert all(row["found"] and row["excess"] >= -1e-6 for row in found)


def test_the_corridor_goes_round_what_the_straight_band_runs_into(tiny_model):
    cost = np.full((128, 128), 0.1, np.float32)
    cost[48:80, :112] = 1.0
    model = NetworkModel(tiny_model)
    here = OneMap(cost, ((10, 20), (118, 20)), Networks(model, model))
    found = Rows(here.searched({CORRIDOR: CORRIDOR, BAND: BAND}))
    assert found.of(CORRIDOR).all("found") == [1.0] and found.of(BAND).all("found") == [0.0]
    assert np.isnan(found.increase(BAND)) and found.increase(CORRIDOR) >= 0.0
