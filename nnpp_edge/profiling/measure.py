"""The measured run of a profile: every planner, every query, in turns, in two halves."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice, product
from pathlib import Path

import numpy as np

from nnpp_edge.profiling.arrivals import Reactions, arrival_ms, reactions
from nnpp_edge.profiling.contest import Harness, RivalCalls
from nnpp_edge.profiling.inference import inference_ms
from nnpp_edge.profiling.machine import Disturbance, EnergyMeter
from nnpp_edge.profiling.plain_astar import build_graph, search
from nnpp_edge.profiling.profile_file import PLANNERS, SAMPLE, Device, Load, Networks, Profile
from nnpp_edge.profiling.rivals import RivalPlanner
from nnpp_edge.profiling.sensors import Sensors
from nnpp_edge.profiling.suites import (
    SYNTHETIC,
    Case,
    TerrainFiles,
    large_enough,
    source_of,
    terrain_cases,
)
from nnpp_edge.progress import Progress, ignore
from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError, TerrainError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.options import METHODS, STILL
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.vehicle_files import load_vehicle

HALVES = 2
_MOST_PLAIN = 4
"""Queries that an A* in plain Python answers in each half: a second or more each at 256²."""
_MAPS_TRIED = 20
"""Times as many maps as are needed are searched for queries that have a path."""


@dataclass
class Answers:
    """Answers of one planner to the queries of one workload and size. Lists run over the queries,
    in order.
    """

    figures: list[list[dict[str, float]]] = field(
        default_factory=lambda: [[] for _ in range(HALVES)]
    )
    """For each half, for each query, milliseconds where they are measured: ``time_ms`` of the
    middle call (of two the faster one), ``network_ms`` of the whole network on map and query right
    after a plan, ``map_ms`` from elevations to the path, ``patch_ms`` of a patch on that path."""
    stages_ms: list[dict[str, float]] = field(default_factory=list)
    """The stages of the same calls of both halves, and ``other``: what no stage counts."""
    plans: list[Plan] = field(default_factory=list)
    energy_mj: list[float] = field(default_factory=list)
    """Of every call of both halves; NaN where the kernel does not tell."""

    def halves(self, name: str) -> Floats:
        """(2, N) a figure of each query that it was measured of, in both halves."""
        return np.array([[row[name] for row in rows if name in row] for rows in self.figures])

    def column(self, name: str) -> Floats:
        """(N,) the means of both halves."""
        means: Floats = self.halves(name).mean(0)
        return means

    def add(self, record: RivalCalls[Endpoints, Plan], half: int) -> None:
        """Add the measurements of a query in one half. Plans are the same in both halves, so only
        those of the first are kept.
        """
        seconds, plan = record.middle()
        stages = {stage: ms for stage, ms in plan.timings_ms.items() if stage != "total"}
        self.stages_ms.append(stages | {"other": 1e3 * seconds - sum(stages.values())})
        self.figures[half].append({"time_ms": 1e3 * seconds})
        if half == 0:
            self.plans.append(plan)


@dataclass
class WorkloadRun:
    """One workload and size."""

    workload: str
    size: int
    terrain: str
    answers: dict[str, Answers]
    """By the planner's name."""
    queries_by_map: list[list[Endpoints]] = field(default_factory=list)
    """Map by map; on some maps no query had a path."""
    reactions: list[Reactions] = field(default_factory=list)
    """Of the onboard loop, for each half; empty where these are not measured."""
    plain_ms: list[list[float]] = field(default_factory=lambda: [[] for _ in range(HALVES)])
    """Milliseconds of an A* in plain Python, for each half, of the first queries; empty where these
    are not measured."""


@dataclass
class Measurements:
    """All that was measured."""

    workloads: list[WorkloadRun]
    disturbance: list[Disturbance]
    """One for each half."""


