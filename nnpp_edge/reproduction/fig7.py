"""Fig. 7: path length and CC against ω, and the ω at which the sum of both, normalised, is least."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.harness import Harness
from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import PAPER, new_figure, png, tidy
from nnpp_edge.reproduction.report import About, Finding, Result, Row, Table, columns, judge
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import SQRT2, StepModel
from nnpp_edge.runtime.search.astar import astar
from nnpp_edge.runtime.search.workspace import Workspace

Floats = NDArray[np.float64]
_LENGTH_COLOUR, _CC_COLOUR, _SUM_COLOUR, _TIME_COLOUR = "#0072b2", "#e69f00", "#7b3294", "#d76f9f"


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    maps: int = paper.OMEGA_MAPS
    size: int = 256
    fine: int = 50
    """Values of ω up to 0.05, evenly spaced; 0 comes in addition."""
    coarse: int = 30
    """Values of ω from there to 0.2."""

    def omegas(self) -> Floats:
        """The values of ω, per grey level."""
        fine = np.linspace(0.0, 0.05, self.fine + 1)
        return np.concatenate([fine, np.linspace(0.05, paper.OMEGA_MOST, self.coarse + 1)[1:]])


@dataclass(frozen=True)
class Sweep:
    """What the paths of several maps come to: (M, N) for M maps and N values of ω."""

    omegas: Floats
    length: Floats
    cc: Floats
    time_s: Floats

    def normalised(self) -> tuple[Floats, Floats]:
        """LEN and CC, each brought to [0, 1] on each map: least to 0, greatest to 1."""
        return _unit(self.length), _unit(self.cc)

    def best(self) -> Floats:
        """(M,) the ω of each map at which LEN + CC is least; the middle one where several are."""
        length, cc = self.normalised()
        return _argmin(self.omegas, length + cc)

    def both(self) -> dict[str, Floats]:
        """The best ω of each map by both readings of "normalised"."""
        return {"by range": self.best(), "by greatest": self.best_by_greatest()}

    def best_by_greatest(self) -> Floats:
        """The best ω of each map where LEN and CC are divided by their greatest values instead."""
        length, cc = (x / np.maximum(x.max(axis=1, keepdims=True), 1e-12) for x in (self.length, self.cc))
        return _argmin(self.omegas, length + cc)


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """Sweep ω on many maps, start and goal fixed on each, by exact A*."""
    (size, notes), omegas = context.one_size(settings.size), settings.omegas()
    measured = []
    for case, query in context.maps(size, settings.maps):
        measured.append(_sweep(case, query, omegas))
        progress(len(measured) / settings.maps)
    sweep = Sweep(omegas, *np.array(measured).transpose(1, 0, 2))
    notes.append(
        f"{settings.maps} maps of {size}², one query each, {len(omegas)} values of ω from 0 to {omegas[-1]:g}. The "
        "paper does not say how LEN and CC are normalised, and the best ω depends on it. By range: each is brought "
        "to [0, 1] on each map over the sweep, as in the picture. By greatest: each is divided by its greatest value."
    )
    notes.append("ω is per grey level of the cost map, T times 255: with T in [0, 1] it is 255 times as large.")
    about = About("none", f"{settings.maps} maps, one query each, {len(omegas)} values of ω")
    return Result(about, _summary(sweep), _data(sweep), _findings(sweep), _picture(sweep), notes)


def _sweep(case: Case, query: Endpoints, omegas: Floats) -> tuple[list[float], list[float], list[float]]:
    harness, workspace = Harness(), Workspace((len(case.cost) + 2) ** 2)
    lengths, ccs, times = [], [], []
    for omega in omegas:
        grid = Grid.of(case.cost, StepModel.of("paper", float(omega)))
        seconds, found = harness.timed(lambda grid=grid: astar(grid, *query, workspace))  # type: ignore[misc]
        times.append(seconds)
        path = found.path
        diagonal = (np.abs(np.diff(path, axis=0)).sum(axis=1) == 2).sum()
        lengths.append(float(len(path) - 1 + (SQRT2 - 1.0) * diagonal))
        ccs.append(float(case.cost[path[:, 0], path[:, 1]].sum(dtype=np.float64)))
    return lengths, ccs, times


def _unit(values: Floats) -> Floats:
    least, greatest = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    unit: Floats = (values - least) / np.maximum(greatest - least, 1e-12)
    return unit


def _argmin(omegas: Floats, sums: Floats) -> Floats:
    best = []
    for row in sums:
        least = np.flatnonzero(row <= row.min() + 1e-9)
        best.append(omegas[least[len(least) // 2]])
    return np.array(best)


def _spread(values: Floats) -> str:
    return f"{values.mean():.4f} ± {values.std():.4f}"


def _summary(sweep: Sweep) -> Table:
    rows: list[Row] = [("paper", paper.OMEGA_MAPS, f"{paper.OMEGA:.3f} ± {paper.OMEGA_DEVIATION:.3f}", None, None)]
    for label, best in sweep.both().items():
        low, middle, high = np.quantile(best, (0.25, 0.5, 0.75))
        rows.append((f"ours, {label}", len(best), _spread(best), f"{middle:.4f}", f"{low:.4f} to {high:.4f}"))
    return Table(columns("LEN and CC normalised | maps | best ω, mean ± deviation | median | quartiles"), rows)


def _data(sweep: Sweep) -> Table:
    length, cc = sweep.normalised()
    header = columns("omega | len_mean | len_sd | cc_mean | cc_sd | sum_mean | time_s_mean | maps_with_best")
    best = sweep.best()
    values = (length.mean(0), length.std(0), cc.mean(0), cc.std(0), (length + cc).mean(0), sweep.time_s.mean(0))
    rows = [
        (float(omega), *(float(column[at]) for column in values), int((best == omega).sum()))
        for at, omega in enumerate(sweep.omegas)
    ]
    return Table(header, rows)


def _findings(sweep: Sweep) -> Sequence[Finding]:
    length, cc = (values.mean(axis=0) for values in sweep.normalised())
    sums = length + cc
    least = int(np.argmin(sums))
    inside, monotone = 0 < least < len(sums) - 1, (np.diff(length) > -0.02).all() and (np.diff(cc) < 0.02).all()
    ends = f"LEN {length[0]:.2f} → {length[-1]:.2f}, CC {cc[0]:.2f} → {cc[-1]:.2f}"
    at_least, rule = f"ω = {sweep.omegas[least]:.3f} on the mean", "neither the first nor the last ω"
    theirs = f"{paper.OMEGA:.3f} ± {paper.OMEGA_DEVIATION:.3f}"
    found = []
    for label, best in sweep.both().items():
        claim = f"best ω per grey level, LEN and CC normalised {label}"
        near = abs(float(best.mean()) - paper.OMEGA) <= paper.OMEGA_DEVIATION
        own_rule = "our mean lies within the paper's deviation"
        found.append(judge(claim, theirs, _spread(best), agrees=near, rule=own_rule))
    found.append(judge("some ω between the ends makes LEN + CC least", "yes", at_least, agrees=inside, rule=rule))
    claim = "the greater ω, the longer the path and the smaller its CC"
    rule = "no step of the means goes the other way by over 0.02"
    found.append(judge(claim, "yes", ends, agrees=bool(monotone), rule=rule))
    return [*found, _time_finding(sweep)]


def _time_finding(sweep: Sweep) -> Finding:
    """Whether planning time rises up to the paper's ω and is nearly the same from a quarter of the sweep on."""
    typical, quarter = np.median(sweep.time_s, axis=0), 0.25 * paper.OMEGA_MOST
    settled = typical[sweep.omegas >= quarter]
    first, last = float(typical[0]), float(settled.mean())
    knee = float(typical[sweep.omegas <= paper.OMEGA][-3:].mean())
    return judge(
        "planning time rises at first and then stays",
        "yes",
        f"{1e3 * first:.2f} ms at 0, {1e3 * knee:.2f} ms at {paper.OMEGA}, {1e3 * last:.2f} ms from {quarter:g} on",
        agrees=bool(knee > 1.2 * first and np.ptp(settled) <= 0.35 * last),
        rule=f"up by a fifth or more at ω = {paper.OMEGA}; beyond a quarter of the sweep within 35 %",
    )


