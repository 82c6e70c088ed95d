"""The paper's A* and A*NN, as plain Python, and our planners, on the same queries and in turns."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction.plain_astar import build_graph, search
from nnpp_edge.runtime.errors import InvalidQueryError, Status
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Plan, Source, measure
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.labels import Query

PLAIN, PLAIN_NN = "plain A*", "plain A*NN"
"""The paper's two methods: A* over a graph of the whole map; A* over a graph of the network's region at the
adaptive threshold td, in which the time of the network counts."""
OURS = ("astar", "corridor", "nnpp")
PLANNERS = (PLAIN, PLAIN_NN, *OURS)
_NETWORK_STAGES = ("encode", "inference", "threshold")


@dataclass(frozen=True)
class Answer:
    """What one planner made of one query."""

    time_s: float
    found: bool
    """In the first region, before any widening."""
    traverse_cost: float
    """CC of the path."""
    excess: float
    """The path's cost over the optimum, less 1."""
    mm: float | None = None
    """Cells of the optimal path over those of the region searched; None for the whole map."""
    stages_s: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Round:
    """All planners' answers to one query."""

    size: int
    path_cells: int
    """Of the optimal path."""
    answers: dict[str, Answer]


def contest(
    cases: Iterator[Case], model: NetworkModel, queries: int, *, planners: Sequence[str] = PLANNERS, repeats: int = 3
) -> Iterator[Round]:
    """Put queries to all planners, in turns; those without a path are passed over.

    Parameters
    ----------
    cases : iterator of Case
        Maps and queries.
    model : NetworkModel
        For `PLAIN_NN` and ``nnpp``.
    queries : int
        How many.
    planners : sequence of str
        Of `PLANNERS`.
    repeats : int
        How often each of ours answers each query; the median time counts. Plain Python answers once.

    Raises
    ------
    InvalidQueryError
        Too few of the queries have a path.
    """
    done = 0
    for case in islice(cases, 20 * queries):
        planner = Planner(case.cost, model=model, ask_from=0)
        for name in OURS:  # the map's own work, and warm caches
            planner.plan(*case.queries[0], method=name)
        for query in case.queries:
            answers = _answers(planner, model, case.cost, query, planners, repeats, done)
            if answers is not None:
                yield answers
                done += 1
            if done == queries:
                return
    raise InvalidQueryError(f"wanted {queries} queries with a path, got {done}")


def _answers(
    planner: Planner, model: NetworkModel, cost: NDArray[np.float32], query: Query, planners: Sequence[str],
    repeats: int, turn: int,
) -> Round | None:  # fmt: skip
    exact = planner.plan(*query, method="astar")
    if exact.status is not Status.OK:
        return None
    answers: dict[str, Answer] = {}
    shift = turn % len(planners)
    for name in (*planners[shift:], *planners[:shift]):
        if name == PLAIN:
            answers[name] = _plain(planner, cost, query, exact)
        elif name == PLAIN_NN:
            answers[name] = _plain_nn(planner, model, cost, query, exact)
        else:
            answers[name] = _ours(planner, name, query, exact, repeats)
    return Round(len(cost), len(exact.path), {name: answers[name] for name in planners})


def _plain(
    planner: Planner, cost: NDArray[np.float32], query: Query, exact: Plan, inside: NDArray[np.bool_] | None = None
) -> Answer:
    began = time.perf_counter()
    graph = build_graph(cost, inside)
    built = time.perf_counter()
    path = search(graph, *query)
    ended = time.perf_counter()
    stages = {"graph": built - began, "search": ended - built}
    mm = None if inside is None else len(exact.path) / len(graph.edges)
    if path is None:
        return Answer(ended - began, False, np.inf, np.inf, mm, stages)
    price, _, traverse_cost = measure(planner.grid, np.array(path, np.int32))
    return Answer(ended - began, True, traverse_cost, price / exact.cost - 1.0, mm, stages)


def _plain_nn(
    planner: Planner, model: NetworkModel, cost: NDArray[np.float32], query: Query, exact: Plan
) -> Answer:  # fmt: skip
    plan = planner.plan(*query, method="nnpp")
    assert plan.network_region is not None
    began = time.perf_counter()
    inside = plan.network_region.mask()
    masked = time.perf_counter() - began
    began = time.perf_counter()
    model.run(anew=True)  # on what it was shown for this plan: the paper's network sees the map at each query
    inferred = time.perf_counter() - began
    plain = _plain(planner, cost, query, exact, inside)
    network = {stage: 1e-3 * plan.timings_ms[stage] for stage in _NETWORK_STAGES}
    stages = network | {"inference": inferred, "mask": masked} | plain.stages_s
    return Answer(sum(stages.values()), plain.found, plain.traverse_cost, plain.excess, plain.mm, stages)


def _ours(planner: Planner, name: str, query: Query, exact: Plan, repeats: int) -> Answer:
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        plan = planner.plan(*query, method=name)
        times.append(time.perf_counter() - began)
    mm = None if plan.region is None else len(exact.path) / plan.region.area()
    stages = {stage: 1e-3 * ms for stage, ms in plan.timings_ms.items() if stage != "total"}
    in_first = plan.source in (Source.MAP, Source.REGION)
    return Answer(
        float(np.median(times)), in_first, plan.traverse_cost, plan.cost / exact.cost - 1.0, mm, stages
    )  # fmt: skip


def increase(cc: float, exact_cc: float) -> float:
    """By what share a CC lies above exact A*'s; 0 where both are, on level ground."""
    return cc / exact_cc - 1.0 if exact_cc else (0.0 if cc == 0.0 else np.inf)


@dataclass(frozen=True)
class Means:
    """What one planner came to over many queries."""

    time_s: float
    time_sd_s: float
    success: float
    traverse_cost: float
    """Mean CC of the paths."""
    cc_increase: float
    """Mean CC over exact A*'s on the same queries, less 1; of the queries with a path."""
    excess: float
    mm: float | None
    mm_sd: float | None


def means(rounds: Sequence[Round], name: str) -> Means:
    """Means of a planner over rounds in which ``astar`` answered too."""
    answers = [r.answers[name] for r in rounds]
    exact = [r.answers["astar"] for r in rounds]
    solved = [(a, e) for a, e in zip(answers, exact, strict=True) if np.isfinite(a.traverse_cost)]
    cc = float(np.mean([a.traverse_cost for a, _ in solved])) if solved else np.nan
    exact_cc = float(np.mean([e.traverse_cost for _, e in solved])) if solved else np.nan
    mms = [a.mm for a in answers if a.mm is not None]
    return Means(
        time_s=float(np.mean([a.time_s for a in answers])),
        time_sd_s=float(np.std([a.time_s for a in answers])),
        success=float(np.mean([a.found for a in answers])),
        traverse_cost=cc,
        cc_increase=increase(cc, exact_cc),
        excess=float(np.mean([a.excess for a, _ in solved])) if solved else np.nan,
        mm=float(np.mean(mms)) if mms else None,
        mm_sd=float(np.std(mms)) if mms else None,
    )
