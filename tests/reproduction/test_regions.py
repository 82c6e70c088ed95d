"""The network's region by the paper's rule, and its controls."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from nnpp_edge.calibrate.quantize import answers
from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction.planners import WHOLE_MAP, OneMap
from nnpp_edge.reproduction.regions import BAND, CONTROLS, CORRIDOR, NETWORK
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.training.validation import Validator
from tests.strategies import uniform

QUERY = ((5, 8), (118, 110))


@pytest.fixture
def here(tiny_networks):
    cost = uniform(3, (128, 128), 0.0, 0.8)
    return OneMap(cost, QUERY, tiny_networks)


def joined(blocks, here):
    """Whether blocks that touch join start and goal."""
    rows, cols = here.lookup
    _, pieces = cv2.connectedComponents(blocks.astype(np.uint8), connectivity=8)
    start, goal = (pieces[rows[row], cols[col]] for row, col in QUERY)
    return start == goal != 0


def test_the_papers_region_is_all_at_a_factor_of_the_greatest_threshold_that_joins_start_and_goal(
    here,
):
    region = here.region(NETWORK)
    levels = here.finder.levels.astype(int)
    td = max(level for level in range(256) if joined(levels >= level, here))
    assert td > 0
    blocks = region.blocks()[:-1, :-1]
    np.testing.assert_array_equal(blocks, levels >= int(td * 0.5**0.25))
    assert (blocks > (levels >= td)).any()


def test_controls_are_as_large_as_the_networks_region_and_join_start_and_goal(here):
    assert set(here.regions) == {NETWORK, *CONTROLS}
    for name in (CORRIDOR, BAND):
        assert here.regions[name].area() == here.regions[NETWORK].area()
        assert joined(here.regions[name].blocks(), here)
    for row in here.searched({kind: kind for kind in here.regions}):
        assert row["found"]
        assert row["gap"] >= -1e-6


def test_the_corridor_goes_round_what_the_straight_band_runs_into(tiny_networks):
    cost = uniform(3, (128, 128), 0.0, 0.2)
    cost[48:80, :112] = 1.0
    here = OneMap(cost, ((10, 20), (118, 20)), tiny_networks)
    found = here.searched({CORRIDOR: CORRIDOR, BAND: BAND})
    assert found.of(CORRIDOR).all("found") == [1.0]
    assert found.of(BAND).all("found") == [0.0]
    assert np.isnan(found.increase(BAND))
    assert found.increase(CORRIDOR) >= 0.0
    whole, corridor = here.plain((WHOLE_MAP, CORRIDOR), Harness()).all("gap")
    assert corridor > 0.001 > abs(whole)


def test_training_and_the_reproduction_say_the_same_of_the_same_queries(tiny_networks):
    """The case of a user: `train` and `quantize` each had another share of found queries."""
    rng = np.random.default_rng(4)
    side = tiny_networks.paper.metadata.input_size
    planes = rng.integers(20, 250, (3, 2, side, side), np.uint8)
    planes[:, 1] = 0
    ends = rng.integers(0, side, (2, 3, 2)).astype(np.float32)
    labels = np.zeros((3, 8, 8), np.uint8)
    samples = Samples(planes, np.arange(3, dtype=np.int32), *ends, labels, labels)
    model = tiny_networks.paper
    facts = model.metadata
    spec = SimpleNamespace(input_size=side, blocks=facts.blocks)
    validator = Validator(samples, spec, PAPER_OMEGA)
    judged = validator.judge_answers(answers(model, samples), facts.region_factor)
    rows = Rows()
    for at, (start, goal) in enumerate(ends.swapaxes(0, 1).astype(int).tolist()):
        cost = planes[at, 0].astype(np.float32) / 255.0
        here = OneMap(cost, (tuple(start), tuple(goal)), tiny_networks)
        rows += here.searched({NETWORK: NETWORK})
    assert rows.mean("found") == judged.success
    assert rows.mean("mm") == pytest.approx(judged.mm)
    assert rows.mean("gap") == pytest.approx(judged.gap, abs=1e-6)
