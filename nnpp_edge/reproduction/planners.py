"""The planners of the paper, in plain Python, their controls, and ours: a row (`rows`) for each
answer to a query.
"""

import time
from collections.abc import Iterable
from functools import partial

import numpy as np

from nnpp_edge.profiling.contest import Answer, Harness, beside, priced
from nnpp_edge.profiling.plain_astar import build_graph, search
from nnpp_edge.profiling.rivals import planned
from nnpp_edge.profiling.rows import Row, Rows
from nnpp_edge.reproduction.regions import (
    BAND,
    CONTROLS,
    CORRIDOR,
    NETWORK,
    SHUFFLED,
    NetworkPair,
    best_path,
    grid_of,
    nearest_blocks,
    shuffled,
)
from nnpp_edge.runtime.arrays import Bool, Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.kernels.threshold import lowered
from nnpp_edge.runtime.network.encoding import Frame
from nnpp_edge.runtime.planners.plan import Plan
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.region.learned import RegionFinder
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.terrain.shards import planes_of

PLAIN = "plain A*"
PLAIN_NN = "plain A*NN"
"""The paper's two methods: A* over a graph of the whole map; A* over a graph of the network's
region, in which the time of the network counts."""
PLAIN_CONTROLS = {kind: f"{PLAIN}, {kind}" for kind in CONTROLS}
"""A* over a graph of a region that no network made, or one with shuffled weights; the time to make
the region counts.
"""
WHOLE_MAP = "whole map"
PLAIN_KINDS = {WHOLE_MAP: PLAIN, NETWORK: PLAIN_NN, **PLAIN_CONTROLS}
"""The plain planners by the kind of region that they search."""
PLAIN_PLANNERS = tuple(PLAIN_KINDS.values())
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
    """A map with one query: its optimum, its regions, and rows for answers to the query.

    The network's region is by the paper's rule, to the letter (NNPP, section 4.3 and Fig. 10): the
    map is averaged to the network's size. td is the greatest threshold at which start and goal lie
    in one piece of {p >= td}, where blocks that touch are one piece; the region is all of
    {p >= factor · td}, by the factor in the model's metadata. The network is run once, and nothing
    is widened or narrowed. Its controls are of as many blocks.
    """

    def __init__(self, cost: Float2D, query: Endpoints, networks: NetworkPair) -> None:
        self.cost = cost
        self.query = query
        self.networks = networks
        self.grid = grid_of(cost)
        self.optimum = best_path(self.grid, query)
        facts = networks.paper.metadata
        self._frame = Frame(*self.grid.shape, facts.input_size)
        self._factor = facts.region_factor
        self._side = facts.blocks
        self.lookup = self._frame.lookup(self._side)
        self.finder = RegionFinder(self._side)
        row_block, col_block = self.lookup
        self._ends = [(int(row_block[row]), int(col_block[col])) for row, col in query]
        self._models = {
            NETWORK: networks.paper,
            SHUFFLED: shuffled(networks.paper.path),
        }
        self._inference_s = dict[str, float]()
        self._count = 0
        self.regions = {kind: self.region(kind) for kind in (NETWORK, *CONTROLS)}
        """The network's and the controls', by their names."""

    def region(self, kind: str) -> Region:
        """The network's region or that of a control, made anew."""
        if kind in self._models:
            blocks = self._by_network(kind)
        else:
            line = self._ends if kind == BAND else self._coarse_path()
            blocks = nearest_blocks(line, self._count, self._side)
        if kind == NETWORK:
            self._count = int(blocks.sum())
        return Region(np.pad(blocks, (0, 1)).astype(np.int32), *self.lookup, 1)

    def _by_network(self, kind: str) -> Bool:
        """The blocks at the factor on td."""
        model = self._models[kind]
        model.set_map(planes_of(self.grid, self._frame))
        start, goal = map(self._frame.place, self.query)
        began = time.perf_counter()
        probability = model.answer(start, goal, anew=True)
        self._inference_s[kind] = time.perf_counter() - began
        self.finder.read(probability)
        td = self.finder.threshold(*self._ends)
        blocks: Bool = self.finder.levels >= min(td, lowered(td, self._factor))
        return blocks

    def _coarse_path(self) -> list[Cell]:
        """The cheapest path over the map averaged to blocks; start and goal where there is none."""
        cost, blocked = planes_of(self.grid, Frame(*self.grid.shape, self._side))
        passable = np.where(blocked < 1.0, np.minimum(cost, np.float32(0.999)), np.float32(np.inf))
        return search(build_graph(passable), *self._ends) or self._ends

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
            rows.append(self.row(name, best_path(self.grid, self.query, self.regions.get(kind))))
        return rows

    def plain(self, kinds: Iterable[str], harness: Harness) -> Rows:
        """Planners of `PLAIN_KINDS` in turns, once each."""
        calls = {kind: partial(self._plain, kind) for kind in kinds}
        (records,) = harness.measure(calls, [self.query])
        rows = Rows()
        for kind, record in records.items():
            path = np.array(record.results[0] or np.empty((0, 2)), np.int32)
            row = self.row(PLAIN_KINDS[kind], priced(self.grid, path, self.regions.get(kind)))
            row["time_s"] = record.median_s
            if kind == NETWORK:
                row["inference_s"] = self._inference_s[NETWORK]
            rows.append(row)
        return rows

    def ours(self, repeats: int, harness: Harness) -> Rows:
        """The planners `OURS` in turns, `repeats` times, whose median time counts."""
        planner = Planner(self.cost, model=self.networks.ours, ask_from=0)
        calls = {name: partial(planned, planner, name) for name in OURS}
        for call in calls.values():
            call(self.query)  # the map's own work, and warm caches
        (records,) = harness.measure(calls, [self.query], repeats=repeats)
        rows = Rows()
        for name, record in records.items():
            plan = calls[name](self.query, keep_regions=True)
            rows.append({**self.row(name, plan), "time_s": record.median_s})
        return rows

    def _plain(self, kind: str, query: Endpoints) -> list[Cell] | None:
        """Plain A* over the map's graph, or over that of a region, which is made anew."""
        inside = None if kind == WHOLE_MAP else self.region(kind).mask()
        return search(build_graph(self.cost, inside), *query)
