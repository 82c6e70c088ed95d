"""Fig. 9: planning time and inference time against the side of the map, and MM against it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import OURS, PLAIN, PLAIN_NN, PLANNERS, Means, Round, contest, means
from nnpp_edge.reproduction.experiment import Context, Experiment, Report
from nnpp_edge.reproduction.pictures import COLOURS, MARKERS, PAPER, new_figure, png, sides_axis, tidy
from nnpp_edge.reproduction.report import Finding, Result, Table, judge, seconds


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


def run(context: Context, settings: Settings, report: Report) -> Result:
    """Random queries on random maps of each size, each put to all planners."""
    sizes, notes = context.fitting(settings.sizes)
    work = settings.queries * sum(size**2 for size in sizes)
    figures: Figures = {}
    done = 0
    for size in sizes:
        rounds: list[Round] = []
        for answered in contest(context.cases(size), context.model, settings.queries, repeats=settings.repeats):
            rounds.append(answered)
            done += size**2
            report(done / work)
        inference = [r.answers[PLAIN_NN].stages_s["inference"] for r in rounds]  # the whole network, map and query
        figures[size] = _Scale(
            {name: means(rounds, name) for name in PLANNERS}, float(np.mean(inference)), float(np.std(inference))
        )
    notes.append(
        f"Means over {settings.queries} queries at each size, on crops of the terrain at its own resolution (the "
        "paper scales its maps). The network sees every map averaged to its own input size."
    )
    notes.append(
        "MM of `plain A*NN` is that of the network's region at td, the paper's; MM of `nnpp` and `corridor` that of "
        "the cells which the search at full resolution was given."
    )
    return Result(_summary(figures), _data(figures), _findings(figures), _picture(figures), notes)


def _summary(figures: Figures) -> Table:
    header = ("map", "paper's A*", "paper's A*NN", "plain A*", "plain A*NN", "inference", "`astar`", "`corridor`",
              "`nnpp`", "MM, plain A*NN", "MM, `nnpp`")  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for size, scale in figures.items():
        theirs, both = paper.TABLE_1.get(size), paper.TABLE_2.get(size)
        times = [seconds(scale.by_name[name].time_s) for name in PLANNERS]
        rows.append((
            f"{size}²", theirs and seconds(theirs.graph_s + theirs.search_s), both and seconds(both.nn_s), *times[:2],
            seconds(scale.inference_s), *times[2:], _mm(scale.by_name[PLAIN_NN]), _mm(scale.by_name["nnpp"]),
        ))  # fmt: skip
    return Table(header, rows)


def _mm(m: Means) -> str | None:
    return None if m.mm is None else f"{m.mm:.3f} ± {m.mm_sd:.3f}"


def _data(figures: Figures) -> Table:
    header = ("size", "planner", "time_s_mean", "time_s_sd", "mm_mean", "mm_sd")
    rows: list[tuple[Any, ...]] = []
    for size, scale in figures.items():
        if theirs := paper.TABLE_1.get(size):
            rows.append((size, "paper A*", theirs.graph_s + theirs.search_s, None, None, None))
        if both := paper.TABLE_2.get(size):
            rows.append((size, "paper A*NN", both.nn_s, None, None, None))
        rows += [(size, name, m.time_s, m.time_sd_s, m.mm, m.mm_sd) for name, m in scale.by_name.items()]
        rows.append((size, "inference", scale.inference_s, scale.inference_sd_s, None, None))
    return Table(header, rows)


def _findings(figures: Figures) -> Sequence[Finding]:
    inference = [scale.inference_s for scale in figures.values()]
    mean = float(np.mean(inference))
    found = [
        judge(
            "inference takes the same time whatever the map's size", f"{1e3 * paper.INFERENCE_S:.0f} ms throughout",
            f"{1e3 * min(inference):.2f} to {1e3 * max(inference):.2f} ms",
            agrees=max(inference) - min(inference) <= 0.3 * mean, rule="the means within 30 % of their mean",
        ),
        judge(
            "inference keeps up 17 frames a second on a CPU", f"{1.0 / paper.INFERENCE_S:.0f} a second",
            f"{1.0 / mean:.0f} a second", agrees=mean <= paper.INFERENCE_S, rule="at least the paper's",
        ),
    ]  # fmt: skip
    if len(figures) == 1:
        return found
    gains = {size: _gain(scale, PLAIN, PLAIN_NN) for size, scale in figures.items()}
    own = {size: _gain(scale, "astar", "nnpp") for size, scale in figures.items()}
    small, large = min(figures), max(figures)
    mm = [figures[size].by_name[PLAIN_NN].mm or 0.0 for size in (small, large)]
    for label, values in (("plain", gains), ("`nnpp` against our exact A*", own)):
        found.append(judge(
            f"the larger the map, the more the network gains ({label})", "yes",
            ", ".join(f"{size}² {gain:.2f}×" for size, gain in values.items()),
            agrees=values[large] > values[small], rule=f"more at {large}² than at {small}²",
        ))  # fmt: skip
    found.append(judge(
        "MM falls as the map grows", "yes", f"{small}² {mm[0]:.3f}, {large}² {mm[1]:.3f}", agrees=mm[1] < mm[0],
        rule=f"less at {large}² than at {small}², plain A*NN",
    ))  # fmt: skip
    return found


def _gain(scale: _Scale, slower: str, faster: str) -> float:
    return scale.by_name[slower].time_s / scale.by_name[faster].time_s


def _picture(figures: Figures) -> bytes:
    figure = new_figure(11.5, 5.3)
    left, right = figure.subplots(1, 2)
    sizes = list(figures)
    known = [size for size in sizes if size in paper.TABLE_1]
    left.plot(known, [paper.TABLE_1[s].graph_s + paper.TABLE_1[s].search_s for s in known], "o--", color=PAPER,
              label="paper's A*")  # fmt: skip
    both = [size for size in sizes if size in paper.TABLE_2]
    left.plot(both, [paper.TABLE_2[s].nn_s for s in both], "s:", color=PAPER, label="paper's A*NN")
    for name in PLANNERS:
        times = [scale.by_name[name].time_s for scale in figures.values()]
        left.plot(sizes, times, marker=MARKERS[name], color=COLOURS[name], label=name)
    left.plot(sizes, [scale.inference_s for scale in figures.values()], marker=MARKERS["inference"],
              color=COLOURS["inference"], linewidth=1.0, label="inference")  # fmt: skip
    sides_axis(left, sizes)
    left.set_yscale("log")
    tidy(left, "Mean time of a query", "map", "seconds")
    left.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=4, frameon=False)
    for name in (PLAIN_NN, *OURS):
        pairs = [(scale.by_name[name].mm, scale.by_name[name].mm_sd) for scale in figures.values()]
        if all(mm is not None for mm, _ in pairs):
            mms, deviations = zip(*pairs, strict=True)
            right.errorbar(sizes, mms, deviations, marker=MARKERS[name], color=COLOURS[name], capsize=3, label=name)
    sides_axis(right, sizes)
    right.set_ylim(bottom=0.0)
    tidy(right, "MM, mean and standard deviation", "map", "path's cells / region's cells")
    right.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3, frameon=False)
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 9", "Time and ModelMetric against the map's size", run, Settings(), Settings((64, 128, 256), 4, 2)
)
