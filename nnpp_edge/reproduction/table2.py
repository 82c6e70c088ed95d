"""Table 2: A* against A* in the network's region, at 256² and 512²; and our own planners beside them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import OURS, PLAIN, PLAIN_NN, PLANNERS, Means, contest_by_size, means, shown
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import COLOURS, PAPER, new_figure, png, tidy
from nnpp_edge.reproduction.report import (
    Finding,
    Result,
    Row,
    Table,
    columns,
    judge,
    judge_increase,
    judge_ratio,
    optional,
    percent,
    seconds,
    times,
)


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    sizes: tuple[int, ...] = tuple(paper.TABLE_2)
    queries: int = 200
    repeats: int = 3


Figures = dict[int, dict[str, Means]]


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """Random queries on random maps, all planners on each."""
    sizes, notes = context.fitting(settings.sizes)
    rounds = contest_by_size(context, sizes, settings.queries, settings.repeats, progress)
    figures = {size: {name: means(of_size, name) for name in PLANNERS} for size, of_size in rounds.items()}
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
    return Result(summary(figures), _data(figures), findings(figures, context), _picture(figures), notes)


def summary(figures: Figures) -> Table:
    header = columns(
        "map | planner | AT | speed-up over plain A* | speed-up over our exact A* | CC | CC increase | success | MM"
    )
    rows: list[Row] = []
    for size, by_name in figures.items():
        side = f"{size}²"
        if theirs := paper.TABLE_2.get(size):
            astar = (seconds(theirs.astar_s), "1.0×", None, f"{theirs.astar_cc:.1f}", None, "100.0 %", None)
            quality = (f"{theirs.nn_cc:.1f}", percent(theirs.cc_increase), percent(theirs.nn_success), None)
            rows.append((side, "paper's A*", *astar))
            rows.append((side, "paper's A*NN", seconds(theirs.nn_s), f"{theirs.speedup:.1f}×", None, *quality))
        for name, m in by_name.items():
            gains = (_gain(by_name[PLAIN], m), _gain(by_name["astar"], m))
            ours = (f"{m.traverse_cost:.1f}", percent(m.cc_increase, 2), percent(m.success), optional(m.mm, ".3f"))
            rows.append((side, shown(name), seconds(m.time_s), *gains, *ours))
    return Table(header, rows)


def _gain(slower: Means, faster: Means) -> str:
    return times(slower.time_s, faster.time_s, ".0f" if slower.time_s >= 100.0 * faster.time_s else ".3g")


def _data(figures: Figures) -> Table:
    header = columns(
        "size | planner | time_s_mean | time_s_sd | speedup_over_plain | speedup_over_astar | cc_mean | "
        "cc_increase | cost_excess | success | mm_mean | mm_sd"
    )
    rows: list[Row] = []
    for size, by_name in figures.items():
        if theirs := paper.TABLE_2.get(size):
            astar = (theirs.astar_s, None, 1.0, None, theirs.astar_cc, 0.0, None, 1.0, None, None)
            quality = (theirs.nn_cc, theirs.cc_increase, None, theirs.nn_success, None, None)
            rows.append((size, "paper A*", *astar))
            rows.append((size, "paper A*NN", theirs.nn_s, None, theirs.speedup, None, *quality))
        for name, m in by_name.items():
            gains = (by_name[PLAIN].time_s / m.time_s, by_name["astar"].time_s / m.time_s)
            ours = (m.traverse_cost, m.cc_increase, m.excess, m.success, m.mm, m.mm_sd)
            rows.append((size, name, m.time_s, m.time_sd_s, *gains, *ours))
    return Table(header, rows)


def findings(figures: Figures, context: Context) -> Sequence[Finding]:
    found: list[Finding] = []
    for size, by_name in figures.items():
        if theirs := paper.TABLE_2.get(size):
            found += _beside_paper(size, theirs, by_name)
        fastest = min(OURS, key=lambda name: by_name[name].time_s)
        claim, network = f"{size}²: the network's region is the fastest way to plan", context.model.metadata.name
        rule, ours = "`nnpp` has the least mean time of ours", f"`{fastest}` (network {network})"
        found.append(judge(claim, "A*NN", ours, agrees=fastest == "nnpp", rule=rule))
    if len(figures) > 1:
        small, large = min(figures), max(figures)
        rule = f"the speed-up at {large}² is greater than at {small}²"
        known = [paper.TABLE_2[size].speedup for size in (small, large) if size in paper.TABLE_2]
        theirs_grow = f"{known[0]:.1f}× → {known[1]:.1f}×" if len(known) == 2 else "grows"
        for slow, fast, label in ((PLAIN, PLAIN_NN, "plain A*NN"), ("astar", "nnpp", "`nnpp` over our exact A*")):
            low, high = (figures[size][slow].time_s / figures[size][fast].time_s for size in (small, large))
            claim = f"the network gains more on larger maps ({label})"
            found.append(judge(claim, theirs_grow, f"{low:.2f}× → {high:.2f}×", agrees=high > low, rule=rule))
    return found


def _beside_paper(size: int, theirs: paper.Scale, by_name: dict[str, Means]) -> Iterator[Finding]:
    """What the paper gives figures of at one size."""
    plain, plain_nn, exact, ours = (by_name[name] for name in (PLAIN, PLAIN_NN, "astar", "nnpp"))
    both, own = "of A*NN over A*, both plain", "of `nnpp` over our own exact A*"
    yield judge_ratio(f"{size}²: speed-up {both}", theirs.speedup, plain.time_s / plain_nn.time_s)
    yield judge_increase(f"{size}²: CC increase {both}", theirs.cc_increase, plain_nn.cc_increase)
    yield judge(
        f"{size}²: success of A*NN in its first region",
        percent(theirs.nn_success),
        percent(plain_nn.success),
        agrees=abs(plain_nn.success - theirs.nn_success) <= 0.01,
        rule="within one point",
        better=plain_nn.success > theirs.nn_success,
    )
    yield judge_ratio(f"{size}²: speed-up {own}", theirs.speedup, exact.time_s / ours.time_s)
    yield judge_increase(f"{size}²: CC increase {own}", theirs.cc_increase, ours.cc_increase)


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
