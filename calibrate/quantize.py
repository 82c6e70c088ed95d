"""An int8 model made from an fp32 model, and measured against it: speed, agreement, and the outcome
of searches.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import NDArray
from onnxruntime import quantization
from onnxruntime.quantization import QuantType

from nnpp_edge import __version__
from nnpp_edge.export.to_onnx import nodes_leading_to, quiet
from nnpp_edge.files import write_whole
from nnpp_edge.model.registry import Spec
from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.inference import InferenceMs, inference_ms, medians
from nnpp_edge.runtime.arrays import Array
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError, ModelError, OutputError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import METADATA_KEY
from nnpp_edge.terrain.dataset import Samples, read_known, read_recipe, read_samples
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.training.unseen import Fit, KnownValidator
from nnpp_edge.training.validation import Judgement, Validator

Floats = NDArray[np.float32]
Queries = Samples | KnownMaps
"""Labelled queries, or maps known by their blocks for a network that prices unseen ground."""
Judge = Callable[[Floats], Judgement | Fit]
OPERATORS = ("Conv", "Relu", "Add", "Resize", "Concat", "AveragePool", "MaxPool")
"""Kinds of nodes that have an int8 kernel on CPUs, so that their QDQ pairs disappear."""
HELD_OUT = 256
"""Queries to judge on, at most."""
WARM_UP = 10
ROUNDS = 150
"""Timings of each model before those that count, and these."""
WORTH_IT = 1.1
"""Times as fast as fp32 that int8 must be to be worth having."""
MOST_GAP = 0.3
"""The most that it may add to the mean gap, in percentage points."""
MOST_FAILED = 1
"""The most that it may take from the share of queries with a path inside the region, in %."""
MOST_DIFFERENCE = 0.005
"""Mean difference of the probabilities above which it is another network: about one of the region's
256 levels.
"""
MOST_ERROR = 2
"""The most by which the errors of prices may grow, in %."""
HELD_OUT_SHARE = 4
"""Of a data set's maps, one in this many is held out to judge on."""
LAYERS_COMPARED_ON = 4
"""Queries on which the layers of both models are compared."""


@dataclass(frozen=True)
class Comparison:
    """Two models on the same held-out queries."""

    queries: int
    mean_difference: float
    """Of the probabilities."""
    max_difference: float
    fp32: Judgement | Fit
    """Outcome of searches in its regions, at the model's factor on the threshold; or errors of
    prices.
    """
    int8: Judgement | Fit
    fp32_ms: InferenceMs
    """Medians of one query's inference."""
    int8_ms: InferenceMs

    @property
    def speed_up(self) -> InferenceMs:
        """How many times as fast int8 is, in both cases."""
        return InferenceMs(
            self.fp32_ms.warm / self.int8_ms.warm,
            self.fp32_ms.after_plan / self.int8_ms.after_plan,
        )

    def recommendation(self) -> str:
        """One plain sentence that begins with ``int8`` or ``keep fp32``."""
        gain = self.speed_up
        as_fast = f"{gain.warm:.2f} times as fast warm and {gain.after_plan:.2f} right after a plan"
        wanted = [(gain.warm >= WORTH_IT, f"and {WORTH_IT} warm is wanted")]
        if isinstance(self.fp32, Judgement) and isinstance(self.int8, Judgement):
            more = 100 * (self.int8.gap - self.fp32.gap)
            fewer = 100 * (self.fp32.success - self.int8.success)
            change = f"the cost gap changes by {more:+.2f} points"
            wanted += [
                (
                    more <= MOST_GAP,
                    f"but the cost gap grows by {more:.2f} points, and {MOST_GAP} are allowed",
                ),
                (
                    fewer <= MOST_FAILED,
                    f"but finds a path inside its region on {fewer:.1f} % fewer of the queries, "
                    f"and {MOST_FAILED} % is allowed",
                ),
                (
                    self.mean_difference <= MOST_DIFFERENCE,
                    f"but its probabilities differ by {self.mean_difference:.4f}: leave nodes "
                    "float (--exclude)",
                ),
            ]
        else:
            errors = zip(astuple(self.fp32), astuple(self.int8), strict=True)
            growth = 100 * max(after / before - 1.0 for before, after in errors)
            change = f"its errors grow by {growth:.1f} %"
            wanted.append((growth <= MOST_ERROR, f"but {change}, and {MOST_ERROR} % is allowed"))
        for holds, why_not in wanted:
            if not holds:
                return f"keep fp32: on this machine int8 is {as_fast}, {why_not}."
        return f"int8: {as_fast} on this machine, and {change}."


