"""Table 1 and Fig. 7: what needs no network, the building of A*'s graph and the weight ω."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.plain_astar import build_graph, search
from nnpp_edge.profiling.rows import Row, Rows
from nnpp_edge.progress import with_unit
from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.experiment import Context, Experiment
from nnpp_edge.reproduction.findings import Finding, stated
from nnpp_edge.reproduction.planners import PLAIN
from nnpp_edge.reproduction.table import percent, spread
from nnpp_edge.runtime.arrays import Float2D, Floats, in_blocks
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.workspace import Workspace
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.viz.figures import panels, with_legend

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SWEPT = ("omega", "length", "cc", "time_s", "length_of_range", "cc_of_range")


def table1(context: Context, *, sizes: Sequence[int], maps: int) -> Iterator[Row]:
    """Average maps of the greatest size down to the others, start and goal with them, and time
    plain A*.
    """
    sizes = context.fitting(sizes)
    harness = Harness()
    for number, case in context.maps([max(sizes)], maps):
        for size in sizes:
            cost, ends = _scaled(case.cost, case.queries[0], size)
            graph_s, graph = harness.timed(partial(build_graph, cost))
            search_s, path = harness.timed(partial(search, graph, *ends))
            assert path is not None  # a cell is impassable only if all that it covers is
            row = paper.graph_row(size, PLAIN, graph_s, search_s, len(path))
            yield {"map": number, **row}


def _scaled(cost: Float2D, query: Endpoints, size: int) -> tuple[Float2D, Endpoints]:
    """A map of `size` cells a side, each the mean of the passable cells that it covers, and the
    query on it.
    """
    factor = len(cost) // size
    if factor * size != len(cost):
        raise InvalidQueryError(f"wanted sizes that divide {len(cost)}, got {size}")
    cells = in_blocks(cost, factor).astype(np.float64)
    means = np.ma.masked_greater_equal(cells, 1.0).mean(axis=(1, 3)).filled(np.inf)
    start, goal = ((row // factor, col // factor) for row, col in query)
    return means.astype(np.float32), (start, goal)


def table1_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of all sizes."""
    by_size = rows.by("size")
    shares = [of.mean("graph_share") for of in by_size.values()]
    ends = dict.fromkeys((percent(min(shares), 0), percent(max(shares), 0)))
    ours = f"{' to '.join(ends)} (plain A*)"
    yield stated(
        "the graph takes about 85 % of A*'s time",
        percent(paper.GRAPH_SHARE, 0),
        ours,
        "within 10 points at every size",
        all(abs(share - paper.GRAPH_SHARE) <= 0.1 for share in shares),
    )
    yield stated(
        "the graph takes the greater part of A*'s time",
        "84 to 89 %",
        ours,
        "over a half at every size",
        min(shares) > 0.5,
    )
    small = min(by_size)
    large = max(by_size)
    if small == large:
        return

    def grown(rows: Rows) -> float:
        return rows.of(size=large).mean("time_s") / rows.of(size=small).mean("time_s")

    cells = (large / small) ** 2
    yield stated(
        f"time grows with the number of cells ({cells:.0f}× from {small}² to {large}²)",
        with_unit(grown(paper.TABLE_1), "x"),
        f"{grown(rows):.0f}× (plain A*)",
        "within a factor of 2 of the cells'",
        0.5 <= grown(rows) / cells <= 2.0,
    )


def fig7(context: Context, *, maps: int, size: int, fine: int, coarse: int) -> Iterator[Row]:
    """Sweep ω on many maps by exact A*: `fine` values up to 0.05, `coarse` ones from there to 0.2,
    and 0; and the best ω of each map, by how LEN and CC are normalised.
    """
    (size,) = context.fitting([size])
    up_to_005 = np.linspace(0.0, 0.05, fine + 1)
    omegas = np.r_[up_to_005, np.linspace(0.05, paper.OMEGA_MOST, coarse + 1)[1:]]
    harness = Harness()
    workspace = Workspace((size + 2) ** 2)
    for number, case in context.maps([size], maps):
        swept = []
        for omega in omegas.tolist():
            grid = Grid.of(case.cost, StepModel.of("paper", omega))
            time_s, found = harness.timed(partial(astar, grid, *case.queries[0], workspace))
            _, length, _ = grid.costs_of(found.path)
            # by the map's own costs, as the grid's are all 0 at ω = 0
            cc = float(case.cost[tuple(found.path.T)].sum(dtype=np.float64))
            swept.append((omega, length, cc, time_s))
        _, length, cc, _ = np.transpose(swept)
        of_range = zip(swept, by_range(length).tolist(), by_range(cc).tolist(), strict=True)
        for row, length_of_range, cc_of_range in of_range:
            values = (*row, length_of_range, cc_of_range)
            yield {"map": number, **dict(zip(_SWEPT, values, strict=True))}
        for how, normal in (("by range", by_range), ("by greatest", by_greatest)):
            best = best_omega(omegas, normal(length) + normal(cc))
            yield {"map": number, "normalised": how, "best_omega": best}


