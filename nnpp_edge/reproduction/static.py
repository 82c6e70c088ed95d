"""Table 2, Fig. 9, 11 and 12: the paper's method, its controls and our planners on random queries
of random maps.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.suites import LEAST_DISTANCE
from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.experiment import Context, Result, experiment
from nnpp_edge.reproduction.findings import Finding, Own, judge, judge_increase, judge_speedup
from nnpp_edge.reproduction.planners import OURS, PLAIN, PLAIN_NN, PLAIN_PLANNERS, PLANNERS, answers
from nnpp_edge.reproduction.rows import Rows, percent
from nnpp_edge.viz.figures import new_figure

_THEIRS = (paper.ASTAR, paper.ASTAR_NN)
_PAIRS = {
    (PLAIN, PLAIN_NN): "A*NN over A*, both plain",
    ("astar", "nnpp"): "`nnpp` over our own exact A*",
}
"""Whose gain is compared with the paper's."""


def contest(
    context: Context,
    sizes: Sequence[int],
    maps: int,
    *,
    repeats: int,
    timed: int | None = None,
    least_distance: float = LEAST_DISTANCE,
) -> Rows:
    """All planners on so many random maps a size, one query each; the first `timed` of them against
    the clock.
    """
    harness = Harness()
    rows = Rows()
    done = 0
    for size in sizes:
        for at, (case, query) in enumerate(context.maps(size, maps, least_distance), 1):
            clock = repeats if timed is None or at <= timed else 0
            found = answers(case.cost, query, context.networks, clock, harness)
            rows += [{"size": size, "map": at, **row} for row in found]
            done += size**2
            context.progress(done / (maps * sum(side**2 for side in sizes)))
    return rows


@experiment(
    "Table 2", "A* against A* in the network's region", {"maps": 8, "queries": 4, "repeats": 2}
)
def table2(
    context: Context,
    *,
    sizes: Sequence[int] = (256, 512),
    maps: int = paper.VALIDATION_MAPS,
    queries: int = 200,
    repeats: int = 3,
) -> Result:
    """All planners against the clock on some of the maps, the regions of both networks on all."""
    sizes = context.fitting(sizes)
    rows = contest(context, sizes, maps, repeats=repeats, timed=queries)
    theirs = Rows(row for row in paper.TABLE_2 if row["size"] in sizes)
    everything = [*theirs, *rows]
    picture = drawing.bars({f"{size}²": Rows(everything).of(size=size) for size in sizes})
    return Result(rows, ("size", "planner"), table2_findings(rows), picture, everything)


def table2_findings(rows: Rows) -> list[Finding]:
    """Of the rows of all sizes."""
    found = list[Finding]()
    for (size,), of in rows.by("size").items():
        if theirs := paper.TABLE_2.of(size=size):
            gain = theirs.speedup(*_THEIRS)
            more = theirs.increase(paper.ASTAR_NN)
            for pair, label in _PAIRS.items():
                found.append(
                    judge_speedup(f"{size}²: speed-up of {label}", gain, of, pair, near=True)
                )
                found.append(judge_increase(f"{size}²: CC increase of {label}", more, of, pair[1]))
            known = theirs.of(paper.ASTAR_NN).mean("found")
            own = of.of(PLAIN_NN).mean("found")

            def as_often(own: Own, of: Rows = of, least: float = known - 0.01) -> bool:
                return of.of(own(PLAIN_NN)).mean("found") >= least

            claim = f"{size}²: success of A*NN in its first region"
            better = own - known > 0.01
            texts = percent(known), percent(own), "within one point"
            found.append(judge(claim, *texts, as_often, of, PLAIN_NN, better=better))
        mean_s = {name: of.of(name).mean("time_s") for name in OURS}
        fastest = min(mean_s, key=mean_s.__getitem__)
        claim = f"{size}²: the network's region is the fastest way to plan"
        rule = "`nnpp` has the least mean time of ours"
        found.append(judge(claim, "A*NN", f"`{fastest}`", rule, fastest == "nnpp"))
    return [*found, *_growth(rows, "the network gains more on larger maps")]


def _growth(rows: Rows, claim: str) -> Iterator[Finding]:
    """Whether the network gains more on larger maps."""
    by_size = {size: of for (size,), of in rows.by("size").items()}
    small = next(iter(by_size))
    large = list(by_size)[-1]
    if small == large:
        return
    known = [
        f"{of.speedup(*_THEIRS):.1f}×"
        for size in (small, large)
        if (of := paper.TABLE_2.of(size=size))
    ]
    for (slow, fast), label in _PAIRS.items():

        def grows(own: Own, slow: str = slow, fast: str = fast) -> bool:
            return by_size[large].speedup(slow, own(fast)) > by_size[small].speedup(slow, own(fast))

        ours = ", ".join(f"{size}² {of.speedup(slow, fast):.2f}×" for size, of in by_size.items())
        texts = " → ".join(known) or "yes", ours, f"more at {large}² than at {small}²"
        yield judge(f"{claim} ({label})", *texts, grows, rows, fast)


