"""The planners of the paper, in plain Python, their controls, and ours: a row (`rows`) for each
answer to a query.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.contest import Harness, gap
from nnpp_edge.progress import markdown_table
from nnpp_edge.progress import shown as figure
from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.plain import build_graph, search
from nnpp_edge.reproduction.regions import (
    CONTROLS,
    CORRIDOR,
    NETWORK,
    SHUFFLED,
    Networks,
    PaperRegions,
    all_regions,
    best_path,
)
from nnpp_edge.reproduction.rows import Row, Rows, percent, seconds, spread, times
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.planners.plan import Plan, Source
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.search.region import Region
from nnpp_edge.runtime.terrain.step_cost import StepModel

PLAIN = "plain A*"
PLAIN_NN = "plain A*NN"
"""The paper's two methods: A* over a graph of the whole map; A* over a graph of the network's
region, in which the time of the network counts."""
PLAIN_CONTROLS = {kind: f"{PLAIN}, {kind}" for kind in CONTROLS}
"""A* over a graph of a region that no network made, or one with shuffled weights; the region's
making counts.
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

    def __init__(self, cost: Float2D, query: Endpoints, networks: Networks) -> None:
        self.cost = cost
        self.query = query
        self.networks = networks
        self.maker = PaperRegions(cost, networks.paper)
        self.grid = Grid.of(cost, StepModel.of("paper"))
        self.regions = all_regions(self.maker, query)
        self.optimum = best_path(self.grid, query)
        self._least_cost, _, self._exact_cc = self.grid.costs_of(self.optimum)

    def row(
        self,
        planner: str,
        path: NDArray[np.int32] | list[Cell] | None,
        region: Region | None = None,
    ) -> Row:
        """Figures of a path found in this region or on the whole map."""
        cells = np.array([] if path is None else path, np.int32).reshape(-1, 2)
        cost, _, cc = self.grid.costs_of(cells)
        start, goal = (f"{row},{col}" for row, col in self.query)
        row: Row = {
            "planner": planner,
            "start": start,
            "goal": goal,
            "path_cells": len(self.optimum),
        }
        row["found"] = float(len(cells) > 0)
        if len(cells):
            row |= {"cc": cc, "exact_cc": self._exact_cc, "excess": gap(cost, self._least_cost)}
        if region is not None:
            area = region.area()
            row |= {"mm": len(self.optimum) / area, "share": area / self.cost.size}
        return row

    def searched(self, names: dict[str, str]) -> Rows:
        """Figures of compiled searches in regions, under these names by the regions' kinds."""
        found = ((name, self.regions[kind]) for kind, name in names.items())
        return Rows(
            self.row(name, best_path(self.grid, self.query, region), region)
            for name, region in found
        )

    def timed(self, planners: Sequence[str], repeats: int, harness: Harness) -> list[Row]:
        """Planners of `PLANNERS` in turns: ours `repeats` times, whose median time counts, plain
        Python once.
        """
        makers = {NETWORK: self.maker.find} | self.maker.controls(self.regions[NETWORK])
        ours = Planner(self.cost, model=self.networks.ours, ask_from=0)
        calls: dict[str, Callable[[Endpoints], Plan | list[Cell] | None]] = {PLAIN: self._plain}
        calls |= {
            name: partial(self._plain, make=makers[kind]) for kind, name in PLAIN_KINDS.items()
        }
        calls |= {name: lambda query, name=name: ours.plan(*query, method=name) for name in OURS}  # type: ignore[misc]
        for name in set(OURS).intersection(planners):
            calls[name](self.query)  # the map's own work, and warm caches
        taking_part = {name: calls[name] for name in planners}
        (records,) = harness.measure(
            taking_part, [self.query], repeats=repeats, once=PLAIN_PLANNERS
        )
        regions = {name: self.regions[kind] for kind, name in PLAIN_KINDS.items()}
        rows = []
        for name, record in records.items():
            found = record.results[-1]
            if isinstance(found, Plan):
                kept = ours.plan(*self.query, method=name, keep_regions=True)
                row = self.row(name, found.path, kept.region)
                row["found"] = float(found.source in (Source.MAP, Source.REGION))
            else:
                row = self.row(name, found, regions.get(name))
            rows.append(row | {"time_s": record.median_s})
            if name == PLAIN_NN:
                rows[-1]["inference_s"] = self.maker.inference_s
        return rows

    def _plain(
        self, query: Endpoints, make: Callable[[Endpoints], Region] | None = None
    ) -> list[Cell] | None:
        return search(build_graph(self.cost, make(query).mask() if make else None), *query)


