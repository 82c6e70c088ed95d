"""Table 2, Fig. 9, 11 and 12: the paper's method, its controls and our planners on random queries
of random maps.
"""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.suites import LEAST_DISTANCE
from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.drawing import Panel, RegionPicture
from nnpp_edge.reproduction.experiment import Context, Result
from nnpp_edge.reproduction.findings import (
    Finding,
    judge,
    judge_increase,
    judge_speedup,
)
from nnpp_edge.reproduction.planners import (
    OURS,
    PLAIN,
    PLAIN_NN,
    PLAIN_PLANNERS,
    PLANNERS,
    OneMap,
)
from nnpp_edge.reproduction.rows import Rows, percent
from nnpp_edge.viz.figures import new_figure

_PAIRS = {
    (PLAIN, PLAIN_NN): "A*NN over A*, both plain",
    ("astar", "nnpp"): "`nnpp` over our own exact A*",
}
"""Whose gain is compared with the paper's."""


def contest(
    context: Context,
    sizes: Sequence[int],
    maps: int,
    repeats: int,
    *,
    timed: float = math.inf,
    least_distance: float = LEAST_DISTANCE,
) -> Iterator[tuple[OneMap, Rows]]:
    """All planners on so many random maps of each size, one query each; the first `timed` of each
    size against the clock.
    """
    harness = Harness()
    for number, case, query in context.maps(sizes, maps, least_distance):
        here = OneMap(case.cost, query, context.networks)
        rows = here.timed(PLANNERS, repeats, harness) if number <= timed else here.untimed()
        yield here, Rows({"size": case.size, "map": number, **row} for row in rows)


def table2(
    context: Context,
    *,
    sizes: Sequence[int] = (256, 512),
    maps: int = paper.VALIDATION_MAPS,
    queries: int = 200,
    repeats: int = 3,
) -> Result:
    """All planners timed on some of the maps, the regions of both networks on all."""
    sizes = context.fitting(sizes)
    rows = Rows()
    for _, found in contest(context, sizes, maps, repeats, timed=queries):
        rows += found
    everything = Rows(row for row in (*paper.TABLE_2, *rows) if row["size"] in sizes)
    return Result(
        rows,
        ("size", "planner"),
        table2_findings(rows),
        drawing.bars({f"{size}²": everything.of(size=size) for size in sizes}),
        everything,
    )


