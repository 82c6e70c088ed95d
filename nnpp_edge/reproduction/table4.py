"""Table 4: five maps, each standing still and changing."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import PLAIN, PLAIN_NN, Round
from nnpp_edge.reproduction.dynamic_contest import TIMES_NOTE, Drive, drive, find_episodes, speedup, stride_on, sums
from nnpp_edge.reproduction.experiment import Context, Experiment, Report
from nnpp_edge.reproduction.pictures import COLOURS, OURS, PAPER, new_figure, png, tidy
from nnpp_edge.reproduction.report import Finding, Result, Table, judge, judge_ratio, percent, seconds

_Rounds = Sequence[Round]


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


def _mean_of(rows: dict[str, Any], figure: str) -> float:
    return float(sum(getattr(row, figure) for row in rows.values())) / len(rows)


_S, _D = paper.TABLE_4_STATIC, paper.TABLE_4_DYNAMIC
_COMPARISONS = (
    _Comparison("A*NN over A*, static", _mean_of(_S, "astar_s") / _mean_of(_S, "nn_s"), True, (PLAIN, PLAIN_NN),
                ("astar", "nnpp")),
    _Comparison("A*NN over A*, dynamic", _mean_of(_D, "astar_s") / _mean_of(_D, "nn_s"), False, (PLAIN, PLAIN_NN),
                ("astar", "nnpp")),
    _Comparison("D* over A*, dynamic", _mean_of(_D, "astar_s") / _mean_of(_D, "dstar_s"), False, None,
                ("astar", "dstar")),
    _Comparison("D*NN over D*, dynamic", _mean_of(_D, "dstar_s") / _mean_of(_D, "dstar_nn_s"), False, None,
                ("dstar", "nnpp-dstar")),
    _Comparison("D*NN over A*, dynamic", _mean_of(_D, "astar_s") / _mean_of(_D, "dstar_nn_s"), False, None,
                ("astar", "nnpp-dstar")),
)  # fmt: skip


def run(context: Context, settings: Settings, report: Report) -> Result:
    """An episode on each of some maps, put to all planners."""
    sizes, notes = context.fitting((settings.size, 128, 64))
    size = max(sizes)
    notes = [note for note in notes if size < settings.size]
    drives = []
    for episode in find_episodes(context, size, settings.maps):
        drives.append(drive(episode, context.model, settings.repeats))
        report(len(drives) / settings.maps)
    plans = ", ".join(str(len(each.rounds)) for each in drives)
    notes.append(TIMES_NOTE)
    notes.append(
        f"Maps of {size}². -s is an episode's first plan; -d all its plans ({plans}), a plan every {stride_on(size)} "
        "cells. Our CC is the sum over the plans, each of what is left to drive; the paper does not say what its -d "
        "adds up (its CC grows less from -s to -d than in its Table 3), so only shares are compared."
    )
    return Result(_summary(drives), _data(drives), _findings(drives), _picture(drives), notes)


def _summary(drives: Sequence[Drive]) -> Table:
    header = ("scenario", "A*: AT", "A*NN: AT", "D*: AT", "D*NN: AT", "A*NN over A*", "D*NN over D*", "CC of A*",
              "CC of A*NN", "CC of D*NN", "MM")  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for static in (True, False):
        for at, each in enumerate(drives, 1):
            rows += _lines(f"map{at}-{'s' if static else 'd'}", each.rounds[:1] if static else each.rounds)
        rows += _lines(f"all-{'s' if static else 'd'}", _rounds(drives, static))
    rows += [_static_row(f"paper's {name}-s", row) for name, row in _S.items()]
    rows += [_dynamic_row(f"paper's {name}-d", row) for name, row in _D.items()]
    return Table(header, rows)


def _rounds(drives: Sequence[Drive], static: bool) -> list[Round]:
    return [each for one in drives for each in (one.rounds[:1] if static else one.rounds)]


def _lines(label: str, rounds: _Rounds) -> list[tuple[Any, ...]]:
    """A scenario's two lines: the plain planners, and ours."""
    plain, plain_nn = sums(rounds, PLAIN), sums(rounds, PLAIN_NN)
    exact, ours, dstar, dstar_nn = (sums(rounds, name) for name in ("astar", "nnpp", "dstar", "nnpp-dstar"))
    mm = None if plain_nn.mm is None else f"{plain_nn.mm:.3f}"
    return [
        (f"{label}, plain", seconds(plain.time_s), seconds(plain_nn.time_s), None, None,
         _times(plain.time_s, plain_nn.time_s), None, f"{plain.cc:.2f}", f"{plain_nn.cc:.2f}", None, mm),
        (f"{label}, ours", *(seconds(each.time_s) for each in (exact, ours, dstar, dstar_nn)),
         _times(exact.time_s, ours.time_s), _times(dstar.time_s, dstar_nn.time_s), f"{exact.cc:.2f}",
         f"{ours.cc:.2f}", f"{dstar_nn.cc:.2f}", None),
    ]  # fmt: skip


