"""An int8 model made from an fp32 model, and measured against it: speed, agreement, and what a
search makes of it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
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
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError, ModelError, OutputError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import METADATA_KEY
from nnpp_edge.terrain.dataset import Samples, read_known, read_recipe, read_samples
from nnpp_edge.training.unseen import Fit, KnownValidator
from nnpp_edge.training.validation import Judgement, Validator

Floats = NDArray[np.float32]
Judge = Callable[[Floats], Sequence[Judgement | Fit]]
OPERATORS = ("Conv", "Relu", "Add", "Resize", "Concat", "AveragePool", "MaxPool")
"""Kinds of nodes that have an int8 kernel on CPUs, so that their QDQ pairs disappear."""
HELD_OUT = 256
"""Queries to judge on, at most."""
ROUNDS = 300
"""Timed runs of each model."""
WORTH_IT = 1.1
"""Times as fast as fp32 that int8 must be to be worth having."""
GAP_LIMIT = 0.003
"""The most that it may add to the mean gap (0.3 percentage points)."""
SUCCESS_LIMIT = 0.01
"""The most that it may take from the share of queries with a path inside the region."""
DIFFERENCE_LIMIT = 0.005
"""Mean difference of the probabilities from which on it is another network: about one of the
region's 256 levels.
"""
ERROR_LIMIT = 0.02
"""The most by which the errors of prices may grow, as a share of them."""
HELD_OUT_SHARE = 4
"""Of a data set's maps, one in this many is held out to judge on."""


@dataclass(frozen=True)
class Latency:
    """Of one query's inference."""

    median_ms: float
    p99_ms: float


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
    fp32_latency: Latency
    int8_latency: Latency

    @property
    def speed_up(self) -> float:
        return self.fp32_latency.median_ms / self.int8_latency.median_ms

    def recommendation(self) -> str:
        """One plain sentence that begins with ``int8`` or ``keep fp32``."""
        as_fast = f"{self.speed_up:.2f} times as fast"
        checks = [(self.speed_up >= WORTH_IT, f"and {WORTH_IT} is wanted")]
        if isinstance(self.fp32, Judgement) and isinstance(self.int8, Judgement):
            more = self.int8.gap - self.fp32.gap
            fewer = self.fp32.success - self.int8.success
            grows = (
                f"but the cost gap grows by {100 * more:.2f} points, and "
                f"{100 * GAP_LIMIT:.1f} are allowed"
            )
            misses = (
                f"but finds a path inside its region on {100 * fewer:.1f} % fewer of the queries"
            )
            differs = (
                f"but its probabilities differ by {self.mean_difference:.4f}: leave nodes "
                "float (--exclude)"
            )
            checks.append((more <= GAP_LIMIT, grows))
            checks.append(
                (fewer <= SUCCESS_LIMIT, f"{misses}, and {100 * SUCCESS_LIMIT:.0f} % is allowed")
            )
            checks.append((self.mean_difference <= DIFFERENCE_LIMIT, differs))
            change = f"the cost gap changes by {100 * more:+.2f} points"
        else:
            errors = zip(astuple(self.fp32), astuple(self.int8), strict=True)
            change = (
                f"its errors grow by {100 * (grown := max(b / a - 1.0 for a, b in errors)):.1f} %"
            )
            checks.append(
                (grown <= ERROR_LIMIT, f"but {change}, and {100 * ERROR_LIMIT:.0f} % is allowed")
            )
        for holds, why in checks:
            if not holds:
                return f"keep fp32: on this machine int8 is {as_fast}, {why}."
        return f"int8: {as_fast} on this machine, and {change}."


