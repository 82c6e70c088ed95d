"""Table 2: A* against A* in the network's region, at 256² and 512²; and our own planners beside them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import (
    OURS,
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_NN,
    PLAIN_PLANNERS,
    PLANNERS,
    Means,
    contest_by_size,
    means,
    network_of,
    shown,
)
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import COLOURS, PAPER, new_figure, png, tidy
from nnpp_edge.reproduction.regions import (
    CONTROLS,
    CONTROLS_NOTE,
    NETWORK,
    Found,
    Networks,
    RegionMeans,
    compare_regions,
    region_means,
)
from nnpp_edge.reproduction.report import (
    About,
    Finding,
    Result,
    Row,
    Sections,
    Table,
    columns,
    judge,
    judge_increase,
    judge_ratio,
    percent,
    seconds,
    times,
)


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    sizes: tuple[int, ...] = tuple(paper.TABLE_2)
    maps: int = paper.VALIDATION_MAPS
    """At each size, in the regions of which paths are searched; one query each."""
    queries: int = 200
    """Of them, which all planners answer against the clock."""
    repeats: int = 3


@dataclass(frozen=True)
class Scale:
    """What was measured at one size."""

    times: dict[str, Means]
    """Of each planner, over the timed queries."""
    paper: dict[str, RegionMeans]
    """Of the region of the paper's method and its controls, over all maps."""
    ours: dict[str, RegionMeans]
    """The same of our network's own region."""

    def gains(self, slower: str) -> dict[str, float]:
        """How many times as fast as this planner each of the others is."""
        return {name: self.times[slower].time_s / m.time_s for name, m in self.times.items()}


Figures = dict[int, Scale]


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """Random maps, one query each: all planners on some of them, the regions on all."""
    sizes, notes = context.fitting(settings.sizes)
    rounds = contest_by_size(context, sizes, settings.queries, settings.repeats, lambda share: progress(0.7 * share))
    figures: Figures = {}
    for at, size in enumerate(sizes):

        def report(share: float, at: int = at) -> None:
            progress(0.7 + 0.3 * (at + share) / len(sizes))

        found = _regions(context, size, settings.maps, report)
        by_name = {name: means(rounds[size], name) for name in PLANNERS}
        figures[size] = Scale(by_name, *({name: region_means(of) for name, of in each.items()} for each in found))
    notes.append(
        "Start and goal are at least 0.35 of the map's side apart. Times are of the whole job. What depends on the"
        " map alone (our padded weights, pyramid and the network's view of the map) is made before our planners' "
        "clock starts, while the plain ones average the map, run the network and build their graph for each query."
    )
    notes.append(
        "`plain A*NN` is the paper's method as it stands: the network's region at the adaptive threshold td, a "
        "graph of that region alone, a search in it; one look, nothing widened. Success, CC and MM are of that "
        "region, over all maps. `nnpp` is this toolkit's: a wider region, narrowed from coarse to fine, searched "
        "by the compiled A*; success and MM beside it are of its network's own region before all that, by the "
        "paper's rule."
    )
    about = About(
        context.networks.named,
        f"{settings.maps} maps a size, one query each; times over {settings.queries} of them, ours the median of "
        f"{settings.repeats}",
        CONTROLS_NOTE,
    )
    return Result(
        about, summary(figures, context.networks), _data(figures), findings(figures), _picture(figures), notes
    )


def _regions(
    context: Context, size: int, maps: int, progress: OnProgress
) -> tuple[dict[str, list[Found]], dict[str, list[Found]]]:
    """What searches in the regions of the paper's method, and of our network, come to on each map."""
    networks = context.networks
    pairs = (networks.paper, networks.shuffled), (networks.ours, networks.ours_shuffled)
    found: tuple[dict[str, list[Found]], dict[str, list[Found]]] = ({}, {})
    for done, (case, query) in enumerate(context.maps(size, maps), 1):
        for kinds, pair in zip(found, pairs, strict=True):
            for name, each in compare_regions(case.cost, query, *pair).items():
                kinds.setdefault(name, []).append(each)
        progress(done / maps)
    return found


def summary(figures: Figures, networks: Networks) -> Sections:
    """The paper's method and its controls, then ours."""
    return Sections([("The paper's method", _papers(figures, networks)), ("Ours", _ours(figures, networks))])


