"""An int8 model against the fp32 model that it was made from: speed, agreement, and what a search makes of it."""

import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import NDArray

from nnpp_edge.calibrate.calibration_set import feed, probabilities
from nnpp_edge.files import temporary_folder
from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.kernels.threshold import quantise
from nnpp_edge.runtime.network.encoding import Frame
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.region.threshold import RegionFinder, lowered
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.training.validation import Judgement, Validator

WORTH_IT = 1.1
"""Times as fast as fp32 that int8 must be to be worth having."""
GAP_LIMIT = 0.003
"""What it may add to the mean gap (0.3 percentage points)."""
SUCCESS_LIMIT = 0.01
"""What it may take from the share of queries with a path inside the region."""


@dataclass(frozen=True)
class Latency:
    """Of one query's inference, in milliseconds."""

    median_ms: float
    p99_ms: float


@dataclass(frozen=True)
class Agreement:
    """How two models' probabilities differ, over held-out queries."""

    queries: int
    mean_difference: float
    """Of the probabilities."""
    max_difference: float
    same_side: float
    """Share of the blocks that lie on the same side of the threshold that the fp32 probabilities set."""


@dataclass(frozen=True)
class Searches:
    """What searches in the regions of two models come to."""

    queries: int
    fp32: Judgement
    int8: Judgement


def latencies(one: NetworkModel, other: NetworkModel, samples: Samples, rounds: int) -> tuple[Latency, Latency]:
    """Time two models in turns on the same queries, so that whatever else the machine does slows both."""
    times: tuple[list[float], list[float]] = ([], [])
    models = (one, other)
    for at in range(-max(3, rounds // 10), rounds):
        for which in (0, 1) if at % 2 else (1, 0):
            feed(models[which], samples, at % len(samples))
            started = time.perf_counter()
            models[which].run()
            if at >= 0:
                times[which].append(1e3 * (time.perf_counter() - started))
    a, b = (Latency(float(np.median(t)), float(np.percentile(t, 99))) for t in times)
    return a, b


def agreement(fp32: NDArray[np.float32], int8: NDArray[np.float32], samples: Samples, factor: float) -> Agreement:
    """Compare probabilities (Q, B, B) for the queries of `samples`, at `factor` times the adaptive threshold."""
    blocks = fp32.shape[-1]
    finder, levels = RegionFinder(blocks), np.empty((blocks, blocks), np.uint8)
    size = samples.planes.shape[-1]
    lookup = Frame(size, size, size).lookup(blocks)[0]
    same = []
    for query in range(len(samples)):
        (r0, c0), (r1, c1) = (lookup[np.rint(p[query]).astype(int)].tolist() for p in (samples.start, samples.goal))
        finder.read(fp32[query])
        threshold = lowered(finder.threshold((r0, c0), (r1, c1)), factor)
        quantise(int8[query], levels)
        same.append(((finder.levels >= threshold) == (levels >= threshold)).mean())
    difference = np.abs(fp32 - int8)
    return Agreement(len(samples), float(difference.mean()), float(difference.max()), float(np.mean(same)))


def judge_both(fp32: NetworkModel, int8: NetworkModel, samples: Samples, most: int) -> Searches:
    """Search at most `most` of the queries in either's region, at the model's factor on the threshold."""
    m = fp32.metadata
    spec = Spec(m.architecture, m.input_size, m.sigma, encoding=m.encoding)
    validator = Validator(samples, spec, m.omega, most)
    queries = samples.pick(validator.index)
    found = (probabilities(model, queries) for model in (fp32, int8))
    a, b = (validator.judge_probabilities(p, (m.region_factor,))[0] for p in found)
    return Searches(len(queries), a, b)


def operators_left(path: Path) -> Counter[str]:
    """Kinds of nodes after onnxruntime's optimisation on this machine, and how many of each."""
    with temporary_folder() as folder:
        options = ort.SessionOptions()
        options.log_severity_level = 4
        options.optimized_model_filepath = str(folder / "optimised.onnx")
        ort.InferenceSession(str(path), options, ["CPUExecutionProvider"])
        graph = onnx.load(options.optimized_model_filepath).graph
    return Counter(node.op_type for node in graph.node)


def recommend(fp32: Latency, int8: Latency, searches: Searches) -> str:
    """One plain sentence that begins with ``int8`` or ``keep fp32``."""
    ratio = fp32.median_ms / int8.median_ms
    keep = f"keep fp32: on this machine int8 is {ratio:.2f} times as fast"
    if ratio < WORTH_IT:
        return f"{keep}, and {WORTH_IT} is wanted."
    more, fewer = searches.int8.gap - searches.fp32.gap, searches.fp32.success - searches.int8.success
    if not more <= GAP_LIMIT:
        return f"{keep}, but the cost gap grows by {100 * more:.2f} points, and {100 * GAP_LIMIT:.1f} are allowed."
    if fewer > SUCCESS_LIMIT:
        return (
            f"{keep}, but finds a path inside its region on {100 * fewer:.1f} % fewer of the queries, "
            f"and {100 * SUCCESS_LIMIT:.0f} % is allowed."
        )
    return f"int8: {ratio:.2f} times as fast on this machine, and the cost gap changes by {100 * more:+.2f} points."
