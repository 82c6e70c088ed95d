"""The planners of the paper, in plain Python, their controls, and ours: a row (`rows`) for each answer to a query."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.contest import Harness, gap
from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.plain_astar import build_graph, search
from nnpp_edge.reproduction.regions import (
    BAND,
    CONTROLS,
    CORRIDOR,
    NETWORK,
    SHUFFLED,
    Networks,
    PaperRegions,
    all_regions,
    band_region,
    best_path,
    corridor_region,
    shuffled,
)
from nnpp_edge.reproduction.rows import Columns, Row, Rows, number, percent, seconds, spread, table, times
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.planners.plan import Plan, Source
from nnpp_edge.runtime.planners.planner import Planner

Path = NDArray[np.int32]
PLAIN, PLAIN_NN = "plain A*", "plain A*NN"
"""The paper's two methods: A* over a graph of the whole map; A* over a graph of the network's region at the
adaptive threshold td, in which the time of the network counts."""
PLAIN_CONTROLS = {kind: f"{PLAIN}, {kind}" for kind in CONTROLS}
"""A* over a graph of a region that no network made, or one with shuffled weights; the region's making counts."""
PLAIN_DSTAR, PLAIN_DSTAR_NN, PLAIN_DSTAR_CORRIDOR = "plain D*", "plain D*NN", "plain D*, corridor"
"""D* Lite over a graph of the whole map, of the network's region, and of a corridor of the same area: the graph is
repaired as the map changes, and as the region does."""
PLAIN_KINDS = {NETWORK: PLAIN_NN, **PLAIN_CONTROLS}
"""The plain planners that search a region, by its kind."""
PLAIN_PLANNERS = (PLAIN, PLAIN_NN, *PLAIN_CONTROLS.values())
OURS = ("astar", "corridor", "nnpp")
PLANNERS = (*PLAIN_PLANNERS, *OURS)
OWN = {NETWORK: "`nnpp`'s own region"} | {kind: f"*{kind}* in place of `nnpp`'s own region" for kind in CONTROLS}
"""The region of our network by the paper's rule, before all that ``nnpp`` does with it, and its controls."""
CONTROLS_OF = {
    PLAIN_NN: PLAIN_CONTROLS,
    PLAIN_DSTAR_NN: {CORRIDOR: PLAIN_DSTAR_CORRIDOR},
    OWN[NETWORK]: {kind: OWN[kind] for kind in CONTROLS},
    "nnpp": {CORRIDOR: "corridor"},
    "nnpp-dstar": {CORRIDOR: "corridor-dstar"},
}
"""For each method with a network the same without it, by the kind of region in its place."""


class OneMap:
    """A map with one query: its optimum, its regions, and rows for answers to the query."""

    def __init__(self, cost: Float2D, query: Endpoints, networks: Networks) -> None:
        self.cost, self.query, self.networks = cost, query, networks
        self.maker, self.grid = PaperRegions(cost, networks.paper), Grid.of(cost, StepModel.of("paper"))
        self.regions = all_regions(self.maker, query)
        self.optimum = best_path(self.grid, query)
        self._least_cost, _, self._exact_cc = self.grid.costs_of(self.optimum)

    def row(self, planner: str, path: Path, region: Region | None = None) -> Row:
        """Figures of a path found in this region or on the whole map."""
        cost, _, cc = self.grid.costs_of(path)
        start, goal = (f"{row},{col}" for row, col in self.query)
        row: Row = {"planner": planner, "start": start, "goal": goal, "path_cells": len(self.optimum)}
        row["found"] = float(len(path) > 0)
        if len(path):
            row |= {"cc": cc, "exact_cc": self._exact_cc, "excess": gap(cost, self._least_cost)}
        if region is not None:
            area = region.area()
            row |= {"mm": len(self.optimum) / area, "share": area / self.cost.size}
        return row

    def searched(self, names: dict[str, str], regions: dict[str, Region]) -> list[Row]:
        """Figures of compiled searches in regions, under these names by the regions' kinds."""
        paths = {kind: best_path(self.grid, self.query, regions[kind]) for kind in names}
        return [self.row(name, paths[kind], regions[kind]) for kind, name in names.items()]

    def timed(self, planners: Sequence[str], repeats: int, harness: Harness) -> list[Row]:
        """Planners of `PLANNERS` in turns: ours `repeats` times, whose median time counts, plain Python once."""
        makers: dict[str, Callable[[Endpoints], Region]] = {
            NETWORK: self.maker.find,
            CORRIDOR: partial(corridor_region, self.grid, like=self.regions[NETWORK]),
            BAND: partial(band_region, self.grid, like=self.regions[NETWORK]),
            SHUFFLED: PaperRegions(self.cost, shuffled(self.networks.paper)).find,
        }
        ours = Planner(self.cost, model=self.networks.ours, ask_from=0)
        calls: dict[str, Callable[[Endpoints], Plan | list[Cell] | None]] = {PLAIN: self._plain}
        calls |= {name: partial(self._plain, make=makers[kind]) for kind, name in PLAIN_KINDS.items()}
        calls |= {name: lambda query, name=name: ours.plan(*query, method=name) for name in OURS}  # type: ignore[misc]
        taking_part = {name: calls[name] for name in planners}
        for name in set(OURS).intersection(planners):
            calls[name](self.query)  # the map's own work, and warm caches
        (records,) = harness.measure(taking_part, [self.query], repeats=repeats, once=PLAIN_PLANNERS)
        regions, rows = {name: self.regions[kind] for kind, name in PLAIN_KINDS.items()}, []
        for name, record in records.items():
            found = record.results[-1]
            if isinstance(found, Plan):
                kept = ours.plan(*self.query, method=name, keep_regions=True)
                row = self.row(name, found.path, kept.region)
                row["found"] = float(found.source in (Source.MAP, Source.REGION))
            else:
                row = self.row(name, np.array(found or [], np.int32).reshape(-1, 2), regions.get(name))
            rows.append(row | {"time_s": record.median_s})
            if name == PLAIN_NN:
                rows[-1]["inference_s"] = self.maker.inference_s
        return rows

    def _plain(self, query: Endpoints, make: Callable[[Endpoints], Region] | None = None) -> list[Cell] | None:
        return search(build_graph(self.cost, make(query).mask() if make else None), *query)


