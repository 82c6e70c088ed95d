"""Table 2: A* against A* in the network's region, at 256² and 512²; and our own planners beside them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import OURS, PLAIN, PLAIN_NN, PLANNERS, Means, contest, means
from nnpp_edge.reproduction.experiment import Context, Experiment, Report
from nnpp_edge.reproduction.pictures import COLOURS, PAPER, new_figure, png, tidy
from nnpp_edge.reproduction.report import Finding, Result, Table, judge, judge_ratio, percent, seconds


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    sizes: tuple[int, ...] = tuple(paper.TABLE_2)
    queries: int = 200
    repeats: int = 3


Figures = dict[int, dict[str, Means]]


def run(context: Context, settings: Settings, report: Report) -> Result:
    """Random queries on random maps, each put to all planners."""
    sizes, notes = context.fitting(settings.sizes)
    work = settings.queries * sum(size**2 for size in sizes)
    figures: Figures = {}
    done = 0
    for size in sizes:
        rounds = []
        for answered in contest(context.cases(size), context.model, settings.queries, repeats=settings.repeats):
            rounds.append(answered)
            done += size**2
            report(done / work)
        figures[size] = {name: means(rounds, name) for name in PLANNERS}
    notes.append(
        f"Means over {settings.queries} queries a size, start and goal at least 0.35 of the map's side apart. Times "
        "are of the whole job; what depends on the map alone (our padded weights, pyramid and the network's view) is "
        "made before the clock starts, while the plain A* builds its graph for each query, as the paper's does."
    )
    notes.append(
        "`plain A*NN` is the paper's method as it stands: the network's region at the adaptive threshold td, a graph "
        "of that region alone, a search in it. `nnpp` is this toolkit's: a wider region, narrowed from coarse to "
        "fine, searched in place by the compiled A*. Success is a path in the first region; both widen it otherwise."
    )
    return Result(
        _summary(figures), _data(figures), _findings(figures, context), _picture(figures), notes
    )  # fmt: skip


def _summary(figures: Figures) -> Table:
    header = ("map", "planner", "AT", "speed-up over plain A*", "speed-up over our exact A*", "CC", "CC increase",
              "success", "MM")  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for size, by_name in figures.items():
        if theirs := paper.TABLE_2.get(size):
            rows.append((f"{size}²", "paper's A*", seconds(theirs.astar_s), "1.0×", None,
                         f"{theirs.astar_cc:.1f}", None, "100.0 %", None))  # fmt: skip
            rows.append((f"{size}²", "paper's A*NN", seconds(theirs.nn_s), f"{theirs.speedup:.1f}×", None,
                         f"{theirs.nn_cc:.1f}", percent(theirs.cc_increase), percent(theirs.nn_success),
                         None))  # fmt: skip
        for name, m in by_name.items():
            rows.append((
                f"{size}²", f"`{name}`" if name in OURS else name, seconds(m.time_s), _times(by_name[PLAIN], m),
                _times(by_name["astar"], m), f"{m.traverse_cost:.1f}", percent(m.cc_increase, 2), percent(m.success),
                m.mm and f"{m.mm:.3f}",
            ))  # fmt: skip
    return Table(header, rows)


def _times(slower: Means, faster: Means) -> str:
    ratio = slower.time_s / faster.time_s
    return f"{ratio:.0f}×" if ratio >= 100.0 else f"{ratio:.3g}×"


def _data(figures: Figures) -> Table:
    header = ("size", "planner", "time_s_mean", "time_s_sd", "speedup_over_plain", "speedup_over_astar", "cc_mean",
              "cc_increase", "cost_excess", "success", "mm_mean", "mm_sd")  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for size, by_name in figures.items():
        if theirs := paper.TABLE_2.get(size):
            rows.append(
                (size, "paper A*", theirs.astar_s, None, 1.0, None, theirs.astar_cc, 0.0, None, 1.0, None, None)
            )
            rows.append((size, "paper A*NN", theirs.nn_s, None, theirs.speedup, None, theirs.nn_cc,
                         theirs.cc_increase, None, theirs.nn_success, None, None))  # fmt: skip
        for name, m in by_name.items():
            rows.append((size, name, m.time_s, m.time_sd_s, by_name[PLAIN].time_s / m.time_s,
                         by_name["astar"].time_s / m.time_s, m.traverse_cost, m.cc_increase, m.excess, m.success,
                         m.mm, m.mm_sd))  # fmt: skip
    return Table(header, rows)


def _findings(figures: Figures, context: Context) -> Sequence[Finding]:
    network = context.model.metadata.name
    found = []
    for size, by_name in figures.items():
        theirs = paper.TABLE_2.get(size)
        plain, plain_nn, exact, ours = (by_name[name] for name in (PLAIN, PLAIN_NN, "astar", "nnpp"))
        if theirs:
            found += [
                judge_ratio(f"{size}²: speed-up of A*NN over A*, both plain", theirs.speedup,
                            plain.time_s / plain_nn.time_s),
                judge(f"{size}²: CC increase of A*NN over A*, both plain", percent(theirs.cc_increase),
                      percent(plain_nn.cc_increase, 2),
                      agrees=abs(plain_nn.cc_increase - theirs.cc_increase) <= 0.01, rule="within one point",
                      better=plain_nn.cc_increase < theirs.cc_increase),
                judge(f"{size}²: success of A*NN in its first region", percent(theirs.nn_success),
                      percent(plain_nn.success), agrees=abs(plain_nn.success - theirs.nn_success) <= 0.01,
                      rule="within one point", better=plain_nn.success > theirs.nn_success),
                judge_ratio(f"{size}²: speed-up of `nnpp` over our own exact A*", theirs.speedup,
                            exact.time_s / ours.time_s),
                judge(f"{size}²: CC increase of `nnpp` over our own exact A*", percent(theirs.cc_increase),
                      percent(ours.cc_increase, 2), agrees=abs(ours.cc_increase - theirs.cc_increase) <= 0.01,
                      rule="within one point", better=ours.cc_increase < theirs.cc_increase),
            ]  # fmt: skip
        fastest = min(OURS, key=lambda name: by_name[name].time_s)
        found.append(judge(
            f"{size}²: the network's region is the fastest way to plan", "A*NN", f"`{fastest}` (network {network})",
            agrees=fastest == "nnpp", rule="`nnpp` has the least mean time of ours",
        ))  # fmt: skip
    if len(figures) > 1:
        small, large = min(figures), max(figures)
        for names, label in (((PLAIN, PLAIN_NN), "plain A*NN"), (("astar", "nnpp"), "`nnpp` over our exact A*")):
            gains = [figures[size][names[0]].time_s / figures[size][names[1]].time_s for size in (small, large)]
            known = [paper.TABLE_2[size].speedup for size in (small, large) if size in paper.TABLE_2]
            found.append(judge(
                f"the network gains more on larger maps ({label})",
                f"{known[0]:.1f}× → {known[1]:.1f}×" if len(known) == 2 else "grows",
                f"{gains[0]:.2f}× → {gains[1]:.2f}×", agrees=gains[1] > gains[0],
                rule=f"the speed-up at {large}² is greater than at {small}²",
            ))  # fmt: skip
    return found


def _picture(figures: Figures) -> bytes:
    figure = new_figure(11, 4.4 * len(figures))
    grid = figure.subplots(len(figures), 2, squeeze=False)
    for (size, by_name), (left, right) in zip(figures.items(), grid, strict=True):
        theirs = paper.TABLE_2.get(size)
        bars = [(name, m.time_s, m.cc_increase, COLOURS[name]) for name, m in by_name.items()]
        if theirs:
            bars.insert(0, ("paper's A*", theirs.astar_s, 0.0, PAPER))
            bars.insert(1, ("paper's A*NN", theirs.nn_s, theirs.cc_increase, PAPER))
        labels = [label for label, *_ in bars]
        places = np.arange(len(bars))
        colours = [colour for *_, colour in bars]
        drawn = left.barh(places, [time_s for _, time_s, _, _ in bars], color=colours)
        left.bar_label(drawn, [seconds(time_s) for _, time_s, _, _ in bars], padding=3, fontsize="small")
        left.set_xscale("log")
        left.set_xlim(1e-4, 10.0 * max(time_s for _, time_s, _, _ in bars))
        tidy(left, f"{size}²: mean time of a query", "seconds", "")
        increases = [100.0 * increase for _, _, increase, _ in bars]
        drawn = right.barh(places, increases, color=colours)
        right.bar_label(drawn, [f"{x + 0.0:.2f}" for x in np.round(increases, 2)], padding=3, fontsize="small")
        right.margins(x=0.15)
        tidy(right, f"{size}²: CC above that of exact A*", "%", "")
        for axes in (left, right):
            axes.set_yticks(places, labels)
            axes.invert_yaxis()
    return png(figure)


EXPERIMENT = Experiment(
    "Table 2", "A* against A* in the network's region", run, Settings(), Settings(queries=4, repeats=2)
)
