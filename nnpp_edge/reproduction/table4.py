"""Table 4: five maps, each standing still and changing."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import PLAIN, PLAIN_NN, Round, answers_table, means
from nnpp_edge.reproduction.dynamic_contest import TIMES_NOTE, Drive, drive, find_episodes, speedup, stride_on
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import COLOURS, OURS, PAPER, new_figure, png, tidy
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
    seconds,
    times,
)


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    size: int = 256
    maps: int = 5
    repeats: int = 5


@dataclass(frozen=True)
class _Comparison:
    """Two methods' summed times."""

    label: str
    paper: float
    static: bool
    """Over the first plans alone."""
    plain: tuple[str, str] | None
    compiled: tuple[str, str]


def _mean_of(rows: Iterable[paper.Static], figure: str) -> float:
    values = [getattr(row, figure) for row in rows]
    return float(sum(values)) / len(values)


def _ratio(rows: Iterable[paper.Static], above: str, below: str) -> float:
    rows = list(rows)
    return _mean_of(rows, above) / _mean_of(rows, below)


_S, _D = list(paper.TABLE_4_STATIC.values()), list(paper.TABLE_4_DYNAMIC.values())
_PLAIN_PAIR, _OURS_PAIR = (PLAIN, PLAIN_NN), ("astar", "nnpp")
_COMPARISONS = (
    _Comparison("A*NN over A*, static", _ratio(_S, "astar_s", "nn_s"), True, _PLAIN_PAIR, _OURS_PAIR),
    _Comparison("A*NN over A*, dynamic", _ratio(_D, "astar_s", "nn_s"), False, _PLAIN_PAIR, _OURS_PAIR),
    _Comparison("D* over A*, dynamic", _ratio(_D, "astar_s", "dstar_s"), False, None, ("astar", "dstar")),
    _Comparison("D*NN over D*, dynamic", _ratio(_D, "dstar_s", "dstar_nn_s"), False, None, ("dstar", "nnpp-dstar")),
    _Comparison("D*NN over A*, dynamic", _ratio(_D, "astar_s", "dstar_nn_s"), False, None, ("astar", "nnpp-dstar")),
)


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """An episode on each of some maps, by all planners."""
    size, notes = context.one_size(settings.size)
    drives = []
    for episode in find_episodes(context, size, settings.maps):
        drives.append(drive(episode, context.model, settings.repeats))
        progress(len(drives) / settings.maps)
    plans = ", ".join(str(len(each.rounds)) for each in drives)
    notes.append(TIMES_NOTE)
    notes.append(
        f"Maps of {size}². -s is an episode's first plan; -d all its plans ({plans}), a plan every {stride_on(size)} "
        "cells. Our CC is the sum over the plans, each of what is left to drive; the paper does not say what its -d "
        "adds up (its CC grows less from -s to -d than in its Table 3), so only shares are compared."
    )
    answered = (((at, n), query, of) for at, each in enumerate(drives, 1) for n, query, of in each.answered())
    data = answers_table("map | plan", answered)
    return Result(summary(drives), data, findings(drives), _picture(drives), notes)


def summary(drives: Sequence[Drive]) -> Table:
    header = columns(
        "scenario | A*: AT | A*NN: AT | D*: AT | D*NN: AT | A*NN over A* | D*NN over D* | CC of A* | CC of A*NN | "
        "CC of D*NN | MM"
    )
    rows: list[Row] = []
    for static in (True, False):
        for at, each in enumerate(drives, 1):
            rows += _lines(f"map{at}-{'s' if static else 'd'}", each.rounds[:1] if static else each.rounds)
        rows += _lines(f"all-{'s' if static else 'd'}", _rounds(drives, static))
    rows += [_paper_row(f"paper's {name}-s", row) for name, row in paper.TABLE_4_STATIC.items()]
    rows += [_paper_row(f"paper's {name}-d", row) for name, row in paper.TABLE_4_DYNAMIC.items()]
    return Table(header, rows)


def _rounds(drives: Sequence[Drive], static: bool) -> list[Round]:
    return [each for one in drives for each in (one.rounds[:1] if static else one.rounds)]


