"""The measured run of a profile: every planner, every query, in turns, in two halves."""

import math
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from nnpp_edge.profiling.arrivals import arrival_ms, reactions
from nnpp_edge.profiling.contest import Harness, RivalCalls, answer
from nnpp_edge.profiling.inference import inference_ms
from nnpp_edge.profiling.machine import Disturbance, EnergyMeter
from nnpp_edge.profiling.plain_astar import build_graph, search
from nnpp_edge.profiling.profile_file import PLANNERS, SAMPLE, Device, Load, Networks, Profile
from nnpp_edge.profiling.rivals import EXACT, OnMap, RivalPlanner
from nnpp_edge.profiling.rows import Row, Rows
from nnpp_edge.profiling.sensors import Sensors
from nnpp_edge.profiling.suites import (
    SYNTHETIC,
    Case,
    check_sizes,
    dems_of,
    solvable,
    source_of,
    terrain_cases,
)
from nnpp_edge.progress import Progress, ignore
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.options import METHODS
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.vehicle_files import load_vehicle

HALVES = 2
_MOST_PLAIN = 4
"""Queries that an A* in plain Python answers in each half: a second or more each at 256²."""


@dataclass
class Measurements:
    """All that was measured."""

    answers: Rows
    """Of each planner to each ``query`` of a ``workload`` and ``size``, in each ``half``: figures
    as of `contest.answer`, ``stages_ms`` and, where they were measured, ``energy_mj`` of a call,
    ``inference_ms`` of the whole network on map and query right after a plan (and ``fp32_ms`` of
    the same network in fp32), ``map_ms`` from elevations to the path, ``patch_ms`` of a patch on
    that path, and ``plain_ms`` of an A* in plain Python."""
    reactions: Rows
    """Answers of the onboard loop."""
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
                self.dems += dems_of(paths, load.rescale, load.cell_size)
        if self.dems:
            largest = max(self.dems, key=lambda dem: min(dem.shape))
            check_sizes([largest], [min(load.sizes)])

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
    """The planners of a profile, each with a network of its own: one that planners share takes the
    map over whenever the other has used it. ModelError if a model cannot be loaded.
    """
    others = {"nnpp-fp32": networks.fp32, "paper": networks.paper}
    found = []
    for name in PLANNERS:
        file = others.get(name, networks.int8)
        if file is None:
            continue
        method = Method.NNPP if name in others else Method(name)
        asks = METHODS[method].chooses or "network" in METHODS[method].needs
        model = NetworkModel(file, threads=device.threads) if asks else None
        found.append(RivalPlanner(name, method, model))
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
    by_name = {rival.name: rival for rival in rivals}
    harness = Harness()
    meter = EnergyMeter()
    found = Measurements(Rows(), Rows(), [Disturbance(cores) for _ in range(HALVES)])
    places = list(product(load.workloads, load.sizes))
    done = 0
    for half, (workload, size) in product(range(HALVES), places):
        terrain = source_of(maps.dems, size)
        at = {"workload": workload, "size": size, "terrain": terrain, "half": half}
        session = _Session(profile, by_name, sensors, harness, meter, at, found)
        for on_map, queries in solvable(maps.maps(workload, size), load.queries):
            session.measure(on_map, queries)
            done += len(queries)
            progress(done)
    return found


def queries_in(load: Load) -> int:
    """How many queries `run` will report as done."""
    return HALVES * len(load.workloads) * len(load.sizes) * load.queries