def answers(
    cost: Float2D, query: Endpoints, networks: Networks, repeats: int, harness: Harness
) -> list[Row]:
    """All of `PLANNERS` timed; without `repeats` the paper's method and its controls alone, without
    times.
    """
    here = OneMap(cost, query, networks)
    if not repeats:
        return [here.row(PLAIN, here.optimum), *here.searched(PLAIN_KINDS)]
    return here.timed(PLANNERS, repeats, harness)


def network_of(planner: str, networks: Networks) -> str:
    """The network that a planner runs, for a table."""
    if planner.startswith("paper's"):
        return "the paper's" if planner.endswith("NN") else "–"
    asked = dict.fromkeys((PLAIN_NN, PLAIN_CONTROLS[SHUFFLED], NETWORK, SHUFFLED), networks.paper)
    asked |= dict.fromkeys(("nnpp", "nnpp-dstar"), networks.ours)
    return (
        f"`{asked[planner].metadata.name}`" + ", shuffled" * (SHUFFLED in planner)
        if planner in asked
        else "–"
    )


def shown(name: str, value: Any) -> str:
    """A value in the first columns of a table."""
    if name == "planner":
        return (
            str(value)
            if " " in value or value in CONTROLS_OF[NETWORK] or value == NETWORK
            else f"`{value}`"
        )
    return {"size": "{}²", "map": "map {}", "plan": "T + {}Δt"}.get(name, "{}").format(value)


def summary(
    rows: Sequence[Row], by: Sequence[str], networks: Networks, *, totals: bool = False
) -> str:
    r"""A table for people: a line for each group by these names, a column for each figure that the
    rows have.

    Means, or for `totals` sums over the queries that all planners answered, beside how many each
    failed. *over A\** is over the A* of the same origin: the paper's, plain, or ours.
    """
    everything = Rows(
        rows if isinstance(rows[0][by[0]], str) else sorted(rows, key=lambda row: row[by[0]])
    )
    rows = everything.answered() if totals else everything
    place = [name for name in by if name != "planner"]

    def every(of: Rows) -> Rows:
        return everything.of(**{name: of[0][name] for name in by})

    def of_all(of: Rows, name: str) -> float:
        return (sum(of.all(name)) or math.nan) if totals else of.mean(name)

    def over_astar(of: Rows) -> float:
        name = str(of[0]["planner"])
        slow = (
            paper.ASTAR
            if name.startswith("paper's")
            else PLAIN
            if name.startswith("plain")
            else "astar"
        )
        return rows.of(slow, **{name: of[0][name] for name in place}).mean("time_s") / of.mean(
            "time_s"
        )

    def mended(of: Rows) -> str:
        later = [row["mended"] for row in every(of) if row.get("plan") and "mended" in row]
        return f"{sum(later):.0f} of {len(later)}" if later else "–"

    def failed(of: Rows) -> str:
        return (
            f"{sum('cc' not in row for row in every(of))} of {len(every(of))}"
            if of.all("found")
            else "–"
        )

    columns: dict[str, tuple[str, Callable[[Rows], str]]] = {
        "network": ("planner", lambda of: network_of(str(of[0]["planner"]), networks)),
        "time in all" if totals else "AT": ("time_s", lambda of: seconds(of_all(of, "time_s"))),
        "over A*": ("time_s", lambda of: times(over_astar(of))),
        "inference": ("inference_s", lambda of: seconds(of.mean("inference_s"))),
        "graph": ("graph_s", lambda of: seconds(of.mean("graph_s"))),
        "search": ("search_s", lambda of: seconds(of.mean("search_s"))),
        "graph's share": ("graph_share", lambda of: percent(of.mean("graph_share"))),
        "path, cells": ("path_cells", lambda of: figure(of.mean("path_cells"), ".0f")),
        "length, cells": ("length", lambda of: figure(of.mean("length"), ".2f")),
        "CC": ("cc", lambda of: figure(of_all(of, "cc"), ".2f")),
        "CC increase": ("exact_cc", lambda of: percent(of.increase(), 2)),
        "cost above the optimum": ("excess", lambda of: percent(of.mean("excess"), 2)),
        "failed" if totals else "success": (
            "found",
            failed if totals else lambda of: percent(of.mean("found")),
        ),
        "MM": ("mm", lambda of: spread(of.all("mm"), 3)),
        "region, of the map": ("share", lambda of: percent(of.mean("share"))),
        "in common with the first": ("common", lambda of: percent(of.mean("common"))),
        "best ω": ("best_omega", lambda of: spread(of.all("best_omega"), 4)),
        "mended, plans after the first": ("mended", mended),
    }
    names = {name for row in rows for name in row}
    used = {label: text for label, (name, text) in columns.items() if name in names}
    if "planner" not in by:
        used = {label: text for label, text in used.items() if label not in ("network", "over A*")}
    lines = [
        [*map(shown, by, key), *(text(of) for text in used.values())]
        for key, of in rows.by(*by).items()
    ]
    return markdown_table([*by, *used], lines)
