"""What is written about a model and advised of it, without the networks: torch, which takes seconds
to import, is a stand-in.
"""

import math
import sys
from importlib import import_module
from types import SimpleNamespace
from unittest.mock import MagicMock

import onnx
import pytest

from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.network.model_file import ModelMetadata
from nnpp_edge.runtime.terrain.traversability import Traversability
from tests.conftest import TINY_MODEL

MADE = ("export.to_onnx", "calibrate.quantize")
STAND_INS = ("torch", "torch.nn", "torch.utils", "torch.utils.flop_counter", "onnxscript")
ROOMS = ("calibrate", "export", "model", "training")
HEAVY = (*STAND_INS, *(f"nnpp_edge.{name}." for name in ROOMS))


@pytest.fixture(scope="module")
def made():
    """The modules that export and quantise."""

    def taken():
        return {name: sys.modules.pop(name) for name in list(sys.modules) if name.startswith(HEAVY)}

    rooms = [vars(import_module(f"nnpp_edge.{name}")) for name in ROOMS]
    names = [dict(room) for room in rooms]
    real = taken()
    torch = MagicMock()
    torch.nn.Module = object
    sys.modules.update(dict.fromkeys(STAND_INS, torch))
    yield SimpleNamespace(**{name: import_module(f"nnpp_edge.{name}") for name in MADE})
    taken()
    sys.modules.update(real)
    for room, own in zip(rooms, names, strict=True):  # `from nnpp_edge.model import edge` reads it
        room.clear()
        room.update(own)


def test_a_model_says_how_the_maps_were_made_that_it_was_trained_on(made, tmp_path):
    export = vars(made)["export.to_onnx"]
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


def test_the_recommendation_weighs_speed_cost_and_agreement(made):
    of = vars(made)["calibrate.quantize"]

    def advice(fp32, int8, int8_ms=1.0, difference=0.001):
        times = of.InferenceMs(2.0, 2.0), of.InferenceMs(int8_ms, int8_ms)
        return of.Comparison(9, difference, 0.1, fp32, int8, *times).recommendation()

    def of_searches(gap, success=1.0, **more):
        judged = (
            of.Judgement(0.5, *each, 0.1, 0.1, 0.1) for each in ((1.0, 0.002), (success, gap))
        )
        return advice(*judged, **more)

    as_fast = "2.00 times as fast warm and 2.00 right after a plan"
    said = f"int8: {as_fast} on this machine, and the cost gap changes by +0.20 points."
    assert of_searches(0.004) == said
    assert "and 1.1 warm is wanted" in of_searches(0.002, int8_ms=2.0)
    assert "grows by 0.40 points" in of_searches(0.006)
    assert "keep fp32" in of_searches(math.inf)
    assert "2.0 % fewer of the queries" in of_searches(0.002, success=0.98)
    assert "differ by 0.0100" in of_searches(0.002, difference=0.01)
    for most, begins in ((0.101, "int8"), (0.11, "keep fp32")):
        words = advice(of.Fit(0.1, 0.2, 0.1, 0.1), of.Fit(0.1, 0.2, most, 0.1))
        grown = 100.0 * (most / 0.1 - 1.0)
        assert words.startswith(begins) and f"its errors grow by {grown:.1f} %" in words