def _static_row(label: str, row: paper.Static) -> tuple[Any, ...]:
    return (label, seconds(row.astar_s), seconds(row.nn_s), None, None, _times(row.astar_s, row.nn_s), None,
            f"{row.astar_cc:.2f}", f"{row.nn_cc:.2f}", None, f"{row.nn_mm:.2f}")  # fmt: skip


def _dynamic_row(label: str, row: paper.Dynamic) -> tuple[Any, ...]:
    return (label, seconds(row.astar_s), seconds(row.nn_s), seconds(row.dstar_s), seconds(row.dstar_nn_s),
            _times(row.astar_s, row.nn_s), _times(row.dstar_s, row.dstar_nn_s), f"{row.astar_cc:.2f}",
            f"{row.nn_cc:.2f}", f"{row.dstar_nn_cc:.2f}", f"{row.nn_mm:.2f}")  # fmt: skip


def _times(slower_s: float, faster_s: float) -> str:
    return f"{slower_s / faster_s:.2f}×"


def _data(drives: Sequence[Drive]) -> Table:
    header = ("map", "plan", "planner", "path_cells", "start_row", "start_col", "goal_row", "goal_col", "time_s",
              "cc", "cost_excess", "mm")  # fmt: skip
    rows = [
        (at, n, name, answered.path_cells, *step.start, *each.episode.goal, a.time_s, a.traverse_cost, a.excess, a.mm)
        for at, each in enumerate(drives, 1)
        for n, (step, answered) in enumerate(zip(each.episode.steps, each.rounds, strict=True))
        for name, a in answered.answers.items()
    ]
    return Table(header, rows)


def _findings(drives: Sequence[Drive]) -> Sequence[Finding]:
    found = []
    for each in _COMPARISONS:
        rounds = _rounds(drives, each.static)
        if each.plain:
            found.append(
                judge_ratio(f"speed-up of {each.label}, both plain", each.paper, speedup(rounds, *each.plain))
            )
        found.append(judge_ratio(f"speed-up of {each.label}, both ours", each.paper, speedup(rounds, *each.compiled)))
    moving = _rounds(drives, static=False)
    theirs, ours = _mean_of(_D, "dstar_s") / _mean_of(_D, "nn_s"), speedup(moving, "dstar", "nnpp")
    found.append(judge(
        "the network gains A* more than D* does: A*NN is sooner done than D*, dynamic", f"{theirs:.2f}×",
        f"{ours:.2f}×", agrees=ours > 1.0, rule="`nnpp` takes less time than `dstar`",
    ))  # fmt: skip
    for label, name, static, increase in (
        ("A*NN, static, plain", PLAIN_NN, True, _mean_of(_S, "nn_cc") / _mean_of(_S, "astar_cc") - 1.0),
        ("A*NN, dynamic, plain", PLAIN_NN, False, _mean_of(_D, "nn_cc") / _mean_of(_D, "astar_cc") - 1.0),
        ("D*NN, dynamic, ours", "nnpp-dstar", False, _mean_of(_D, "dstar_nn_cc") / _mean_of(_D, "astar_cc") - 1.0),
    ):
        own = sums(_rounds(drives, static), name).cc_increase
        found.append(judge(
            f"CC increase of {label}", percent(increase), percent(own, 2), agrees=abs(own - increase) <= 0.01,
            rule="within one point", better=own < increase,
        ))  # fmt: skip
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
