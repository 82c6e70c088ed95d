"""Rivals × queries: timed side by side in turns, judged by exact A*, a tidy row an answer."""

import gc
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from nnpp_edge.outcome import outcome
from nnpp_edge.profiling.rows import Row
from nnpp_edge.progress import ignore
from nnpp_edge.runtime.planners.plan import Plan

CaseT = TypeVar("CaseT")
ResultT = TypeVar("ResultT")


@dataclass(frozen=True)
class RivalCalls(Generic[CaseT, ResultT]):
    """One rival's calls on one case, in the order in which they were made."""

    case: CaseT
    elapsed_s: tuple[float, ...]
    results: tuple[ResultT, ...]

    @property
    def median_s(self) -> float:
        return float(np.median(self.elapsed_s))

    def middle(self) -> tuple[float, ResultT]:
        """Time and result of the call of middle time; of two calls the faster one."""
        ranked = np.argsort(self.elapsed_s, kind="stable")
        at = int(ranked[(len(ranked) - 1) // 2])
        return self.elapsed_s[at], self.results[at]


class Harness:
    """Times calls by a clock in seconds. Garbage is not collected meanwhile. `seed` draws the order
    of the turns.
    """

    def __init__(self, seed: int = 0, clock: Callable[[], float] = time.perf_counter) -> None:
        self._rng = np.random.default_rng(seed)
        self.clock = clock

    def timed(self, call: Callable[[], ResultT]) -> tuple[float, ResultT]:
        """Seconds that one call takes, and what it returns."""
        with _no_garbage_collection():
            began = self.clock()
            result = call()
            return self.clock() - began, result

    def measure(
        self,
        rivals: Mapping[str, Callable[[CaseT], ResultT]],
        cases: Iterable[CaseT],
        *,
        repeats: int = 1,
        before: Callable[[str], None] = ignore,
        after: Callable[[str, float, ResultT], None] = ignore,
    ) -> Iterator[dict[str, RivalCalls[CaseT, ResultT]]]:
        """Let every rival, a function of a case, answer every case: for each case a record of each
        rival, in order.

        Cases are taken one by one, when the records of the one before have been used. In each of
        `repeats` turns every rival is called once, in an order that is drawn anew. `before` and
        `after` are called around each timed call, outside the time that counts.

        What a rival raises ends the measurement: figures of the others would no longer be of the
        same cases."""
        for case in cases:
            calls: dict[str, list[tuple[float, ResultT]]] = {name: [] for name in rivals}
            with _no_garbage_collection():
                for _ in range(repeats):
                    for name in self._rng.permutation([*rivals]).tolist():
                        before(name)
                        began = self.clock()
                        result = rivals[name](case)
                        seconds = self.clock() - began
                        after(name, seconds, result)
                        calls[name].append((seconds, result))
            yield {name: RivalCalls(case, *zip(*made, strict=True)) for name, made in calls.items()}


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    collected = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collected:
            gc.enable()


def answer(plan: Plan, time_ms: float, optimum: Plan, exact_ms: float | None) -> Row:
    """A plan's figures beside the optimum; `exact_ms` is exact A*'s time, where it was measured.
    Whether it was found in the ``first`` region, and whether at all, ``solved``. Of the region that
    was searched ``mm`` and ``region_share``, where the plan has it.
    """
    of = outcome(plan.cost, optimum.cost, len(optimum.path), plan.region, plan.source)
    found: Row = {
        "time_ms": time_ms,
        "first": of["found"],
        "solved": float(plan.ok),
        "expansions": plan.expansions,
        "costs_computed": plan.costs_computed,
        "checks": plan.checks,
    }
    if exact_ms is not None:
        found |= {"exact_ms": exact_ms, "speedup": exact_ms / time_ms}
    if plan.ok:
        cc = {"cc": plan.traverse_cost, "exact_cc": optimum.traverse_cost}
        found |= {"gap": of["gap"], **cc}
    if plan.region is not None:
        found |= {"region_share": of["share"], "mm": of["mm"]}
    return found