@dataclass(frozen=True)
class QuantizeReport:
    """The model made, and how it compares with the model that it was made from."""

    source: str
    output: str
    samples: int
    """Queries that it was calibrated on."""
    excluded: tuple[str, ...]
    """Nodes left float, beside those of the head."""
    quantised: int
    """Convolutions in int8."""
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
    rounds: int = ROUNDS,
) -> QuantizeReport:
    """Make an int8 model (static, QDQ) of an fp32 file or a shipped model, and measure it against
    its source.

    The `output` is written last, whole or not at all, whatever the recommendation. It is calibrated
    on so many `samples` of `dataset`, queries drawn at random, and judged on `validation`, without
    that on a quarter of `dataset`'s maps, which is held out. Each model is timed `rounds` times.

    The nodes in `exclude` stay float, and the head (the last convolution and what does not lead to
    it): it costs next to nothing, and its error would be that of the probabilities. The rest are
    measured choices (docs/decisions/papers-network.md).
    """
    if not output.parent.is_dir():
        raise OutputError(f"{output}: its folder does not exist")
    fp32 = NetworkModel(model)
    m = fp32.metadata
    if m.precision != "fp32":
        raise ModelError(f"{fp32.path}: wanted an fp32 model, got one of {m.precision}")
    if output.resolve() == fp32.path.resolve():
        raise InvalidQueryError(f"{output}: wanted another file than the fp32 model")
    calibration: Samples | Floats
    held_out: Samples | Floats
    judge: Judge
    if m.encoding == "unseen":
        maps = read_known(dataset)
        known = KnownValidator(
            read_known(validation) if validation else maps.pick(slice(1, None, 2)), HELD_OUT
        )
        calibration = KnownValidator(maps.pick(slice(0, None, 2)), samples).planes
        held_out = known.planes
        judge = known.judge_answers
    else:
        pool = read_samples(dataset, most_maps=2 * samples, size=m.input_size)
        pool, other = (
            (pool, read_samples(validation, size=m.input_size)) if validation else split(pool, seed)
        )
        calibration = pool.pick(np.random.default_rng([seed, 1]).permutation(len(pool))[:samples])
        validator = Validator(other, Spec(m.architecture, m.input_size, m.sigma), m.omega, HELD_OUT)
        held_out = other.pick(validator.index)
        judge = partial(validator.judge_probabilities, factors=(m.region_factor,))
    versions = {"nnpp_edge": __version__, "onnxruntime": ort.__version__, "onnx": onnx.__version__}
    facts: dict[str, object] = {
        "samples": len(calibration),
        "seed": seed,
        "dataset_seed": read_recipe(dataset).seed,
    }
    facts |= {
        "method": "minmax",
        "reduce_range": True,
        "excluded": list(exclude),
        "versions": versions,
    }
    with TemporaryDirectory() as folder:
        made, quantised = quantised_graph(fp32, calibration, Path(folder), exclude)
        path = Path(folder) / "int8.onnx"
        path.write_bytes(_with_facts(made, fp32, facts))
        compared = compare(fp32, NetworkModel(path), held_out, judge, rounds)
    figures = {
        name: getattr(compared, name) for name in ("queries", "mean_difference", "max_difference")
    }
    content = _with_facts(made, fp32, facts | {"agreement": figures})
    write_whole(output, content)
    source = str(fp32.path)
    sizes = (fp32.path.stat().st_size, len(content))
    told = compared, compared.recommendation()
    return QuantizeReport(
        source, str(output), len(calibration), tuple(exclude), quantised, *sizes, *told
    )


def quantised_graph(
    fp32: NetworkModel, samples: Samples | Floats, folder: Path, exclude: Sequence[str] = ()
) -> tuple[onnx.ModelProto, int]:
    """A model's int8 variant, calibrated on all of `samples`, and the number of convolutions in
    int8.

    The `folder` is for the files in between. ModelError where `exclude` names a node that is not
    there.
    """
    prepared = folder / "prepared.onnx"
    target = folder / "quantised.onnx"
    with quiet():
        try:
            quantization.quant_pre_process(fp32.path, prepared)
        except (
            Exception
        ):  # it cannot follow ReduceMax over axes given as an input; plain inference can
            quantization.quant_pre_process(fp32.path, prepared, skip_symbolic_shape=True)
        graph = onnx.load(prepared).graph
        convolutions = [node for node in graph.node if node.op_type == "Conv"]
        if not convolutions:
            raise ModelError(f"{fp32.path}: wanted a network with convolutions, got one without")
        before_head = nodes_leading_to(convolutions[-1].input, graph)
        chosen = [node.name for node in convolutions if node.name in before_head]
        if unknown := set(exclude) - {node.name for node in graph.node}:
            raise ModelError(
                f"wanted nodes out of {', '.join(chosen)}, got {', '.join(sorted(unknown))}"
            )
        quantization.quantize_static(
            prepared,
            target,
            _Reader(fp32, samples),
            op_types_to_quantize=list(OPERATORS),
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            nodes_to_exclude=[
                *(node.name for node in graph.node if node.name not in before_head),
                *exclude,
            ],
        )
    made = onnx.load(target)
    made.graph.node.sort(
        key=lambda node: node.op_type == "If"
    )  # onnxruntime's sort overlooks what branches read
    return made, len(set(chosen) - set(exclude))


