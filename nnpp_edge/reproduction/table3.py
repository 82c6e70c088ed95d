"""Table 3 and Fig. 16: the plans of one episode on a map that changes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.animation import View, animate, draw_driven, draw_view, frame, legend, view_episode
from nnpp_edge.reproduction.contest import Round, answers_table, means
from nnpp_edge.reproduction.dynamic_contest import (
    CONTROL_OF,
    CONTROLS_NOTE,
    OURS,
    PLAIN_ASTARS,
    PLAIN_DSTARS,
    PLAIN_PLANNERS,
    TIMES_NOTE,
    drive,
    find_episodes,
    label,
    mended,
    network_of,
    speedup,
    stride_on,
)
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import bare, new_figure, png
from nnpp_edge.reproduction.regions import CORRIDOR, Networks
from nnpp_edge.reproduction.report import (
    About,
    Finding,
    Result,
    Row,
    Sections,
    Table,
    judge,
    judge_increase,
    judge_ratio,
    seconds,
)

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
    driven = drive(episode, context.networks, settings.repeats)
    progress(0.6)
    views = view_episode(episode, context.networks.paper)
    stride = stride_on(size)
    animation = animate(views, stride, settings.cells_a_frame)
    progress(1.0)
    notes.append(TIMES_NOTE)
    notes.append(
        f"A map of {size}²; the robot follows the optimal path for {stride} cells, then rectangles of cost 1 appear "
        "on what is left of it, move on or vanish. All planners answer the same plans. CC of a frame is that of the "
        "path planned there, from the robot to the goal; *all* is their sum, as in the paper's table. The animated "
        "picture shows the same episode, with regions and paths of the paper's method."
    )
    notes.append("The paper's table gives D* 2.58 s in all; its frames sum to 2.68 s, which is compared with here.")
    data = answers_table("frame", (((at,), query, answered) for at, query, answered in driven.answered()))
    about = About(
        context.networks.named,
        f"1 episode, {len(driven.rounds)} plans; ours the median of {settings.repeats} lives",
        CONTROLS_NOTE,
    )
    return Result(
        about,
        summary(driven.rounds, context.networks),
        data,
        findings(driven.rounds),
        _picture(views, stride),
        notes,
        animation,
    )


def summary(rounds: Sequence[Round], networks: Networks) -> Sections:
    """The paper's methods in plain Python beside the paper's figures, then ours."""
    plain = _frames(rounds, PLAIN_PLANNERS, networks)
    lines = [(f"paper's {frame(at)}", line) for at, line in enumerate(zip(*_papers_columns(), strict=True))]
    sums = [tuple(map(math.fsum, zip(*column, strict=True))) for column in _papers_columns()]
    for where, line in [*lines, ("paper's, all", tuple(sums))]:
        plain.append((where, *_of_paper(line)))
    headers = (_header(names, networks) for names in (PLAIN_PLANNERS, OURS))
    tables = [
        Table(header, rows) for header, rows in zip(headers, (plain, _frames(rounds, OURS, networks)), strict=True)
    ]
    return Sections(list(zip(("The paper's methods, plain Python", "Ours"), tables, strict=True)))


def _header(names: Sequence[str], networks: Networks) -> tuple[str, ...]:
    named = [
        f"{label(name)}, network {asked}" if (asked := network_of(name, networks)) else label(name) for name in names
    ]
    return ("frame", *(f"{name}: {what}" for name in named for what in ("AT", "CC")))


def _frames(rounds: Sequence[Round], names: Sequence[str], networks: Networks) -> list[Row]:
    """A line for each frame, one for all, and one for how often each planner mended."""
    rows: list[Row] = [(frame(at), *_pairs([answered], names)) for at, answered in enumerate(rounds)]
    rows.append(("all", *_pairs(rounds, names)))
    rows.append(("mended", *(part for name in names for part in (mended(rounds[1:], name), None))))
    return rows


def _papers_columns() -> list[Sequence[tuple[float, float]]]:
    return [paper.TABLE_3[name] for name in ("A*", "A*NN", "D*", "D*NN")]


def _of_paper(line: Sequence[Sequence[float]]) -> list[str | None]:
    """The paper's figures under our columns."""
    astar, astar_nn, dstar, dstar_nn = ([seconds(time_s), f"{cc:.2f}"] for time_s, cc in line)
    return [*astar, *astar_nn, None, None, *dstar, *dstar_nn, None, None]


def _pairs(rounds: Sequence[Round], names: Sequence[str]) -> list[str]:
    out = []
    for name in names:
        of_it = means(rounds, name)
        out += [seconds(of_it.total_s), f"{of_it.total_cc:.2f}"]
    return out


def _total(name: str, figure: int) -> float:
    return math.fsum(line[figure] for line in paper.TABLE_3[name])


def findings(rounds: Sequence[Round]) -> Sequence[Finding]:
    plain, plain_nn, _ = PLAIN_ASTARS
    plain_dstar, plain_dstar_nn, _ = PLAIN_DSTARS
    found = []
    for claim, theirs, slow, fast in (
        ("speed-up of A*NN over A*, both plain", ("A*", "A*NN"), plain, plain_nn),
        ("speed-up of `nnpp` over our own exact A*", ("A*", "A*NN"), "astar", "nnpp"),
        ("speed-up of D* over A*, both plain", ("A*", "D*"), plain, plain_dstar),
        ("speed-up of D* over A*, both ours", ("A*", "D*"), "astar", "dstar"),
        ("speed-up of D*NN over D*, both plain", ("D*", "D*NN"), plain_dstar, plain_dstar_nn),
        ("speed-up of D*NN over D*, both ours", ("D*", "D*NN"), "dstar", "nnpp-dstar"),
    ):
        gain, controls = _total(theirs[0], 0) / _total(theirs[1], 0), _control(rounds, slow, fast)
        found.append(judge_ratio(claim, gain, speedup(rounds, slow, fast), controls=controls))
    for name, theirs_name in ((plain_nn, "A*NN"), (plain_dstar_nn, "D*NN"), ("nnpp-dstar", "D*NN")):
        increase = _total(theirs_name, 1) / _total("A*", 1) - 1.0
        own, control = (means(rounds, each).cc_increase for each in (name, CONTROL_OF[name]))
        claim = f"CC increase of {theirs_name} ({label(name)})"
        found.append(judge_increase(claim, increase, own, controls={CORRIDOR: control}))
    theirs_s = [paper.TABLE_3[name][-1][0] for name in ("D*NN", "D*")]
    nn_s, dstar_s = ours_s = [means(rounds[-1:], name).total_s for name in (plain_dstar_nn, plain_dstar)]
    claim = "near the goal, in the last frame, D*NN takes longer than D*"
    rule = f"{plain_dstar_nn} takes longer than {plain_dstar}"
    paper_s, own_s = (" against ".join(map(seconds, pair)) for pair in (theirs_s, ours_s))
    found.append(judge(claim, paper_s, own_s, agrees=nn_s > dstar_s, rule=rule, better=nn_s <= dstar_s))
    return found


def _control(rounds: Sequence[Round], slow: str, fast: str) -> dict[str, float] | None:
    """What the same gains with a corridor in place of the network's region."""
    return {CORRIDOR: speedup(rounds, slow, CONTROL_OF[fast])} if fast in CONTROL_OF else None


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
