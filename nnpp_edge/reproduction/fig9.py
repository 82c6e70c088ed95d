"""Fig. 9: planning time and inference time against the side of the map, and MM against it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import (
    OURS,
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_NN,
    PLANNERS,
    Means,
    contest_by_size,
    means,
    network_of,
    shown,
)
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import COLOURS, MARKERS, PAPER, legend_below, new_figure, png, sides_axis, tidy
from nnpp_edge.reproduction.regions import CONTROLS_NOTE, Networks
from nnpp_edge.reproduction.report import About, Finding, Result, Row, Table, columns, judge, percent, seconds


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    sizes: tuple[int, ...] = tuple(paper.TABLE_1)
    queries: int = 30
    """At each size."""
    repeats: int = 3


@dataclass(frozen=True)
class _Scale:
    """What was measured at one size."""

    by_name: dict[str, Means]
    inference_s: float
    inference_sd_s: float


Figures = dict[int, _Scale]


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """Random queries on random maps of each size, all planners on each."""
    sizes, notes = context.fitting(settings.sizes)
    figures: Figures = {}
    rounds_by_size = contest_by_size(context, sizes, settings.queries, settings.repeats, progress)
    for size, rounds in rounds_by_size.items():
        inference = [r.answers[PLAIN_NN].stages_s["inference"] for r in rounds]  # the whole network, map and query
        by_name = {name: means(rounds, name) for name in PLANNERS}
        figures[size] = _Scale(by_name, float(np.mean(inference)), float(np.std(inference)))
    notes.append(
        "Crops of the terrain at its own resolution (the paper scales its maps). A network sees every map averaged"
        " to its own input size; inference is that of the paper's method, once a query."
    )
    notes.append(
        "MM of `plain A*NN` and of `nnpp` is that of their network's own region at td, by the paper's rule; that of "
        "`corridor` is of the cells which the search at full resolution was given."
    )
    about = About(
        context.networks.named,
        f"{settings.queries} maps a size, one query each; ours the median of {settings.repeats}",
        CONTROLS_NOTE,
    )
    return Result(
        about, _summary(figures, context.networks), _data(figures), _findings(figures), _picture(figures), notes
    )


def _summary(figures: Figures, networks: Networks) -> Table:
    header = columns("map | planner | network | AT | of it inference | found in the region | CC increase | MM")
    rows: list[Row] = []
    for size, scale in figures.items():
        side = f"{size}²"
        if theirs := paper.TABLE_1.get(size):
            rows.append((side, "paper's A*", None, seconds(theirs.total_s), None, None, None, None))
        if both := paper.TABLE_2.get(size):
            quality = (percent(both.nn_success), percent(both.cc_increase), None)
            rows.append(
                (side, "paper's A*NN", "the paper's", seconds(both.nn_s), seconds(paper.INFERENCE_S), *quality)
            )
        for name, m in scale.by_name.items():
            inference = seconds(scale.inference_s) if name == PLAIN_NN else None
            figures_of = (percent(m.success), percent(m.cc_increase, 2), _mm(m))
            rows.append((side, shown(name), network_of(name, networks), seconds(m.time_s), inference, *figures_of))
    return Table(header, rows)


def _mm(m: Means) -> str | None:
    return None if m.mm is None else f"{m.mm:.3f} ± {m.mm_sd:.3f}"


def _data(figures: Figures) -> Table:
    header = columns("size | planner | time_s_mean | time_s_sd | mm_mean | mm_sd")
    rows: list[Row] = []
    for size, scale in figures.items():
        if theirs := paper.TABLE_1.get(size):
            rows.append((size, "paper A*", theirs.total_s, None, None, None))
        if both := paper.TABLE_2.get(size):
            rows.append((size, "paper A*NN", both.nn_s, None, None, None))
        rows += [(size, name, m.time_s, m.time_sd_s, m.mm, m.mm_sd) for name, m in scale.by_name.items()]
        rows.append((size, "inference", scale.inference_s, scale.inference_sd_s, None, None))
    return Table(header, rows)


def _findings(figures: Figures) -> Sequence[Finding]:
    inference = [scale.inference_s for scale in figures.values()]
    mean, least, greatest = float(np.mean(inference)), min(inference), max(inference)
    theirs, theirs_fps = f"{1e3 * paper.INFERENCE_S:.0f} ms throughout", f"{1.0 / paper.INFERENCE_S:.0f} a second"
    ours, ours_fps = f"{1e3 * least:.2f} to {1e3 * greatest:.2f} ms", f"{1.0 / mean:.0f} a second"
    steady, fast = greatest - least <= 0.3 * mean, mean <= paper.INFERENCE_S
    same_time = "inference takes the same time whatever the map's size"
    keeps_up = "inference keeps up 17 frames a second on a CPU"
    found = [
        judge(same_time, theirs, ours, agrees=steady, rule="the means within 30 % of their mean"),
        judge(keeps_up, theirs_fps, ours_fps, agrees=fast, rule="at least the paper's"),
    ]
    return found if len(figures) == 1 else [*found, *_growth(figures, min(figures), max(figures))]


def _growth(figures: Figures, small: int, large: int) -> Iterator[Finding]:
    """What becomes of the network's gain, and of MM, as maps grow."""
    pairs = (
        (PLAIN, PLAIN_NN, "plain", PLAIN_CONTROLS),
        ("astar", "nnpp", "`nnpp` against our exact A*", {"corridor": "corridor"}),
    )
    for slower, faster, label, controls in pairs:
        gains = {size: _gain(scale, slower, faster) for size, scale in figures.items()}
        ours = ", ".join(f"{size}² {gain:.2f}×" for size, gain in gains.items())
        claim, rule = (
            f"the larger the map, the more the network gains ({label})",
            f"more at {large}² than at {small}²",
        )
        as_well = {kind: _grows(figures, slower, name, small, large) for kind, name in controls.items()}
        yield judge(claim, "yes", ours, agrees=gains[large] > gains[small], rule=rule, controls=as_well)
    at_small, at_large = (figures[size].by_name[PLAIN_NN].mm or 0.0 for size in (small, large))
    ours, rule = f"{small}² {at_small:.3f}, {large}² {at_large:.3f}", f"less at {large}² than at {small}², plain A*NN"
    as_well = {
        kind: (figures[large].by_name[name].mm or 0.0) < (figures[small].by_name[name].mm or 0.0)
        for kind, name in PLAIN_CONTROLS.items()
    }
    yield judge("MM falls as the map grows", "yes", ours, agrees=at_large < at_small, rule=rule, controls=as_well)