@dataclass(frozen=True)
class Layer:
    """A convolution, and how far int8 is from fp32 behind it."""

    name: str
    quantised: bool
    error: float
    """Root mean square difference of its outputs, as a share of the fp32 outputs' root mean square:
    its own error and what the layers before it pass on.
    """


@dataclass(frozen=True)
class QuantizeReport:
    """The model made, and how it compares with the model that it was made from."""

    source: str
    output: str
    samples: int
    """Queries that it was calibrated on."""
    held_out_maps: tuple[int, ...]
    """Numbers of the data set's maps that it was judged on instead of a validation set's."""
    excluded: tuple[str, ...]
    """Nodes left float, beside those of the head."""
    quantised: int
    """Convolutions in int8."""
    layers: tuple[Layer, ...]
    """All convolutions but those in a branch, as of `edge`'s head."""
    fp32_bytes: int
    int8_bytes: int
    compared: Comparison
    recommendation: str

    def to_json(self) -> str:
        """One line of JSON; null for what has no number."""
        return msgspec.json.encode(self).decode()


def quantize(
    model: Path,
    dataset: Path,
    output: Path,
    *,
    validation: Path | None = None,
    samples: int = 200,
    exclude: Sequence[str] = (),
    seed: int = 1,
) -> QuantizeReport:
    """Make an int8 model (static, QDQ) of an fp32 file or a shipped model, and measure it against
    its source.

    The `output` is written last, whole or not at all, whatever the recommendation. It is calibrated
    on so many `samples` of `dataset`, queries drawn at random, and judged on `validation`, without
    that on a quarter of `dataset`'s maps, which is held out.

    The nodes in `exclude` stay float, and the head (the last convolution and what does not lead to
    it): it costs next to nothing, and its error would be that of the probabilities. The rest are
    measured choices (docs/decisions/papers-network.md).
    """
    if not output.parent.is_dir():
        raise OutputError(f"{output}: its folder does not exist")
    fp32 = NetworkModel(model)
    precision = fp32.metadata.precision
    if precision != "fp32":
        raise ModelError(f"{fp32.path}: wanted an fp32 model, got one of {precision}")
    if output.resolve() == fp32.path.resolve():
        raise InvalidQueryError(f"{output}: wanted another file than the fp32 model")
    calibration, held_out, judge, maps = _data(fp32, dataset, validation, samples, seed)
    facts = {
        "samples": len(calibration),
        "seed": seed,
        "dataset_seed": read_recipe(dataset).seed,
        "method": "minmax",
        "reduce_range": True,
        "excluded": list(exclude),
        "versions": {
            "nnpp_edge": __version__,
            "onnxruntime": ort.__version__,
            "onnx": onnx.__version__,
        },
    }
    with TemporaryDirectory() as folder:
        made, layers = quantised_graph(fp32, calibration, Path(folder), exclude)
        path = Path(folder) / "int8.onnx"
        path.write_bytes(_with_facts(made, fp32, facts))
        compared = compare(fp32, NetworkModel(path), held_out, judge)
    facts["agreement"] = {
        "queries": compared.queries,
        "mean_difference": compared.mean_difference,
        "max_difference": compared.max_difference,
    }
    content = _with_facts(made, fp32, facts)
    write_whole(output, content)
    return QuantizeReport(
        source=str(fp32.path),
        output=str(output),
        samples=len(calibration),
        held_out_maps=tuple(maps),
        excluded=tuple(exclude),
        quantised=sum(layer.quantised for layer in layers),
        layers=layers,
        fp32_bytes=fp32.path.stat().st_size,
        int8_bytes=len(content),
        compared=compared,
        recommendation=compared.recommendation(),
    )


