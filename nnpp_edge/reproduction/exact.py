"""Table 1 and Fig. 7: what needs no network, the building of A*'s graph and the weight ω."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.experiment import Context, Result, experiment
from nnpp_edge.reproduction.findings import Finding, judge
from nnpp_edge.reproduction.plain import build_graph, search
from nnpp_edge.reproduction.planners import PLAIN
from nnpp_edge.reproduction.rows import Row, Rows, percent, spread, times
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.viz.figures import new_figure

Floats = NDArray[np.float64]
_OMEGA = f"{paper.OMEGA:.3f} ± {paper.OMEGA_DEVIATION:.3f}"
_QUICK = {"sizes": (64, 128, 256), "maps": 1}


@experiment("Table 1", "Building the graph against searching it", _QUICK, networks=())
def table1(
    context: Context, *, sizes: Sequence[int] = (64, 128, 256, 512, 1024), maps: int = 5
) -> Result:
    """Average maps of the greatest size down to the others, start and goal with them, and time
    plain A*.
    """
    sizes = context.fitting(sizes)
    rows = Rows()
    harness = Harness()
    done = 0
    for at, (case, query) in enumerate(context.maps(max(sizes), maps), 1):
        for size in sizes:
            cost, ends = _scaled(case.cost, query, size)
            graph_s, graph = harness.timed(partial(build_graph, cost))
            search_s, path = harness.timed(partial(search, graph, *ends))
            assert path is not None  # a cell is impassable only if all that it covers is
            rows.append(
                {"map": at, "size": size} | paper.graph_row(PLAIN, graph_s, search_s, len(path))
            )
            done += size**2
            context.progress(done / (maps * sum(side**2 for side in sizes)))
    everything = Rows(row for row in (*paper.TABLE_1, *rows) if row["size"] in sizes)
    styles = {paper.ASTAR: "o--", PLAIN: "o-"}
    of_times = everything, "time_s", styles, "Mean time of a query, the graph included", "seconds"
    of_shares = everything, "graph_share", styles, "Share of the graph in the time", ""
    picture = drawing.by_size([of_times, of_shares])
    return Result(rows, ("size", "planner"), table1_findings(rows), picture, everything)


def _scaled(cost: Float2D, query: Endpoints, size: int) -> tuple[Float2D, Endpoints]:
    """A map of `size` cells a side, each the mean of the passable cells that it covers, and the
    query on it.
    """
    factor = len(cost) // size
    if factor * size != len(cost):
        raise InvalidQueryError(f"wanted sizes that divide {len(cost)}, got {size}")
    cells = cost.reshape(size, factor, size, factor).astype(np.float64)
    count = (cells < 1.0).sum(axis=(1, 3))
    total = np.where(cells < 1.0, cells, 0.0).sum(axis=(1, 3))
    small = np.where(count, total / np.maximum(count, 1), np.inf).astype(np.float32)
    (a, b), (c, d) = query
    return small, ((a // factor, b // factor), (c // factor, d // factor))


def table1_findings(rows: Rows) -> list[Finding]:
    """Of the rows of all sizes."""
    plain = rows.of(PLAIN)
    shares = [of.mean("graph_share") for of in plain.by("size").values()]
    ours = (
        f"{' to '.join(dict.fromkeys((percent(min(shares), 0), percent(max(shares), 0))))} "
        "(plain A*)"
    )
    near = max(abs(share - paper.GRAPH_SHARE) for share in shares) <= 0.1
    about = "the graph takes about 85 % of A*'s time"
    greater = "the graph takes the greater part of A*'s time"
    found = [
        judge(about, percent(paper.GRAPH_SHARE, 0), ours, "within 10 points at every size", near),
        judge(greater, "84 to 89 %", ours, "over a half at every size", min(shares) > 0.5),
    ]
    small = min(plain.all("size"))
    large = max(plain.all("size"))
    if small < large:
        cells = (large / small) ** 2
        theirs, grown = (
            of.of(size=large).mean("time_s") / of.of(size=small).mean("time_s")
            for of in (paper.TABLE_1, plain)
        )
        claim = (
            f"time grows with the number of cells ({cells:.0f}× from {small:.0f}² to {large:.0f}²)"
        )
        near = 0.5 * cells <= grown <= 2.0 * cells
        rule = "within a factor of 2 of the cells'"
        found.append(judge(claim, times(theirs), f"{grown:.0f}× (plain A*)", rule, near))
    return found


def _at_omega(cost: Float2D, query: Endpoints, omega: float, workspace: Workspace) -> Row:
    """The optimal path at an ω: its length in cells, a diagonal step counting √2, and the sum of
    the map's costs.
    """
    grid = Grid.of(cost, StepModel.of("paper", omega))
    time_s, found = Harness().timed(partial(astar, grid, *query, workspace))
    cc = float(cost[tuple(found.path.T)].sum(dtype=np.float64))  # at ω = 0 no grid knows it
    return {"omega": omega, "length": grid.costs_of(found.path)[1], "cc": cc, "time_s": time_s}


@experiment(
    "Fig. 7", "The weight ω of the traversability cost", {"maps": 8, "fine": 25}, networks=()
)
def fig7(
    context: Context,
    *,
    maps: int = paper.OMEGA_MAPS,
    size: int = 256,
    fine: int = 50,
    coarse: int = 30,
) -> Result:
    """Sweep ω on many maps by exact A*: `fine` values up to 0.05, `coarse` ones from there to 0.2,
    and 0.
    """
    size = context.one_size(size)
    omegas = np.r_[
        np.linspace(0.0, 0.05, fine + 1), np.linspace(0.05, paper.OMEGA_MOST, coarse + 1)[1:]
    ]
    rows = Rows()
    workspace = Workspace((size + 2) ** 2)
    for at, (case, query) in enumerate(context.maps(size, maps), 1):
        rows += [
            {"map": at} | _at_omega(case.cost, query, omega, workspace) for omega in omegas.tolist()
        ]
        context.progress(at / maps)
    lengths, ccs, times_s = (
        np.reshape(rows.all(name), (maps, -1)) for name in ("length", "cc", "time_s")
    )
    typical_s = np.median(times_s, axis=0)
    best = {
        f"by {how}": best_omegas(omegas, normal(lengths), normal(ccs))
        for how, normal in {"range": by_range, "greatest": by_greatest}.items()
    }
    lengths = by_range(lengths)
    ccs = by_range(ccs)
    figure = new_figure(13, 4.2)
    left, middle, right = figure.subplots(1, 3)
    for label, values in {"LEN": lengths, "CC": ccs}.items():
        average = values.mean(0)
        deviation = values.std(0)
        left.plot(omegas, average, label=label)
        left.fill_between(omegas, average - deviation, average + deviation, alpha=0.18, linewidth=0)
    middle.plot(omegas, (lengths + ccs).mean(0), label="LEN + CC")
    middle.plot(
        omegas, typical_s / typical_s.max(), label="time of exact A*, median, over its longest"
    )
    right.hist(
        list(best.values()), 20, label=[f"{how}: {spread(of, 4)}" for how, of in best.items()]
    )
    least = paper.OMEGA - paper.OMEGA_DEVIATION
    most = paper.OMEGA + paper.OMEGA_DEVIATION
    titles = "Normalised by range; mean ± deviation", "LEN + CC, and time", f"Best ω of {maps} maps"
    for axes, title in zip((left, middle, right), titles, strict=True):
        axes.axvspan(least, most, color=drawing.PAPER, alpha=0.25, label=f"paper: {_OMEGA}")
        drawing.tidy(axes, title, "ω per grey level")
        axes.legend(fontsize="small")
    findings = fig7_findings(omegas, lengths.mean(0), ccs.mean(0), typical_s, best)
    shown = [{"normalised": how, "best_omega": omega} for how, of in best.items() for omega in of]
    return Result(rows, ("normalised",), findings, figure, shown)


def by_range(values: Floats) -> Floats:
    """(M, N) brought to [0, 1] on each of M maps: least to 0, greatest to 1."""
    return by_greatest(values - values.min(axis=1, keepdims=True))


def by_greatest(values: Floats) -> Floats:
    """(M, N) divided by the greatest of each map."""
    unit: Floats = values / np.maximum(values.max(axis=1, keepdims=True), 1e-12)
    return unit


def best_omegas(omegas: Floats, length: Floats, cc: Floats) -> Floats:
    """(M,) the ω of each map at which LEN + CC is least; the middle one where several are."""
    least = [np.flatnonzero(row <= row.min() + 1e-9) for row in length + cc]
    return np.array([omegas[each[len(each) // 2]] for each in least])


def fig7_findings(
    omegas: Floats, length: Floats, cc: Floats, typical_s: Floats, best: dict[str, Floats]
) -> list[Finding]:
    """Of the mean length and CC, by range, and the median time at each ω, and each map's
    best one.
    """
    middle = int(np.argmin(length + cc))
    settled = typical_s[omegas >= 0.25 * paper.OMEGA_MOST]
    monotone = bool((np.diff(length) > -0.02).all() and (np.diff(cc) < 0.02).all())
    first = typical_s[0]
    knee = typical_s[omegas <= paper.OMEGA][-3:].mean()
    last = settled.mean()
    steady = bool(knee > 1.2 * first and np.ptp(settled) <= 0.35 * last)
    found = []
    for label, of in best.items():
        claim = f"best ω per grey level, LEN and CC normalised {label}"
        near = abs(of.mean() - paper.OMEGA)
        rule = "our mean lies within the paper's deviation"
        found.append(judge(claim, _OMEGA, spread(of, 4), rule, bool(near <= paper.OMEGA_DEVIATION)))
    claim = "some ω between the ends makes LEN + CC least"
    ours = f"ω = {omegas[middle]:.3f} on the mean"
    found.append(
        judge(claim, "yes", ours, "neither the first nor the last ω", 0 < middle < len(omegas) - 1)
    )
    claim = "the greater ω, the longer the path and the smaller its CC"
    rule = "no step goes the other way by over 0.02"
    ours = f"LEN {length[0]:.2f} → {length[-1]:.2f}, CC {cc[0]:.2f} → {cc[-1]:.2f}"
    found.append(judge(claim, "yes", ours, rule, monotone))
    ours = (
        f"{1e3 * first:.2f} ms at 0, {1e3 * knee:.2f} ms at {paper.OMEGA}, {1e3 * last:.2f} ms "
        "from 0.05 on"
    )
    rule = f"up by a fifth or more at ω = {paper.OMEGA}; beyond a quarter of the sweep within 35 %"
    return [*found, judge("planning time rises at first and then stays", "yes", ours, rule, steady)]