@dataclass
class _Session:
    """Measures the planners on the maps of one workload and size, in one half of the run."""

    profile: Profile
    rivals: Mapping[str, RivalPlanner]
    sensors: Sensors | None
    harness: Harness
    meter: EnergyMeter
    at: Row
    """Of every row."""
    found: Measurements
    queries: int = 0
    """That are answered."""

    def measure(self, on_map: Case, queries: list[Endpoints]) -> None:
        """Have all planners answer the queries on one map; then the profile's on this map as if it
        had just arrived, and the loop where a budget asks for its reactions.
        """
        first = self.queries
        place = (self.at["workload"], self.at["size"])
        rows = self._answered(on_map, queries)
        self._arriving(on_map.ground, queries, rows)
        if not first and place in self.profile.measured_at("reaction"):
            patches = self.profile.load.patches
            reacted = reactions(on_map.ground, queries, self.profile.loop, patches)
            self.found.reactions += [self.at | row for row in reacted]
        plain = place in self.profile.measured_at("plain_ratio")
        for query, answers in zip(queries[: max(_MOST_PLAIN - first, 0)], rows, strict=False):
            if plain:
                call = partial(_plain_astar, on_map, query)
                plain_ms = 1e3 * self.harness.timed(call)[0]
                for row in answers.values():
                    row["plain_ms"] = plain_ms
        self.found.answers += [row for answers in rows for row in answers.values()]

    def _answered(self, on_map: Case, queries: list[Endpoints]) -> list[dict[str, Row]]:
        """For each query a row for each planner."""
        disturbance = self.found.disturbance[self.at["half"]]
        of_rivals = OnMap(on_map, self.rivals.values())
        networks = {
            name: rival.model
            for name, rival in self.rivals.items()
            if rival.method is Method.NNPP and rival.model is not None
        }
        if on_map.ground.vehicle is not None:  # where no network is used
            networks.clear()
        energies_mj = defaultdict[str, list[float]](list)
        energy = self.meter.read()
        worked_s = 0.0

        def before(name: str) -> None:
            nonlocal energy, worked_s
            of_rivals.renew(name)
            if self.sensors is not None and self.sensors.due():
                disturbance.left_out(self.sensors.read)
            energy = self.meter.read()
            worked_s = time.thread_time()

        def after(name: str, elapsed_s: float, plan: Plan) -> None:
            worked = time.thread_time() - worked_s
            energies_mj[name].append(self.meter.since_mj(energy))
            if plan.method is Method.NNPP:  # this thread may have waited for threads of its own
                disturbance.leave_out(elapsed_s, worked)

        for call in of_rivals.calls.values():
            call(queries[0])  # the map's own work, and warm caches
        repeats = self.profile.load.repeats
        found = []
        disturbance.start()
        for records in self.harness.measure(
            of_rivals.calls, queries, repeats=repeats, before=before, after=after
        ):
            rows = {name: self._row(name, records) for name in records}
            for name, spent_mj in energies_mj.items():
                if not math.isnan(energy_mj := float(np.mean(spent_mj))):
                    rows[name]["energy_mj"] = energy_mj
            energies_mj.clear()
            # networks last, so that no planner follows what others do not; each on the map that it
            # was shown last, encoded anew, and a query
            times = disturbance.left_out(partial(inference_ms, networks, self.harness))
            for name, ms in times.items():
                rows[name]["inference_ms"] = ms
            if "nnpp-fp32" in times:
                rows["nnpp"]["fp32_ms"] = times["nnpp-fp32"]
            found.append(rows)
            self.queries += 1
        disturbance.stop()
        return found

    def _row(self, name: str, records: Mapping[str, RivalCalls[Endpoints, Plan]]) -> Row:
        """A planner's answer: the middle call of its turns (of two the faster one)."""
        seconds, plan = records[name].middle()
        exact_s, optimum = records[EXACT].middle()
        stages_ms = {stage: ms for stage, ms in plan.timings_ms.items() if stage != "total"}
        stages_ms["other"] = 1e3 * seconds - sum(stages_ms.values())
        row = {"planner": name, "query": self.queries, "stages_ms": stages_ms}
        figures = answer(plan, 1e3 * seconds, optimum, 1e3 * exact_s)
        return {**self.at, **row, **figures}

    def _arriving(
        self, ground: Ground, queries: list[Endpoints], rows: list[dict[str, Row]]
    ) -> None:
        """Times of maps and patches that have just arrived, into the rows of the queries."""
        for name in self.rivals.keys() & self.profile.arriving:
            own = self.rivals[name].apart()
            arrival_ms(own, ground, queries[0], self.harness)  # kernels loaded
            for query, answers in zip(queries, rows, strict=True):
                times = [
                    arrival_ms(own, ground, query, self.harness)
                    for _ in range(self.profile.load.repeats)
                ]
                map_ms, patch_ms = np.median(times, axis=0).tolist()
                answers[name] |= {"map_ms": map_ms, "patch_ms": patch_ms}


def _plain_astar(on_map: Case, query: Endpoints) -> list[Cell] | None:
    """The answer of an A* like the paper's, its graph included."""
    return search(build_graph(on_map.cost), *query)