class _Reader(quantization.CalibrationDataReader):  # type: ignore[misc]  # onnxruntime has no types
    """Inputs of a network for all queries of `samples`, one at a time, as `model` lays them out."""

    def __init__(self, model: NetworkModel, samples: Samples | Floats) -> None:
        self.model = model
        self.samples = samples
        self.queries = iter(range(len(samples)))

    def get_next(self) -> dict[str, NDArray[np.generic]] | None:
        """The next query's inputs by name; None at the end."""
        for query in self.queries:
            shown(self.model, self.samples, query)()  # lays out the inputs
            return {name: array.copy() for name, array in self.model.inputs.items()}
        return None


def _with_facts(model: onnx.ModelProto, fp32: NetworkModel, facts: Mapping[str, object]) -> bytes:
    """The file: our metadata with facts on the calibration, no operator sets but those in use, and
    checked.
    """
    training = fp32.metadata.training | {"calibration": dict(facts)}
    metadata = replace(fp32.metadata, precision="int8", training=training)
    onnx.helper.set_model_props(model, {METADATA_KEY: metadata.to_json()})
    used = {node.domain for node in model.graph.node}
    versions = [
        o for o in model.opset_import if o.domain in used or (o.domain == "ai.onnx" and "" in used)
    ]
    del model.opset_import[:]
    model.opset_import.extend(versions)
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def compare(
    fp32: NetworkModel, int8: NetworkModel, samples: Samples | Floats, judge: Judge, rounds: int
) -> Comparison:
    """Compare two models on the queries, or planes, and time each `rounds` times."""
    p = answers(fp32, samples)
    q = answers(int8, samples)
    difference, (one,), (other,) = np.abs(p - q), judge(p), judge(q)
    figures = float(difference.mean()), float(difference.max())
    return Comparison(len(samples), *figures, one, other, *latencies(fp32, int8, samples, rounds))


def shown(model: NetworkModel, samples: Samples | Floats, query: int) -> Callable[[], Floats]:
    """Show a network the map of a query, or planes; what runs it. Inputs and answers stay until the
    next.
    """
    if isinstance(samples, np.ndarray):
        rows, cols = samples.shape[2:]
        model.inputs["input"][0, :, :rows, :cols] = samples[query]
        return lambda: model.answers()[:, :rows, :cols]
    planes, start, goal = samples.query(query)
    model.set_map(planes)
    return partial(model.answer, start, goal)


def answers(model: NetworkModel, samples: Samples | Floats) -> Floats:
    """Of all the queries, (Q, B, B) probabilities, or planes, (Q, 3, B, B)."""
    return np.array([shown(model, samples, query)().copy() for query in range(len(samples))])


def latencies(
    one: NetworkModel, other: NetworkModel, samples: Samples | Floats, rounds: int
) -> tuple[Latency, Latency]:
    """Time two models in turns on the same queries, so that whatever else the machine does slows
    both.
    """
    times: tuple[list[float], list[float]] = ([], [])
    models = (one, other)
    for at in range(-max(3, rounds // 10), rounds):
        for which in (0, 1) if at % 2 else (1, 0):
            run = shown(models[which], samples, at % len(samples))
            started = time.perf_counter()
            run()
            if at >= 0:
                times[which].append(1e3 * (time.perf_counter() - started))
    a, b = (Latency(float(np.median(t)), float(np.percentile(t, 99))) for t in times)
    return a, b


def split(samples: Samples, seed: int) -> tuple[Samples, Samples]:
    """Queries to calibrate on and queries to judge on, of different maps; DataSetError where all
    are on one map.
    """
    maps = np.random.default_rng([seed, 0]).permutation(np.unique(samples.map_index))
    if len(maps) < 2:
        raise DataSetError(f"wanted queries on at least two maps, got {len(maps)}")
    held_out = np.isin(samples.map_index, maps[: -(-len(maps) // HELD_OUT_SHARE)])
    return samples.pick(~held_out), samples.pick(held_out)
