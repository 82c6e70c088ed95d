"""Model files: flipped bits, odd metadata, odd graphs, data outside the file, graphs that never end."""

import json
import random
from pathlib import Path
from typing import Any

from tests.fuzz.commands import Command
from tests.fuzz.files import MAP, PLAN
from tests.fuzz.mutations import junk_value, mutated, mutated_json
from tests.fuzz.options import disturbed

NAME = "models"
_FILE = "in/own.onnx"
_READERS = (
    ((*PLAN, "--method", "nnpp", "--model", _FILE), 5.0),
    ((*PLAN, "--method", "auto", "--model", _FILE), 1.0),
    (("models", _FILE), 2.0),
    (("models", _FILE, "--json"), 1.0),
    ((*MAP[:3], "--method", "nnpp", "--model", _FILE, "--input", "replay:in/drive.jsonl", "--fast"), 2.0),
    (
        (
            "simulate",
            "--map",
            "in/dem.npz",
            "--size",
            "16",
            "--ticks",
            "3",
            "--method",
            "nnpp-dstar",
            "--model",
            _FILE,
        ),
        1.0,
    ),
    (
        (
            "evaluate",
            "--terrain",
            "in/dem.npz",
            "--sizes",
            "16",
            "--queries",
            "1",
            "--methods",
            "nnpp",
            "--model",
            _FILE,
        ),
        0.5,
    ),
)


def generate(rng: random.Random, samples: Path, heavy: bool = True) -> Command:
    """A command that loads a model which may not be what it seems."""
    words = rng.choices([words for words, _ in _READERS], [share for _, share in _READERS])[0]
    if heavy and rng.random() < 0.04:
        words = ("quantize", _FILE, "--dataset", "in/set", "-o", "out/int8.onnx", "--samples", "2")
    files = {_FILE: b""}
    kind = rng.random()
    if kind < 0.4:
        files[_FILE] = mutated(rng, (samples / "tiny.onnx").read_bytes())
    elif kind < 0.45 and heavy:
        files[_FILE] = mutated(rng, (samples / "edge64.onnx").read_bytes())
    elif kind < 0.75:
        files[_FILE] = _odd_metadata(rng, samples)
    else:
        files[_FILE] = _odd_graph(rng, samples)
    if rng.random() < 0.05:
        files["in/own.onnx.data"] = b"\x00" * 64
    return disturbed(
        rng, Command(words, files, needs=("dem.npz", "drive.jsonl", "set") if heavy else ("dem.npz", "drive.jsonl"))
    )


def _load(samples: Path) -> Any:
    import onnx

    return onnx.load(samples / "tiny.onnx")


def _odd_metadata(rng: random.Random, samples: Path) -> bytes:
    """The metadata's values changed, or something else in its place."""
    from onnx import helper

    from nnpp_edge.runtime.network.inference import METADATA_KEY

    model = _load(samples)
    stored = {prop.key: prop.value for prop in model.metadata_props}
    content = stored[METADATA_KEY].encode()
    if rng.random() < 0.5:
        known = json.loads(content)
        key = rng.choice(list(known))
        known[key] = junk_value(rng)
        content = json.dumps(known).encode()
    else:
        content = mutated_json(rng, content)
    if rng.random() < 0.1:
        stored.pop(METADATA_KEY)
    else:
        stored[METADATA_KEY] = content.decode("utf-8", "replace")
    stored |= {"x" * 3000: "y"} if rng.random() < 0.05 else {}
    helper.set_model_props(model, stored)
    return bytes(model.SerializeToString())


def _odd_graph(rng: random.Random, samples: Path) -> bytes:
    """A graph that loads but fails, waits, or answers nonsense."""
    from onnx import TensorProto, helper

    model = _load(samples)
    graph, kind = model.graph, rng.randrange(9)
    if kind == 0:  # a loop without an end
        body_in = [
            helper.make_tensor_value_info(n, t, ()) for n, t in (("i", TensorProto.INT64), ("go", TensorProto.BOOL))
        ]
        body_out = [helper.make_tensor_value_info("go_on", TensorProto.BOOL, ())]
        body = helper.make_graph([helper.make_node("Identity", ["go"], ["go_on"])], "body", body_in, body_out)
        graph.initializer.append(helper.make_tensor("forever", TensorProto.INT64, (), [2**62]))
        graph.initializer.append(helper.make_tensor("yes", TensorProto.BOOL, (), [True]))
        graph.node.append(helper.make_node("Loop", ["forever", "yes"], [], body=body))
        graph.node[-1].output.extend([])
    elif kind == 1:  # data outside the file
        tensor = graph.initializer[rng.randrange(len(graph.initializer))]
        tensor.ClearField("raw_data")
        tensor.data_location = TensorProto.EXTERNAL
        places = ("/etc/passwd", "../../../../etc/passwd", "own.onnx.data", "missing", "/dev/zero", "", "in/dem.npz")
        for key, value in (
            ("location", rng.choice(places)),
            ("offset", rng.choice(("0", "-1", "9" * 30))),
            ("length", "4"),
        ):
            entry = tensor.external_data.add()
            entry.key, entry.value = key, value
    elif kind == 2:  # other shapes
        value = rng.choice([*graph.input, *graph.output])
        dims = value.type.tensor_type.shape.dim
        if dims:
            dim = dims[rng.randrange(len(dims))]
            if rng.random() < 0.3:
                dim.dim_param = "n"
            else:
                dim.dim_value = rng.choice((0, -1, 1, 2, 63, 65, 2**31, 2**62))
    elif kind == 3:
        rng.choice([*graph.input, *graph.output]).name = rng.choice(("", "x", "cost", "input", "probability", "é"))
    elif kind == 4:  # numbers that are none
        tensor = next(t for t in graph.initializer if t.name in ("half", "slope"))
        tensor.CopyFrom(
            helper.make_tensor(tensor.name, 1, (), [rng.choice((float("nan"), float("inf"), -1e38, 1e38))])
        )
    elif kind == 5:
        node = graph.node[rng.randrange(len(graph.node))]
        node.op_type = rng.choice(("Nope", "Add", "MatMul", "Reshape", "Concat", "NonZero", "Gather", ""))
    elif kind == 6:
        graph.node.remove(graph.node[rng.randrange(len(graph.node))])
    elif kind == 7:  # fails when it is run
        graph.initializer.append(helper.make_tensor("side", TensorProto.INT64, (2,), [7, 7]))
        last = graph.node[-1]
        last.output[0] = "whole"
        graph.node.append(helper.make_node("Reshape", ["whole", "side"], ["probability"]))
    else:
        model.opset_import[0].version = rng.choice((0, 1, 5, 99, 2**31))
        model.ir_version = rng.choice((0, 3, 10, 99))
    return bytes(model.SerializeToString())
