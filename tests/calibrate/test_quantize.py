"""The int8 model: its size, how close it stays, what the report says, and what is refused."""

import dataclasses
import json
import math

import numpy as np
import onnx
import pytest
import torch

from nnpp_edge.calibrate.calibration_set import QueryReader, probabilities, split, spread
from nnpp_edge.calibrate.compare import Latency, Searches, agreement, judge_both, operators_left, recommend
from nnpp_edge.calibrate.quantize import quantize
from nnpp_edge.calibrate.quantizer import METHODS, Quantizer
from nnpp_edge.calibrate.sensitivity import exclude_worst, node_errors, snr_db
from nnpp_edge.export.to_onnx import export_network
from nnpp_edge.model.network import Network
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError, ModelError, OutputError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.training.validation import Judgement, Validator
from tests.networks import RECIPE, SMALL

FIRST, SECOND = "encoder.stem.0/Conv", "encoder.widen.0/Conv"


@pytest.fixture(scope="module")
def fp32(trained):
    """Path of a trained fp32 model."""
    return trained.onnx


@pytest.fixture(scope="module")
def convolutions(quantizer):
    """How many can be quantised: all but the last, which belongs to the head."""
    return sum(isinstance(module, torch.nn.Conv2d) for module in Network(SMALL).modules()) - 1


@pytest.fixture(scope="module")
def made(fp32, dataset, tmp_path_factory):
    """The report of an int8 model, made with the ranking of its nodes."""
    output = tmp_path_factory.mktemp("int8") / "small-int8.onnx"
    return quantize(fp32, dataset, output, samples=24, rank=True, rounds=10)


@pytest.fixture(scope="module")
def quantizer(fp32, samples, tmp_path_factory):
    found = Quantizer(NetworkModel(fp32), tmp_path_factory.mktemp("between"))
    found.calibrate(spread(samples, 16, 1))
    return found


def test_int8_is_smaller_and_close(made, fp32, samples):
    wanted_of, got_of = NetworkModel(fp32), NetworkModel(made.output)
    assert made.int8_bytes < 0.7 * made.fp32_bytes
    wanted, got = probabilities(wanted_of, samples), probabilities(got_of, samples)
    assert wanted.std() > 0.02
    assert np.abs(got - wanted).mean() < 0.01
    assert np.corrcoef(got.ravel(), wanted.ravel())[0, 1] > 0.99


def test_the_report_holds_what_it_promises(made, fp32, convolutions):
    assert (made.samples, made.method, made.reduce_range) == (24, "minmax", True)
    assert made.fp32_bytes == fp32.stat().st_size
    assert made.quantised == convolutions - len(made.excluded)
    assert made.agreement.mean_difference <= made.agreement.max_difference < 0.3
    assert 0.9 < made.agreement.same_side <= 1.0
    assert 0.0 < made.fp32_latency.median_ms <= made.fp32_latency.p99_ms
    assert made.speed_up == pytest.approx(made.fp32_latency.median_ms / made.int8_latency.median_ms)
    assert made.searches.fp32.factor == made.searches.int8.factor == made.region_factor == 0.5
    assert made.recommendation.startswith(("int8: ", "keep fp32: "))
    told = json.loads(made.to_json())
    assert told["agreement"]["queries"] == made.agreement.queries
    assert told["qdq_left"] == made.qdq_left


def test_no_pairs_are_left_but_at_the_edges_of_the_graph(made):
    """The map is quantised, and what the float head reads is brought back."""
    assert made.excluded == ()
    assert made.qdq_left == 2


def test_the_nodes_are_ranked_from_the_worst_on(made, convolutions):
    values = list(made.node_snr_db.values())
    assert len(values) == convolutions
    assert values == sorted(values)
    assert 10.0 < values[0] < values[-1] <= 200.0


def test_the_file_tells_how_it_was_calibrated(made, fp32):
    before, after = NetworkModel(fp32).metadata, NetworkModel(made.output).metadata
    told = after.training["calibration"]
    assert after.precision == "int8"
    assert (told["samples"], told["method"], told["dataset_seed"]) == (24, "minmax", RECIPE.seed)
    assert set(told["versions"]) == {"nnpp_edge", "onnxruntime", "onnx"}
    assert told["agreement"]["mean_difference"] == made.agreement.mean_difference
    kept = {**after.training, "calibration": None}
    assert dataclasses.replace(after, precision="fp32", training=kept) == dataclasses.replace(
        before, training=before.training | {"calibration": None}
    )


def weights(path):
    """Name and values of the int8 weights."""
    tensors = onnx.load(path).graph.initializer
    return {t.name: onnx.numpy_helper.to_array(t) for t in tensors if t.name.endswith("weight_quantized")}


