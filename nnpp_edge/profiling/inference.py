"""Times of a network's inference, in two cases: warm, and right after a plan.

`nnpp-edge profile` and `nnpp-edge quantize` measure by this. Warm is what a benchmark in a loop
shows. Right after a plan, whose map has driven the network out of the caches, is what a robot gets.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import cache

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.runtime.planners.planner import Planner

_SIDE = 512
"""Of the map that is planned on between two inferences: 13 MB of weights and scratch memory."""


@dataclass(frozen=True)
class InferenceMs:
    """Milliseconds of one inference."""

    warm: float
    """Right after another one by the same network."""
    after_plan: float
    """Right after an exact plan on a map of 512²."""


def inference_ms(
    networks: Mapping[str, Callable[[], object]], harness: Harness
) -> dict[str, InferenceMs]:
    """Time one inference of each network in both cases, in an order that is drawn anew."""
    found = {}
    for name in harness.shuffled(networks):
        run = networks[name]
        _plan_between()
        after_plan, _ = harness.timed(run)
        run()
        warm, _ = harness.timed(run)
        found[name] = InferenceMs(1e3 * warm, 1e3 * after_plan)
    return found


def medians(times: Sequence[InferenceMs]) -> InferenceMs:
    """The median of each case."""
    return InferenceMs(*np.median([astuple(each) for each in times], axis=0).tolist())


def _plan_between() -> None:
    start, goal = (3, 3), (_SIDE - 4, _SIDE - 4)
    _planner().plan(start, goal, method="astar")


@cache
def _planner() -> Planner:
    """Of rough ground, the same in every process."""
    cost = np.random.default_rng(0).uniform(0.0, 0.5, (_SIDE, _SIDE)).astype(np.float32)
    return Planner(cost)
