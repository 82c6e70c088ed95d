"""What is written about a model and advised of it, without the networks: torch, which takes seconds
to import, is a stand-in.
"""

import sys
from collections import Counter
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import onnx
import onnxruntime
import pytest

from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import ModelMetadata
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.dataset import Samples
from tests.conftest import TINY_MODEL
from tests.tables import cases, keywords

MADE = ("export.to_onnx", "calibrate.quantize", "profiling.int8", "training.train")
STAND_INS = (
    *("torch", "torch.nn", "torch.nn.functional", "torch.utils", "torch.utils.flop_counter"),
    "onnxscript",
)
ROOMS = ("calibrate", "export", "model", "profiling", "training")
FIRST = "encoder.stem.0/Conv"
HEAD = "encoder.describe/Conv"
HEAVY = (*STAND_INS, *(f"nnpp_edge.{name}." for name in ROOMS))


@pytest.fixture(scope="module")
def made():
    """The modules that export and quantise."""

    def taken():
        return {name: sys.modules.pop(name) for name in list(sys.modules) if name.startswith(HEAVY)}

    rooms = [vars(import_module(f"nnpp_edge.{name}")) for name in ROOMS]
    names = [dict(room) for room in rooms]
    real = taken()
    torch = MagicMock(__version__="0")
    torch.nn.Module = object
    sys.modules.update(dict.fromkeys(STAND_INS, torch))
    yield {name: import_module(f"nnpp_edge.{name}") for name in MADE}
    taken()
    sys.modules.update(real)
    for room, own in zip(rooms, names, strict=True):  # `from nnpp_edge.model import edge` reads it
        room.clear()
        room.update(own)


def test_a_model_says_how_the_maps_were_made_that_it_was_trained_on(made, tmp_path):
    export = made["export.to_onnx"]
    export.to_onnx = lambda _: onnx.parser.parse_model(TINY_MODEL)
    export.NetworkModel = export.count_macs = MagicMock()
    told = {"name": "own", "region_factor": 0.4, "omega": 0.037, "training": {"steps": 3}}
    limits = Traversability(slope_limit_deg=21.0)
    network = SimpleNamespace(spec=Spec("nnpp", 128, 0.3), body=None)
    export.export_network(network, tmp_path / "own.onnx", limits=limits, **told)
    (stored,) = onnx.load(tmp_path / "own.onnx").metadata_props
    found = vars(ModelMetadata.from_json(stored.value, "own.onnx"))
    assert found == found | told | {"input_size": 128, "blocks": 16, "sigma": 0.3}
    assert found["cost_limits"]["slope_limit_deg"] == 21.0
    assert "hard_slope_deg" not in found["cost_limits"]


def operators_left(path, folder):
    """Kinds of nodes after onnxruntime's optimisation, and how many of each."""
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(folder / "optimised.onnx")
    onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    return Counter(node.op_type for node in onnx.load(options.optimized_model_filepath).graph.node)


@pytest.fixture
def quantised(made, tmp_path, monkeypatch):
    """Quantises edge-fp32 on eight random queries, which are not searched, and returns the report;
    with the `queries`, those `shown` to a network, and the answers `judged`.
    """
    of = made["profiling.int8"]
    making = made["calibrate.quantize"]
    rng = np.random.default_rng(0)
    planes = rng.integers(256, size=(8, 2, 64, 64), dtype=np.uint8)
    ends = rng.uniform(0.0, 63.0, (2, 8, 2)).astype(np.float32)
    queries = Samples(planes, np.arange(8, dtype=np.int32), *ends, planes, planes)
    shown = []
    judged = []
    answer = making.answer

    def judge(answers):
        judged.append(answers)
        return of.Judgement(0.2, 1.0, 0.01 * len(judged), 0.1, 0.1, 0.1)

    def shows(model, given, at):
        shown.append(at)
        return answer(model, given, at)

    def quantise(**asked):
        output = tmp_path / "int8.onnx"
        return of.quantize(Path("edge-fp32"), tmp_path, output, validation=tmp_path, **asked)

    for name, stand_in in {
        "_data": lambda *_: (queries, queries.pick(range(3)), judge),
        "read_recipe": lambda _: SimpleNamespace(seed=7),
        "fp32_and_int8_ms": lambda *models: (3.0, 1.0),
    }.items():
        monkeypatch.setattr(of, name, stand_in)
    monkeypatch.setattr(making, "answer", shows)
    vars(quantise).update(queries=queries, shown=shown, judged=judged)
    return quantise


