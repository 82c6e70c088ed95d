"""An int8 model against the fp32 model that it was made from: speed, agreement, and what a search makes of it."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.model.registry import Spec
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.terrain.dataset import Samples
from nnpp_edge.training.validation import Judgement, Validator

WORTH_IT = 1.1
"""Times as fast as fp32 that int8 must be to be worth having."""
GAP_LIMIT = 0.003
"""The most that it may add to the mean gap (0.3 percentage points)."""
SUCCESS_LIMIT = 0.01
"""The most that it may take from the share of queries with a path inside the region."""
DIFFERENCE_LIMIT = 0.005
"""Mean difference of the probabilities from which on it is another network: about one of the region's 256 levels."""
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
    fp32: Judgement
    """Outcome of searches in its regions, at the model's factor on the threshold."""
    int8: Judgement
    fp32_latency: Latency
    int8_latency: Latency

    @property
    def speed_up(self) -> float:
        """Ratio of the medians."""
        return self.fp32_latency.median_ms / self.int8_latency.median_ms

    def recommendation(self) -> str:
        """One plain sentence that begins with ``int8`` or ``keep fp32``."""
        more, fewer = self.int8.gap - self.fp32.gap, self.fp32.success - self.int8.success
        as_fast = f"{self.speed_up:.2f} times as fast"
        grows = f"but the cost gap grows by {100 * more:.2f} points, and {100 * GAP_LIMIT:.1f} are allowed"
        misses = f"but finds a path inside its region on {100 * fewer:.1f} % fewer of the queries"
        differs = f"but its probabilities differ by {self.mean_difference:.4f}: leave nodes float (--exclude)"
        for holds, why in (
            (self.speed_up >= WORTH_IT, f"and {WORTH_IT} is wanted"),
            (more <= GAP_LIMIT, grows),
            (fewer <= SUCCESS_LIMIT, f"{misses}, and {100 * SUCCESS_LIMIT:.0f} % is allowed"),
            (self.mean_difference <= DIFFERENCE_LIMIT, differs),
        ):
            if not holds:
                return f"keep fp32: on this machine int8 is {as_fast}, {why}."
        return f"int8: {as_fast} on this machine, and the cost gap changes by {100 * more:+.2f} points."


def compare(fp32: NetworkModel, int8: NetworkModel, samples: Samples, most: int, rounds: int) -> Comparison:
    """Compare two models on at most `most` of the queries, and time each `rounds` times."""
    m = fp32.metadata
    validator = Validator(samples, Spec(m.architecture, m.input_size, m.sigma, encoding=m.encoding), m.omega, most)
    queries = samples.pick(validator.index)
    p, q = (probabilities(model, queries) for model in (fp32, int8))
    (one,), (other,) = (validator.judge_probabilities(each, (m.region_factor,)) for each in (p, q))
    difference = np.abs(p - q)
    figures = float(difference.mean()), float(difference.max())
    return Comparison(len(queries), *figures, one, other, *latencies(fp32, int8, queries, rounds))


def answer(model: NetworkModel, samples: Samples, query: int) -> NDArray[np.float32]:
    """A network's probabilities for a query on its map; they, and the inputs, stay until the next."""
    planes, start, goal = samples.query(query)
    model.set_map(planes)
    return model.answer(start, goal)


def probabilities(model: NetworkModel, samples: Samples) -> NDArray[np.float32]:
    """(Q, B, B) of all the queries."""
    out = np.empty((len(samples), model.metadata.blocks, model.metadata.blocks), np.float32)
    for query in range(len(samples)):
        out[query] = answer(model, samples, query)
    return out


def latencies(one: NetworkModel, other: NetworkModel, samples: Samples, rounds: int) -> tuple[Latency, Latency]:
    """Time two models in turns on the same queries, so that whatever else the machine does slows both."""
    times: tuple[list[float], list[float]] = ([], [])
    models = (one, other)
    for at in range(-max(3, rounds // 10), rounds):
        for which in (0, 1) if at % 2 else (1, 0):
            planes, start, goal = samples.query(at % len(samples))
            models[which].set_map(planes)
            started = time.perf_counter()
            models[which].answer(start, goal)
            if at >= 0:
                times[which].append(1e3 * (time.perf_counter() - started))
    a, b = (Latency(float(np.median(t)), float(np.percentile(t, 99))) for t in times)
    return a, b


def split(samples: Samples, seed: int) -> tuple[Samples, Samples]:
    """Queries to calibrate on and queries to judge on, of different maps; DataSetError where all are on one map."""
    maps = np.random.default_rng([seed, 0]).permutation(np.unique(samples.map_index))
    if len(maps) < 2:
        raise DataSetError(f"wanted queries on at least two maps, got {len(maps)}")
    held_out = np.isin(samples.map_index, maps[: -(-len(maps) // HELD_OUT_SHARE)])
    return samples.pick(~held_out), samples.pick(held_out)


def spread(samples: Samples, count: int, seed: int) -> Samples:
    """At most `count` queries at random, from as many maps as there are: each map gives one, then a second, …"""
    order = np.random.default_rng([seed, 1]).permutation(len(samples))
    maps = samples.map_index[order]
    turn = np.empty(len(order), np.int64)  # how many queries of the same map come before
    by_map = np.argsort(maps, kind="stable")
    _, first, counts = np.unique(maps[by_map], return_index=True, return_counts=True)
    turn[by_map] = np.arange(len(order)) - np.repeat(first, counts)
    return samples.pick(order[np.argsort(turn, kind="stable")[:count]])