def table2_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of all sizes."""
    for size, of_size in rows.by("size").items():
        where = f"{size}²: "
        theirs = paper.TABLE_2.of(size=size)
        if theirs:
            gain = theirs.speedup(paper.ASTAR, paper.ASTAR_NN)
            increase = theirs.increase(paper.ASTAR_NN)
            for (slow, fast), label in _PAIRS.items():
                claim = f"{where}speed-up of {label}"
                yield judge_speedup(claim, gain, of_size, slow, fast, near=True)
                yield judge_increase(f"{where}CC increase of {label}", increase, of_size, fast)
            yield _success(where, theirs.of(paper.ASTAR_NN).mean("found"), of_size)
        mean_s = {of_size.of(name).mean("time_s"): name for name in OURS}
        fastest = mean_s[min(mean_s)]
        yield judge(
            f"{where}the network's region is the fastest way to plan",
            "A*NN",
            f"`{fastest}`",
            "`nnpp` has the least mean time of ours",
            fastest == "nnpp",
        )
    yield from _growth(rows, "the network gains more on larger maps")


def _success(where: str, theirs: float, rows: Rows) -> Finding:
    ours = rows.of(PLAIN_NN).mean("found")
    return judge(
        f"{where}success of A*NN in its first region",
        percent(theirs),
        percent(ours),
        "within one point",
        lambda rows: rows.of(PLAIN_NN).mean("found") >= theirs - 0.01,
        rows,
        PLAIN_NN,
        better=ours - theirs > 0.01,
    )


def _growth(rows: Rows, claim: str) -> Iterator[Finding]:
    """Whether the network gains more on larger maps."""
    sizes = rows.by("size")
    ends = (min(sizes), max(sizes))
    if len(sizes) == 1:
        return
    known = paper.TABLE_2.speedups(paper.ASTAR, paper.ASTAR_NN)
    theirs = " → ".join(f"{known[size]:.1f}×" for size in ends if size in known)
    for pair, label in _PAIRS.items():
        gains = rows.speedups(*pair)
        yield judge(
            f"{claim} ({label})",
            theirs or "yes",
            ", ".join(f"{size}² {gain:.2f}×" for size, gain in gains.items()),
            "more at {1}² than at {0}²".format(*ends),
            partial(_grows, pair),
            rows,
            pair[1],
        )


def _grows(pair: tuple[str, str], rows: Rows) -> bool:
    """Whether a speed-up is greater on the largest maps than on the smallest."""
    gains = rows.speedups(*pair)
    return gains[max(gains)] > gains[min(gains)]


def fig9(
    context: Context,
    *,
    sizes: Sequence[int] = (64, 128, 256, 512, 1024),
    queries: int = 30,
    repeats: int = 3,
) -> Result:
    """Random queries on random maps of each size, all planners on each."""
    sizes = context.fitting(sizes)
    rows = Rows()
    for _, found in contest(context, sizes, queries, repeats):
        rows += found
    theirs = (*paper.TABLE_1, *paper.TABLE_2.of(paper.ASTAR_NN))
    everything = Rows(row for row in (*theirs, *rows) if row["size"] in sizes)
    times = Rows(everything)
    for row in rows.of(PLAIN_NN):
        times.append({**row, "planner": "inference", "time_s": row["inference_s"]})
    styles = {
        paper.ASTAR: "o--",
        paper.ASTAR_NN: "s:",
        **dict.fromkeys(PLANNERS, "o-"),
        "inference": "x-",
    }
    narrow = dict.fromkeys((PLAIN_NN, "corridor", "nnpp"), "o-")
    charts = [
        Panel(times, "time_s", styles, "Mean time of a query", "seconds"),
        Panel(rows, "mm", narrow, "Mean MM", "path's cells / region's cells"),
    ]
    return Result(
        rows,
        ("size", "planner"),
        fig9_findings(rows),
        drawing.by_size(charts),
        everything,
    )


def fig9_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of all sizes."""
    by_size = rows.by("size")
    inference_s = [of.mean("inference_s") for of in by_size.values()]
    mean_s = np.mean(inference_s)
    yield judge(
        "inference takes the same time whatever the map's size",
        f"{1e3 * paper.INFERENCE_S:.0f} ms throughout",
        f"{1e3 * min(inference_s):.2f} to {1e3 * max(inference_s):.2f} ms",
        "the means within 30 % of their mean",
        bool(np.ptp(inference_s) <= 0.3 * mean_s),
    )
    yield judge(
        "inference keeps up 17 frames a second on a CPU",
        f"{1.0 / paper.INFERENCE_S:.0f} a second",
        f"{1.0 / mean_s:.0f} a second",
        "at least the paper's",
        bool(mean_s <= paper.INFERENCE_S),
    )
    yield from _growth(rows, "the larger the map, the more the network gains")
    small = min(by_size)
    large = max(by_size)
    if small == large:
        return

    def mm(rows: Rows, size: int) -> float:
        return rows.of(PLAIN_NN, size=size).mean("mm")

    yield judge(
        "MM falls as the map grows",
        "yes",
        f"{small}² {mm(rows, small):.3f}, {large}² {mm(rows, large):.3f}",
        f"less at {large}² than at {small}², plain A*NN",
        lambda rows: mm(rows, large) < mm(rows, small),
        rows,
        PLAIN_NN,
    )


def fig11(context: Context, *, size: int = 256, queries: int = 300, repeats: int = 3) -> Result:
    """Random queries, near ones among them, each put to all planners."""
    size = context.one_size(size)
    rows = Rows()
    for _, found in contest(context, [size], queries, repeats, least_distance=0.05):
        rows += found
    figure = new_figure(11.5, 4.6)
    left, right = figure.subplots(1, 2)
    for axes, title, names in (
        (left, "Plain Python, a graph for each query", PLAIN_PLANNERS[:3]),
        (right, "This toolkit's planners", OURS),
    ):
        for name in names:
            color = drawing.COLOURS[name]
            own = rows.of(name)
            cells = np.array(own.all("path_cells"))
            times_s = np.array(own.all("time_s"))
            slope, offset, _ = _fit(own)
            axes.scatter(cells, 1e3 * times_s, s=12, alpha=0.6, color=color)
            axes.plot(cells, 1e3 * (offset + slope * cells), color=color, label=name)
        drawing.tidy(axes, title, "cells of the optimal path", "time of a query, ms")
        axes.legend(fontsize="small")
    findings = chain.from_iterable(_slopes(rows, *pair) for pair in _PAIRS)
    return Result(rows, ("planner",), findings, figure)


