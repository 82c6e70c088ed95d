"""What `nnpp` does with a vehicle: by the network's prices in its range, else by another, which is said."""

import shutil
import warnings

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Planner, Vehicle
from nnpp_edge.runtime.errors import InvalidMapError, ModelError
from nnpp_edge.runtime.network import passage_model
from nnpp_edge.runtime.network.model_file import model_path
from nnpp_edge.runtime.planners import map_planners
from nnpp_edge.terrain.synthetic import fractal

CELL_M = 0.25
ROVER = Vehicle(1.5, 1.2, 0.3)
ENDS = (20, 20), (76, 70)


@pytest.fixture(autouse=True)
def nothing_said():
    """Each test is warned anew."""
    map_planners.warn_once.cache_clear()


def planner(cell_m=CELL_M, **options):
    heights = fractal(np.random.default_rng(0), 96, cell_m, 2.0 * cell_m)
    return Planner.of_elevation(heights, cell_m, vehicle=ROVER, warn=False, **options)


def test_nnpp_goes_by_the_networks_prices_and_the_corridor_by_eq1():
    for method, price in (("nnpp", "network"), ("corridor", "eq1")):
        usual, named = planner().plan(*ENDS, method=method), planner().plan(*ENDS, method="corridor", price=price)
        assert usual.ok and usual.method == method
        np.testing.assert_array_equal(usual.path, named.path)
        assert usual.checks == named.checks > 0
        assert ("look" in usual.timings_ms) == (price == "network")


def test_a_network_that_was_loaded_has_seen_the_map():
    planner().plan(*ENDS, method="nnpp")  # kernels are loaded
    loaded = planner()
    loaded.load_network()
    assert (
        loaded.plan(*ENDS, method="nnpp").timings_ms["look"] < planner().plan(*ENDS, method="nnpp").timings_ms["look"]
    )


def test_outside_the_networks_range_another_price_is_taken_which_is_said_once():
    with pytest.warns(
        UserWarning, match="nnpp goes by the price eq1: the network is for vehicles whose length in cells"
    ):
        plan = planner(0.1).plan(*ENDS, method="nnpp")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = planner(0.1).plan(*ENDS, method="nnpp")
        named = planner(0.1).plan(*ENDS, method="corridor")
    assert "length in cells" in plan.choice and "length in cells" in again.choice
    np.testing.assert_array_equal(plan.path, named.path)
    with pytest.raises(
        InvalidMapError, match=r"price='network' is for vehicles whose length in cells lies in \[3, 8\]"
    ):
        planner(0.1).plan(*ENDS, method="nnpp", price="network")


def test_without_the_shipped_file_another_price_is_taken_and_one_that_was_named_is_missed(monkeypatch, tmp_path):
    def missing(model):
        raise ModelError(f"{model} is not there")

    monkeypatch.setattr(passage_model, "model_path", missing)
    passage_model.passage_model.cache_clear()
    with pytest.warns(UserWarning, match="passage is not there"):
        assert planner().plan(*ENDS, method="nnpp").ok
    for model, price in (("edge", "network"), ("mine.onnx", None)):
        with pytest.raises(ModelError, match="is not there"):
            planner(model=model).plan(*ENDS, method="nnpp", price=price)


def test_ones_own_network_is_asked_and_one_of_another_kind_refused(tmp_path):
    own = tmp_path / "own.onnx"
    shutil.copy(model_path("passage"), own)
    one, other = (planner(model=model).plan(*ENDS, method="nnpp") for model in (own, "edge"))
    np.testing.assert_array_equal(one.path, other.path)
    with pytest.raises(ModelError, match="wanted a passage network"):
        planner(model="paper").plan(*ENDS, method="nnpp")


def test_a_network_may_take_anothers_place_and_a_bad_one_does_not(tmp_path):
    own, broken = tmp_path / "own.onnx", tmp_path / "broken.onnx"
    shutil.copy(model_path("passage"), own)
    broken.write_bytes(b"no model")
    asked = planner()
    before = asked.plan(*ENDS, method="nnpp")
    for bad in ("paper", broken):
        with pytest.raises(ModelError):
            asked.use_model(bad)
    asked.use_model(own)
    after = asked.plan(*ENDS, method="nnpp")
    np.testing.assert_array_equal(before.path, after.path)
    assert after.timings_ms["look"] > 0.0


@pytest.mark.parametrize("method", ["nnpp", "nnpp-dstar"])
def test_on_a_map_that_changes_the_network_prices_what_there_is_now(method):
    heights = fractal(np.random.default_rng(0), 96, CELL_M, 2.0 * CELL_M)
    changing = DynamicPlanner.of_elevation(heights, CELL_M, ENDS[1], method=method, vehicle=ROVER)
    changing.prepare()
    changing.move(ENDS[0])
    first = changing.replan()
    row, col = first.path[len(first.path) // 2]
    patch = heights[row - 4 : row + 5, col - 4 : col + 5] + np.float32(0.8)
    changing.update_elevation(int(row) - 4, int(col) - 4, patch)
    heights[row - 4 : row + 5, col - 4 : col + 5] = patch
    after = changing.replan()
    fresh = Planner.of_elevation(heights, CELL_M, vehicle=ROVER, warn=False).plan(*ENDS, method="nnpp")
    assert after.planner == method and "look" in after.timings_ms
    assert after.cost == pytest.approx(fresh.cost, rel=1e-5) and not np.array_equal(after.path, first.path)