class ProfileMaps:
    """Where a profile's maps come from. The same load gives the same maps on any machine.

    TerrainError or InvalidQueryError if a terrain file or the vehicle's cannot be read, or no file
    is large enough for any of the sizes.
    """

    def __init__(self, load: Load) -> None:
        self.load = load
        self._vehicle = None if load.vehicle is None else load_vehicle(load.vehicle)
        self.dems: list[Dem] = []
        for name in load.terrain:
            if name != SYNTHETIC:
                paths = () if name == SAMPLE else (Path(name),)
                self.dems += TerrainFiles.or_sample(paths, load.rescale, load.cell_size).read()
        least = min(load.sizes)
        if self.dems and not large_enough(self.dems, least):
            largest = max(self.dems, key=lambda dem: min(dem.shape))
            rows, cols = largest.shape
            raise TerrainError(
                f"{largest.source}: wanted at least {least} × {least} cells, the size to be "
                f"measured, got {rows} × {cols}; --sizes {min(rows, cols)} measures on it"
            )

    def maps(self, name: str, size: int) -> Iterator[Case]:
        """Maps of one workload and size with their queries, without end."""
        return terrain_cases(
            self.dems,
            name,
            size,
            self.load.seed,
            self.load.min_distance,
            self._vehicle,
        )


def rivals_of(networks: Networks, device: Device) -> list[RivalPlanner]:
    """The planners of a profile; ModelError if a model cannot be loaded."""

    def network(name: str) -> NetworkModel:
        return NetworkModel(name, threads=device.threads)

    asks = [name for name in STILL if METHODS[name].chooses or "network" in METHODS[name].needs]
    # networks of their own: one that planners share takes the map over whenever the other has
    # used it
    found = [
        RivalPlanner(name, Method(name), network(networks.int8) if name in asks else None)
        for name in PLANNERS
        if name in STILL
    ]
    others = {"nnpp-fp32": networks.fp32, "paper": networks.paper}
    found[3:3] = [
        RivalPlanner(name, Method.NNPP, network(file))
        for name, file in others.items()
        if file is not None
    ]
    return found


def run(
    profile: Profile,
    rivals: Sequence[RivalPlanner],
    cores: Sequence[int],
    *,
    sensors: Sensors | None = None,
    progress: Progress = ignore,
) -> Measurements:
    """Have every planner, exact A* first, answer every query, in both halves of the run.

    `cores` are those that this process is pinned to: the time that others use on them is counted.
    `sensors` are read between the calls. `progress` is called with the number of queries that are
    done, of `queries_in`.

    On a vehicle's map each call is that of a planner which has checked no pose before. Maps and
    patches that have just arrived are measured afterwards, map by map: they drive the standing map
    out of the caches.
    """
    load = profile.load
    maps = ProfileMaps(load)
    session = _Session(profile, rivals, sensors)
    runs = []
    for name, size in product(load.workloads, load.sizes):
        answers = {rival.name: Answers() for rival in rivals}
        runs.append(WorkloadRun(name, size, source_of(maps.dems, size), answers))
    disturbance = [Disturbance(cores) for _ in range(HALVES)]
    done = 0
    for half, of in product(range(HALVES), runs):
        chosen = first_half_again(maps, of) if half else _solvable(maps, of, load)
        for on_map, queries in chosen:
            session.measure(on_map, queries, of, half, disturbance[half])
            session.measure_arriving(on_map, queries, of, half)
            done += len(queries)
            progress(done)
    return Measurements(runs, disturbance)


def queries_in(load: Load) -> int:
    """How many queries `run` will report as done."""
    return HALVES * len(load.workloads) * len(load.sizes) * load.queries


def first_half_again(maps: ProfileMaps, of: WorkloadRun) -> Iterator[tuple[Case, list[Endpoints]]]:
    """The maps of the first half again, with its queries."""
    found = zip(of.queries_by_map, maps.maps(of.workload, of.size), strict=False)
    return ((on_map, queries) for queries, on_map in found if queries)


def _solvable(
    maps: ProfileMaps,
    of: WorkloadRun,
    load: Load,
) -> Iterator[tuple[Case, list[Endpoints]]]:
    """Maps with those of their queries that have a path, until there are enough; they are kept in
    `of`.
    """
    missing = load.queries
    for on_map in islice(maps.maps(of.workload, of.size), _MAPS_TRIED * load.queries):
        chosen = list(islice(filter(on_map.connections(), on_map.queries), missing))
        of.queries_by_map.append(chosen)
        missing -= len(chosen)
        if chosen:
            yield on_map, chosen
        if not missing:
            return
    raise InvalidQueryError(
        f"wanted {load.queries} queries with a path on maps of {of.size} × {of.size} "
        f"({of.workload}), found {load.queries - missing} on {len(of.queries_by_map)} maps"
    )


