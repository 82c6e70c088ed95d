"""Table 3 and Fig. 16: the plans of one episode on a map that changes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.animation import View, animate, draw_driven, draw_view, frame, legend, view_episode
from nnpp_edge.reproduction.contest import PLAIN, PLAIN_NN, Round, answers_table, means, shown
from nnpp_edge.reproduction.dynamic_contest import PLANNERS, TIMES_NOTE, drive, find_episodes, speedup, stride_on
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import bare, new_figure, png
from nnpp_edge.reproduction.report import Finding, Result, Row, Table, judge, judge_increase, judge_ratio, seconds

_MOST_COLUMNS = 5
_PAPER_FRAMES = len(paper.TABLE_3["A*"])


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    size: int = 256
    episodes: int = 12
    """Of which the one with as many plans as the paper's is taken, or the nearest to that."""
    repeats: int = 5
    cells_a_frame: int = 3
    """Cells that the robot drives from one picture of the animation to the next."""


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """One episode: every plan of it by all planners, and drawn."""
    size, notes = context.one_size(settings.size)
    found = find_episodes(context, size, settings.episodes)
    episode = min(found, key=lambda each: abs(len(each.steps) - _PAPER_FRAMES))
    progress(0.2)
    driven = drive(episode, context.model, settings.repeats)
    progress(0.6)
    views = view_episode(episode, context.model)
    stride = stride_on(size)
    animation = animate(views, stride, settings.cells_a_frame)
    progress(1.0)
    notes.append(TIMES_NOTE)
    notes.append(
        f"A map of {size}²; the robot follows the optimal path for {stride} cells, then rectangles of cost 1 appear "
        "on what is left of it, move on or vanish. All planners answer the same plans. CC is of what is left to "
        "drive. The animated picture shows the same episode."
    )
    notes.append("The paper's table gives D* 2.58 s in all; its frames sum to 2.68 s, which is compared with here.")
    data = answers_table("frame", (((at,), query, answered) for at, query, answered in driven.answered()))
    return Result(summary(driven.rounds), data, findings(driven.rounds), _picture(views, stride), notes, animation)


def summary(rounds: Sequence[Round]) -> Table:
    header = ("frame", *(f"{shown(name)}: {what}" for name in PLANNERS for what in ("AT", "CC")))
    rows: list[Row] = []
    for at, answered in enumerate(rounds):
        rows.append((frame(at), *_pairs([answered])))
    rows.append(("all", *_pairs(rounds)))
    for at, line in enumerate(zip(*(paper.TABLE_3[name] for name in _PAPER_COLUMNS), strict=True)):
        rows.append((f"paper's {frame(at)}", *_of_paper(line)))
    all_of_them = [tuple(map(sum, zip(*paper.TABLE_3[name], strict=True))) for name in _PAPER_COLUMNS]
    rows.append(("paper's, all", *_of_paper(all_of_them)))
    return Table(header, rows)


_PAPER_COLUMNS = ("A*", "A*NN", "D*", "D*NN")


def _of_paper(line: Sequence[Sequence[float]]) -> list[str | None]:
    """The paper's figures under our columns: A* and A*NN are its plain ones, its D* stands under ours."""
    shown = [(seconds(time_s), f"{cc:.2f}") for time_s, cc in line]
    return [*shown[0], *shown[1], None, None, None, None, *shown[2], *shown[3]]


def _pairs(rounds: Sequence[Round]) -> list[str]:
    out = []
    for name in PLANNERS:
        of_it = means(rounds, name)
        out += [seconds(of_it.total_s), f"{of_it.total_cc:.2f}"]
    return out


def _total(name: str, figure: int) -> float:
    return math.fsum(line[figure] for line in paper.TABLE_3[name])


def findings(rounds: Sequence[Round]) -> Sequence[Finding]:
    found = [
        judge_ratio(claim, _total(theirs[0], 0) / _total(theirs[1], 0), speedup(rounds, *ours))
        for claim, theirs, ours in (
            ("speed-up of A*NN over A*, both plain", ("A*", "A*NN"), (PLAIN, PLAIN_NN)),
            ("speed-up of `nnpp` over our own exact A*", ("A*", "A*NN"), ("astar", "nnpp")),
            ("speed-up of D* over A*, both ours", ("A*", "D*"), ("astar", "dstar")),
            ("speed-up of D*NN over D*, both ours", ("D*", "D*NN"), ("dstar", "nnpp-dstar")),
        )
    ]
    for name, theirs in ((PLAIN_NN, "A*NN"), ("nnpp-dstar", "D*NN")):
        increase = _total(theirs, 1) / _total("A*", 1) - 1.0
        found.append(
            judge_increase(f"CC increase of {theirs} ({shown(name)})", increase, means(rounds, name).cc_increase)
        )
    theirs_s = [paper.TABLE_3[name][-1][0] for name in ("D*NN", "D*")]
    nn_s, dstar_s = ours_s = [means(rounds[-1:], name).total_s for name in ("nnpp-dstar", "dstar")]
    claim, rule = (
        "near the goal, in the last frame, D*NN takes longer than D*",
        "`nnpp-dstar` takes longer than `dstar`",
    )
    paper_s, own_s = (" against ".join(map(seconds, pair)) for pair in (theirs_s, ours_s))
    found.append(judge(claim, paper_s, own_s, agrees=nn_s > dstar_s, rule=rule, better=nn_s <= dstar_s))
    return found


def _picture(views: Sequence[View], stride: int) -> bytes:
    rows = math.ceil((len(views) + 1) / _MOST_COLUMNS)
    columns = math.ceil((len(views) + 1) / rows)
    figure = new_figure(2.7 * columns, 2.95 * rows + 0.5)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for at, (axes, view) in enumerate(zip(panels, views, strict=False)):
        draw_view(axes, view, before=views[at - 1] if at else None)
        bare(axes, frame(at))
    draw_driven(panels[len(views)], views, stride)
    bare(panels[len(views)], "the way driven")
    for axes in panels[len(views) + 1 :]:
        axes.set_axis_off()
    legend(figure, panels[min(1, len(views) - 1)])
    return png(figure)


_QUICK = Settings(size=128, episodes=3, repeats=1, cells_a_frame=11)
EXPERIMENT = Experiment(
    "Table 3 and Fig. 16", "Planning anew as the map changes, plan by plan", run, Settings(), _QUICK
)
