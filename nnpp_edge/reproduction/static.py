"""Table 2, Fig. 9, 11 and 12: the paper's method, its controls and our planners on random queries
of random maps.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from operator import methodcaller
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.rows import Row, Rows
from nnpp_edge.profiling.suites import LEAST_DISTANCE
from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.experiment import Context, Experiment
from nnpp_edge.reproduction.findings import (
    ONE_POINT,
    WITHIN,
    Figure,
    Finding,
    judge,
    judge_increase,
    judge_speedups,
    mean,
    pairs,
    stated,
)
from nnpp_edge.reproduction.paper import ASTAR, ASTAR_NN
from nnpp_edge.reproduction.planners import OURS, PLAIN_KINDS, PLAIN_NN, PLAIN_PLANNERS, OneMap
from nnpp_edge.reproduction.table import percent
from nnpp_edge.viz.figures import panels, with_legend

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

_MORE = math.nextafter(1.0, 2.0)


def contest(
    context: Context,
    *,
    sizes: Sequence[int],
    repeats: int,
    maps: int = 0,
    queries: int = 0,
    least_distance: float = LEAST_DISTANCE,
    draw: bool = False,
) -> Iterator[Row]:
    """All planners on so many random maps of each size, one query each; the first `queries` of each
    size against the clock. Of maps and queries one may be left out.
    """
    harness = Harness()
    sizes = context.fitting(sizes)
    for number, case in context.maps(sizes, maps or queries, least_distance):
        here = OneMap(case.cost, case.queries[0], context.networks)
        if number <= (queries or maps):
            rows = here.plain(PLAIN_KINDS, harness)
            rows += here.ours(repeats, harness)
        else:
            rows = here.searched(PLAIN_KINDS)
        for row in rows:
            yield {"size": case.size, "map": number, **row}
        if draw:
            own = rows.of(PLAIN_NN)
            excess = percent(own.mean("gap"), 2)
            title = f"map {number}: MM {own.mean('mm'):.3f},\ncost {excess} above the optimum"
            context.scenes.append(drawing.scene(title, here))


def table2_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of all sizes."""
    for size, of_size in rows.by("size").items():
        where = f", {size}²"
        if theirs := paper.TABLE_2.of(size=size):
            yield from judge_speedups(ASTAR, ASTAR_NN, theirs, of_size, where)
            for words, _, network in pairs(ASTAR, ASTAR_NN):
                most = theirs.increase(ASTAR_NN)
                yield judge_increase(f"{words}{where}", most, of_size, network)
            success = theirs.of(ASTAR_NN).mean("found")
            yield judge(
                f"success of A*NN in its first region{where}",
                percent(success),
                WITHIN,
                mean("found", PLAIN_NN),
                of_size,
                PLAIN_NN,
                least=success - ONE_POINT,
                better_from=success + ONE_POINT,
            )
        mean_s = {of_size.of(name).mean("time_s"): name for name in OURS}
        fastest = mean_s[min(mean_s)]
        yield stated(
            f"the network's region is the fastest way to plan{where}",
            "A*NN",
            f"`{fastest}`",
            "`nnpp` has the least mean time of ours",
            fastest == "nnpp",
        )
    yield from _growth("the network gains more on larger maps", rows)


def _growth(claim: str, rows: Rows) -> Iterator[Finding]:
    """Whether the network gains more on larger maps."""
    sizes = rows.by("size")
    small = min(sizes)
    large = max(sizes)
    if small == large:
        return
    theirs = []
    for size in (small, large):
        if known := paper.TABLE_2.of(size=size):
            theirs.append(f"{known.speedup(ASTAR, ASTAR_NN):.1f}×")
    for words, exact, network in pairs(ASTAR, ASTAR_NN):
        gains = {size: of.speedup(exact, network) for size, of in sizes.items()}
        yield judge(
            f"{claim} ({words})",
            " → ".join(theirs) or "yes",
            f"more at {large}² than at {small}²",
            _grown(methodcaller("speedup", exact, network), small, large),
            rows,
            network,
            least=_MORE,
            ours=", ".join(f"{size}² {gain:.2f}×" for size, gain in gains.items()),
        )


def _grown(of: Callable[[Rows], float], small: int, large: int) -> Figure:
    """A figure on the largest maps over that on the smallest."""

    def grown(rows: Rows) -> float:
        return of(rows.of(size=large)) / of(rows.of(size=small))

    return Figure(grown, "{:.3g}×".format)


def fig9_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of all sizes."""
    by_size = rows.by("size")
    inference_s = [of.mean("inference_s") for of in by_size.values()]
    mean_s = np.mean(inference_s)
    yield stated(
        "inference takes the same time whatever the map's size",
        f"{1e3 * paper.INFERENCE_S:.0f} ms throughout",
        f"{1e3 * min(inference_s):.2f} to {1e3 * max(inference_s):.2f} ms",
        "the means within 30 % of their mean",
        np.ptp(inference_s) <= 0.3 * mean_s,
    )
    yield stated(
        "inference keeps up 17 frames a second on a CPU",
        f"{1.0 / paper.INFERENCE_S:.0f} a second",
        f"{1.0 / mean_s:.0f} a second",
        "at least the paper's",
        mean_s <= paper.INFERENCE_S,
    )
    yield from _growth("the larger the map, the more the network gains", rows)
    small = min(by_size)
    large = max(by_size)
    if small == large:
        return

    mm = mean("mm", PLAIN_NN).of
    ends = (f"{size}² {mm(by_size[size]):.3f}" for size in (small, large))
    yield judge(
        "MM falls as the map grows",
        "yes",
        f"less at {large}² than at {small}², plain A*NN",
        _grown(mm, small, large),
        rows,
        PLAIN_NN,
        most=1.0,
        ours=", ".join(ends),
    )


def _fig11_picture(rows: Rows) -> "Picture":
    """Each query's time against the length of its path."""
    figure, places = panels(1, 2)
    plain = ("Plain Python, a graph for each query", PLAIN_PLANNERS[:3])
    ours = ("This toolkit's planners", OURS)
    for axes, (title, names) in zip(places, (plain, ours), strict=True):
        for name in names:
            own = rows.of(name)
            colour = drawing.COLOURS[name]
            axes.plot(own.all("path_cells"), own.all("time_s"), ".", color=colour, label=name)
        axes.set(title=title, xlabel="cells of the optimal path", ylabel="seconds")
    return with_legend(figure)