def test_weights_have_seven_bits_and_a_scale_for_each_channel(made, quantizer, convolutions):
    found = weights(made.output)
    assert len(found) == convolutions
    assert all(w.dtype == np.int8 and np.abs(w.astype(int)).max() <= 64 for w in found.values())
    full = weights(quantizer.build("full", reduce_range=False))
    assert max(np.abs(w.astype(int)).max() for w in full.values()) == 127
    stored = {t.name: t for t in onnx.load(made.output).graph.initializer}
    assert stored["body.encoder.stem.0.weight_scale"].dims == [16]


def test_the_head_stays_float(made, quantizer):
    assert {"encoder.describe/Conv", "head/If"} <= set(quantizer.head)
    assert {name.split(".")[0] for name in quantizer.nodes} == {"encoder"}
    assert "body.encoder.describe.weight" in {t.name for t in onnx.load(made.output).graph.initializer}


def test_the_papers_network_is_quantised_too(samples, tmp_path):
    torch.manual_seed(0)
    network = Network(Spec("nnpp", 128, options={"width": 4}))
    torch.nn.init.normal_(network.body.classifier.weight, std=0.5)
    export_network(network, tmp_path / "nnpp.onnx", name="nnpp")
    fp32 = NetworkModel(tmp_path / "nnpp.onnx")
    quantizer = Quantizer(fp32, tmp_path)
    assert quantizer.head == ("classifier/Conv", "Sigmoid")
    larger = dataclasses.replace(samples, planes=samples.planes.repeat(2, axis=2).repeat(2, axis=3))
    few = spread(larger, 8, 1)
    quantizer.calibrate(few)
    path = quantizer.build("int8")
    assert operators_left(path)["QLinearConv"] > 0.5 * len(quantizer.nodes)
    wanted = probabilities(fp32, few)
    assert wanted.std() > 0.02
    assert np.abs(probabilities(NetworkModel(path), few) - wanted).mean() < 0.05


@pytest.mark.parametrize("method", METHODS)
def test_every_method_stays_close(method, fp32, samples, tmp_path):
    quantizer = Quantizer(NetworkModel(fp32), tmp_path)
    quantizer.calibrate(spread(samples, 12, 1), method)
    int8 = NetworkModel(quantizer.build("int8"))
    few = spread(samples, 12, 2)
    assert np.abs(probabilities(int8, few) - probabilities(quantizer.model, few)).mean() < 0.02


def test_excluded_nodes_keep_float_weights(quantizer, convolutions):
    node = quantizer.nodes[3]
    found = weights(quantizer.build("but-one", exclude=[node]))
    assert len(found) == convolutions - 1
    assert f"body.{node.partition('/')[0]}.weight_quantized" not in found
    with pytest.raises(ModelError, match=r"wanted nodes out of encoder\.stem\.0/Conv, .*got nobody"):
        quantizer.build("none", exclude=["nobody"])


