"""The int8 model of networks that were trained here: what is said of it, and what is refused."""

import dataclasses
import re

import msgspec
import onnx
import pytest
import torch

from nnpp_edge.calibrate.quantize import quantised_graph
from nnpp_edge.export.to_onnx import export_network
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.profiling.int8 import Comparison, quantize
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError, ModelError, OutputError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import model_path
from nnpp_edge.terrain.dataset import make_dataset, read_samples
from nnpp_edge.training.checkpoint import load_checkpoint
from nnpp_edge.training.validation import Validator
from tests.test_made_models import operators_left
from tests.training.conftest import RECIPE, SMALL, enlarged

FIRST = "encoder.stem.1/Conv"
SECOND = "encoder.widen.1/Conv"


@pytest.fixture(scope="module")
def fp32(trained):
    """Path of a trained fp32 model."""
    return trained.onnx


def test_the_papers_network_is_quantised_too(samples, tmp_path):
    torch.manual_seed(0)
    network = Network(Spec("nnpp", 128, options={"width": 4}))
    torch.nn.init.normal_(network.body.classifier.weight, std=0.5)
    export_network(network, tmp_path / "nnpp.onnx", name="nnpp")
    fp32 = NetworkModel(tmp_path / "nnpp.onnx")
    few = enlarged(samples, 128).pick(range(8))
    model, layers = quantised_graph(fp32, few, tmp_path)
    assert "body.classifier.weight" in {tensor.name for tensor in model.graph.initializer}
    onnx.save(model, tmp_path / "int8.onnx")
    assert operators_left(tmp_path / "int8.onnx", tmp_path)["QLinearConv"] > 0.5 * len(layers)


def test_what_training_and_quantize_say_of_a_network_is_the_same(trained, fp32, tmp_path):
    """On maps of twice its resolution: they are searched as they are held."""
    recipe = msgspec.structs.replace(RECIPE, size=128, blocks=32, maps=6, maps_per_shard=6)
    make_dataset(recipe, tmp_path / "set", workers=1)
    validator = Validator(read_samples(tmp_path / "set"), SMALL, RECIPE.omega)
    judged = validator.judge(load_checkpoint(trained.folder / "best.pt").trained())
    report = quantize(
        fp32, tmp_path / "set", tmp_path / "int8.onnx", validation=tmp_path / "set", samples=4
    )
    said = report.compared.fp32
    (trained_at,) = (each for each in judged if each.factor == said.factor)
    assert dataclasses.astuple(said) == pytest.approx(dataclasses.astuple(trained_at), rel=1e-6)


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        ({"model": "int8.onnx"}, ModelError, "wanted an fp32 model, got one of int8"),
        ({"model": "none.onnx"}, ModelError, "wanted a model file"),
        ({"dataset": "."}, DataSetError, "wanted a data set's folder"),
        ({"output": "no/out.onnx"}, OutputError, "its folder does not exist"),
        ({"output": "fp32.onnx"}, InvalidQueryError, "another file"),
        ({"exclude": ["nobody"]}, ModelError, r"nodes out of encoder\.stem\.1/Conv, .*got nobody"),
    ],
    ids=str,
)
def test_what_cannot_be_quantised_is_refused_and_nothing_written(
    fp32, dataset, tmp_path, wrong, error, said
):
    files = {"int8.onnx": model_path("edge"), "fp32.onnx": fp32, "dataset": dataset}
    for name, target in files.items():
        (tmp_path / name).symlink_to(target)
    words = {"model": "fp32.onnx", "dataset": "dataset", "output": "out.onnx", **wrong}
    exclude = words.pop("exclude", ())
    with pytest.raises(error, match=said):
        quantize(
            **{name: tmp_path / path for name, path in words.items()},
            validation=dataset,
            exclude=exclude,
        )
    assert {path.name for path in tmp_path.iterdir()} == set(files)


def test_the_command_prints_a_table_and_a_recommendation(
    nnpp_edge, fp32, dataset, tmp_path, monkeypatch
):
    output = tmp_path / "q.onnx"
    line = ("quantize", fp32, "--dataset", dataset, "--validation", dataset, "-o", output)
    words = (*line, "--samples", 8)
    monkeypatch.setattr(Comparison, "added_gap", 0.2)
    ended = nnpp_edge(*words, "--most-gap", 0.2, "--exclude", f"{FIRST},{SECOND}")
    assert ended.code == 0 and "points more are allowed" not in ended.out
    card = output.with_suffix(".md").read_text()
    printed = " ".join(ended.out.split())
    for name, fact in (
        ("left float", f"encoder.describe/Conv, {FIRST}, {SECOND}"),
        ("calibrated", f"on 8 queries of {dataset}"),
    ):
        assert f"{name} {fact}" in printed and f"- {name}: {fact}" in card
    assert ended.out.splitlines()[-1] == card.splitlines()[-1]
    assert card.splitlines()[-1].startswith(("recommended: int8. ", "recommended: fp32. "))
    for name in (FIRST, SECOND, "encoder.describe/Conv"):
        assert re.search(rf"{name} \| float \| [\d.]+ %", card), name
    ended = nnpp_edge(*words, "--most-gap", 0.1, "--json")
    assert (ended.code, ended.json["samples"]) == (1, 8)
    assert "at most 0.1 points more are allowed" in ended.out