def _data(
    fp32: NetworkModel,
    dataset: Path,
    validation: Path | None,
    samples: int,
    seed: int,
) -> tuple[Queries, Queries, Judge, list[int]]:
    """Queries to calibrate on and to judge on, their judge, and the maps of `dataset` that are held
    out for it.
    """
    m = fp32.metadata
    if m.encoding == "unseen":
        maps = read_known(dataset)
        calibration = KnownValidator(maps.pick(slice(0, None, 2)), samples)
        numbers = [] if validation else list(range(1, len(maps), 2))
        judged_on = read_known(validation) if validation else maps.pick(np.array(numbers))
        known = KnownValidator(judged_on, HELD_OUT)
        return calibration.shown, known.shown, known.judge_answers, numbers
    pool = read_samples(dataset, most_maps=2 * samples, size=m.input_size)
    if validation:  # searched on the maps as they are held, as in training
        others = read_samples(validation)
    else:
        pool, others = split(pool, seed)
    order = np.random.default_rng([seed, 1]).permutation(len(pool))
    validator = Validator(others, Spec(m.architecture, m.input_size, m.sigma), m.omega, HELD_OUT)

    def judge(answers: Floats) -> Judgement:
        return validator.judge_answers(answers, (m.region_factor,))[0]

    numbers = [] if validation else np.unique(others.map_index).tolist()
    return pool.pick(order[:samples]), validator.shown, judge, numbers