def test_excluding_the_worst_nodes_stops_at_a_third(quantizer, samples, convolutions):
    few = spread(samples, 4, 1)
    assert exclude_worst(quantizer, few, target=1.0) == ((), {})
    errors = dict.fromkeys(quantizer.nodes, 0.0)
    excluded, _ = exclude_worst(quantizer, few, target=0.0, errors=errors)
    assert excluded == quantizer.nodes[: convolutions // 3]


def test_one_node_alone_hurts_less_than_all(quantizer, samples):
    few = spread(samples, 4, 1)
    wanted = probabilities(quantizer.model, few)
    whole = snr_db(wanted, probabilities(NetworkModel(quantizer.build("all")), few))
    alone = node_errors(quantizer, few)
    assert np.median(list(alone.values())) > whole


def test_snr_counts_in_decibels():
    ones = np.ones((1, 4, 4), np.float32)
    assert snr_db(ones, 0.9 * ones) == pytest.approx(20.0, abs=1e-4)
    assert snr_db(ones, ones) == 200.0


def test_calibration_feeds_what_the_runtime_feeds(fp32, samples):
    model = NetworkModel(fp32)
    reader = QueryReader(model, spread(samples, 3, 1))
    fed = []
    while (inputs := reader.get_next()) is not None:
        fed.append(inputs)
    assert len(fed) == 3
    assert {name: array.shape for name, array in fed[0].items()} == {
        "map": (1, 32, 16, 16),
        "query": (1, 15, 8, 8),
        "ask": (1,),
    }
    assert not np.array_equal(fed[0]["map"], fed[1]["map"])


def test_queries_spread_over_the_maps(samples):
    maps = len(np.unique(samples.map_index))
    assert len(np.unique(spread(samples, maps, 1).map_index)) == maps
    both = spread(samples, maps + 5, 1)
    assert np.bincount(both.map_index).max() == 2
    assert len(spread(samples, 10**6, 1)) == len(samples)
    again = spread(samples, 9, 1)
    np.testing.assert_array_equal(again.start, spread(samples, 9, 1).start)
    assert not np.array_equal(again.start, spread(samples, 9, 2).start)


def test_queries_to_judge_on_lie_on_other_maps(samples):
    ours, theirs = split(samples, 1)
    assert not set(ours.map_index) & set(theirs.map_index)
    assert len(ours) + len(theirs) == len(samples)
    one = dataclasses.replace(samples, map_index=np.zeros_like(samples.map_index))
    with pytest.raises(DataSetError, match="at least two maps, got 1"):
        split(one, 1)


def test_models_agree_with_themselves(fp32, samples):
    few = spread(samples, 5, 1)
    p = probabilities(NetworkModel(fp32), few)
    found = agreement(p, p, few, 0.5)
    assert (found.queries, found.mean_difference, found.max_difference, found.same_side) == (5, 0.0, 0.0, 1.0)
    assert agreement(p, 1.0 - p, few, 0.5).same_side < 1.0


def test_searches_judge_as_the_validator_does(fp32, samples):
    model = NetworkModel(fp32)
    found = judge_both(model, model, samples, 20)
    validator = Validator(samples, SMALL, RECIPE.omega, 20)
    p = probabilities(model, samples)[validator.index]
    assert found == Searches(20, *(2 * validator.judge_probabilities(p, (0.5,))))


def test_the_recommendation_weighs_speed_and_cost():
    def advice(fp32_ms, int8_ms, gap, success=1.0):
        a, b = Judgement(0.5, 1.0, 0.002, 0.1, 0.1), Judgement(0.5, success, gap, 0.1, 0.1)
        return recommend(Latency(fp32_ms, fp32_ms), Latency(int8_ms, int8_ms), Searches(9, a, b))

    assert (
        advice(2.0, 1.0, 0.004)
        == "int8: 2.00 times as fast on this machine, and the cost gap changes by +0.20 points."
    )
    assert "and 1.1 is wanted" in advice(1.0, 1.0, 0.002)
    assert "grows by 0.40 points" in advice(2.0, 1.0, 0.006)
    assert "keep fp32" in advice(2.0, 1.0, math.inf)
    assert "2.0 % fewer of the queries" in advice(2.0, 1.0, 0.002, success=0.98)


def test_what_cannot_be_quantised_is_refused_and_nothing_written(made, fp32, dataset, tmp_path):
    output = tmp_path / "out.onnx"
    with pytest.raises(ModelError, match="wanted an fp32 model, got one of int8"):
        quantize(made.output, dataset, output)
    with pytest.raises(ModelError, match="wanted a model file"):
        quantize(tmp_path / "none.onnx", dataset, output)
    with pytest.raises(DataSetError, match="wanted a data set's folder"):
        quantize(fp32, tmp_path, output)
    with pytest.raises(ModelError, match="got nobody"):
        quantize(fp32, dataset, output, samples=4, exclude=("nobody",))
    with pytest.raises(InvalidQueryError, match="method must be one of"):
        quantize(fp32, dataset, output, method="guess")
    with pytest.raises(OutputError, match="its folder does not exist"):
        quantize(fp32, dataset, tmp_path / "no" / "out.onnx")
    with pytest.raises(InvalidQueryError, match="another file"):
        quantize(fp32, dataset, fp32)
    assert not list(tmp_path.iterdir())


def test_maps_of_another_size_are_refused(fp32, samples, tmp_path):
    larger = dataclasses.replace(samples, planes=samples.planes.repeat(2, axis=2).repeat(2, axis=3))
    with pytest.raises(DataSetError, match="wanted maps of 64 × 64 cells, got 128"):
        Quantizer(NetworkModel(fp32), tmp_path).calibrate(larger)


def test_the_command_prints_a_table_and_a_recommendation(nnpp_edge, fp32, dataset, tmp_path):
    words = ("quantize", fp32, "--dataset", dataset, "--validation", dataset, "-o", tmp_path / "q.onnx")
    told = nnpp_edge(*words, "--samples", 8, "--exclude", f"{FIRST},{SECOND}")
    assert told.code == 0
    assert f"left float: the head, {FIRST}, {SECOND}" in told.out
    assert told.out.splitlines()[-1].startswith(("int8: ", "keep fp32: "))
    assert json.loads(nnpp_edge(*words, "--samples", 8, "--json").out)["excluded"] == []
