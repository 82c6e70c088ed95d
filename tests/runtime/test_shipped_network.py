"""What the shipped network `edge` answers, on sample maps: bounds that a turned, mirrored or
clipped answer breaks.

Measured on 64 queries, in brackets for an answer turned by 180°, mirrored, and with the ranges of
int8 halved: probability along the optimal path 0.71 (0.03, 0.17, 0.67); share of the map in the
region 0.12 (0.88, 0.72, 0.11); share of the optimal path inside it 0.82 (0.91, 0.96, 0.76); mean
gap 0.29 % (0.77, 0.48, 0.64 %); mean difference from the file before quantisation 0.0012 (0.20,
0.16, 0.03).
"""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from nnpp_edge.runtime import NetworkModel, Plan, Planner, traversability_cost
from nnpp_edge.runtime.network.model_file import model_path
from nnpp_edge.runtime.region.map_view import MapView
from nnpp_edge.terrain.dem import sample_dem
from nnpp_edge.terrain.workloads import workload

MAPS = (("moon_highlands", 0), ("moon_highlands", 256), ("earth_hummocks", 0), ("mars_victoria", 0))
QUERIES = 8
"""A map and workload."""


class Answer(NamedTuple):
    """A query, answered."""

    probability: np.ndarray
    """(B, B) of `edge`."""
    unquantised: np.ndarray
    """(B, B) of the same network before quantisation."""
    blocks: tuple[np.ndarray, np.ndarray]
    """Rows and columns of the blocks that the optimal path lies in."""
    exact: Plan
    plan: Plan
    """By ``nnpp``."""


@pytest.fixture(scope="module")
def answers():
    rng = np.random.default_rng(1)
    found = []
    networks = NetworkModel("edge"), NetworkModel(model_path("edge").with_name("edge-fp32.onnx"))
    for name, corner in MAPS:
        dem = sample_dem(name)
        heights = dem.elevation[corner : corner + 256, corner : corner + 256]
        for limits in ("soft", "limit20"):
            cost = traversability_cost(heights, dem.cell_size_m, workload(limits), warn=False)
            planner = Planner(cost, model=networks[0], ask_from=0)
            views = [MapView(planner.state, network) for network in networks]
            passable = np.argwhere(cost < 1.0)
            wanted = len(found) + QUERIES
            while len(found) < wanted:
                start, goal = (
                    tuple(passable[at].tolist()) for at in rng.integers(len(passable), size=2)
                )
                exact = planner.plan(start, goal, method="astar")
                if max(abs(start[0] - goal[0]), abs(start[1] - goal[1])) < 80 or not exact.ok:
                    continue
                ours, before = (
                    view.network.answer(*view.show(start, goal)).copy() for view in views
                )
                blocks = tuple(
                    lookup[at] for lookup, at in zip(views[0].lookup, exact.path.T, strict=True)
                )
                plan = planner.plan(start, goal, method="nnpp", keep_regions=True)
                found.append(Answer(ours, before, blocks, exact, plan))
    return found


def test_probable_is_where_the_optimal_path_lies(answers):
    def along(turned):
        return np.array([turned(each.probability)[each.blocks].mean() for each in answers])

    ours = along(lambda p: p)
    assert ours.mean() > 0.62
    for turned in (lambda p: p[::-1, ::-1], lambda p: p[:, ::-1], lambda p: p[::-1], lambda p: p.T):
        control = along(turned)
        assert control.mean() < 0.5 * ours.mean() and (control < ours).mean() > 0.9


def test_the_first_region_is_small_and_holds_most_of_the_optimal_path(answers):
    regions = [each.plan.network_region.mask() for each in answers]
    assert np.mean([mask.mean() for mask in regions]) < 0.25
    inside = [
        mask[tuple(each.exact.path.T)].mean() for mask, each in zip(regions, answers, strict=True)
    ]
    assert np.mean(inside) > 0.79
    gaps = [each.plan.cost / each.exact.cost - 1.0 for each in answers]
    assert np.mean(gaps) < 0.0045 and max(gaps) < 0.08


def test_int8_answers_as_the_network_did_before(answers):
    shipped = NetworkModel("edge")
    assert shipped.metadata.precision == "int8" and shipped.path.stat().st_size <= 3e6
    apart = [np.abs(each.probability - each.unquantised) for each in answers]
    assert np.mean(apart) < 0.005 and np.max(apart) < 0.25
    assert (
        min(
            np.corrcoef(each.probability.ravel(), each.unquantised.ravel())[0, 1]
            for each in answers
        )
        > 0.99
    )


def test_an_encoder_runs_once_for_each_map():
    model = NetworkModel("edge")
    runs = []
    run = model.session.run_with_iobinding
    model.session = SimpleNamespace(run_with_iobinding=lambda *words: runs.append(run(*words)))
    for maps in (1, 2):
        model.set_map(np.full((2, 64, 64), 0.2 * maps, np.float32))
        for goal in ((3.0, 60.0), (50.0, 9.5)):
            answer = model.answer((1.0, 2.0), goal).copy()
        assert len(runs) == 2 * maps - 1
        np.testing.assert_array_equal(model.answer((1.0, 2.0), goal, anew=True), answer)
        assert len(runs) == 2 * maps