def split(samples: Samples, seed: int) -> tuple[Samples, Samples]:
    """Queries to calibrate on and queries to judge on, of different maps; DataSetError where all
    are on one map.
    """
    maps = np.random.default_rng([seed, 0]).permutation(np.unique(samples.map_index))
    if len(maps) < 2:
        raise DataSetError(f"wanted queries on at least two maps, got {len(maps)}")
    held_out = np.isin(samples.map_index, maps[: -(-len(maps) // HELD_OUT_SHARE)])
    return samples.pick(~held_out), samples.pick(held_out)


def quantised_graph(
    fp32: NetworkModel, queries: Queries, folder: Path, exclude: Sequence[str] = ()
) -> tuple[onnx.ModelProto, tuple[Layer, ...]]:
    """A model's int8 variant, calibrated on all of the queries, and its convolutions.

    The `folder` is for the files in between. ModelError where `exclude` names a node that does not
    exist.
    """
    prepared = folder / "prepared.onnx"
    target = folder / "quantised.onnx"
    with quiet():
        try:
            quantization.quant_pre_process(fp32.path, prepared)
        # it cannot follow ReduceMax over axes given as an input; plain inference can
        except Exception:
            quantization.quant_pre_process(fp32.path, prepared, skip_symbolic_shape=True)
        nodes = onnx.load(prepared).graph.node
        convolutions = [node for node in nodes if node.op_type == "Conv"]
        if not convolutions:
            raise ModelError(f"{fp32.path}: wanted a network with convolutions, got one without")
        before_head = nodes_leading_to(convolutions[-1].input, nodes)
        chosen = [node.name for node in convolutions if node.name in before_head]
        unknown = set(exclude) - {node.name for node in nodes}
        if unknown:
            raise ModelError(
                f"wanted nodes out of {', '.join(chosen)}, got {', '.join(sorted(unknown))}"
            )
        head = [node.name for node in nodes if node.name not in before_head]
        quantization.quantize_static(
            prepared,
            target,
            _Reader(fp32, queries),
            op_types_to_quantize=list(OPERATORS),
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            nodes_to_exclude=[*head, *exclude],
        )
    made = onnx.load(target)
    # onnxruntime's sort overlooks what branches read
    made.graph.node.sort(key=lambda node: node.op_type == "If")
    in_int8 = set(chosen) - set(exclude)
    inputs = list(islice(inputs_of(fp32, queries), LAYERS_COMPARED_ON))
    names = [node.name for node in convolutions]
    exact = _behind(names, onnx.load(prepared), inputs)
    rounded = _behind(names, made, inputs)
    errors = map(_relative_error, exact, rounded)
    layers = tuple(
        Layer(name, name in in_int8, error) for name, error in zip(names, errors, strict=True)
    )
    return made, layers


def _behind(
    names: Sequence[str], model: onnx.ModelProto, inputs: Sequence[dict[str, Array]]
) -> list[Floats]:
    """The outputs of a graph's nodes for all inputs, by the nodes' names."""
    of_node = {node.name: node.output[0] for node in model.graph.node}
    shown = onnx.ModelProto()
    shown.CopyFrom(model)
    wanted = [of_node[name] for name in names]
    shown.graph.output.extend(onnx.ValueInfoProto(name=name) for name in wanted)
    session = ort.InferenceSession(shown.SerializeToString(), providers=["CPUExecutionProvider"])
    found = [session.run(wanted, each) for each in inputs]
    return [np.array(each) for each in zip(*found, strict=True)]


def _relative_error(exact: Floats, rounded: Floats) -> float:
    return float(np.linalg.norm(rounded - exact) / np.linalg.norm(exact))


class _Reader(quantization.CalibrationDataReader):  # type: ignore[misc]  # onnxruntime has no types
    """`inputs_of` for onnxruntime."""

    def __init__(self, model: NetworkModel, queries: Queries) -> None:
        self._inputs = inputs_of(model, queries)

    def get_next(self) -> dict[str, Array] | None:
        """The next query's inputs by name; None at the end."""
        return next(self._inputs, None)


def inputs_of(model: NetworkModel, queries: Queries) -> Iterator[dict[str, Array]]:
    """Inputs of a network for each query, by name, as `model` lays them out."""
    for number in range(len(queries)):
        shown(model, queries, number)()  # lays out the inputs
        yield {name: array.copy() for name, array in model.inputs.items()}


def _with_facts(model: onnx.ModelProto, fp32: NetworkModel, facts: Mapping[str, object]) -> bytes:
    """The file: our metadata with facts on the calibration, no operator sets but those in use, and
    checked.
    """
    training = {**fp32.metadata.training, "calibration": dict(facts)}
    metadata = replace(fp32.metadata, precision="int8", training=training)
    onnx.helper.set_model_props(model, {METADATA_KEY: metadata.to_json()})
    used = {node.domain or "ai.onnx" for node in model.graph.node}
    versions = [each for each in model.opset_import if (each.domain or "ai.onnx") in used]
    del model.opset_import[:]
    model.opset_import.extend(versions)
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def compare(fp32: NetworkModel, int8: NetworkModel, queries: Queries, judge: Judge) -> Comparison:
    """Compare two models on the queries, and time each `ROUNDS` times."""
    exact = answers(fp32, queries)
    rounded = answers(int8, queries)
    difference = np.abs(exact - rounded)
    return Comparison(
        len(queries),
        float(difference.mean()),
        float(difference.max()),
        judge(exact),
        judge(rounded),
        *times_ms(fp32, int8, queries),
    )


def shown(model: NetworkModel, queries: Queries, number: int) -> Callable[[], Floats]:
    """Show a network the map of a query, or a map known by its blocks; a function that runs all of
    it at each call. Inputs and answers stay until the next call of this one.
    """
    if isinstance(queries, KnownMaps):
        rows, cols = queries.heights[number].shape
        queries.encode(number, model.inputs["input"][0, :, :rows, :cols])
        return lambda: model.answers()[:, :rows, :cols]
    planes, start, goal = queries.query(number)
    model.set_map(planes)
    return partial(model.answer, start, goal, anew=True)


def answers(model: NetworkModel, queries: Queries) -> Floats:
    """(Q, B, B) probabilities of queries, or (Q, 3, B, B) answers for maps known by blocks."""
    return np.array([shown(model, queries, number)().copy() for number in range(len(queries))])


def times_ms(
    one: NetworkModel, other: NetworkModel, queries: Queries
) -> tuple[InferenceMs, InferenceMs]:
    """Medians of two models' inference in turns on the same queries, so that whatever else the
    machine does slows both.
    """
    harness = Harness()
    times = []
    for at in range(WARM_UP + ROUNDS):
        query = at % len(queries)
        runs = {"one": shown(one, queries, query), "other": shown(other, queries, query)}
        times.append(inference_ms(runs, harness))
    ours, theirs = (medians([each[name] for each in times[WARM_UP:]]) for name in ("one", "other"))
    return ours, theirs