def _fit(rows: Rows) -> tuple[float, float]:
    """Seconds a cell of the path, by a line through one planner's times, and the correlation."""
    cells = rows.all("path_cells")
    times_s = rows.all("time_s")
    if len(set(cells)) < 2:
        return 0.0, 0.0
    slope, _ = np.polyfit(cells, times_s, 1)
    return slope, np.corrcoef(cells, times_s)[0, 1]


def fig11_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of all queries."""
    for _, slow, fast in pairs(ASTAR, ASTAR_NN):
        yield from _slopes(rows, slow, fast)


def _slopes(rows: Rows, slow: str, fast: str) -> Iterator[Finding]:
    slope_s, correlation = _fit(rows.of(slow))
    pair = f"({fast} against {slow})"
    yield stated(
        f"time grows with the path's length ({slow})",
        "yes",
        f"{1e6 * slope_s:.3g} µs a cell, r = {correlation:.2f}",
        "correlation above 0.3",
        slope_s > 0.0 and correlation > 0.3,
    )
    yield judge(
        f"it grows more slowly with the network {pair}",
        "yes",
        "a smaller slope",
        Figure(lambda rows: 1e6 * _fit(rows.of(fast))[0], "{:.3g} µs a cell".format),
        rows,
        fast,
        most=1e6 * slope_s,
    )
    yield judge(
        f"the network's way is much the faster {pair}",
        "yes",
        "on at least 90 %",
        Figure(partial(_wins, slow, fast), "faster on {:.0%} of the queries".format),
        rows,
        fast,
        least=0.9,
    )


def _wins(slow: str, fast: str, rows: Rows) -> float:
    """Share of the queries that the fast planner answers faster."""
    faster = np.less(rows.of(fast).all("time_s"), rows.of(slow).all("time_s"))
    return float(faster.mean())


def fig12_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of all maps, beside the static rows of Table 4."""
    theirs = paper.TABLE_4.of(scene=paper.STATIC)
    yield from judge_speedups(ASTAR, ASTAR_NN, theirs, rows)
    yield judge_increase("A*NN, plain", theirs.increase(ASTAR_NN), rows, PLAIN_NN)
    own = rows.of(PLAIN_NN)
    mm = own.all("mm")
    known = theirs.all("mm")
    most = own.increase() + ONE_POINT
    yield judge(
        "MM of the network's region",
        f"{min(known):.2f} to {max(known):.2f}",
        "our mean lies within the paper's range",
        mean("mm", PLAIN_NN),
        rows,
        PLAIN_NN,
        least=min(known),
        better_from=max(known),
        also=lambda rows: rows.increase(PLAIN_NN) <= most,
        ours=f"{min(mm):.3f} to {max(mm):.3f}",
    )
    yield judge(
        "the region is a small part of the map",
        "yes (Fig. 8)",
        "below 20 %",
        mean("region_share", PLAIN_NN, found=1.0),
        rows,
        PLAIN_NN,
        most=0.2,
    )


EXPERIMENTS = {
    "table2": Experiment(
        "Table 2",
        "A* against A* in the network's region",
        contest,
        ("size", "planner"),
        table2_findings,
        partial(drawing.by_planner, "size"),
        {"sizes": (256, 512), "maps": paper.VALIDATION_MAPS, "queries": 200, "repeats": 3},
        paper.TABLE_2,
    ),
    "fig9": Experiment(
        "Fig. 9",
        "Time and ModelMetric against the map's size",
        contest,
        ("size", "planner"),
        fig9_findings,
        partial(
            drawing.by_size,
            {
                "time_s": ("Mean time of a query", "seconds"),
                "inference_s": ("Mean time of the inference", "seconds"),
                "mm": ("Mean MM", "path's cells / region's cells"),
            },
        ),
        {"sizes": (64, 128, 256, 512, 1024), "queries": 30, "repeats": 3},
        [*paper.TABLE_1, *paper.TABLE_2.of(ASTAR_NN)],
    ),
    "fig11": Experiment(
        "Fig. 11",
        "Time against the length of the path",
        partial(contest, least_distance=0.05),
        ("planner",),
        fig11_findings,
        _fig11_picture,
        {"sizes": (256,), "queries": 300, "repeats": 3},
    ),
    "fig12": Experiment(
        "Fig. 12 and Table 4, static",
        "Regions and paths on five maps",
        partial(contest, draw=True),
        ("planner",),
        fig12_findings,
        None,
        {"sizes": (256,), "maps": 5, "repeats": 5},
        paper.TABLE_4.of(scene=paper.STATIC),
    ),
}