def _papers(figures: Figures, networks: Networks) -> Table:
    header = columns(
        "map | planner | network | AT | speed-up over plain A* | CC | CC increase | success | MM | region, of the map"
    )
    rows: list[Row] = []
    for size, scale in figures.items():
        side = f"{size}²"
        if theirs := paper.TABLE_2.get(size):
            quality = (f"{theirs.nn_cc:.1f}", percent(theirs.cc_increase), percent(theirs.nn_success), None, None)
            astar = (f"{theirs.astar_cc:.1f}", None, "100.0 %", None, None)
            rows.append((side, "paper's A*", None, seconds(theirs.astar_s), "1.0×", *astar))
            speedup = f"{theirs.speedup:.1f}×"
            rows.append((side, "paper's A*NN", "the paper's", seconds(theirs.nn_s), speedup, *quality))
        for name in PLAIN_PLANNERS:
            m, region = scale.times[name], scale.paper.get(_KINDS.get(name, ""))
            timed = (seconds(m.time_s), _gain(scale.times[PLAIN], m))
            exact = (f"{scale.paper[NETWORK].exact_cc:.1f}", percent(0.0), percent(1.0), None, None)
            of_it = _quality(region) if region else exact
            rows.append((side, name, network_of(name, networks), *timed, *of_it))
    return Table(header, rows)


_KINDS = {PLAIN_NN: NETWORK, **{name: kind for kind, name in PLAIN_CONTROLS.items()}}
"""The region that each plain planner searches."""


def _quality(region: RegionMeans) -> Row:
    increase, mm = percent(region.cc_increase, 2), f"{region.mm:.3f} ± {region.mm_sd:.3f}"
    return f"{region.cc:.1f}", increase, percent(region.success), mm, percent(region.share)


def _ours(figures: Figures, networks: Networks) -> Table:
    header = columns(
        "map | planner | network | AT | speed-up over plain A* | speed-up over our exact A* | CC | CC increase | "
        "own region: success | MM | of the map"
    )
    rows: list[Row] = []
    for size, scale in figures.items():
        for name in OURS:
            m, own = scale.times[name], scale.ours[NETWORK] if name == "nnpp" else None
            gains = (_gain(scale.times[PLAIN], m), _gain(scale.times["astar"], m))
            quality = _quality(own)[2:] if own else (None, None, None)
            path = (f"{m.traverse_cost:.1f}", percent(m.cc_increase, 2))
            rows.append(
                (f"{size}²", shown(name), network_of(name, networks), seconds(m.time_s), *gains, *path, *quality)
            )
        for kind in CONTROLS:
            label = f"*{kind}* in place of `nnpp`'s own region"
            rows.append((f"{size}²", label, None, None, None, None, *_quality(scale.ours[kind])))
    return Table(header, rows)


def _gain(slower: Means, faster: Means) -> str:
    return times(slower.time_s, faster.time_s, ".0f" if slower.time_s >= 100.0 * faster.time_s else ".3g")


def _data(figures: Figures) -> Table:
    header = columns(
        "size | of | name | time_s_mean | time_s_sd | speedup_over_plain | speedup_over_astar | cc_mean | "
        "cc_increase | cost_excess | success | mm_mean | mm_sd | region_share | queries"
    )
    nothing = (None, None, None, None)
    rows: list[Row] = []
    for size, scale in figures.items():
        if theirs := paper.TABLE_2.get(size):
            astar = (theirs.astar_cc, 0.0, None, 1.0, *nothing[:3], paper.VALIDATION_MAPS)
            quality = (theirs.nn_cc, theirs.cc_increase, None, theirs.nn_success, *nothing[:3], paper.VALIDATION_MAPS)
            rows.append((size, "times", "paper A*", theirs.astar_s, None, 1.0, None, *astar))
            rows.append((size, "times", "paper A*NN", theirs.nn_s, None, theirs.speedup, None, *quality))
        plain, exact = scale.gains(PLAIN), scale.gains("astar")
        for name, m in scale.times.items():
            timed = (m.time_s, m.time_sd_s, plain[name], exact[name])
            rows.append(
                (
                    size,
                    "times",
                    name,
                    *timed,
                    m.traverse_cost,
                    m.cc_increase,
                    m.excess,
                    m.success,
                    m.mm,
                    m.mm_sd,
                    None,
                    m.queries,
                )
            )
        for whose, regions in (("paper's region", scale.paper), ("our region", scale.ours)):
            for kind, r in regions.items():
                figures_of = (r.cc, r.cc_increase, r.excess, r.success, r.mm, r.mm_sd, r.share, r.queries)
                rows.append((size, whose, kind, *nothing, *figures_of))
    return Table(header, rows)