def _lines(label: str, rounds: Sequence[Round]) -> list[Row]:
    """A scenario's two lines: the plain planners, and ours."""
    plain, plain_nn = means(rounds, PLAIN), means(rounds, PLAIN_NN)
    exact, ours, dstar, dstar_nn = (means(rounds, name) for name in ("astar", "nnpp", "dstar", "nnpp-dstar"))
    plain_times = (seconds(plain.total_s), seconds(plain_nn.total_s), None, None)
    plain_cc = (f"{plain.total_cc:.2f}", f"{plain_nn.total_cc:.2f}", None, optional(plain_nn.mm, ".3f"))
    our_times = (seconds(each.total_s) for each in (exact, ours, dstar, dstar_nn))
    our_gains = (times(exact.total_s, ours.total_s), times(dstar.total_s, dstar_nn.total_s))
    our_cc = (f"{exact.total_cc:.2f}", f"{ours.total_cc:.2f}", f"{dstar_nn.total_cc:.2f}", None)
    return [
        (f"{label}, plain", *plain_times, times(plain.total_s, plain_nn.total_s), None, *plain_cc),
        (f"{label}, ours", *our_times, *our_gains, *our_cc),
    ]


def _paper_row(label: str, row: paper.Static) -> Row:
    moving = row if isinstance(row, paper.Dynamic) else None
    return (
        *(label, seconds(row.astar_s), seconds(row.nn_s)),
        *((seconds(moving.dstar_s), seconds(moving.dstar_nn_s)) if moving else (None, None)),
        *(times(row.astar_s, row.nn_s), times(moving.dstar_s, moving.dstar_nn_s) if moving else None),
        *(f"{row.astar_cc:.2f}", f"{row.nn_cc:.2f}", f"{moving.dstar_nn_cc:.2f}" if moving else None),
        f"{row.nn_mm:.2f}",
    )


def findings(drives: Sequence[Drive]) -> Sequence[Finding]:
    found = []
    for each in _COMPARISONS:
        for pair, kind in ((each.plain, "plain"), (each.compiled, "ours")):
            if pair:
                gain = speedup(_rounds(drives, each.static), *pair)
                found.append(judge_ratio(f"speed-up of {each.label}, both {kind}", each.paper, gain))
    theirs, ours = _ratio(_D, "dstar_s", "nn_s"), speedup(_rounds(drives, static=False), "dstar", "nnpp")
    claim = "the network gains A* more than D* does: A*NN is sooner done than D*, dynamic"
    rule = "`nnpp` takes less time than `dstar`"
    found.append(judge(claim, f"{theirs:.2f}×", f"{ours:.2f}×", agrees=ours > 1.0, rule=rule))
    for label, name, static, gain in (
        ("A*NN, static, plain", PLAIN_NN, True, _ratio(_S, "nn_cc", "astar_cc")),
        ("A*NN, dynamic, plain", PLAIN_NN, False, _ratio(_D, "nn_cc", "astar_cc")),
        ("D*NN, dynamic, ours", "nnpp-dstar", False, _ratio(_D, "dstar_nn_cc", "astar_cc")),
    ):
        own = means(_rounds(drives, static), name).cc_increase
        found.append(judge_increase(f"CC increase of {label}", gain - 1.0, own))
    return found


def _picture(drives: Sequence[Drive]) -> bytes:
    figure = new_figure(9.5, 4.6)
    axes = figure.subplots()
    width, gap = 0.26, 0.28
    for at, each in enumerate(_COMPARISONS):
        rounds = _rounds(drives, each.static)
        bars: list[tuple[int, float, str, list[float]]] = [(0, each.paper, PAPER, [])]
        for place, pair, colour in ((1, each.plain, COLOURS[PLAIN]), (2, each.compiled, OURS)):
            if pair:
                of_maps = [speedup(one.rounds[:1] if each.static else one.rounds, *pair) for one in drives]
                bars.append((place, speedup(rounds, *pair), colour, of_maps))
        for place, height, colour, of_maps in bars:
            x = at + (place - 1) * gap
            axes.bar(x, height, width, color=colour)
            axes.plot([x] * len(of_maps), of_maps, ".", color="black", markersize=4)
            above = (x, max([height, *of_maps]))
            axes.annotate(f"{height:.2f}", above, (0, 3), textcoords="offset points", ha="center", fontsize="small")
    for label, colour in (("paper", PAPER), ("ours, plain Python", COLOURS[PLAIN]), ("ours, compiled", OURS)):
        axes.fill_between([], [], color=colour, label=label)
    axes.plot([], [], ".", color="black", markersize=4, label="each map")
    axes.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
    tidy(axes, "Speed-ups, of times summed over all maps and plans", "", "times as fast")
    axes.set_xticks(range(len(_COMPARISONS)), [each.label.replace(", ", ",\n") for each in _COMPARISONS])
    axes.set_yscale("log")
    axes.set_ylim(min(0.5, axes.get_ylim()[0]), 1.6 * axes.get_ylim()[1])
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(frameon=False, fontsize="small")
    return png(figure)


EXPERIMENT = Experiment(
    "Table 4", "Five maps, standing still and changing", run, Settings(), Settings(size=128, maps=2, repeats=1)
)