def test_an_int8_model_is_close_says_how_it_was_made_and_has_a_card(quantised, tmp_path):
    report = quantised(card=lambda report: f"of {report.samples} queries")
    assert quantised.shown == [*range(8), *range(4), *range(3), *range(3)]
    model = NetworkModel("edge-fp32")
    exact, rounded = quantised.judged
    for at, found in enumerate(exact):
        planes, *ends = quantised.queries.query(at)
        model.set_map(planes)
        np.testing.assert_array_equal(model.answer(*ends), found)
    differences = np.abs(rounded - exact)
    compared = report.compared
    assert exact.std() > 0.02 and 1e-6 < differences.mean() < 0.01
    assert compared.max_difference == differences.max()
    assert (compared.added_gap, compared.speed_up) == (pytest.approx(1.0), 3.0)
    assert report.recommendation.startswith("recommended: fp32. int8 pays in speed: ")
    assert report.int8_bytes < 0.4 * report.fp32_bytes
    assert (tmp_path / "int8.md").read_text() == "of 8 queries\n"

    found = NetworkModel(report.output).metadata
    calibration = found.training["calibration"]
    assert (calibration["samples"], calibration["dataset_seed"]) == (8, 7)
    assert calibration["agreement"]["max_difference"] == pytest.approx(compared.max_difference)
    assert found == replace(model.metadata, precision="int8", training=found.training)


def test_all_but_the_head_is_in_int8_with_a_scale_for_each_channel(quantised, tmp_path):
    report = quantised()
    assert not (tmp_path / "int8.md").exists()
    left = operators_left(report.output, tmp_path)
    assert left["QLinearConv"] == len(report.layers) - 1
    assert (
        left["QuantizeLinear"] + left["DequantizeLinear"] == 2
    )  # the map, and what the head reads
    initializers = onnx.load(report.output).graph.initializer
    stored = {each.name: onnx.numpy_helper.to_array(each) for each in initializers}
    kinds = {value.dtype.name for name, value in stored.items() if "zero_point" in name}
    assert {"uint8", "int8"} <= kinds and "body.encoder.describe.weight" in stored
    weights = [name.removesuffix("_quantized") for name in stored if "weight_quant" in name]
    assert len(weights) == left["QLinearConv"]
    for name in weights:
        values = stored[f"{name}_quantized"].astype(int)
        assert len(stored[f"{name}_scale"]) == len(values) and 50 < np.abs(values).max() <= 64


def test_layers_come_by_their_errors_and_those_left_out_stay_float(quantised, tmp_path):
    layers = {each.name: each for each in quantised().layers}
    errors = [each.error for each in layers.values()]
    assert errors == sorted(errors, reverse=True) and 1e-3 < errors[-1] <= errors[0] < 0.1
    assert [name for name, each in layers.items() if not each.quantised] == [HEAD]
    of_all = layers[FIRST].error
    (tmp_path / "int8.onnx").unlink()
    layers = {each.name: each for each in quantised(exclude=[FIRST]).layers}
    assert layers[FIRST].error == 0.0 < of_all and not layers[FIRST].quantised

    def fails(report):
        raise ZeroDivisionError

    (tmp_path / "int8.onnx").unlink()
    with pytest.raises(ZeroDivisionError):
        quantised(card=fails)
    assert not (tmp_path / "int8.onnx").exists()


