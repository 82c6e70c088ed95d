"""Maps known by their blocks: the data set, its targets, and a network from it to int8."""

import numpy as np
import pytest

from nnpp_edge.export.to_onnx import export_network, parity
from nnpp_edge.model.registry import Spec
from nnpp_edge.profiling.int8 import quantize
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost
from nnpp_edge.terrain.dataset import make_dataset, read_known, read_samples
from nnpp_edge.terrain.known import CERTAIN, known_map
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.training.checkpoint import load_checkpoint
from nnpp_edge.training.settings import TrainSettings
from nnpp_edge.training.train import train

SMALL = Spec("unseen", input_size=32, options={"widths": (8, 8, 8)})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data set of synthetic ground, factors 4 and 8."""
    folder = tmp_path_factory.mktemp("known")
    poolings = ((4, 1.0), (8, 1.0))
    recipe = Recipe((), maps=16, size=32, blocks=8, poolings=poolings, maps_per_shard=8, known=True)
    make_dataset(recipe, folder, workers=1)
    return folder


def test_targets_are_the_blocks_own_cells():
    limits = Traversability(slope_limit_deg=12.0, hard_slope_deg=12.0)
    elevation = 1.5 * synthetic_terrain(np.random.default_rng(3), 64, 2.0)
    cost = traversability_cost(elevation, 2.0, limits, warn=False)
    _, answers, *_ = known_map(elevation, cost, 2.0, limits, 8)
    mean, blocked, closed = answers / np.float32(CERTAIN)
    cells = cost.reshape(8, 8, 8, 8).swapaxes(1, 2).reshape(8, 8, 64)
    impassable = np.isinf(cells)
    assert mean == pytest.approx(np.minimum(cells, 1.0).mean(-1), abs=1.0 / CERTAIN)
    assert blocked == pytest.approx(impassable.mean(-1), abs=1.0 / CERTAIN)
    assert set(closed[impassable.all(-1)]) == {1.0}
    assert set(closed[~impassable.any(-1)]) == {0.0}
    assert 0.5 in closed


def test_a_set_of_blocks_is_none_of_queries(folder):
    with pytest.raises(DataSetError, match="known by their blocks"):
        read_samples(folder)


def test_a_network_from_data_set_to_int8(nnpp_edge, folder, tmp_path):
    maps = read_known(folder)
    best = train(SMALL, TrainSettings(steps=3, batch=8), maps, maps, tmp_path, omega=0.011)
    saved = load_checkpoint(best)
    assert {"rmse_mean", "rmse_blocked", "rmse_closed"} <= saved.progress.history[-1].keys()
    network = saved.trained()
    fp32 = tmp_path / "small.onnx"
    int8 = tmp_path / "int8.onnx"
    export_network(network, fp32, name="small")
    assert parity(network, fp32).passed
    report = quantize(fp32, folder, int8, validation=folder, samples=6)
    assert sum(layer.quantised for layer in report.layers) == 10
    assert report.compared.mean_difference < 0.02
    words = ("--dataset", folder, "--validation", folder, "-o", int8, "--most-gap", 0.1)
    nnpp_edge("quantize", fp32, *words).refused("--most-gap is for networks that answer queries")