def by_range(values: Floats) -> Floats:
    """Brought to [0, 1]: least to 0, greatest to 1."""
    return by_greatest(values - values.min())


def by_greatest(values: Floats) -> Floats:
    """Divided by the greatest."""
    unit: Floats = values / max(values.max(), 1e-12)
    return unit


def best_omega(omegas: Floats, total: Floats) -> float:
    """The ω at which LEN + CC is least; the middle one where several are."""
    least = np.flatnonzero(total <= total.min() + 1e-9)
    return float(omegas[least[len(least) // 2]])


def _curves(rows: Rows) -> Floats:
    """(4, N): the values of ω, mean length and CC by range, and the median time at each."""
    return np.transpose(
        [
            (omega, of.mean("length_of_range"), of.mean("cc_of_range"), np.median(of.all("time_s")))
            for omega, of in rows.having("omega").by("omega").items()
        ]
    )


def fig7_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the means at each ω, the median time there, and each map's best ω."""
    for how, of in rows.having("normalised").by("normalised").items():
        best = of.all("best_omega")
        yield stated(
            f"best ω per grey level, LEN and CC normalised {how}",
            f"{paper.OMEGA:.3f} ± {paper.OMEGA_DEVIATION:.3f}",
            spread(best, 4),
            "our mean lies within the paper's deviation",
            abs(np.mean(best) - paper.OMEGA) <= paper.OMEGA_DEVIATION,
        )
    omegas, length, cc, typical_s = _curves(rows)
    middle = int(np.argmin(length + cc))
    yield stated(
        "some ω between the ends makes LEN + CC least",
        "yes",
        f"ω = {omegas[middle]:.3f} on the mean",
        "neither the first nor the last ω",
        0 < middle < len(omegas) - 1,
    )
    yield stated(
        "the greater ω, the longer the path and the smaller its CC",
        "yes",
        "LEN {:.2f} → {:.2f}, CC {:.2f} → {:.2f}".format(*length[[0, -1]], *cc[[0, -1]]),
        "no step goes the other way by over 0.02",
        np.diff(length).min() > -0.02 and np.diff(cc).max() < 0.02,
    )
    first = typical_s[0]
    knee = typical_s[omegas <= paper.OMEGA][-3:].mean()
    settled = typical_s[omegas >= 0.25 * paper.OMEGA_MOST]
    last = settled.mean()
    yield stated(
        "planning time rises at first and then stays",
        "yes",
        f"{1e3 * first:.2f} ms at 0, {1e3 * knee:.2f} ms at {paper.OMEGA}, "
        f"{1e3 * last:.2f} ms from 0.05 on",
        f"up by a fifth or more at ω = {paper.OMEGA}; beyond a quarter of the sweep within 35 %",
        knee > 1.2 * first and np.ptp(settled) <= 0.35 * last,
    )


def _fig7_picture(rows: Rows) -> "Figure":
    """Mean length and CC and the median time at each ω."""
    omegas, length, cc, typical_s = _curves(rows)
    sums = {"LEN": length, "CC": cc, "LEN + CC": length + cc}
    figure, (sides, times) = panels(1, 2)
    for name, values in sums.items():
        sides.plot(omegas, values, label=name)
    sides.set(title="LEN and CC, normalised by range", xlabel="ω per grey level")
    times.plot(omegas, typical_s)
    times.set(title="Time of exact A*", xlabel="ω per grey level", ylabel="seconds")
    return with_legend(figure)


EXPERIMENTS = {
    "table1": Experiment(
        "Table 1",
        "Building the graph against searching it",
        table1,
        ("size", "planner"),
        table1_findings,
        partial(
            drawing.by_size,
            {
                "time_s": ("Mean time of a query, the graph included", "seconds"),
                "graph_share": ("Share of the graph in the time", ""),
            },
        ),
        {"sizes": (64, 128, 256, 512, 1024), "maps": 5},
        paper.TABLE_1,
        networks=(),
    ),
    "fig7": Experiment(
        "Fig. 7",
        "The weight ω of the traversability cost",
        fig7,
        ("normalised",),
        fig7_findings,
        _fig7_picture,
        {"maps": paper.OMEGA_MAPS, "size": 256, "fine": 50, "coarse": 30},
        networks=(),
    ),
}
