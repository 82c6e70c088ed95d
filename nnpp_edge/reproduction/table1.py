"""Table 1: how much of A*'s time goes into building the graph, on one map at several resolutions."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.experiment import Context, Experiment, Report
from nnpp_edge.reproduction.pictures import COLOURS, PAPER, new_figure, png, sides_axis, tidy
from nnpp_edge.reproduction.plain_astar import build_graph, search
from nnpp_edge.reproduction.report import Finding, Result, Table, judge, percent, seconds
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.terrain.labels import Query


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    sizes: tuple[int, ...] = tuple(paper.TABLE_1)
    maps: int = 5
    repeats: int = 5
    """Of our own A*; the median counts."""


@dataclass(frozen=True)
class _Times:
    """Seconds on one map at one resolution."""

    graph_s: float
    search_s: float
    grid_s: float
    """Our exact A*: taking over the map."""
    astar_s: float
    path_cells: int


def run(context: Context, settings: Settings, report: Report) -> Result:
    """Average maps of the greatest size down to the others, start and goal with them, and time both A*."""
    sizes, notes = context.fitting(settings.sizes)
    largest = max(sizes)
    work = sum(size**2 for size in sizes) * settings.maps
    measured: dict[int, list[_Times]] = {size: [] for size in sizes}
    done = 0
    for case, query in context.maps(largest, settings.maps):
        for size in sizes:
            cost, (start, goal) = _scaled(case.cost, query, size)
            measured[size].append(_time(cost, (start, goal), settings.repeats))
            done += size**2
            report(done / work)
    figures = {size: _Times(*np.mean([_values(t) for t in times], axis=0)) for size, times in measured.items()}
    notes.append(
        f"Means; {settings.maps} of our maps, {largest}² each, averaged down to the other resolutions with start and "
        "goal; the paper's is one map. Our exact A* builds no graph: what stands in that place is the taking over of "
        "the map into its padded weights, which is done once for all queries on a map."
    )
    return Result(
        _summary(figures), _data(figures), _findings(figures), _picture(figures), notes
    )  # fmt: skip


def _scaled(cost: NDArray[np.float32], query: Query, size: int) -> tuple[NDArray[np.float32], Query]:
    """A map of `size` cells a side, each the mean of the passable cells that it covers, and the query on it."""
    factor = len(cost) // size
    if factor * size != len(cost):
        raise InvalidQueryError(f"wanted sizes that divide {len(cost)}, got {size}")
    cells = cost.reshape(size, factor, size, factor).astype(np.float64)
    passable = cells < 1.0
    count = passable.sum(axis=(1, 3))
    total = np.where(passable, cells, 0.0).sum(axis=(1, 3))
    small = np.where(count, total / np.maximum(count, 1), np.inf).astype(np.float32)
    (a, b), (c, d) = query
    return small, ((a // factor, b // factor), (c // factor, d // factor))


def _time(cost: NDArray[np.float32], query: Query, repeats: int) -> _Times:
    began = time.perf_counter()
    graph = build_graph(cost)
    built = time.perf_counter()
    path = search(graph, *query)
    ended = time.perf_counter()
    assert path is not None  # a cell is impassable only if all that it covers is
    grids, searches = [], []
    workspace = Workspace((len(cost) + 2) ** 2)
    for _ in range(repeats):
        first = time.perf_counter()
        grid = Grid.of(cost, StepModel.of("paper"))
        second = time.perf_counter()
        astar(grid, *query, workspace)
        grids.append(second - first)
        searches.append(time.perf_counter() - second)
    return _Times(
        built - began, ended - built, float(np.median(grids)), float(np.median(searches)), len(path)
    )  # fmt: skip


def _values(times: _Times) -> list[float]:
    return [times.graph_s, times.search_s, times.grid_s, times.astar_s, times.path_cells]


def _share(times: Any) -> float:
    share: float = times.graph_s / (times.graph_s + times.search_s)
    return share


def _summary(figures: dict[int, _Times]) -> Table:
    header = ("map", "graph, paper", "graph, plain A*", "search, paper", "search, plain A*", "graph's share, paper",
              "graph's share, plain A*", "path, paper", "path, ours", "our exact A*: map", "our exact A*: search",
              "plain A* over ours")  # fmt: skip
    rows = []
    for size, t in figures.items():
        theirs = paper.TABLE_1.get(size)
        rows.append((
            f"{size}²", theirs and seconds(theirs.graph_s), seconds(t.graph_s), theirs and seconds(theirs.search_s),
            seconds(t.search_s), theirs and percent(theirs.graph_share), percent(_share(t)),
            theirs and theirs.path_cells, f"{t.path_cells:.0f}", seconds(t.grid_s), seconds(t.astar_s),
            f"{(t.graph_s + t.search_s) / (t.grid_s + t.astar_s):.0f}×",
        ))  # fmt: skip
    return Table(header, rows)


def _data(figures: dict[int, _Times]) -> Table:
    header = ("size", "paper_graph_s", "paper_search_s", "paper_path_cells", "plain_graph_s", "plain_search_s",
              "astar_map_s", "astar_search_s", "path_cells")  # fmt: skip
    rows = []
    for size, t in figures.items():
        theirs = paper.TABLE_1.get(size)
        known = (theirs.graph_s, theirs.search_s, theirs.path_cells) if theirs else (None, None, None)
        rows.append((size, *known, t.graph_s, t.search_s, t.grid_s, t.astar_s, t.path_cells))
    return Table(header, rows)


def _findings(figures: dict[int, _Times]) -> Sequence[Finding]:
    shares = [_share(t) for t in figures.values()]
    lowest, highest = min(shares), max(shares)
    told = percent(lowest, 0) if len(shares) == 1 else f"{percent(lowest, 0)} to {percent(highest, 0)}"
    found = [
        judge(
            "the graph takes about 85 % of A*'s time", percent(paper.GRAPH_SHARE, 0), f"{told} (plain A*)",
            agrees=max(abs(share - paper.GRAPH_SHARE) for share in shares) <= 0.1,
            rule="within 10 points at every size",
        ),
        judge(
            "the graph takes the greater part of A*'s time", "84 to 89 %", f"{told} (plain A*)",
            agrees=lowest > 0.5, rule="over a half at every size",
        ),
    ]  # fmt: skip
    if len(figures) > 1:
        small, large = min(figures), max(figures)
        known = [paper.TABLE_1[size] for size in (small, large) if size in paper.TABLE_1]
        cells = (large / small) ** 2
        grown = _total(figures[large]) / _total(figures[small])
        theirs = _total(known[1]) / _total(known[0]) if len(known) == 2 else None
        found.append(judge(
            f"time grows with the number of cells ({cells:.0f}× from {small}² to {large}²)",
            "–" if theirs is None else f"{theirs:.0f}×", f"{grown:.0f}× (plain A*)",
            agrees=0.5 * cells <= grown <= 2.0 * cells, rule="within a factor of 2 of the cells'",
        ))  # fmt: skip
    return found


def _total(times: Any) -> float:
    total: float = times.graph_s + times.search_s
    return total


def _picture(figures: dict[int, _Times]) -> bytes:
    figure = new_figure(11.5, 5.0)
    left, right = figure.subplots(1, 2)
    sizes = list(figures)
    known = [size for size in sizes if size in paper.TABLE_1]
    theirs = [paper.TABLE_1[size] for size in known]
    for (label, colour, style), xs, graph, search_ in (
        (("paper's A*", PAPER, "--"), known, [t.graph_s for t in theirs], [t.search_s for t in theirs]),
        (("plain A*", COLOURS["plain A*"], "-"), sizes, [t.graph_s for t in figures.values()],
         [t.search_s for t in figures.values()]),
        (("our exact A*", COLOURS["astar"], "-"), sizes, [t.grid_s for t in figures.values()],
         [t.astar_s for t in figures.values()]),
    ):  # fmt: skip
        made = "map" if label == "our exact A*" else "graph"
        left.plot(xs, graph, style, marker="o", color=colour, label=f"{label}: {made}")
        left.plot(xs, search_, style, marker="^", color=colour, alpha=0.55, label=f"{label}: search")
    sides_axis(left, sizes)
    left.set_yscale("log")
    tidy(left, "Time of a query", "map", "seconds")
    left.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, frameon=False)
    places = np.arange(len(sizes))
    at_known = np.array([places[sizes.index(size)] for size in known])
    for left_edge, shares, colour, label in (
        (at_known - 0.2, [t.graph_share for t in theirs], PAPER, "paper's A*"),
        (places + 0.2, [_share(t) for t in figures.values()], COLOURS["plain A*"], "plain A*"),
    ):
        bars = right.bar(left_edge, [100.0 * share for share in shares], 0.38, color=colour, label=label)
        right.bar_label(bars, fmt="%.0f", fontsize="small")
    right.set_xticks(places, [f"{size}²" for size in sizes])
    right.set_ylim(0, 100)
    tidy(right, "Share of the time that building the graph takes", "map", "%")
    right.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False)
    return png(figure)


EXPERIMENT = Experiment(
    "Table 1", "Building the graph against searching it", run, Settings(), Settings((64, 128, 256), 1, 1)
)
