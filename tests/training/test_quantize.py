"""The int8 model: how it is made, what is said of it, and what is refused."""

import dataclasses
import re
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from nnpp_edge.calibrate import quantize as making
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
from tests.training.conftest import RECIPE, SMALL, enlarged

FIRST = "encoder.stem.1/Conv"
SECOND = "encoder.widen.1/Conv"
HEAD = "encoder.describe/Conv"


def operators_left(path, folder):
    """Kinds of nodes after onnxruntime's optimisation, and how many of each."""
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(folder / "optimised.onnx")
    onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    return Counter(node.op_type for node in onnx.load(options.optimized_model_filepath).graph.node)


@pytest.fixture(scope="module")
def fp32(trained):
    """Path of a trained fp32 model."""
    return trained.onnx


@pytest.fixture(scope="module")
def quantised(fp32, dataset, tmp_path_factory):
    """The report on an int8 model, calibrated on eight queries; and which queries networks were
    shown meanwhile.
    """
    shown = []
    answer = making.answer

    def shows(model, given, at):
        shown.append(at)
        return answer(model, given, at)

    output = tmp_path_factory.mktemp("int8") / "int8.onnx"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(making, "answer", shows)
        report = quantize(fp32, dataset, output, validation=dataset, samples=8, card=card_of)
    return report, shown


def card_of(report):
    return f"of {report.samples} queries"


def test_an_int8_model_is_close_says_how_it_was_made_and_has_a_card(quantised, fp32, dataset):
    report, shown = quantised
    compared = report.compared
    held_out = range(compared.queries)
    assert shown == [*range(8), *range(4), *held_out, *held_out]
    queries = Validator(read_samples(dataset), SMALL, RECIPE.omega).shown
    output = Path(report.output)
    exact, rounded = (making.answers(NetworkModel(path), queries) for path in (fp32, output))
    differences = np.abs(rounded - exact)
    assert exact.std() > 0.02 and 1e-6 < differences.mean() < 0.01
    assert compared.max_difference == differences.max()
    assert compared.added_gap == pytest.approx(100.0 * (compared.int8.gap - compared.fp32.gap))
    assert report.int8_bytes < 0.6 * report.fp32_bytes
    assert output.with_suffix(".md").read_text() == "of 8 queries\n"

    source = NetworkModel(fp32).metadata
    found = NetworkModel(output).metadata
    calibration = found.training["calibration"]
    assert (calibration["samples"], calibration["dataset_seed"]) == (8, RECIPE.seed)
    assert calibration["agreement"]["max_difference"] == pytest.approx(compared.max_difference)
    assert found == dataclasses.replace(source, precision="int8", training=found.training)


def test_all_but_the_head_is_in_int8_with_a_scale_for_each_channel(quantised, tmp_path):
    report, _ = quantised
    left = operators_left(report.output, tmp_path)
    assert left["QLinearConv"] == len(report.layers) - 1
    between = left["QuantizeLinear"] + left["DequantizeLinear"]
    assert between == 2, "the map, and what the head reads"
    initializers = onnx.load(report.output).graph.initializer
    stored = {each.name: onnx.numpy_helper.to_array(each) for each in initializers}
    kinds = {value.dtype.name for name, value in stored.items() if "zero_point" in name}
    assert {"uint8", "int8"} <= kinds and "encoder.describe.weight" in stored
    weights = [name.removesuffix("_quantized") for name in stored if "weight_quant" in name]
    assert len(weights) == left["QLinearConv"]
    for name in weights:
        values = stored[f"{name}_quantized"].astype(int)
        assert len(stored[f"{name}_scale"]) == len(values) and 50 < np.abs(values).max() <= 64


def test_layers_come_by_their_errors_and_those_left_out_stay_float(
    quantised, fp32, samples, tmp_path
):
    layers = {each.name: each for each in quantised[0].layers}
    errors = [each.error for each in layers.values()]
    assert errors == sorted(errors, reverse=True) and 1e-3 < errors[-1] <= errors[0] < 0.1
    assert [name for name, each in layers.items() if not each.quantised] == [HEAD]
    few = samples.pick(range(8))
    _, others = quantised_graph(NetworkModel(fp32), few, tmp_path, exclude=[FIRST])
    (first,) = (each for each in others if each.name == FIRST)
    assert first.error == 0.0 < layers[FIRST].error and not first.quantised


def test_where_the_card_cannot_be_written_no_model_is(fp32, dataset, tmp_path):
    output = tmp_path / "int8.onnx"
    with pytest.raises(ZeroDivisionError):
        quantize(fp32, dataset, output, validation=dataset, samples=4, card=lambda _: 1 / 0)
    assert not list(tmp_path.iterdir())


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
    said = dataclasses.astuple(report.compared.fp32)
    assert said == pytest.approx(dataclasses.astuple(judged), rel=1e-6)


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


def test_the_command_prints_a_table_and_keeps_a_budget_of_the_gap(
    nnpp_edge, fp32, dataset, tmp_path, monkeypatch
):
    output = tmp_path / "q.onnx"
    line = ("quantize", fp32, "--dataset", dataset, "--validation", dataset, "-o", output)
    words = (*line, "--samples", 8)
    monkeypatch.setattr(Comparison, "added_gap", 0.2)
    ended = nnpp_edge(*words, "--most-gap", 0.2, "--exclude", f"{FIRST},{SECOND}")
    assert (ended.code, ended.err) == (0, "")
    card = output.with_suffix(".md").read_text()
    printed = " ".join(ended.out.split())
    for name, fact in (
        ("left float", f"{HEAD}, {FIRST}, {SECOND}"),
        ("calibrated", f"on 8 queries of {dataset}"),
    ):
        assert f"{name} {fact}" in printed and f"- {name}: {fact}" in card
    for name in (FIRST, SECOND, HEAD):
        assert re.search(rf"{name} \| float \| [\d.]+ %", card), name
    ended = nnpp_edge(*words, "--most-gap", 0.1, "--json")
    assert (ended.code, ended.json["samples"]) == (1, 8)
    assert ended.err == "int8 adds 0.200 points to the mean gap, wanted 0.1\n"
