"""Maps known by their blocks: the data set, its targets, and a network from it to int8."""

import numpy as np
import pytest
import torch

from nnpp_edge.calibrate.quantize import quantize
from nnpp_edge.export.to_onnx import export_network, parity
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.priors import NetworkPrior
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost
from nnpp_edge.terrain.dataset import make_dataset, read_known, read_samples
from nnpp_edge.terrain.known import fitted_slope, known_map
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.training.checkpoint import TrainSettings, load_checkpoint
from nnpp_edge.training.train import train
from nnpp_edge.training.unseen import loss_where_unseen, sample

SMALL = Spec("unseen", input_size=32, options={"widths": (8, 8, 8)})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data set of synthetic ground, factors 4 and 8."""
    folder = tmp_path_factory.mktemp("known")
    recipe = Recipe((), maps=16, size=32, blocks=8, poolings=((4, 1.0), (8, 1.0)), maps_per_shard=8, known=True)
    make_dataset(recipe, folder, workers=1)
    return folder


def test_targets_are_the_blocks_own_cells():
    limits = Traversability(slope_limit_deg=12.0, hard_slope_deg=12.0)
    elevation = synthetic_terrain(np.random.default_rng(3), 64, 2.0)
    _, mean, blocked, closed, *_ = known_map(elevation, 2.0, 2.0, limits, 8)
    cost = traversability_cost(elevation, 2.0, limits, warn=False)
    block = cost[8:16, 24:32]
    parts = np.minimum(cost, 1.0).reshape(32, 2, 32, 2).mean(axis=(1, 3))
    assert mean / 255.0 == pytest.approx(parts, abs=1.0 / 255.0)
    assert blocked[4:8, 12:16].mean() / 255.0 == pytest.approx(np.isinf(block).mean(), abs=0.01)
    shut = np.isinf(cost).reshape(8, 8, 8, 8).all(axis=(1, 3))
    assert (closed[shut] == 2).all() and not closed[~np.isinf(cost).reshape(8, 8, 8, 8).any(axis=(1, 3))].any()


def test_samples_hide_what_was_seen_and_turn_inputs_and_targets_alike(folder):
    maps, alike, turned = read_known(folder), [], []
    for at in range(len(maps)):
        planes, answers = sample(maps, at, np.random.default_rng(at))
        assert (np.isnan(answers[0]) == (planes[9] == 1.0)).all()
        steep, mean = np.hypot(planes[0], planes[1]), np.nan_to_num(answers[0], nan=np.nanmean(answers[0]))
        alike.append(np.corrcoef(steep.ravel(), mean.ravel())[0, 1])
        turned.append(np.corrcoef(steep.ravel(), np.rot90(mean).ravel())[0, 1])
    assert np.mean(alike) > 0.2 + np.mean(turned)
    assert fitted_slope(maps).gain > 0.3
    with pytest.raises(DataSetError, match="known by their blocks"):
        read_samples(folder)


def test_blocks_without_a_target_do_not_count():
    logits, target = torch.zeros(1, 3, 4, 4), torch.full((1, 3, 4, 4), torch.nan)
    target[0, :, 1, 2] = 1.0
    assert loss_where_unseen(logits, target).item() == pytest.approx(3 * np.log(2.0), rel=1e-5)


def test_a_network_from_data_set_to_int8(folder, tmp_path):
    maps = read_known(folder)
    checkpoint = train(SMALL, TrainSettings(steps=3, batch=8), maps, maps, tmp_path, omega=0.011)
    saved = load_checkpoint(checkpoint)
    assert {"rmse_mean", "rmse_blocked", "rmse_closed"} <= saved.progress.history[-1].keys()
    network: Network = saved.trained()
    export_network(network, tmp_path / "small.onnx", name="small")
    assert parity(network, tmp_path / "small.onnx", n=2).passed
    report = quantize(tmp_path / "small.onnx", folder, tmp_path / "int8.onnx", samples=6, rounds=5)
    assert report.quantised == 10 and report.compared.mean_difference < 0.02
    dem = 20.0 * np.random.default_rng(1).random((50, 40), np.float32)
    exact, rounded = (
        NetworkPrior(tmp_path / name, Traversability(), 16.0, 8).prices(dem) for name in ("small.onnx", "int8.onnx")
    )
    assert rounded == pytest.approx(exact, abs=0.1)
