"""The measured run of a profile: every planner, every query, in turns, in two halves."""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from nnpp_edge.profiling.arrivals import arrival_ms, reactions
from nnpp_edge.profiling.contest import Harness, RivalCalls, answer
from nnpp_edge.profiling.inference import inference_ms
from nnpp_edge.profiling.machine import Disturbance
from nnpp_edge.profiling.plain_astar import build_graph, search
from nnpp_edge.profiling.profile_file import SAMPLE, Device, Load, Networks, Profile
from nnpp_edge.profiling.quantities import EXACT
from nnpp_edge.profiling.rivals import OnMap, RivalPlanner
from nnpp_edge.profiling.rows import Row, Rows
from nnpp_edge.profiling.sensors import Sensors
from nnpp_edge.profiling.suites import (
    SYNTHETIC,
    Case,
    check_sizes,
    dems_of,
    solvable,
    terrain_cases,
)
from nnpp_edge.progress import Progress, ignore
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.options import METHODS, STILL
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.vehicle_files import load_vehicle

HALVES = 2
_MOST_PLAIN = 4
"""Queries that an A* in plain Python answers in each half: a second or more each at 256²."""


def maps_of(load: Load) -> Callable[[str, int], Iterator[Case]]:
    """Maps with their queries, without end, as a function of workload and size. The same load gives
    the same maps on any machine.

    TerrainError or InvalidQueryError if a terrain file or the vehicle's cannot be read, or no file
    is large enough for any of the sizes.
    """
    vehicle = None if load.vehicle is None else load_vehicle(load.vehicle)
    dems: list[Dem] = []
    for name in load.terrain:
        if name != SYNTHETIC:
            paths = () if name == SAMPLE else (Path(name),)
            dems += dems_of(paths, load.rescale, load.cell_size)
    if dems:
        largest = max(dems, key=lambda dem: min(dem.shape))
        check_sizes([largest], [min(load.sizes)])
    return lambda workload, size: terrain_cases(
        dems, workload, size, load.seed, load.min_distance, vehicle
    )


def rivals_of(networks: Networks, device: Device) -> list[RivalPlanner]:
    """The planners of a profile, each with a network of its own: one that planners share takes the
    map over whenever the other has used it. ModelError if a model cannot be loaded.
    """
    found = []
    for name, file in networks.by_planner.items():
        method = Method(name) if name in STILL else Method.NNPP
        asks = METHODS[method].chooses or "network" in METHODS[method].needs
        model = NetworkModel(file, threads=device.threads) if asks else None
        found.append(RivalPlanner(name, method, model))
    return found


def run(
    profile: Profile,
    rivals: Sequence[RivalPlanner],
    cores: Sequence[int],
    progress: Progress = ignore,
) -> "Run":
    """Have every planner, exact A* first, answer every query, in both halves of the run.

    `cores` are those that this process is pinned to: the time that others use on them is counted.
    `progress` is called with the number of queries that are done, of `queries_in`.

    On a vehicle's map each call is that of a planner which has checked no pose before. Maps and
    patches that have just arrived are measured afterwards, map by map: they drive the standing map
    out of the caches.
    """
    load = profile.load
    maps = maps_of(load)
    found = Run(profile, rivals, cores)
    done = 0
    for half, workload, size in product(range(HALVES), load.workloads, load.sizes):
        first = 0
        for case in solvable(maps(workload, size), load.queries):
            found.measure(case, half, first)
            first += len(case.queries)
            progress(done + first)
        done += first
    return found


def queries_in(load: Load) -> int:
    """How many queries `run` will report as done."""
    return HALVES * len(load.workloads) * len(load.sizes) * load.queries


