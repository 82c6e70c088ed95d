"""What is written about a model and advised of it, without the networks: torch, which takes seconds
to import, is a stand-in.
"""

import math
import sys
from importlib import import_module
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import onnx
import pytest

from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.network.model_file import ModelMetadata
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.terrain.dataset import Samples
from tests.conftest import TINY_MODEL

ROOMS = ("calibrate", "export", "model", "training")
STAND_INS = ("torch", "torch.nn", "torch.utils", "torch.utils.flop_counter", "onnxscript")


@pytest.fixture(scope="module")
def made():
    """The modules that export and quantise."""
    rooms = [import_module(f"nnpp_edge.{name}") for name in ROOMS]
    heavy = (*(f"{room.__name__}." for room in rooms), *STAND_INS)
    names = [dict(vars(room)) for room in rooms]

    def taken():
        return {name: sys.modules.pop(name) for name in list(sys.modules) if name.startswith(heavy)}

    real = taken()
    torch = MagicMock()
    torch.nn.Module = object
    sys.modules.update(dict.fromkeys(STAND_INS, torch))
    yield SimpleNamespace(
        export=import_module("nnpp_edge.export.to_onnx"),
        quantize=import_module("nnpp_edge.calibrate.quantize"),
        batches=import_module("nnpp_edge.training.batches"),
    )
    taken()
    sys.modules.update(real)
    for room, own in zip(rooms, names, strict=True):
        vars(room).clear()
        vars(room).update(own)


def test_a_model_says_how_the_maps_were_made_that_it_was_trained_on(made, tmp_path, monkeypatch):
    monkeypatch.setattr(made.export, "to_onnx", lambda _: onnx.parser.parse_model(TINY_MODEL))
    monkeypatch.setattr(made.export, "NetworkModel", lambda _: None)
    monkeypatch.setattr(made.export, "count_macs", lambda *_: 7)
    network = SimpleNamespace(spec=Spec("nnpp", 128, 0.3), body=None)
    limits = Traversability(slope_limit_deg=21.0, hard_slope_deg=23.0)
    told = {"name": "own", "region_factor": 0.4, "omega": 0.037, "training": {"steps": 3}}
    made.export.export_network(network, tmp_path / "own.onnx", limits=limits, **told)
    (stored,) = onnx.load(tmp_path / "own.onnx").metadata_props
    found = ModelMetadata.from_json(stored.value, "own.onnx")
    assert {name: getattr(found, name) for name in told} == told
    assert (found.architecture, found.input_size, found.blocks, found.sigma) == (
        "nnpp", 128, 16, 0.3,
    )  # fmt: skip
    hard = {name: found.cost_limits.get(name) for name in ("hard_slope_deg", "hard_step_m")}
    assert hard == {"hard_slope_deg": 23.0, "hard_step_m": None}
    assert found.cost_limits["slope_limit_deg"] == 21.0


def test_the_recommendation_weighs_speed_cost_and_agreement(made):
    of = made.quantize
    judged = import_module("nnpp_edge.training.validation").Judgement
    fit = import_module("nnpp_edge.training.unseen").Fit

    def advice(fp32_ms, int8_ms, a, b, difference=0.001):
        times = (of.Latency(ms, ms) for ms in (fp32_ms, int8_ms))
        return of.Comparison(9, difference, 0.1, a, b, *times).recommendation()

    def of_searches(fp32_ms, int8_ms, gap, success=1.0, difference=0.001):
        a = judged(0.5, 1.0, 0.002, 0.1, 0.1)
        return advice(fp32_ms, int8_ms, a, judged(0.5, success, gap, 0.1, 0.1), difference)

    said = "int8: 2.00 times as fast on this machine, and the cost gap changes by +0.20 points."
    assert of_searches(2.0, 1.0, 0.004) == said
    assert "and 1.1 is wanted" in of_searches(1.0, 1.0, 0.002)
    assert "grows by 0.40 points" in of_searches(2.0, 1.0, 0.006)
    assert "keep fp32" in of_searches(2.0, 1.0, math.inf)
    assert "2.0 % fewer of the queries" in of_searches(2.0, 1.0, 0.002, success=0.98)
    assert "differ by 0.0100" in of_searches(2.0, 1.0, 0.002, difference=0.01)
    for errors, begins in (((0.1, 0.2, 0.101), "int8"), ((0.101, 0.2, 0.11), "keep fp32")):
        words = advice(2.0, 1.0, fit(0.1, 0.2, 0.1), fit(*errors))
        grown = 100.0 * (errors[2] / 0.1 - 1.0)
        assert words.startswith(begins) and f"its errors grow by {grown:.1f} %" in words


def test_batches_turn_and_mirror_maps_ends_and_targets_alike(made):
    """Each map has a mark at the start, and the target's only cheap block lies below it."""
    starts = np.array([(9.0, 100.0), (70.0, 20.0)], np.float32)
    planes = np.zeros((2, 2, 128, 128), np.uint8)
    excess = np.full((2, 16, 16), 255, np.uint8)
    for at, (row, col) in enumerate(starts.astype(int)):
        planes[at, 0, row, col] = 255
        excess[at, row // 8, col // 8] = 0
    samples = Samples(
        planes, np.arange(2, dtype=np.int32), starts, 127.0 - starts, excess,
        np.zeros((2, 16, 2), np.uint8),
    )  # fmt: skip
    batches = made.batches.Batches(samples, Spec("nnpp", 128), made.batches.TrainSettings(batch=2))
    swaps = set()
    for epoch in range(8):
        for maps, queries, targets in batches.epoch(epoch):
            for shown, query, target in zip(maps, queries, targets, strict=True):
                mark = np.unravel_index(shown[0].argmax(), (128, 128))
                peaks = [np.unravel_index(each.argmax(), (128, 128)) for each in query]
                assert mark in peaks
                swaps.add(peaks.index(mark))
                assert target[mark[0] // 8, mark[1] // 8] == 1.0 == target.sum()
    assert swaps == {0, 1}