def _grows(figures: Figures, slower: str, faster: str, small: int, large: int) -> bool:
    return _gain(figures[large], slower, faster) > _gain(figures[small], slower, faster)


def _gain(scale: _Scale, slower: str, faster: str) -> float:
    return scale.by_name[slower].time_s / scale.by_name[faster].time_s


def _picture(figures: Figures) -> bytes:
    figure = new_figure(11.5, 5.3)
    left, right = figure.subplots(1, 2)
    sizes = list(figures)
    known = [size for size in sizes if size in paper.TABLE_1]
    left.plot(known, [paper.TABLE_1[size].total_s for size in known], "o--", color=PAPER, label="paper's A*")
    both = [size for size in sizes if size in paper.TABLE_2]
    left.plot(both, [paper.TABLE_2[s].nn_s for s in both], "s:", color=PAPER, label="paper's A*NN")
    for name in PLANNERS:
        times_s = [scale.by_name[name].time_s for scale in figures.values()]
        left.plot(sizes, times_s, marker=MARKERS[name], color=COLOURS[name], label=name)
    (line,) = left.plot(sizes, [scale.inference_s for scale in figures.values()], label="inference")
    line.set(marker=MARKERS["inference"], color=COLOURS["inference"], linewidth=1.0)
    sides_axis(left, sizes)
    left.set_yscale("log")
    tidy(left, "Mean time of a query", "map", "seconds")
    legend_below(left, 4)
    for name in (PLAIN_NN, *OURS):
        mms = [mm for scale in figures.values() if (mm := scale.by_name[name].mm) is not None]
        deviations = [scale.by_name[name].mm_sd or 0.0 for scale in figures.values()]
        if len(mms) == len(sizes):
            right.errorbar(sizes, mms, deviations, marker=MARKERS[name], color=COLOURS[name], capsize=3, label=name)
    sides_axis(right, sizes)
    right.set_ylim(bottom=0.0)
    tidy(right, "MM, mean and standard deviation", "map", "path's cells / region's cells")
    legend_below(right, 3)
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 9", "Time and ModelMetric against the map's size", run, Settings(), Settings((64, 128, 256), 4, 2)
)