def findings(figures: Figures) -> Sequence[Finding]:
    found: list[Finding] = []
    for size, scale in figures.items():
        if theirs := paper.TABLE_2.get(size):
            found += _beside_paper(size, theirs, scale)
        gains = scale.gains("astar")
        fastest = max(OURS, key=gains.__getitem__)
        claim = f"{size}²: the network's region is the fastest way to plan"
        rule, ours = "`nnpp` has the least mean time of ours", f"`{fastest}`"
        found.append(judge(claim, "A*NN", ours, agrees=fastest == "nnpp", rule=rule))
    if len(figures) > 1:
        found += _growth(figures, min(figures), max(figures))
    return found


def _growth(figures: Figures, small: int, large: int) -> Iterator[Finding]:
    """Whether the network gains more on larger maps."""
    rule = f"the speed-up at {large}² is greater than at {small}²"
    known = [paper.TABLE_2[size].speedup for size in (small, large) if size in paper.TABLE_2]
    theirs_grow = f"{known[0]:.1f}× → {known[1]:.1f}×" if len(known) == 2 else "grows"
    for slow, fast, label, controls in (
        (PLAIN, PLAIN_NN, "plain A*NN", PLAIN_CONTROLS),
        ("astar", "nnpp", "`nnpp` over our exact A*", {"corridor": "corridor"}),
    ):
        low, high = (figures[size].gains(slow) for size in (small, large))
        as_well = {kind: high[name] > low[name] for kind, name in controls.items()}
        claim, ours = f"the network gains more on larger maps ({label})", f"{low[fast]:.2f}× → {high[fast]:.2f}×"
        yield judge(claim, theirs_grow, ours, agrees=high[fast] > low[fast], rule=rule, controls=as_well)


def _beside_paper(size: int, theirs: paper.Scale, scale: Scale) -> Iterator[Finding]:
    """What the paper gives figures of at one size.

    A control counts where it finds as many paths; among the speed-ups, where its CC is no more than a point above.
    """
    gains, compiled, own = scale.gains(PLAIN), scale.gains("astar"), scale.paper[NETWORK]
    controls = {kind: of for kind in CONTROLS if (of := scale.paper[kind]).success >= own.success}
    increases = {kind: of.cc_increase for kind, of in controls.items()}
    as_near = [kind for kind, increase in increases.items() if increase <= own.cc_increase + 0.01]
    faster = {kind: gains[PLAIN_CONTROLS[kind]] for kind in as_near}
    plain, ours = "of A*NN over A*, both plain", "of `nnpp` over our own exact A*"
    yield judge_ratio(f"{size}²: speed-up {plain}", theirs.speedup, gains[PLAIN_NN], controls=faster)
    yield judge_increase(f"{size}²: CC increase {plain}", theirs.cc_increase, own.cc_increase, controls=increases)
    yield judge(
        f"{size}²: success of A*NN in its first region",
        percent(theirs.nn_success),
        percent(own.success),
        agrees=abs(own.success - theirs.nn_success) <= 0.01,
        rule="within one point",
        better=own.success > theirs.nn_success,
        controls={
            kind: of.success >= theirs.nn_success - 0.01 for kind, of in scale.paper.items() if kind != NETWORK
        },
    )
    corridor = scale.times["corridor"]
    of_corridor = {"corridor": compiled["corridor"]}
    yield judge_ratio(f"{size}²: speed-up {ours}", theirs.speedup, compiled["nnpp"], controls=of_corridor)
    increase = scale.times["nnpp"].cc_increase
    as_well = {"corridor": corridor.cc_increase}
    yield judge_increase(f"{size}²: CC increase {ours}", theirs.cc_increase, increase, controls=as_well)


def _picture(figures: Figures) -> bytes:
    figure = new_figure(11, 4.4 * len(figures))
    grid = figure.subplots(len(figures), 2, squeeze=False)
    for (size, scale), (left, right) in zip(figures.items(), grid, strict=True):
        theirs = paper.TABLE_2.get(size)
        bars = [(name, m.time_s, m.cc_increase, COLOURS[name]) for name, m in scale.times.items()]
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
        increases = np.round([100.0 * increase for _, _, increase, _ in bars], 2) + 0.0  # no -0
        drawn = right.barh(places, increases, color=colours)
        right.bar_label(drawn, [f"{x:.2f}" for x in increases], padding=3, fontsize="small")
        right.margins(x=0.15)
        tidy(right, f"{size}²: CC above that of exact A*", "%", "")
        for axes in (left, right):
            axes.set_yticks(places, labels)
            axes.invert_yaxis()
    return png(figure)


EXPERIMENT = Experiment(
    "Table 2", "A* against A* in the network's region", run, Settings(), Settings(maps=8, queries=4, repeats=2)
)