@pytest.fixture
def train(made, tmp_path, monkeypatch):
    """Trains by validations with these scores at 0.2 of the threshold, where planners use `edge`;
    at the others they get better and better. Which validations each file was saved after, and the
    progress at the end.
    """
    of = made["training.train"]
    judgement = made["profiling.int8"].Judgement
    batches = MagicMock(**{"__len__.return_value": 99, "epoch.return_value": range(99)})
    monkeypatch.setattr(of, "Network", MagicMock())
    monkeypatch.setattr(of, "Batches", lambda *_, **__: batches)
    monkeypatch.setattr(of, "keep_freed_memory", lambda: None)
    monkeypatch.setattr(of.TrainingRun, "_loss", MagicMock())

    def train(scores, **settings):
        saved = {"best.pt": [], "last.pt": []}
        at_end = []
        left = iter(scores)

        def judge(network):
            scored = next(left)
            at_factor = {0.5: -scored, 0.2: scored}
            return [judgement(at, 1.0, 0.1, 0.1, 0.1, score) for at, score in at_factor.items()]

        def save(checkpoint, path):
            saved[path.name].append(len(checkpoint.progress.history))
            at_end[:] = [checkpoint.progress]

        monkeypatch.setattr(of, "Validator", lambda *_: SimpleNamespace(judge=judge))
        monkeypatch.setattr(of.Checkpoint, "save", save)
        steps = len(scores) - 1
        asked = of.TrainSettings(batch=1, steps=steps, validations=steps, **settings)
        samples = Samples(*(np.empty(0) for _ in range(6)))
        of.train(Spec("edge", 64), asked, samples, samples, tmp_path, omega=0.011)
        return saved, *at_end

    return train


def test_the_best_weights_are_those_of_the_least_score_where_planners_use_them(train):
    saved, progress = train([0.9, 0.5, 0.7, 0.4, 0.6])
    assert saved == {"best.pt": [1, 2, 4], "last.pt": [1, 2, 3, 4, 5, 5]}
    assert (progress.best, progress.waited, progress.warning()) == (3, 1, "")


def test_a_training_that_gets_worse_says_so_and_ends_early_where_that_is_asked_for(train):
    worse = [0.5, 0.1, 0.2, 0.3, 0.4, 0.5]
    _, progress = train(worse)
    for row, loss in zip(progress.history[1:], (0.5, 0.4, 0.3, 0.2, 0.1), strict=True):
        row["loss"] = loss
    assert "got worse since step 1 of 5 (score 0.1000 → 0.5000)" in progress.warning()
    progress.history[-1]["loss"] = 0.6
    assert not progress.warning()
    saved, progress = train(worse, patience=2)
    assert (progress.step, progress.steps, saved["best.pt"]) == (3, 5, [1, 2])


ADVICE = """
gap=0.004               | int8 | speed: right after a plan its inference is 2.00 times as fast as fp32; the mean gap goes
gap=0.004               | int8 | from 0.200 to 0.400 %
int8_ms=1.6             | fp32 | size alone: right after a plan its inference is 1.25 times
gap=0.006               | fp32 | ; at most 0.3 points more are allowed
gap=0.004, most_gap=0.1 | fp32 | ; at most 0.1 points more are allowed
gap=float("inf")        | fp32 | from 0.200 to inf %; at most 0.3 points
success=0.98            | fp32 | ; 2.0 % fewer of the queries have a path inside the region
difference=0.01         | fp32 | ; its probabilities differ by 0.0100: leave nodes float
error=0.101             | int8 | ; its errors grow by 1.0 %
error=0.11              | fp32 | ; its errors grow by 10.0 %; 2 % is allowed
"""


@pytest.mark.parametrize(("given", "take", "said"), cases(ADVICE, 3))
def test_the_recommendation_weighs_speed_cost_and_agreement(made, given, take, said):
    of = made["profiling.int8"]
    usual = keywords("gap=0.002, success=1.0, int8_ms=1.0, difference=0.001, most_gap=0.3")
    asked = SimpleNamespace(**usual | keywords(given))
    judged = [of.Judgement(0.5, 1.0, 0.002, 0.1, 0.1, 0.1)]
    judged.append(replace(*judged, success=asked.success, gap=asked.gap))
    if hasattr(asked, "error"):
        judged = [of.Fit(0.1, 0.2, error, 0.1) for error in (0.1, asked.error)]
    compared = of.Comparison(9, asked.difference, 0.1, *judged, 2.0, asked.int8_ms)
    words = compared.recommendation(asked.most_gap)
    assert words.startswith(f"recommended: {take}. int8 pays in ") and said in words
