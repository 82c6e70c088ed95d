"""The planners of the paper, in plain Python, their controls, and ours: a row (`rows`) for each
answer to a query.
"""

from collections.abc import Iterable
from functools import partial

import numpy as np

from nnpp_edge.profiling.contest import Answer, Harness, beside, priced
from nnpp_edge.profiling.plain_astar import build_graph, search
from nnpp_edge.profiling.rivals import RivalPlanner
from nnpp_edge.profiling.rows import Row, Rows
from nnpp_edge.reproduction.regions import (
    CONTROLS,
    CORRIDOR,
    NETWORK,
    NetworkPair,
    PaperRegions,
    best_path,
)
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.planners.plan import Method, Plan
from nnpp_edge.runtime.planners.planner import Planner

PLAIN = "plain A*"
PLAIN_NN = "plain A*NN"
"""The paper's two methods: A* over a graph of the whole map; A* over a graph of the network's
region, in which the time of the network counts."""
PLAIN_CONTROLS = {kind: f"{PLAIN}, {kind}" for kind in CONTROLS}
"""A* over a graph of a region that no network made, or one with shuffled weights; the time to make
the region counts.
"""
PLAIN_KINDS = {NETWORK: PLAIN_NN, **PLAIN_CONTROLS}
"""The plain planners that search a region, by its kind."""
PLAIN_PLANNERS = (PLAIN, *PLAIN_KINDS.values())
OURS = ("astar", "corridor", "nnpp")
PLANNERS = (*PLAIN_PLANNERS, *OURS)
CONTROLS_OF = {
    NETWORK: {kind: kind for kind in CONTROLS},
    PLAIN_NN: PLAIN_CONTROLS,
    "nnpp": {CORRIDOR: "corridor"},
    "nnpp-dstar": {CORRIDOR: "corridor-dstar"},
}
"""For each method with a network the same without it, by the kind of region in its place."""


class OneMap:
    """A map with one query: its optimum, its regions, and rows for answers to the query."""

    def __init__(self, cost: Float2D, query: Endpoints, networks: NetworkPair) -> None:
        self.cost = cost
        self.query = query
        self.networks = networks
        self.maker = PaperRegions(cost, query, networks.paper)
        self.grid = self.maker.grid
        self.optimum = best_path(self.grid, query)
        self.regions = {kind: self.maker.region(kind) for kind in (NETWORK, *CONTROLS)}
        """The network's and the controls', by their names."""

    def row(self, planner: str, found: Answer | Plan) -> Row:
        """Figures of an answer."""
        start, goal = self.query
        place = {"start": "{},{}".format(*start), "goal": "{},{}".format(*goal)}
        cells = len(self.optimum.path)
        return {"planner": planner, **place, "path_cells": cells, **beside(found, self.optimum)}

    def searched(self, names: dict[str, str]) -> Rows:
        """Figures of compiled searches in regions, under these names by the regions' kinds."""
        rows = Rows()
        for kind, name in names.items():
            rows.append(self.row(name, best_path(self.grid, self.query, self.regions[kind])))
        return rows

    def untimed(self) -> Rows:
        """The paper's method and its controls, by compiled searches."""
        return Rows([self.row(PLAIN, self.optimum), *self.searched(PLAIN_KINDS)])

    def plain(self, names: Iterable[str], harness: Harness) -> Rows:
        """Planners of `PLAIN_PLANNERS` in turns, once each."""
        kinds = {name: kind for kind, name in PLAIN_KINDS.items()}
        calls = {name: partial(self._plain, kinds.get(name)) for name in names}
        (records,) = harness.measure(calls, [self.query])
        rows = Rows()
        for name, record in records.items():
            region = self.regions.get(kinds.get(name, ""))
            path = np.array(record.results[0] or np.empty((0, 2)), np.int32)
            row = self.row(name, priced(self.grid, path, region))
            row["time_s"] = record.median_s
            if name == PLAIN_NN:
                row["inference_s"] = self.maker.inference_s
            rows.append(row)
        return rows

    def ours(self, repeats: int, harness: Harness) -> Rows:
        """The planners `OURS` in turns, `repeats` times, whose median time counts."""
        planner = Planner(self.cost, model=self.networks.ours, ask_from=0)
        rivals = [RivalPlanner(name, Method(name)) for name in OURS]
        calls = {rival.name: partial(rival.plan, planner) for rival in rivals}
        for call in calls.values():
            call(self.query)  # the map's own work, and warm caches
        (records,) = harness.measure(calls, [self.query], repeats=repeats)
        rows = Rows()
        for name, record in records.items():
            plan = calls[name](self.query, keep_regions=True)
            rows.append({**self.row(name, plan), "time_s": record.median_s})
        return rows

    def _plain(self, kind: str | None, query: Endpoints) -> list[Cell] | None:
        """Plain A* over the map's graph, or over that of a region, which is made anew."""
        inside = None if kind is None else self.maker.region(kind).mask()
        return search(build_graph(self.cost, inside), *query)