@experiment(
    "Fig. 9",
    "Time and ModelMetric against the map's size",
    {"sizes": (64, 128, 256), "queries": 4, "repeats": 2},
)
def fig9(
    context: Context,
    *,
    sizes: Sequence[int] = (64, 128, 256, 512, 1024),
    queries: int = 30,
    repeats: int = 3,
) -> Result:
    """Random queries on random maps of each size, all planners on each."""
    sizes = context.fitting(sizes)
    rows = contest(context, sizes, queries, repeats=repeats).of(*PLANNERS)
    theirs = [
        row for row in (*paper.TABLE_1, *paper.TABLE_2.of(paper.ASTAR_NN)) if row["size"] in sizes
    ]
    inference = [
        {**row, "planner": "inference", "time_s": row["inference_s"]} for row in rows.of(PLAIN_NN)
    ]
    styles = {
        paper.ASTAR: "o--",
        paper.ASTAR_NN: "s:",
        **dict.fromkeys(PLANNERS, "o-"),
        "inference": "x-",
    }
    of_mm = dict.fromkeys((PLAIN_NN, "corridor", "nnpp"), "o-")
    times = Rows([*theirs, *rows, *inference]), "time_s", styles, "Mean time of a query", "seconds"
    figure = drawing.by_size(
        [times, (rows, "mm", of_mm, "Mean MM", "path's cells / region's cells")]
    )
    return Result(rows, ("size", "planner"), fig9_findings(rows), figure, [*theirs, *rows])


def fig9_findings(rows: Rows) -> list[Finding]:
    """Of the rows of all sizes."""
    inference = [of.mean("inference_s") for of in rows.by("size").values()]
    average = float(np.mean(inference))
    least = min(inference)
    greatest = max(inference)
    texts = (
        f"{1e3 * paper.INFERENCE_S:.0f} ms throughout",
        f"{1e3 * least:.2f} to {1e3 * greatest:.2f} ms",
    )
    steady = greatest - least <= 0.3 * average
    rule = "the means within 30 % of their mean"
    found = [judge("inference takes the same time whatever the map's size", *texts, rule, steady)]
    texts = f"{1.0 / paper.INFERENCE_S:.0f} a second", f"{1.0 / average:.0f} a second"
    claim = "inference keeps up 17 frames a second on a CPU"
    fast = average <= paper.INFERENCE_S
    found += [judge(claim, *texts, "at least the paper's", fast)]
    found += _growth(rows, "the larger the map, the more the network gains")
    small = min(rows.all("size"))
    large = max(rows.all("size"))
    if small < large:

        def falls(own: Own) -> bool:
            return rows.of(own(PLAIN_NN), size=large).mean("mm") < rows.of(
                own(PLAIN_NN), size=small
            ).mean("mm")

        ours = ", ".join(
            f"{size:.0f}² {rows.of(PLAIN_NN, size=size).mean('mm'):.3f}" for size in (small, large)
        )
        rule = f"less at {large:.0f}² than at {small:.0f}², plain A*NN"
        found.append(judge("MM falls as the map grows", "yes", ours, rule, falls, rows, PLAIN_NN))
    return found


@experiment("Fig. 11", "Time against the length of the path", {"queries": 10, "repeats": 2})
def fig11(context: Context, *, size: int = 256, queries: int = 300, repeats: int = 3) -> Result:
    """Random queries, near ones among them, each put to all planners."""
    size = context.one_size(size)
    rows = contest(context, (size,), queries, repeats=repeats, least_distance=0.05).of(*PLANNERS)
    figure = new_figure(11.5, 4.6)
    panels = {
        "Plain Python, a graph for each query": PLAIN_PLANNERS[:3],
        "This toolkit's planners": OURS,
    }
    for axes, (title, names) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        for name in names:
            cells = np.array(rows.of(name).all("path_cells"))
            slope, offset, _ = _fit(rows.of(name))
            color = drawing.COLOURS[name]
            axes.scatter(
                cells, 1e3 * np.array(rows.of(name).all("time_s")), s=12, alpha=0.6, color=color
            )
            axes.plot(cells, 1e3 * (offset + slope * cells), color=color, label=name)
        drawing.tidy(axes, title, "cells of the optimal path", "time of a query, ms")
        axes.legend(fontsize="small")
    findings = [each for pair in _PAIRS for each in _slopes(rows, *pair)]
    return Result(rows, ("planner",), findings, figure)


