"""The paper's A* and A*NN, as plain Python, and our planners, on the same queries and in turns."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.harness import Harness, Record
from nnpp_edge.profiling.rivals import FIRST_SOURCES, call_on
from nnpp_edge.profiling.suites import LEAST_DISTANCE, Case
from nnpp_edge.reproduction.experiment import MAPS_TRIED, Context, OnProgress
from nnpp_edge.reproduction.plain_astar import build_graph, search
from nnpp_edge.reproduction.regions import (
    BAND,
    CORRIDOR,
    SHUFFLED,
    Networks,
    PaperRegions,
    band_region,
    corridor_region,
    optimal_path,
)
from nnpp_edge.reproduction.report import Row, Table, columns
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.plan import Plan, path_costs
from nnpp_edge.runtime.planners.planner import Planner

PLAIN, PLAIN_NN = "plain A*", "plain A*NN"
"""The paper's two methods: A* over a graph of the whole map; A* over a graph of the network's region at the
adaptive threshold td, in which the time of the network counts."""
PLAIN_CONTROLS = {name: f"plain A*, {name}" for name in (CORRIDOR, BAND, SHUFFLED)}
"""A* over a graph of a region that no network made, or one with shuffled weights; the region's making counts."""
PLAIN_PLANNERS = (PLAIN, PLAIN_NN, *PLAIN_CONTROLS.values())
OURS = ("astar", "corridor", "nnpp")
PLANNERS = (*PLAIN_PLANNERS, *OURS)


@dataclass(frozen=True)
class Answer:
    """One planner's answer to one query."""

    time_s: float
    found: bool
    """In the first region, before any widening; for ``nnpp`` whether its network's own region holds a path."""
    traverse_cost: float
    """CC of the path."""
    excess: float
    """The path's cost over the optimum, less 1."""
    mm: float | None = None
    """Cells of the optimal path over those of the region searched, for ``nnpp`` of its network's own region by the
    paper's rule; None for the whole map."""
    stages_s: dict[str, float] = field(default_factory=dict)
    mended: bool = False
    """Whether what was known from the plan before was mended, rather than searched afresh."""


@dataclass(frozen=True)
class Round:
    """All planners' answers to one query."""

    size: int
    path_cells: int
    """Of the optimal path."""
    answers: dict[str, Answer]


@dataclass(frozen=True)
class _PlainSearch:
    """What a plain method found, and how long each of its stages took."""

    path: list[Cell] | None
    region_cells: int
    stages_s: dict[str, float]


class _OnMap:
    """The planners on one map."""

    def __init__(self, case: Case, networks: Networks, harness: Harness) -> None:
        self.case, self.harness = case, harness
        self.planner = Planner(case.cost, model=networks.ours, ask_from=0)
        self.regions = PaperRegions(case.cost, networks.paper)
        self.own_regions = PaperRegions(case.cost, networks.ours)
        self._networks = networks

    def call(self, name: str) -> Callable[[Endpoints], "Plan | _PlainSearch"]:
        """A planner as a function of start and goal."""
        plain: dict[str, Callable[[Endpoints], _PlainSearch]] = {
            PLAIN: self._plain,
            PLAIN_NN: partial(self._plain_nn, self.regions),
            PLAIN_CONTROLS[CORRIDOR]: partial(self._plain_without, corridor_region),
            PLAIN_CONTROLS[BAND]: partial(self._plain_without, band_region),
        }
        if name == PLAIN_CONTROLS[SHUFFLED]:
            return partial(self._plain_nn, PaperRegions(self.case.cost, self._networks.shuffled))
        return plain[name] if name in plain else call_on(self.planner, name)

    def _plain(self, query: Endpoints, inside: NDArray[np.bool_] | None = None) -> _PlainSearch:
        graph_s, graph = self.harness.timed(lambda: build_graph(self.case.cost, inside))
        search_s, path = self.harness.timed(lambda: search(graph, *query))
        return _PlainSearch(path, len(graph.edges), {"graph": graph_s, "search": search_s})

    def _plain_nn(self, regions: PaperRegions, query: Endpoints) -> _PlainSearch:
        region, stages = regions.find(query)
        return self._inside(query, region, stages)

    def _plain_without(self, make: "Callable[[Grid, Endpoints, Region], Region]", query: Endpoints) -> _PlainSearch:
        """In a region without a network, as large as the network's for this query."""
        like, _ = self.regions.find(query)
        region_s, region = self.harness.timed(lambda: make(self.regions.grid, query, like))
        return self._inside(query, region, {"region": region_s})

    def _inside(self, query: Endpoints, region: Region, stages: dict[str, float]) -> _PlainSearch:
        mask_s, inside = self.harness.timed(region.mask)
        found = self._plain(query, inside)
        return _PlainSearch(found.path, region.area(), stages | {"mask": mask_s} | found.stages_s)

    def answer(self, record: "Record[Endpoints, Plan | _PlainSearch]", exact: Plan) -> Answer:
        """What a planner's calls come to."""
        found = record.results[-1]
        if isinstance(found, Plan):
            stages = {stage: 1e-3 * ms for stage, ms in found.timings_ms.items() if stage != "total"}
            excess, own = found.cost / exact.cost - 1.0, self._own(record, found, exact)
            return Answer(record.median_s, own[0], found.traverse_cost, excess, own[1], stages)
        time_s = sum(found.stages_s.values())
        mm = None if record.rival == PLAIN else len(exact.path) / found.region_cells
        if found.path is None:
            return Answer(time_s, False, np.inf, np.inf, mm, found.stages_s)
        cost, _, traverse_cost = path_costs(self.planner.state.grid, np.array(found.path, np.int32))
        return Answer(time_s, True, traverse_cost, cost / exact.cost - 1.0, mm, found.stages_s)

    def _own(
        self, record: "Record[Endpoints, Plan | _PlainSearch]", found: Plan, exact: Plan
    ) -> tuple[bool, float | None]:
        """Whether the first region held a path, and MM; of ``nnpp`` those of its network's own region."""
        if record.rival == "nnpp":
            region, _ = self.own_regions.find(record.case)
            holds_path = optimal_path(self.own_regions.grid, record.case, region) is not None
            return holds_path, len(exact.path) / region.area()
        searched = self.planner.plan(*record.case, method=record.rival, keep_regions=True).region
        mm = None if searched is None else len(exact.path) / searched.area()
        return found.source in FIRST_SOURCES, mm