def answers(cost: Float2D, query: Endpoints, networks: Networks, repeats: int, harness: Harness) -> list[Row]:
    """All of `PLANNERS` and `OWN`, the former timed; without `repeats` the regions of the paper's and of ours alone.

    Success, MM and share of ``nnpp`` are those of its network's own region.
    """
    here = OneMap(cost, query, networks)
    own_regions = all_regions(PaperRegions(cost, networks.ours), query)
    own = here.searched(OWN, own_regions)
    if not repeats:
        return [here.row(PLAIN, here.optimum), *here.searched(PLAIN_KINDS, here.regions), *own]
    *others, nnpp = here.timed(PLANNERS, repeats, harness)
    return [*others, nnpp | {name: own[0][name] for name in ("found", "mm", "share")}, *own]


def shown(planner: str) -> str:
    """A planner's name in a table for people: ours as code."""
    return planner if " " in planner else f"`{planner}`"


def network_of(planner: str, networks: Networks) -> str:
    """The network that a planner runs, for a table."""
    if planner.startswith("paper's"):
        return "the paper's" if planner.endswith("NN") else "–"
    asked = dict.fromkeys((PLAIN_NN, PLAIN_DSTAR_NN, PLAIN_CONTROLS[SHUFFLED]), networks.paper)
    asked |= dict.fromkeys(("nnpp", "nnpp-dstar", OWN[NETWORK], OWN[SHUFFLED]), networks.ours)
    return f"`{asked[planner].metadata.name}`" + ", shuffled" * (SHUFFLED in planner) if planner in asked else "–"


def planner_table(rows: Rows, place: str, names: str, networks: Networks, more: Columns | None = None) -> str:
    r"""A line for each place (``size``, ``map``, ``scene``) and planner; `names` are columns, `more` further ones.

    *over A\** is over the A* of the same origin: the paper's, plain, or ours.
    """

    def over_astar(of: Rows) -> float:
        name, at = str(of[0]["planner"]), of[0][place]
        slow = paper.ASTAR if name.startswith("paper's") else PLAIN if name.startswith("plain") else "astar"
        return rows.of(slow, **{place: at}).mean("time_s") / of.mean("time_s")

    label = {"size": "{}²", "map": "map {}"}.get(place, "{}")
    columns: Columns = {
        "network": lambda of: network_of(str(of[0]["planner"]), networks),
        "AT": lambda of: seconds(of.mean("time_s")),
        "over A*": lambda of: times(over_astar(of)),
        "CC": lambda of: number(of.mean("cc"), ".2f"),
        "CC increase": lambda of: percent(of.increase(), 2),
        "success": lambda of: percent(of.mean("found")),
        "MM": lambda of: spread(of, "mm"),
        "region, of the map": lambda of: percent(of.mean("share")),
    }
    groups = {(label.format(at), shown(str(name))): of for (at, name), of in rows.by(place, "planner").items()}
    return table(
        f"{place} | planner", groups, {name: columns[name] for name in names.split(" | ")} | dict(more or {})
    )
