"""Time of a network's inference right after a plan, whose map has driven the network out of the
caches: what a robot gets.

`nnpp-edge profile`, `nnpp-edge quantize` and the table in README measure by this alone. In a loop
of its own a small network is faster, and int8 gains more there
(docs/decisions/papers-network.md).
"""

from collections.abc import Mapping
from functools import cache, partial

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.planner import Planner

ROUNDS = 100
"""Turns in which int8 and fp32 are timed."""
_SIDE = 512
"""Of the map that is planned on between two inferences: 13 MB of weights and scratch memory."""


def inference_ms(
    networks: Mapping[str, NetworkModel], harness: Harness, rounds: int = 1
) -> dict[str, float]:
    """Median milliseconds of one inference of each network, all of it, right after an exact plan on
    a map of 512²; their order is drawn anew.
    """
    calls = {name: partial(_try_out, network) for name, network in networks.items()}
    (records,) = harness.measure(calls, [None], repeats=rounds, before=_plan_between)
    return {name: 1e3 * record.median_s for name, record in records.items()}


def fp32_and_int8_ms(fp32: str, int8: str) -> tuple[float, float]:
    """Median milliseconds of both models, by name or path, in turns, so that whatever else the
    machine does slows both. On one thread: two wait for each other, most on a busy machine.
    """
    networks = {model: NetworkModel(model, threads=1) for model in (fp32, int8)}
    found = inference_ms(networks, Harness(), ROUNDS)
    return found[fp32], found[int8]


def _try_out(network: NetworkModel, _: None) -> None:
    network.try_out()


def _plan_between(_: str) -> None:
    _planner().plan((3, 3), (_SIDE - 4, _SIDE - 4), method="astar")


@cache
def _planner() -> Planner:
    """Of rough ground, the same in every process."""
    cost = np.random.default_rng(0).uniform(0.0, 0.5, (_SIDE, _SIDE)).astype(np.float32)
    return Planner(cost)