def contest(
    cases: Iterable[Case], networks: Networks, queries: int, *, planners: Sequence[str] = PLANNERS, repeats: int = 3
) -> Iterator[Round]:
    """Have some of `PLANNERS` answer queries, in turns; those without a path are passed over.

    Ours answer each query `repeats` times, and the median time counts; plain Python answers once. InvalidQueryError
    if too few of the queries have a path.
    """
    done, harness = 0, Harness()
    for case in islice(cases, MAPS_TRIED * queries):
        on_map = _OnMap(case, networks, harness)
        for name in OURS:  # the map's own work, and warm caches
            on_map.planner.plan(*case.queries[0], method=name)
        exact = {query: on_map.planner.plan(*query, method="astar") for query in case.queries}
        solvable = [query for query in case.queries if exact[query].ok][: queries - done]
        calls = {name: on_map.call(name) for name in planners}
        for records in harness.measure(calls, solvable, repeats=repeats, once=PLAIN_PLANNERS):
            best = exact[records[planners[0]].case]
            answers = {name: on_map.answer(record, best) for name, record in records.items()}
            yield Round(len(case.cost), len(best.path), answers)
            done += 1
        if done == queries:
            return
    raise InvalidQueryError(f"wanted {queries} queries with a path, got {done}")


def contest_by_size(
    context: Context, sizes: Sequence[int], queries: int, repeats: int, progress: OnProgress
) -> dict[int, list[Round]]:
    """Rounds of all planners on so many maps at each size, one query each."""
    work, done = queries * sum(size**2 for size in sizes), 0
    rounds: dict[int, list[Round]] = {size: [] for size in sizes}
    for size in sizes:
        for answered in contest(one_query_each(context, size), context.networks, queries, repeats=repeats):
            rounds[size].append(answered)
            done += size**2
            progress(done / work)
    return rounds


def one_query_each(context: Context, size: int, least_distance: float = LEAST_DISTANCE) -> Iterator[Case]:
    """Random maps with one query each; without end."""
    for case in context.cases(size, least_distance):
        yield replace(case, queries=case.queries[:1])


def increase(cc: float, exact_cc: float) -> float:
    """By what share a CC lies above exact A*'s; 0 where both are, on level ground."""
    return cc / exact_cc - 1.0 if exact_cc else (0.0 if cc == 0.0 else np.inf)


@dataclass(frozen=True)
class Means:
    """What one planner came to over many queries."""

    queries: int
    time_s: float
    total_s: float
    """Summed over the queries."""
    time_sd_s: float
    success: float
    traverse_cost: float
    """Mean CC of the paths."""
    total_cc: float
    """Summed over the paths."""
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
        queries=len(rounds),
        time_s=float(np.mean([a.time_s for a in answers])),
        total_s=sum(a.time_s for a in answers),
        time_sd_s=float(np.std([a.time_s for a in answers])),
        success=float(np.mean([a.found for a in answers])),
        traverse_cost=cc,
        total_cc=float(sum(a.traverse_cost for a, _ in solved)),
        cc_increase=increase(cc, exact_cc),
        excess=float(np.mean([a.excess for a, _ in solved])) if solved else np.nan,
        mm=float(np.mean(mms)) if mms else None,
        mm_sd=float(np.std(mms)) if mms else None,
    )


def shown(name: str) -> str:
    """A planner's name in a table for people: ours as code."""
    return name if name in PLAIN_PLANNERS else f"`{name}`"


def network_of(name: str, networks: Networks) -> str | None:
    """The network that a planner asks, for a table; None where it asks none."""
    asked = {PLAIN_NN: networks.paper, PLAIN_CONTROLS[SHUFFLED]: networks.paper, "nnpp": networks.ours}
    model = asked.get(name)
    return None if model is None else f"`{model.metadata.name}`" + (", shuffled" if SHUFFLED in name else "")


def answers_table(places: str, answered: Iterable[tuple[Row, Endpoints, Round]]) -> Table:
    """Every planner's answer to every query, for programs; `places` are the columns of what each row begins with."""
    header = columns(places + " | planner | path_cells | start_row | start_col | goal_row | goal_col")
    rows = [
        (*place, name, each.path_cells, *start, *goal, a.time_s, a.traverse_cost, a.excess, a.mm)
        for place, (start, goal), each in answered
        for name, a in each.answers.items()
    ]
    return Table((*header, "time_s", "cc", "cost_excess", "mm"), rows)
