"""The int8 model: its size, how close it stays, its report, and what is refused."""

import dataclasses
import re
from collections import Counter

import msgspec
import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from nnpp_edge.calibrate.quantize import answers, compare, quantised_graph, quantize
from nnpp_edge.export.to_onnx import export_network
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError, ModelError, OutputError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.terrain.dataset import make_dataset, read_samples
from nnpp_edge.training.checkpoint import load_checkpoint
from nnpp_edge.training.validation import Validator
from tests.training.conftest import RECIPE, SMALL, enlarged

FIRST = "encoder.stem.1/Conv"
SECOND = "encoder.widen.1/Conv"


@pytest.fixture(scope="module")
def fp32(trained):
    """Path of a trained fp32 model."""
    return trained.onnx


@pytest.fixture(scope="module")
def convolutions():
    """How many can be quantised: all but the last, which belongs to the head."""
    return sum(isinstance(module, torch.nn.Conv2d) for module in Network(SMALL).modules()) - 1


@pytest.fixture(scope="module")
def made(fp32, dataset, tmp_path_factory):
    """The report of an int8 model."""
    output = tmp_path_factory.mktemp("int8") / "small-int8.onnx"
    return quantize(fp32, dataset, output, validation=dataset, samples=24)


def operators_left(path, folder):
    """Kinds of nodes after onnxruntime's optimisation, and how many of each."""
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(folder / "optimised.onnx")
    onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    return Counter(node.op_type for node in onnx.load(options.optimized_model_filepath).graph.node)


def test_int8_is_smaller_and_close(made, fp32, samples):
    assert made.int8_bytes < 0.7 * made.fp32_bytes
    wanted, got = (answers(NetworkModel(path), samples) for path in (fp32, made.output))
    assert wanted.std() > 0.02
    assert np.abs(got - wanted).mean() < 0.01
    assert np.corrcoef(got.ravel(), wanted.ravel())[0, 1] > 0.99


def test_no_pairs_are_left_but_at_the_edges_of_the_graph(made, convolutions, tmp_path):
    """The map is quantised, and what the float head reads is brought back."""
    left = operators_left(made.output, tmp_path)
    assert left["QuantizeLinear"] + left["DequantizeLinear"] == 2
    assert left["QLinearConv"] == convolutions


def test_the_papers_network_is_quantised_too(samples, tmp_path):
    torch.manual_seed(0)
    network = Network(Spec("nnpp", 128, options={"width": 4}))
    torch.nn.init.normal_(network.body.classifier.weight, std=0.5)
    export_network(network, tmp_path / "nnpp.onnx", name="nnpp")
    fp32 = NetworkModel(tmp_path / "nnpp.onnx")
    few = enlarged(samples, 128).pick(range(8))
    model, layers = quantised_graph(fp32, few, tmp_path)
    assert "body.classifier.weight" in {tensor.name for tensor in model.graph.initializer}
    model.metadata_props.extend(onnx.load(fp32.path).metadata_props)
    onnx.save(model, tmp_path / "int8.onnx")
    assert operators_left(tmp_path / "int8.onnx", tmp_path)["QLinearConv"] > 0.5 * len(layers)
    wanted = answers(fp32, few)
    assert wanted.std() > 0.02
    assert np.abs(answers(NetworkModel(tmp_path / "int8.onnx"), few) - wanted).mean() < 0.05


def test_a_model_agrees_with_itself_and_is_judged_as_the_validator_does(fp32, samples):
    model = NetworkModel(fp32)
    validator = Validator(samples, SMALL, RECIPE.omega)

    def judge(found):
        return validator.judge_answers(found, [0.5])[0]

    found = compare(model, model, validator.shown, judge)
    assert (found.mean_difference, found.max_difference) == (0.0, 0.0)
    assert found.queries == len(validator.index)
    assert found.fp32 == found.int8 == judge(answers(model, samples)[validator.index])


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
    made, fp32, dataset, tmp_path, wrong, error, said
):
    files = {"int8.onnx": made.output, "fp32.onnx": fp32, "dataset": dataset}
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
    nnpp_edge, fp32, dataset, convolutions, tmp_path
):
    output = tmp_path / "q.onnx"
    words = ("quantize", fp32, "--dataset", dataset, "--validation", dataset, "-o", output)
    ended = nnpp_edge(*words, "--samples", 8, "--exclude", f"{FIRST},{SECOND}")
    assert ended.code == 0
    left_float = f"float the head, {FIRST}, {SECOND}"
    card = output.with_suffix(".md").read_text()
    for words in (
        f"{output}: {convolutions - 2} convolutions",
        left_float,
        f"on 8 queries of {dataset}",
    ):
        assert words in " ".join(ended.out.split()) and words.replace("float ", "float: ") in card
    assert ended.out.splitlines()[-1] == card.splitlines()[-1]
    assert card.splitlines()[-1].startswith(("recommended: int8. ", "recommended: fp32. "))
    for name in (FIRST, SECOND, "encoder.describe/Conv"):
        assert re.search(rf"{name} \| float \| [\d.]+ %", card), name
    names = {tensor.name for tensor in onnx.load(output).graph.initializer}
    assert {"body.encoder.stem.0.weight", "body.encoder.widen.0.weight"} <= names
    assert nnpp_edge(*words, "--samples", 8, "--json").json["excluded"] == []