def _fit(rows: Rows) -> tuple[float, float, float]:
    """Seconds a cell of the path, seconds for none, and the correlation, of a line through one
    planner's times.
    """
    cells = rows.all("path_cells")
    times_s = rows.all("time_s")
    if len(set(cells)) < 2:
        return 0.0, rows.mean("time_s"), 0.0
    slope, offset = np.polyfit(cells, times_s, 1)
    return slope, offset, np.corrcoef(cells, times_s)[0, 1]


def _slopes(rows: Rows, slow: str, fast: str) -> Iterator[Finding]:
    slope_s, _, correlation = _fit(rows.of(slow))
    pair = f"({fast} against {slow})"
    yield judge(
        f"time grows with the path's length ({slow})",
        "yes",
        f"{1e6 * slope_s:.3g} µs a cell, r = {correlation:.2f}",
        "correlation above 0.3",
        slope_s > 0.0 and correlation > 0.3,
    )

    def slope_of_fast(rows: Rows) -> float:
        return _fit(rows.of(fast))[0]

    yield judge(
        f"it grows more slowly with the network {pair}",
        "yes",
        f"{1e6 * slope_of_fast(rows):.3g} µs a cell",
        "a smaller slope",
        lambda rows: slope_of_fast(rows) < slope_s,
        rows,
        fast,
    )

    def wins(rows: Rows) -> float:
        """Share of the queries that the fast planner answers faster."""
        won = np.less(rows.of(fast).all("time_s"), rows.of(slow).all("time_s"))
        return float(won.mean())

    yield judge(
        f"the network's way is much the faster {pair}",
        "yes",
        f"faster on {percent(wins(rows), 0)} of the queries",
        "on at least 90 %",
        lambda rows: wins(rows) >= 0.9,
        rows,
        fast,
    )


def fig12(context: Context, *, size: int = 256, maps: int = 5, repeats: int = 5) -> Result:
    """One query on each of five maps: drawn, and answered by all planners."""
    size = context.one_size(size)
    rows = Rows()
    scenes = list[RegionPicture]()
    for here, found in contest(context, [size], maps, repeats):
        rows += found
        own = found.of(PLAIN_NN)
        title = f"map {len(scenes) + 1}: MM {own.mean('mm'):.3f},\n"
        title += f"cost {percent(own.mean('excess'), 2)} above the optimum"
        scenes.append(RegionPicture(title, here))
    return Result(
        rows,
        ("planner",),
        fig12_findings(rows),
        drawing.maps([scenes]),
        [*rows, *paper.TABLE_4.of(scene=paper.STATIC)],
    )


def fig12_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of all maps, beside the static rows of Table 4."""
    theirs = paper.TABLE_4.of(scene=paper.STATIC)
    label = _PAIRS[PLAIN, PLAIN_NN]
    gain = theirs.speedup(paper.ASTAR, paper.ASTAR_NN)
    yield judge_speedup(f"speed-up of {label}", gain, rows, PLAIN, PLAIN_NN, near=True)
    own = rows.of(PLAIN_NN)
    mm = own.all("mm")
    known = theirs.all("mm")
    most = own.increase() + 0.01

    def as_narrow(rows: Rows) -> bool:
        own = rows.of(PLAIN_NN)
        return own.increase() <= most and own.mean("mm") >= min(known)

    yield judge(
        "MM of the network's region",
        f"{min(known):.2f} to {max(known):.2f}",
        f"{min(mm):.3f} to {max(mm):.3f}",
        "our mean lies within the paper's range",
        as_narrow,
        rows,
        PLAIN_NN,
        better=own.mean("mm") > max(known),
    )
    increase = theirs.increase(paper.ASTAR_NN)
    yield judge_increase(f"CC increase of {label}", increase, rows, PLAIN_NN)
    yield judge(
        "the region is a small part of the map",
        "yes (Fig. 8)",
        percent(own.mean("share")),
        "below 20 %",
        lambda rows: rows.of(PLAIN_NN, found=1.0).mean("share") < 0.2,
        rows,
        PLAIN_NN,
    )