class Run:
    """Measures the planners of a profile on one map after another."""

    def __init__(
        self, profile: Profile, rivals: Sequence[RivalPlanner], cores: Sequence[int]
    ) -> None:
        self._profile = profile
        self._rivals = {rival.name: rival for rival in rivals}
        self._harness = Harness()
        self.answers = Rows()
        """Of each planner to each ``query`` of a ``workload`` and ``size``, in each ``half``:
        figures as of `contest.answer`, ``stages_ms`` and, where they were measured,
        ``inference_ms`` of the whole network on map and query right after a plan (and ``fp32_ms``
        of the same network in fp32), ``map_ms`` from elevations to the path (by
        exact A* ``exact_map_ms``), ``patch_ms`` of a patch on that path, and ``plain_ms`` of an A*
        in plain Python."""
        self.reactions = Rows()
        """Answers of the onboard loop."""
        self.disturbance = [Disturbance(cores) for _ in range(HALVES)]
        self.sensors = Sensors(cores)
        """Read between the calls."""

    def measure(self, case: Case, half: int, first: int) -> None:
        """Have all planners answer the queries on one map, of which `first` is the number of the
        first; then the profile's on this map as if it had just arrived, and the loop where a budget
        asks for its reactions.
        """
        at = {"workload": case.workload, "size": case.size, "terrain": case.terrain, "half": half}
        rows = self._answered(case, self.disturbance[half])
        self._arriving(case, rows)
        place = (case.workload, case.size)
        if not first and place in self._profile.measured_at("reaction"):
            patches = self._profile.load.patches
            reacted = reactions(case.ground, case.queries, self._profile.loop, patches)
            self.reactions += [at | row for row in reacted]
        if place in self._profile.measured_at("plain_ratio"):
            plain = case.queries[: max(_MOST_PLAIN - first, 0)]
            for query, answers in zip(plain, rows, strict=False):
                seconds, _ = self._harness.timed(partial(_plain_astar, case, query))
                for row in answers.values():
                    row["plain_ms"] = 1e3 * seconds
        for number, answers in enumerate(rows, first):
            for name, row in answers.items():
                self.answers.append({**at, "planner": name, "query": number, **row})

    def _answered(self, case: Case, disturbance: Disturbance) -> list[dict[str, Row]]:
        """For each query a row for each planner."""
        sensors = self.sensors
        on_map = OnMap(case, self._rivals.values())
        networks = {}
        if case.ground.vehicle is None:  # no network is used on a vehicle's map
            for name, rival in self._rivals.items():
                if rival.method is Method.NNPP and rival.model is not None:
                    networks[name] = rival.model
        worked_s = 0.0

        def before(name: str) -> None:
            nonlocal worked_s
            on_map.renew(name)
            if sensors.due():
                with disturbance.left_out():
                    sensors.read()
            worked_s = time.thread_time()

        def after(name: str, elapsed_s: float, plan: Plan) -> None:
            if plan.method is Method.NNPP:  # this thread may have waited for threads of its own
                disturbance.leave_out(elapsed_s, time.thread_time() - worked_s)

        for call in on_map.calls.values():
            call(case.queries[0])  # the map's own work, and warm caches
        repeats = self._profile.load.repeats
        found = []
        with disturbance.watched():
            for records in self._harness.measure(
                on_map.calls, case.queries, repeats=repeats, before=before, after=after
            ):
                rows = {name: _row(record, records[EXACT]) for name, record in records.items()}
                # networks last, so that no planner follows what others do not; each on the map that
                # it was shown last, encoded anew, and a query
                with disturbance.left_out():
                    times = inference_ms(networks, self._harness)
                for name, ms in times.items():
                    rows[name]["inference_ms"] = ms
                if "nnpp-fp32" in times:
                    rows["nnpp"]["fp32_ms"] = times["nnpp-fp32"]
                found.append(rows)
        return found

    def _arriving(self, case: Case, rows: list[dict[str, Row]]) -> None:
        """Times of maps and patches that have just arrived, into the rows of the queries."""
        for name in self._rivals.keys() & self._profile.arriving:
            own = self._rivals[name]
            arrive = partial(arrival_ms, own, case.ground, harness=self._harness)
            arrive(case.queries[0])  # kernels loaded
            for query, answers in zip(case.queries, rows, strict=True):
                times = [arrive(query) for _ in range(self._profile.load.repeats)]
                map_ms, patch_ms = np.median(times, axis=0).tolist()
                answers[name] |= {"map_ms": map_ms, "patch_ms": patch_ms}
        for answers in rows:
            if "map_ms" in answers[EXACT]:
                for row in answers.values():
                    row["exact_map_ms"] = answers[EXACT]["map_ms"]


Calls = RivalCalls[Endpoints, Plan]


def _row(calls: Calls, exact: Calls) -> Row:
    """A planner's answer: the middle call of its turns (of two the faster one)."""
    seconds, plan = calls.middle()
    exact_s, optimum = exact.middle()
    stages_ms = {stage: ms for stage, ms in plan.timings_ms.items() if stage != "total"}
    stages_ms["other"] = 1e3 * seconds - sum(stages_ms.values())
    return {"stages_ms": stages_ms, **answer(plan, 1e3 * seconds, optimum, 1e3 * exact_s)}


def _plain_astar(case: Case, query: Endpoints) -> list[Cell] | None:
    """The answer of an A* like the paper's, its graph included."""
    return search(build_graph(case.cost), *query)
