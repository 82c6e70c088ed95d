"""The measured run of a profile: every planner, every query, in turns, in two halves."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.arrivals import REACTIONS, Reactions, arrival_ms, reactions
from nnpp_edge.profiling.disturbance import Disturbance, Instruments
from nnpp_edge.profiling.harness import Harness, Observer, Record
from nnpp_edge.profiling.machine import EnergyMeter
from nnpp_edge.profiling.profile_file import Device, Load, Networks, OnboardLoop
from nnpp_edge.profiling.profile_maps import ProfileMap, ProfileMaps, ProfileQuery
from nnpp_edge.profiling.rivals import EXACT, FindsPlans, RivalPlanner
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.plan import Method, Plan

HALVES = 2
_MAPS_TRIED = 20
"""Times as many maps as are needed are searched for queries that have a path."""


def _per_half() -> list[list[float]]:
    return [[] for _ in range(HALVES)]


@dataclass
class Answers:
    """Answers of one planner to the queries of one workload and size. Lists run over the queries, in order."""

    middle_ms: list[list[float]] = field(default_factory=_per_half)
    """For each half, for each query, the time of its middle call; of two calls the faster one."""
    worst_ms: float = 0.0
    """The slowest call of all."""
    stages_ms: list[list[dict[str, float]]] = field(default_factory=lambda: [[] for _ in range(HALVES)])
    """For each half, for each query, the stages of its middle call, and ``other``: what no stage counts."""
    network_ms: list[list[float]] = field(default_factory=_per_half)
    """For each half, for each query, the time of the whole network on map and query; empty without a network."""
    map_ms: list[list[float]] = field(default_factory=_per_half)
    """For each half, for each judged query, from elevations to the path; empty where that is not measured."""
    patch_ms: list[list[float]] = field(default_factory=_per_half)
    """As `map_ms`, of a patch on that path."""
    plans: list[Plan] = field(default_factory=list)
    energy_j: float = 0.0
    calls: int = 0

    def times(self, half: int | None = None) -> NDArray[np.float64]:
        """Each query's time in milliseconds: in a half, or the mean of both."""
        return np.mean(self.middle_ms, axis=0) if half is None else np.array(self.middle_ms[half])

    def add(self, record: Record[ProfileQuery, Plan], half: int) -> None:
        """Count a query's calls in one half. Plans are the same in both, so the first half's count."""
        self.calls += len(record.elapsed_s)
        self.worst_ms = max(self.worst_ms, 1e3 * max(record.elapsed_s))
        seconds, plan = record.middle()
        stages = {stage: ms for stage, ms in plan.timings_ms.items() if stage != "total"}
        self.middle_ms[half].append(1e3 * seconds)
        stages["other"] = 1e3 * seconds - sum(stages.values())
        self.stages_ms[half].append(stages)
        if half == 0:
            self.plans.append(plan)


@dataclass
class WorkloadRun:
    """One workload and size."""

    workload: str
    size: int
    terrain: str
    queries_by_map: list[list[ProfileQuery]] = field(default_factory=list)
    """Map by map; on some maps no query had a path."""
    answers: dict[str, Answers] = field(default_factory=dict)
    """By the planner's name."""
    reactions: list[Reactions] = field(default_factory=list)
    """Of the onboard loop, for each half; empty where these are not measured."""

    @property
    def queries(self) -> list[ProfileQuery]:
        """All queries, in the order of the answers."""
        return [query for on_map in self.queries_by_map for query in on_map]


@dataclass
class Run:
    """All that was measured."""

    workloads: list[WorkloadRun]
    disturbance: list[Disturbance]
    """One for each half."""
    energy_problem: str
    """Why there is no energy; empty where there is."""
    loop: OnboardLoop
    """Whose reactions were measured."""


@dataclass(frozen=True)
class Arriving:
    """Choice of what is measured of maps and patches that have just arrived."""

    planners: frozenset[str] = frozenset()
    """Whose first path is timed, and whose map after a patch."""
    reactions_at: frozenset[tuple[str, int]] = frozenset()
    """Workloads and sizes at which the loop is run."""
    loop: OnboardLoop = field(default_factory=OnboardLoop)
    patches: int = REACTIONS
    """That the loop is given in each half."""


