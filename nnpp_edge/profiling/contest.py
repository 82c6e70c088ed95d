"""Rivals × queries: timed side by side in turns, judged by exact A*, a tidy row an answer."""

import gc
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from nnpp_edge.outcome import outcome
from nnpp_edge.profiling.rows import Row
from nnpp_edge.progress import ignore
from nnpp_edge.runtime.arrays import Cells
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.planners.plan import Plan, Source
from nnpp_edge.runtime.search.region import Region

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


class Answer(NamedTuple):
    """An answer of what makes no `Plan`."""

    path: Cells
    """(N, 2), empty where there is no path."""
    cost: float
    traverse_cost: float
    region: Region | None
    source: Source = Source.REGION


def priced(grid: Grid, path: Cells, region: Region | None = None) -> Answer:
    """A path by what it costs on a map, found in this region or on all of it."""
    cost, _, cc = grid.costs_of(path)
    return Answer(path, cost, cc, region)


def beside(found: Plan | Answer, optimum: Plan | Answer) -> Row:
    """An answer's figures beside the optimum: whether it was ``found`` in the first region, and of
    a path its ``gap`` and CC; of the region that was searched ``mm`` and ``region_share``, where
    the answer has it.
    """
    row = outcome(found.cost, optimum.cost, len(optimum.path), found.region, found.source)
    if "gap" in row:
        row |= {"cc": found.traverse_cost, "exact_cc": optimum.traverse_cost}
    if "share" in row:
        row["region_share"] = row.pop("share")
    return row


def answer(plan: Plan, time_ms: float, optimum: Plan, exact_ms: float | None) -> Row:
    """A plan's figures `beside` the optimum, whether there is a path at all (``solved``), and what
    it took; `exact_ms` is exact A*'s time, where it was measured.
    """
    row: Row = {
        "time_ms": time_ms,
        "solved": float(plan.ok),
        "expansions": plan.expansions,
        "costs_computed": plan.costs_computed,
        "checks": plan.checks,
    }
    if exact_ms is not None:
        row |= {"exact_ms": exact_ms, "speedup": exact_ms / time_ms}
    return row | beside(plan, optimum)
