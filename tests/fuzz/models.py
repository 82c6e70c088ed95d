"""Model files: flipped bits, odd metadata, odd graphs, data outside the file, graphs that never end."""

import json
import random
from typing import Any

from tests.fuzz.cases import Place
from tests.fuzz.commands import Command
from tests.fuzz.files import MAP, PLAN
from tests.fuzz.mutations import junk_value, mutated, mutated_json
from tests.fuzz.options import disturbed

_READERS = {
    f"{PLAN} --method nnpp --model in/own.onnx": 5.0,
    f"{PLAN} --method auto --model in/own.onnx": 1.0,
    "models in/own.onnx": 2.0,
    "models in/own.onnx --json": 1.0,
    f"{MAP} --method nnpp --model in/own.onnx --input replay:in/drive.jsonl --fast": 2.0,
    "simulate --map in/dem.npz --size 16 --ticks 3 --method nnpp-dstar --model in/own.onnx": 1.0,
    "evaluate --terrain in/dem.npz --sizes 16 --queries 1 --methods nnpp --model in/own.onnx": 0.5,
}


def generate(rng: random.Random, place: Place) -> Command:
    """A command that loads a model which may not be what it seems."""
    words, kind = rng.choices(list(_READERS), list(_READERS.values()))[0], rng.random()
    if place.heavy and rng.random() < 0.04:
        words = "quantize in/own.onnx --dataset in/set -o out/int8.onnx --samples 2"
    if kind < 0.45:
        content = mutated(rng, place.sample("edge64.onnx" if kind < 0.05 and place.heavy else "tiny.onnx"))
    else:
        content = (_odd_metadata if kind < 0.75 else _odd_graph)(rng, place)
    files = {"in/own.onnx": content} | ({"in/own.onnx.data": bytes(64)} if rng.random() < 0.05 else {})
    needs = ("dem.npz", "drive.jsonl", *["set"] * place.heavy)
    return disturbed(rng, Command(tuple(words.split()), files, needs))


def _load(place: Place) -> Any:
    import onnx

    return onnx.load_from_string(place.sample("tiny.onnx"))


def _odd_metadata(rng: random.Random, place: Place) -> bytes:
    """The metadata's values changed, or something else in its place."""
    from onnx import helper

    from nnpp_edge.runtime.network.model_file import METADATA_KEY

    model = _load(place)
    stored = {prop.key: prop.value for prop in model.metadata_props}
    content = stored.pop(METADATA_KEY).encode()
    known = json.loads(content)
    known[rng.choice(list(known))] = junk_value(rng)
    content = json.dumps(known).encode() if rng.random() < 0.5 else mutated_json(rng, content)
    if rng.random() < 0.9:
        stored[METADATA_KEY] = content.decode("utf-8", "replace")
    stored |= {"x" * 3000: "y"} if rng.random() < 0.05 else {}
    helper.set_model_props(model, stored)
    return bytes(model.SerializeToString())


def _odd_graph(rng: random.Random, place: Place) -> bytes:
    """A graph that loads but fails, waits, or answers nonsense."""
    from onnx import TensorProto, helper

    model = _load(place)
    graph = model.graph
    values, nodes = [*graph.input, *graph.output], graph.node

    def loops() -> None:
        """Without an end."""
        kinds = (("i", TensorProto.INT64), ("go", TensorProto.BOOL), ("go_on", TensorProto.BOOL))
        *taken, given = (helper.make_tensor_value_info(name, kind, ()) for name, kind in kinds)
        body = helper.make_graph([helper.make_node("Identity", ["go"], ["go_on"])], "body", taken, [given])
        graph.initializer.append(helper.make_tensor("forever", TensorProto.INT64, (), [2**62]))
        graph.initializer.append(helper.make_tensor("yes", TensorProto.BOOL, (), [True]))
        nodes.append(helper.make_node("Loop", ["forever", "yes"], [], body=body))

    def data_outside() -> None:
        tensor = rng.choice(graph.initializer)
        tensor.ClearField("raw_data")
        tensor.data_location = TensorProto.EXTERNAL
        places = ("/etc/passwd", "../../../../etc/passwd", "own.onnx.data", "missing", "/dev/zero", "", "in/dem.npz")
        facts = {"location": rng.choice(places), "offset": rng.choice(("0", "-1", "9" * 30)), "length": "4"}
        for key, value in facts.items():
            entry = tensor.external_data.add()
            entry.key, entry.value = key, value

    def other_shape() -> None:
        dim = rng.choice([dim for value in values for dim in value.type.tensor_type.shape.dim])
        if rng.random() < 0.3:
            dim.dim_param = "n"
        else:
            dim.dim_value = rng.choice((0, -1, 1, 2, 63, 65, 2**31, 2**62))

    def other_name() -> None:
        rng.choice(values).name = rng.choice(("", "x", "cost", "input", "probability", "é"))

    def no_number() -> None:
        tensor = next(t for t in graph.initializer if t.name in ("half", "slope"))
        value = rng.choice((float("nan"), float("inf"), -1e38, 1e38))
        tensor.CopyFrom(helper.make_tensor(tensor.name, 1, (), [value]))

    def other_operation() -> None:
        rng.choice(nodes).op_type = rng.choice((*str.split("Nope Add MatMul Reshape Concat NonZero Gather"), ""))

    def operation_missing() -> None:
        nodes.remove(rng.choice(nodes))

    def fails() -> None:
        """When it is run."""
        graph.initializer.append(helper.make_tensor("side", TensorProto.INT64, (2,), [7, 7]))
        nodes[-1].output[0] = "whole"
        nodes.append(helper.make_node("Reshape", ["whole", "side"], ["probability"]))

    def other_version() -> None:
        model.opset_import[0].version = rng.choice((0, 1, 5, 99, 2**31))
        model.ir_version = rng.choice((0, 3, 10, 99))

    kinds = (loops, data_outside, other_shape, other_name, no_number, other_operation, operation_missing, fails)
    rng.choice((*kinds, other_version))()
    return bytes(model.SerializeToString())