def _picture(sweep: Sweep) -> bytes:
    figure = new_figure(13, 4.2)
    left, middle, right = figure.subplots(1, 3)
    length, cc = sweep.normalised()
    omegas = sweep.omegas
    for values, label, colour in ((length, "LEN", _LENGTH_COLOUR), (cc, "CC", _CC_COLOUR)):
        mean, deviation = values.mean(0), values.std(0)
        left.plot(omegas, mean, color=colour, label=label)
        low, high = np.maximum(mean - deviation, 0), np.minimum(mean + deviation, 1)
        left.fill_between(omegas, low, high, color=colour, alpha=0.18, linewidth=0)
    tidy(left, "Length and CC of the path, normalised", "ω per grey level", "")
    left.legend(title="mean ± deviation", title_fontsize="small", fontsize="small")
    middle.plot(omegas, (length + cc).mean(0), color=_SUM_COLOUR)
    tidy(middle, "LEN + CC (left) and planning time (right)", "ω per grey level", "LEN + CC")
    middle.yaxis.label.set_color(_SUM_COLOUR)
    clock = middle.twinx()
    clock.plot(omegas, 1e3 * np.median(sweep.time_s, axis=0), color=_TIME_COLOUR, linewidth=1.0)
    clock.set_ylabel("exact A*, median ms", color=_TIME_COLOUR)
    clock.set_ylim(bottom=0.0)
    clock.spines["top"].set_visible(False)
    middle.axvline(paper.OMEGA, color=PAPER, linestyle="--", linewidth=1.0)
    at, where = (paper.OMEGA, 0.97), ("data", "axes fraction")
    middle.annotate("paper's ω", at, (4, 0), where, "offset points", color=PAPER, fontsize="small")
    both = sweep.both()
    edges = np.arange(0.0, max(float(best.max()) for best in both.values()) + 0.003, 0.002) - 0.001
    least, most = paper.OMEGA - paper.OMEGA_DEVIATION, paper.OMEGA + paper.OMEGA_DEVIATION
    label = f"paper: {paper.OMEGA} ± {paper.OMEGA_DEVIATION}"
    right.axvspan(least, most, color=PAPER, alpha=0.25, linewidth=0, label=label)
    for (label, best), colour in zip(both.items(), (_SUM_COLOUR, "#009e73"), strict=True):
        right.hist(best, edges, histtype="stepfilled", color=colour, alpha=0.45, label=f"{label}: {_spread(best)}")
        right.axvline(float(best.mean()), color=colour, linewidth=1.8)
    tidy(right, f"Best ω of {len(sweep.length)} maps, and the means", "ω per grey level", "maps")
    right.locator_params(axis="x", nbins=6)
    right.yaxis.get_major_locator().set_params(integer=True)
    right.margins(y=0.25)
    right.legend(fontsize="small")
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 7", "The weight ω of the traversability cost", run, Settings(), Settings(8, 256, 25, 5), asks_networks=False
)