def rivals_of(networks: Networks, device: Device) -> list[RivalPlanner]:
    """The planners of a profile; ModelError if a model cannot be loaded."""

    def network(name: str) -> NetworkModel:
        return NetworkModel(name, threads=device.threads)

    found = [RivalPlanner(EXACT, Method.ASTAR), RivalPlanner("corridor", Method.CORRIDOR)]
    found.append(RivalPlanner("nnpp", Method.NNPP, network(networks.int8)))
    if networks.fp32 is not None:
        found.append(RivalPlanner("nnpp-fp32", Method.NNPP, network(networks.fp32)))
    # a network of its own: one that planners share takes the map over whenever the other has used it
    return [*found, RivalPlanner("auto", Method.AUTO, network(networks.int8))]


def run(
    rivals: Sequence[RivalPlanner],
    load: Load,
    cores: Sequence[int],
    *,
    arriving: Arriving | None = None,
    harness: Harness | None = None,
    instruments: Instruments | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Run:
    """Have every planner, exact A* first, answer every query, in both halves of the run.

    `cores` are those that this process is pinned to: the time that others use on them is counted. `instruments` are
    read between the calls. `progress` is called with the number of queries that are done, of `queries_in`.
    InvalidQueryError if the terrain has too few queries with a path.

    Notes
    -----
    The second half repeats the first, query by query. So the halves differ by what happened on the machine
    alone, not by the queries, however few they are. What depends on the map alone is made, and every
    planner has answered the map's first query, before the clock starts; within a round planners take turns. On a
    vehicle's map each call is that of a new planner, which has checked no pose. Maps and patches that have just
    arrived are measured afterwards, map by map: they drive the standing map out of the caches.
    """
    maps, meter, arriving = ProfileMaps(load), EnergyMeter(), arriving or Arriving()
    runs: dict[tuple[str, int], WorkloadRun] = {}
    disturbance = [Disturbance(cores) for _ in range(HALVES)]
    session = _Session(rivals, load.repeats, meter, harness or Harness(), arriving, instruments or Instruments())
    done = 0
    for half in range(HALVES):
        for name in load.workloads:
            for size in load.sizes:
                of = runs.setdefault((name, size), WorkloadRun(name, size, maps.source(size)))
                of.answers = of.answers or {rival.name: Answers() for rival in rivals}
                for on_map, queries in first_half_again(maps, of) if half else _solvable(maps, of, load):
                    session.measure(on_map, queries, of, half, disturbance[half])
                    session.measure_arriving(on_map, queries, of, half)
                    progress(done := done + len(queries))
    return Run(list(runs.values()), disturbance, meter.problem, arriving.loop)


def queries_in(load: Load) -> int:
    """How many queries `run` will report as done."""
    return HALVES * len(load.workloads) * len(load.sizes) * (load.queries + load.near)


def first_half_again(maps: ProfileMaps, of: WorkloadRun) -> Iterator[tuple[ProfileMap, list[ProfileQuery]]]:
    """The maps of the first half again, with its queries."""
    found = zip(of.queries_by_map, maps.maps(of.workload, of.size), strict=False)
    return ((on_map, queries) for queries, on_map in found if queries)


def _solvable(maps: ProfileMaps, of: WorkloadRun, load: Load) -> Iterator[tuple[ProfileMap, list[ProfileQuery]]]:
    """Maps with those of their queries that have a path, until there are enough; they are kept in `of`."""
    missing = {True: load.queries, False: load.near}
    for on_map in islice(maps.maps(of.workload, of.size), _MAPS_TRIED * (load.queries + load.near)):
        chosen: list[ProfileQuery] = []
        connects = on_map.connections()
        for query in on_map.queries:
            if missing[query.judged] and connects(query):
                missing[query.judged] -= 1
                chosen.append(query)
        of.queries_by_map.append(chosen)
        if chosen:
            yield on_map, chosen
        if not any(missing.values()):
            return
    raise InvalidQueryError(
        f"wanted {load.queries} queries with a path on maps of {of.size} × {of.size} ({of.workload}), "
        f"found {load.queries - missing[True]} on {len(of.queries_by_map)} maps"
    )


@dataclass
class _Session:
    """Means by which all maps of a run are measured."""

    rivals: Sequence[RivalPlanner]
    repeats: int
    meter: EnergyMeter
    harness: Harness
    arriving: Arriving
    instruments: Instruments

    def measure(
        self, on_map: ProfileMap, queries: list[ProfileQuery], of: WorkloadRun, half: int, disturbance: Disturbance
    ) -> None:
        """Have all planners answer the queries on one map, and count the answers."""
        planners = _Planners(self.rivals, on_map)
        calls = {rival.name: planners.call(rival) for rival in self.rivals}
        for call in calls.values():
            call(queries[0])  # the map's own work, and warm caches
        observer = _PlanObserver(of, self.meter, disturbance, planners, self.instruments)
        began = time.perf_counter()
        disturbance.start()
        for records in self.harness.measure(calls, queries, repeats=self.repeats, observer=observer):
            for rival in self.rivals:
                of.answers[rival.name].add(records[rival.name], half)
            for rival in self.rivals:  # last, so that no planner follows what others do not
                if rival.method is Method.NNPP and rival.model is not None and not on_map.has_body:
                    of.answers[rival.name].network_ms[half].append(self._network_ms(rival.model, disturbance))
        disturbance.stop()
        self._trace(f"{of.workload} {of.size}², half {half + 1}", began)

    def measure_arriving(self, on_map: ProfileMap, queries: list[ProfileQuery], of: WorkloadRun, half: int) -> None:
        """Have some planners answer the judged queries on one map as if it had just arrived; run the loop on it."""
        judged = [(query.start, query.goal) for query in queries if query.judged]
        for rival in self.rivals:
            if rival.name not in self.arriving.planners:
                continue
            own = replace(rival, model=rival.model and rival.model.share())
            answers = of.answers[rival.name]
            began = time.perf_counter()
            for query in judged[:1]:
                arrival_ms(own, on_map.ground, query, self.harness)  # kernels loaded
            for query in judged:
                times = [arrival_ms(own, on_map.ground, query, self.harness) for _ in range(self.repeats)]
                for kept, ms in zip((answers.map_ms, answers.patch_ms), np.median(times, axis=0), strict=True):
                    kept[half].append(float(ms))
            self._trace(f"maps that have just arrived, {rival.name}", began)
        wanted = (of.workload, of.size) in self.arriving.reactions_at
        if wanted and judged and len(of.reactions) == half:
            found = reactions(
                on_map.ground, judged, self.arriving.loop, self.arriving.patches, trace=self.instruments.trace
            )
            of.reactions.append(found)

    def _trace(self, name: str, began_s: float) -> None:
        if self.instruments.trace is not None:
            self.instruments.trace.span(name, began_s, time.perf_counter())

    def _network_ms(self, model: NetworkModel, disturbance: Disturbance) -> float:
        """Milliseconds of the network on the map that it was shown last, encoded anew, and a query."""
        worked = time.thread_time()
        seconds, _ = self.harness.timed(model.try_out)
        disturbance.leave_out(seconds, time.thread_time() - worked)
        return 1e3 * seconds


class _Planners:
    """The rivals' planners on one map: kept from call to call, or with a vehicle new for each."""

    def __init__(self, rivals: Sequence[RivalPlanner], on_map: ProfileMap) -> None:
        self._rivals, self._map = {rival.name: rival for rival in rivals}, on_map
        self._planners = {name: self._planner(rival) for name, rival in self._rivals.items()}

    def call(self, rival: RivalPlanner) -> Callable[[ProfileQuery], Plan]:
        """The rival as a function of a query."""
        return lambda query: rival.plan(self._planners[rival.name], (query.start, query.goal))

    def forget_poses(self, name: str) -> None:
        """Have a rival of a vehicle answer with a planner that has checked no pose."""
        if self._map.has_body:
            self._planners[name] = self._planner(self._rivals[name])

    def _planner(self, rival: RivalPlanner) -> FindsPlans:
        return rival.planner_of(self._map.ground, lazy=True) if self._map.has_body else rival.planner(self._map.cost)


class _PlanObserver(Observer[Plan]):
    """Makes what a call takes, counts its energy, and leaves runs of the network out of the disturbance."""

    def __init__(
        self,
        of: WorkloadRun,
        meter: EnergyMeter,
        disturbance: Disturbance,
        planners: _Planners,
        instruments: Instruments,
    ) -> None:
        self._of, self._meter, self._disturbance, self._planners = of, meter, disturbance, planners
        self._instruments = instruments
        self._counters: list[int] = []
        self._worked_s = 0.0

    def before(self, rival: str) -> None:
        self._planners.forget_poses(rival)
        self._instruments.read(self._disturbance)
        self._counters = self._meter.read()
        self._worked_s = time.thread_time()

    def after(self, rival: str, elapsed_s: float, result: Plan) -> None:
        ended, worked = time.perf_counter(), time.thread_time() - self._worked_s
        if self._counters:
            self._of.answers[rival].energy_j += self._meter.joules(self._counters, self._meter.read())
        if result.method is Method.NNPP:
            self._disturbance.leave_out(elapsed_s, worked)
        if (trace := self._instruments.trace) is not None:
            facts = {"expansions": result.expansions}
            trace.span(rival, ended - elapsed_s, ended, result.timings_ms, facts=facts)
