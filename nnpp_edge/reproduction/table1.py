"""Table 1: how much of A*'s time goes into building the graph, on one map at several resolutions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from nnpp_edge.profiling.harness import Harness
from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import COLOURS, PAPER, legend_below, new_figure, png, sides_axis, tidy
from nnpp_edge.reproduction.plain_astar import build_graph, search
from nnpp_edge.reproduction.report import (
    About,
    Finding,
    Result,
    Table,
    Value,
    columns,
    judge,
    percent,
    seconds,
    times,
)
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.workspace import Workspace


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    sizes: tuple[int, ...] = tuple(paper.TABLE_1)
    maps: int = 5
    repeats: int = 5
    """Of our own A*; the median counts."""


@dataclass(frozen=True)
class Times(paper.Graphing):
    """On one map at one resolution: plain A*, and our exact A*."""

    grid_s: float
    """Of our exact A*: preparing the map."""
    astar_s: float


Figures = dict[int, Times]
"""By the side of the map."""


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """Average maps of the greatest size down to the others, start and goal with them, and time both A*."""
    sizes, notes = context.fitting(settings.sizes)
    largest = max(sizes)
    work = sum(size**2 for size in sizes) * settings.maps
    measured: dict[int, list[Times]] = {size: [] for size in sizes}
    done = 0
    for case, query in context.maps(largest, settings.maps):
        for size in sizes:
            cost, (start, goal) = _scaled(case.cost, query, size)
            measured[size].append(_time(cost, (start, goal), settings.repeats))
            done += size**2
            progress(done / work)
    figures = {size: _mean(found) for size, found in measured.items()}
    notes.append(
        f"Means; {settings.maps} of our maps, {largest}² each, averaged down to the other resolutions with start and "
        "goal; the paper's is one map. Our exact A* builds no graph: what stands in that place is the taking over of "
        "the map into its padded weights, which is done once for all queries on a map."
    )
    about = About("none", f"{settings.maps} maps, one query each; our exact A* the median of {settings.repeats}")
    return Result(about, summary(figures), _data(figures), findings(figures), _picture(figures), notes)


def _scaled(cost: Float2D, query: Endpoints, size: int) -> tuple[Float2D, Endpoints]:
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


def _time(cost: Float2D, query: Endpoints, repeats: int) -> Times:
    harness, workspace = Harness(), Workspace((len(cost) + 2) ** 2)
    graph_s, graph = harness.timed(lambda: build_graph(cost))
    search_s, path = harness.timed(lambda: search(graph, *query))
    assert path is not None  # a cell is impassable only if all that it covers is
    grids_s, searches_s = [], []
    for _ in range(repeats):
        grid_s, grid = harness.timed(lambda: Grid.of(cost, StepModel.of("paper")))
        astar_s, _ = harness.timed(lambda grid=grid: astar(grid, *query, workspace))  # type: ignore[misc]
        grids_s.append(grid_s)
        searches_s.append(astar_s)
    return Times(graph_s, search_s, len(path), float(np.median(grids_s)), float(np.median(searches_s)))


def _mean(found: Sequence[Times]) -> Times:
    return Times(*(float(np.mean([getattr(each, part.name) for each in found])) for part in fields(Times)))


_COLUMNS: tuple[tuple[str, Callable[[float], str]], ...] = (
    ("graph_s", seconds),
    ("search_s", seconds),
    ("graph_share", percent),
    ("path_cells", "{:.0f}".format),
)
"""What the paper gives too, and how it is shown."""


def summary(figures: Figures) -> Table:
    header = columns(
        "map | graph, paper | graph, plain A* | search, paper | search, plain A* | graph's share, paper | "
        "graph's share, plain A* | path, paper | path, ours | our exact A*: map | our exact A*: search | "
        "plain A* over ours"
    )
    rows = []
    for size, t in figures.items():
        theirs = paper.TABLE_1.get(size)
        row: list[Value] = []
        for name, text in _COLUMNS:
            row += [text(getattr(theirs, name)) if theirs else None, text(getattr(t, name))]
        ours = (seconds(t.grid_s), seconds(t.astar_s), times(t.total_s, t.grid_s + t.astar_s, ".0f"))
        rows.append((f"{size}²", *row, *ours))
    return Table(header, rows)


def _data(figures: Figures) -> Table:
    header = columns(
        "size | paper_graph_s | paper_search_s | paper_path_cells | plain_graph_s | plain_search_s | astar_map_s | "
        "astar_search_s | path_cells"
    )
    rows = []
    for size, t in figures.items():
        theirs = paper.TABLE_1.get(size)
        known = (theirs.graph_s, theirs.search_s, theirs.path_cells) if theirs else (None, None, None)
        rows.append((size, *known, t.graph_s, t.search_s, t.grid_s, t.astar_s, t.path_cells))
    return Table(header, rows)


def findings(figures: Figures) -> Sequence[Finding]:
    shares = [t.graph_share for t in figures.values()]
    lowest, highest = min(shares), max(shares)
    span = percent(lowest, 0) if len(shares) == 1 else f"{percent(lowest, 0)} to {percent(highest, 0)}"
    ours, near = f"{span} (plain A*)", max(abs(share - paper.GRAPH_SHARE) for share in shares) <= 0.1
    about, greater = "the graph takes about 85 % of A*'s time", "the graph takes the greater part of A*'s time"
    found = [
        judge(about, percent(paper.GRAPH_SHARE, 0), ours, agrees=near, rule="within 10 points at every size"),
        judge(greater, "84 to 89 %", ours, agrees=lowest > 0.5, rule="over a half at every size"),
    ]
    if len(figures) > 1:
        found.append(_growth(figures, min(figures), max(figures)))
    return found


def _growth(figures: Figures, small: int, large: int) -> Finding:
    known = [paper.TABLE_1[size].total_s for size in (small, large) if size in paper.TABLE_1]
    cells, grown = (large / small) ** 2, figures[large].total_s / figures[small].total_s
    return judge(
        f"time grows with the number of cells ({cells:.0f}× from {small}² to {large}²)",
        times(known[1], known[0], ".0f") if len(known) == 2 else "–",
        f"{grown:.0f}× (plain A*)",
        agrees=0.5 * cells <= grown <= 2.0 * cells,
        rule="within a factor of 2 of the cells'",
    )


def _picture(figures: Figures) -> bytes:
    figure = new_figure(11.5, 5.0)
    left, right = figure.subplots(1, 2)
    theirs = {size: paper.TABLE_1[size] for size in figures if size in paper.TABLE_1}
    for label, colour, style, made, by_size in (
        ("paper's A*", PAPER, "--", "graph", {size: (t.graph_s, t.search_s) for size, t in theirs.items()}),
        (
            "plain A*",
            COLOURS["plain A*"],
            "-",
            "graph",
            {size: (t.graph_s, t.search_s) for size, t in figures.items()},
        ),
        ("our exact A*", COLOURS["astar"], "-", "map", {size: (t.grid_s, t.astar_s) for size, t in figures.items()}),
    ):
        sizes, parts = list(by_size), list(by_size.values())
        left.plot(sizes, [part[0] for part in parts], style, marker="o", color=colour, label=f"{label}: {made}")
        searches_s = [part[1] for part in parts]
        left.plot(sizes, searches_s, style, marker="^", color=colour, alpha=0.55, label=f"{label}: search")
    sides_axis(left, list(figures))
    left.set_yscale("log")
    tidy(left, "Time of a query", "map", "seconds")
    legend_below(left, 3)
    places = {size: at for at, size in enumerate(figures)}
    for shift, shares, colour, label in (
        (-0.2, {size: t.graph_share for size, t in theirs.items()}, PAPER, "paper's A*"),
        (0.2, {size: t.graph_share for size, t in figures.items()}, COLOURS["plain A*"], "plain A*"),
    ):
        heights = [100.0 * share for share in shares.values()]
        bars = right.bar([places[size] + shift for size in shares], heights, 0.38, color=colour, label=label)
        right.bar_label(bars, fmt="%.0f", fontsize="small")
    right.set_xticks(list(places.values()), [f"{size}²" for size in places])
    right.set_ylim(0, 100)
    tidy(right, "Share of the time that building the graph takes", "map", "%")
    legend_below(right, 2)
    return png(figure)


EXPERIMENT = Experiment(
    "Table 1",
    "Building the graph against searching it",
    run,
    Settings(),
    Settings((64, 128, 256), 1, 1),
    asks_networks=False,
)
