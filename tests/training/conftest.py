"""A small data set and a small network, made once in a run of the tests."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from nnpp_edge.export.to_onnx import export_network
from nnpp_edge.model.registry import Spec
from nnpp_edge.terrain.dataset import make_dataset, read_samples
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.training.checkpoint import load_checkpoint
from nnpp_edge.training.settings import TrainSettings
from nnpp_edge.training.train import train

RECIPE = Recipe((), maps=28, size=64, blocks=16, maps_per_shard=28, poolings=((1, 1.0),))
SMALL = Spec("edge", 64, options={"widths": (16, 16, 16, 16), "stem": 16})
VALIDATED_AFTER = (1, 11, 12)
"""Epochs after which the training of `SMALL` is stopped, validated and resumed."""


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    """A small data set's folder."""
    folder = tmp_path_factory.mktemp("small") / "dataset"
    make_dataset(RECIPE, folder, workers=1)
    return folder


@pytest.fixture(scope="session")
def samples(dataset):
    """All of the small data set."""
    return read_samples(dataset)


def enlarged(samples, side):
    """The same queries on maps of `side` cells, each cell of the small data set several times."""
    factor = side // RECIPE.size
    return replace(samples, planes=samples.planes.repeat(factor, axis=2).repeat(factor, axis=3))


@pytest.fixture(scope="session")
def trained(samples, tmp_path_factory):
    """`SMALL` after some epochs on the data set: the run's `folder`, and the fp32 model exported as
    `onnx`.
    """
    folder = tmp_path_factory.mktemp("run")
    settings = TrainSettings(
        batch=16, warmup_steps=5, learning_rate=1e-2, average_decay=0.9, validations=1
    )
    for epochs in VALIDATED_AFTER:
        until = replace(settings, epochs=epochs)
        best = train(SMALL, until, samples, samples.pick(range(24)), folder, omega=RECIPE.omega)
    export_network(load_checkpoint(best).trained(), folder / "small.onnx", name="small")
    return SimpleNamespace(folder=folder, onnx=folder / "small.onnx")