def _fit(rows: Rows) -> tuple[float, float, float]:
    """Seconds a cell of the path, seconds for none, and the correlation, of a line through one
    planner's times.
    """
    cells, times_s = (np.array(rows.all(name)) for name in ("path_cells", "time_s"))
    if len(set(cells)) < 2:
        return 0.0, float(times_s.mean()), 0.0
    slope, offset = np.polyfit(cells, times_s, 1)
    return float(slope), float(offset), float(np.corrcoef(cells, times_s)[0, 1])


def _wins(fast: Rows, slow: Rows) -> float:
    """Share of the queries that one planner answers faster than another."""
    return float((np.array(fast.all("time_s")) < slow.all("time_s")).mean())


def _slopes(rows: Rows, slow: str, fast: str) -> Iterator[Finding]:
    """Two planners, by the lines through their times."""
    slope_s, _, correlation = _fit(rows.of(slow))
    pair = f"({fast} against {slow})"
    claim = f"time grows with the path's length ({slow})"
    ours = f"{1e6 * slope_s:.3g} µs a cell, r = {correlation:.2f}"
    yield judge(claim, "yes", ours, "correlation above 0.3", slope_s > 0.0 and correlation > 0.3)
    claim = f"it grows more slowly with the network {pair}"
    ours = f"{1e6 * _fit(rows.of(fast))[0]:.3g} µs a cell"
    yield judge(
        claim,
        "yes",
        ours,
        "a smaller slope",
        lambda own: _fit(rows.of(own(fast)))[0] < slope_s,
        rows,
        fast,
    )
    slower = rows.of(slow)
    claim = f"the network's way is much the faster {pair}"
    ours = f"faster on {percent(_wins(rows.of(fast), slower), 0)} of the queries"
    rule = "on at least 90 %"
    yield judge(
        claim, "yes", ours, rule, lambda own: _wins(rows.of(own(fast)), slower) >= 0.9, rows, fast
    )


@experiment("Fig. 12 and Table 4, static", "Regions and paths on five maps", {"repeats": 2})
def fig12(context: Context, *, size: int = 256, maps: int = 5, repeats: int = 5) -> Result:
    """One query on each of five maps: drawn, and answered by all planners."""
    size = context.one_size(size)
    rows = contest(context, (size,), maps, repeats=repeats).of(*PLANNERS)
    figure = new_figure(2.6 * maps, 3.4)
    panels = figure.subplots(1, maps, squeeze=False)[0]
    for at, (axes, (case, query)) in enumerate(
        zip(panels, context.maps(size, maps), strict=True), 1
    ):
        own = rows.of(PLAIN_NN, map=at)
        view = drawing.view_plan(case.cost, query, context.networks.paper)
        above = f"cost {percent(own.mean('excess'), 2)} above the optimum"
        drawing.draw_view(axes, view, f"map {at}: MM {own.mean('mm'):.3f},\n{above}")
    drawing.map_legend(figure, panels[0])
    theirs = paper.TABLE_4.of(scene=paper.STATIC)
    return Result(rows, ("map", "planner"), fig12_findings(rows), figure, [*rows, *theirs])


def fig12_findings(rows: Rows) -> list[Finding]:
    """Of the rows of all maps, beside the static rows of Table 4."""
    theirs = paper.TABLE_4.of(scene=paper.STATIC)
    label = _PAIRS[PLAIN, PLAIN_NN]
    own = rows.of(PLAIN_NN)
    mms = own.all("mm")
    known = theirs.all("mm")
    most = own.increase() + 0.01

    def as_narrow(own: Own) -> bool:
        name = own(PLAIN_NN)
        return rows.increase(name) <= most and rows.of(name).mean("mm") >= min(known)

    texts = f"{min(known):.2f} to {max(known):.2f}", f"{min(mms):.3f} to {max(mms):.3f}"
    better = own.mean("mm") > max(known)
    rule = "our mean lies within the paper's range"

    def small(own: Own) -> bool:
        return rows.of(own(PLAIN_NN), found=1.0).mean("share") < 0.2

    of_map = "yes (Fig. 8)", percent(own.mean("share")), "below 20 %"
    return [
        judge_speedup(
            f"speed-up of {label}", theirs.speedup(*_THEIRS), rows, (PLAIN, PLAIN_NN), near=True
        ),
        judge("MM of the network's region", *texts, rule, as_narrow, rows, PLAIN_NN, better=better),
        judge_increase(f"CC increase of {label}", theirs.increase(paper.ASTAR_NN), rows, PLAIN_NN),
        judge("the region is a small part of the map", *of_map, small, rows, PLAIN_NN),
    ]
