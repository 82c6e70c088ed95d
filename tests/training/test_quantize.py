"""The int8 model: its size, how close it stays, what the report says, and what is refused."""

import dataclasses
import json
from collections import Counter
from functools import partial

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from nnpp_edge.calibrate.quantize import (
    answers,
    compare,
    quantised_graph,
    quantize,
    split,
)
from nnpp_edge.export.to_onnx import export_network
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError, ModelError, OutputError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.training.validation import Validator
from tests.training.conftest import RECIPE, SMALL

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
    return quantize(
        fp32, dataset, tmp_path_factory.mktemp("int8") / "small-int8.onnx", samples=24, rounds=10
    )


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


def test_the_report_holds_what_it_promises(made, fp32, convolutions):
    compared = made.compared
    assert (made.samples, made.excluded, made.quantised) == (24, (), convolutions)
    assert made.fp32_bytes == fp32.stat().st_size
    assert compared.mean_difference <= compared.max_difference < 0.3
    assert 0.0 < compared.fp32_latency.median_ms <= compared.fp32_latency.p99_ms
    assert compared.speed_up == pytest.approx(
        compared.fp32_latency.median_ms / compared.int8_latency.median_ms
    )
    assert compared.fp32.factor == compared.int8.factor == 0.5
    assert made.recommendation.startswith(("int8: ", "keep fp32: "))
    assert json.loads(made.to_json())["compared"]["queries"] == compared.queries


def test_no_pairs_are_left_but_at_the_edges_of_the_graph(made, convolutions, tmp_path):
    """The map is quantised, and what the float head reads is brought back."""
    left = operators_left(made.output, tmp_path)
    assert left["QuantizeLinear"] + left["DequantizeLinear"] == 2
    assert left["QLinearConv"] == convolutions


def test_the_file_tells_how_it_was_calibrated(made, fp32):
    before = NetworkModel(fp32).metadata
    after = NetworkModel(made.output).metadata
    told = after.training["calibration"]
    assert after.precision == "int8"
    assert (told["samples"], told["method"], told["dataset_seed"]) == (24, "minmax", RECIPE.seed)
    assert set(told["versions"]) == {"nnpp_edge", "onnxruntime", "onnx"}
    assert told["agreement"]["mean_difference"] == made.compared.mean_difference
    assert dataclasses.replace(after, precision="fp32", training=before.training) == before


def test_weights_have_seven_bits_a_scale_for_each_channel_and_the_head_stays_float(
    made, convolutions
):
    stored = {t.name: t for t in onnx.load(made.output).graph.initializer}
    found = {
        name: onnx.numpy_helper.to_array(t)
        for name, t in stored.items()
        if name.endswith("weight_quantized")
    }
    assert len(found) == convolutions
    assert all(w.dtype == np.int8 and np.abs(w.astype(int)).max() <= 64 for w in found.values())
    assert stored["body.encoder.stem.0.weight_scale"].dims == [16]
    assert "body.encoder.describe.weight" in stored


def test_the_papers_network_is_quantised_too(samples, tmp_path):
    torch.manual_seed(0)
    network = Network(Spec("nnpp", 128, options={"width": 4}))
    torch.nn.init.normal_(network.body.classifier.weight, std=0.5)
    export_network(network, tmp_path / "nnpp.onnx", name="nnpp")
    fp32 = NetworkModel(tmp_path / "nnpp.onnx")
    larger = dataclasses.replace(samples, planes=samples.planes.repeat(2, axis=2).repeat(2, axis=3))
    few = larger.pick(range(8))
    graph, quantised = quantised_graph(fp32, few, tmp_path)
    assert "classifier.weight" in {t.name.removeprefix("body.") for t in graph.graph.initializer}
    onnx.save(graph, tmp_path / "int8.onnx")
    assert operators_left(tmp_path / "int8.onnx", tmp_path)["QLinearConv"] > 0.5 * quantised
    onnx.helper.set_model_props(
        graph, {p.key: p.value for p in onnx.load(fp32.path).metadata_props}
    )
    onnx.save(graph, tmp_path / "int8.onnx")
    wanted = answers(fp32, few)
    assert wanted.std() > 0.02
    assert np.abs(answers(NetworkModel(tmp_path / "int8.onnx"), few) - wanted).mean() < 0.05


def test_queries_to_judge_on_lie_on_other_maps(samples):
    ours, theirs = split(samples, 1)
    assert not set(ours.map_index) & set(theirs.map_index)
    assert len(ours) + len(theirs) == len(samples)
    one = dataclasses.replace(samples, map_index=np.zeros_like(samples.map_index))
    with pytest.raises(DataSetError, match="at least two maps, got 1"):
        split(one, 1)


def test_a_model_agrees_with_itself_and_is_judged_as_the_validator_does(fp32, samples):
    model = NetworkModel(fp32)
    validator = Validator(samples, SMALL, RECIPE.omega, 20)
    queries = samples.pick(validator.index)
    judge = partial(validator.judge_probabilities, factors=(0.5,))
    found = compare(model, model, queries, judge, 3)
    assert (found.queries, found.mean_difference, found.max_difference) == (20, 0.0, 0.0)
    assert [found.fp32, found.int8] == 2 * judge(answers(model, samples)[validator.index])


def test_what_cannot_be_quantised_is_refused_and_nothing_written(
    made, fp32, dataset, samples, tmp_path
):
    output = tmp_path / "out.onnx"
    for words, error, said in (
        ((made.output, dataset, output), ModelError, "wanted an fp32 model, got one of int8"),
        ((tmp_path / "none.onnx", dataset, output), ModelError, "wanted a model file"),
        ((fp32, tmp_path, output), DataSetError, "wanted a data set's folder"),
        ((fp32, dataset, tmp_path / "no" / "out.onnx"), OutputError, "its folder does not exist"),
        ((fp32, dataset, fp32), InvalidQueryError, "another file"),
    ):
        with pytest.raises(error, match=said):
            quantize(*words)
    with pytest.raises(
        ModelError, match=r"wanted nodes out of encoder\.stem\.1/Conv, .*got nobody"
    ):
        quantize(fp32, dataset, output, samples=4, exclude=("nobody",))
    assert not list(tmp_path.iterdir())


def test_the_command_prints_a_table_and_a_recommendation(
    nnpp_edge, fp32, dataset, convolutions, tmp_path
):
    words = (
        "quantize",
        fp32,
        "--dataset",
        dataset,
        "--validation",
        dataset,
        "-o",
        tmp_path / "q.onnx",
    )
    told = nnpp_edge(*words, "--samples", 8, "--exclude", f"{FIRST},{SECOND}")
    assert told.code == 0
    assert (
        f"{convolutions - 2} convolutions in int8, left float: the head, {FIRST}, {SECOND}"
        in told.out
    )
    assert told.out.splitlines()[-1].startswith(("int8: ", "keep fp32: "))
    stored = {t.name for t in onnx.load(tmp_path / "q.onnx").graph.initializer}
    assert {"body.encoder.stem.0.weight", "body.encoder.widen.0.weight"} <= stored
    assert json.loads(nnpp_edge(*words, "--samples", 8, "--json").out)["excluded"] == []