class _Session:
    """Measures the planners map by map, with the clock, sensors and meter of the whole run."""

    def __init__(
        self,
        profile: Profile,
        rivals: Sequence[RivalPlanner],
        sensors: Sensors | None,
    ) -> None:
        self._profile = profile
        self._rivals = rivals
        self._sensors = sensors
        self._harness = Harness()
        self._meter = EnergyMeter()

    def measure(
        self,
        on_map: Case,
        queries: list[Endpoints],
        of: WorkloadRun,
        half: int,
        disturbance: Disturbance,
    ) -> None:
        """Have all planners answer the queries on one map, and count the answers."""
        rivals = {rival.name: rival for rival in self._rivals}
        planners = {name: rival.planner(on_map.standing) for name, rival in rivals.items()}
        turns = on_map.ground.vehicle is not None
        asking = [] if turns else [each for each in self._rivals if each.method is Method.NNPP]
        networks = {each.name: each.model for each in asking if each.model is not None}
        energy = self._meter.read()
        worked_s = 0.0

        def answer(name: str, query: Endpoints) -> Plan:
            return rivals[name].plan(planners[name], query)

        def before(name: str) -> None:
            nonlocal energy, worked_s
            if turns:
                planners[name] = rivals[name].planner(on_map.standing)
            if self._sensors is not None and self._sensors.due():
                disturbance.left_out(self._sensors.read)
            energy = self._meter.read()
            worked_s = time.thread_time()

        def after(name: str, elapsed_s: float, plan: Plan) -> None:
            worked = time.thread_time() - worked_s
            of.answers[name].energy_mj.append(self._meter.since_mj(energy))
            if plan.method is Method.NNPP:  # this thread may have waited for threads of its own
                disturbance.leave_out(elapsed_s, worked)

        for name in rivals:
            answer(name, queries[0])  # the map's own work, and warm caches
        calls = {name: partial(answer, name) for name in rivals}
        repeats = self._profile.load.repeats
        disturbance.start()
        for records in self._harness.measure(
            calls, queries, repeats=repeats, before=before, after=after
        ):
            for name, record in records.items():
                of.answers[name].add(record, half)
            # networks last, so that no planner follows what others do not; each on the map that it
            # was shown last, encoded anew, and a query
            times = disturbance.left_out(partial(inference_ms, networks, self._harness))
            for name, ms in times.items():
                of.answers[name].figures[half][-1]["network_ms"] = ms
        disturbance.stop()

    def measure_arriving(
        self,
        on_map: Case,
        queries: list[Endpoints],
        of: WorkloadRun,
        half: int,
    ) -> None:
        """Measure the profile's planners on this map as if it had just arrived, and the loop's
        reactions where a budget asks for them.
        """
        ground = on_map.ground
        repeats = self._profile.load.repeats
        for rival in self._rivals:
            if rival.name not in self._profile.arriving:
                continue
            own = rival.apart()
            arrival_ms(own, ground, queries[0], self._harness)  # kernels loaded
            rows = of.answers[rival.name].figures[half][-len(queries) :]
            for query, row in zip(queries, rows, strict=True):
                times = [arrival_ms(own, ground, query, self._harness) for _ in range(repeats)]
                row["map_ms"], row["patch_ms"] = np.median(times, axis=0).tolist()
        here = (of.workload, of.size)
        if here in self._profile.measured_at("reaction") and len(of.reactions) == half:
            patches = self._profile.load.patches
            of.reactions.append(reactions(ground, queries, self._profile.loop, patches))
        if here in self._profile.measured_at("plain_ratio"):
            plain_ms = of.plain_ms[half]
            for query in queries[: _MOST_PLAIN - len(plain_ms)]:
                call = partial(_plain_astar, on_map, query)
                plain_ms.append(1e3 * self._harness.timed(call)[0])


def _plain_astar(on_map: Case, query: Endpoints) -> list[Cell] | None:
    """The answer of an A* like the paper's, its graph included."""
    return search(build_graph(on_map.cost), *query)
