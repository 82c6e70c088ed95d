"""Table 4: five maps, each standing still and changing: anywhere as in the paper, and near the robot alone."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import PLAIN, PLAIN_NN, Round, answers_table, means
from nnpp_edge.reproduction.dynamic_contest import (
    CONTROL_OF,
    CONTROLS_NOTE,
    NEAR_STRIDE,
    PLAIN_DSTAR,
    PLAIN_DSTAR_NN,
    PLANNERS,
    TIMES_NOTE,
    Drive,
    drive,
    find_episodes,
    label,
    mended,
    network_of,
    speedup,
    stride_on,
)
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import COLOURS, OURS, PAPER, new_figure, png, tidy
from nnpp_edge.reproduction.regions import CORRIDOR, Networks
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
    optional,
    percent,
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
class Scenes:
    """The drives of both scenes, on the same maps."""

    anywhere: Sequence[Drive]
    """The paper's scene: rectangles appear anywhere on the way."""
    near: Sequence[Drive]
    """The same where the map changes near the robot alone."""

    def rounds(self, scene: str) -> list[Round]:
        """All plans of ``static`` (the first ones), ``dynamic`` or ``near the robot``."""
        drives = self.near if scene == NEAR else self.anywhere
        return [each for one in drives for each in (one.rounds[:1] if scene == STATIC else one.rounds)]

    def later(self, scene: str) -> list[Round]:
        """The plans of a scene that are not an episode's first."""
        drives = self.near if scene == NEAR else self.anywhere
        return [each for one in drives for each in one.rounds[1:]]


STATIC, DYNAMIC, NEAR = "static", "dynamic", "near the robot"


@dataclass(frozen=True)
class _Comparison:
    """Two methods' summed times, plain and compiled."""

    label: str
    paper: float
    scene: str
    plain: tuple[str, str]
    compiled: tuple[str, str]


def _mean_of(rows: Iterable[paper.Static], figure: str) -> float:
    values = [getattr(row, figure) for row in rows]
    return float(sum(values)) / len(values)


def _ratio(rows: Iterable[paper.Static], above: str, below: str) -> float:
    rows = list(rows)
    return _mean_of(rows, above) / _mean_of(rows, below)


_S, _D = list(paper.TABLE_4_STATIC.values()), list(paper.TABLE_4_DYNAMIC.values())
_PLAIN_PAIR, _OURS_PAIR = (PLAIN, PLAIN_NN), ("astar", "nnpp")
_DSTARS = (PLAIN_DSTAR, PLAIN_DSTAR_NN), ("dstar", "nnpp-dstar")
_FRESH = (PLAIN_NN, PLAIN_DSTAR_NN), ("nnpp", "nnpp-dstar")
_D_OVER_D = _ratio(_D, "dstar_s", "dstar_nn_s")
_COMPARISONS = (
    _Comparison("A*NN over A*, static", _ratio(_S, "astar_s", "nn_s"), STATIC, _PLAIN_PAIR, _OURS_PAIR),
    _Comparison("A*NN over A*, dynamic", _ratio(_D, "astar_s", "nn_s"), DYNAMIC, _PLAIN_PAIR, _OURS_PAIR),
    _Comparison(
        "D* over A*, dynamic", _ratio(_D, "astar_s", "dstar_s"), DYNAMIC, (PLAIN, PLAIN_DSTAR), ("astar", "dstar")
    ),
    _Comparison("D*NN over D*, dynamic", _D_OVER_D, DYNAMIC, *_DSTARS),
    _Comparison("D*NN over A*NN, dynamic", _ratio(_D, "nn_s", "dstar_nn_s"), DYNAMIC, *_FRESH),
    _Comparison("D*NN over D*, near the robot", _D_OVER_D, NEAR, *_DSTARS),
    _Comparison("D*NN over A*NN, near the robot", _ratio(_D, "nn_s", "dstar_nn_s"), NEAR, *_FRESH),
)


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """Two episodes on each of some maps, by all planners: changes anywhere, and near the robot."""
    size, notes = context.one_size(settings.size)
    drives: tuple[list[Drive], list[Drive]] = ([], [])
    for of_scene, near in zip(drives, (False, True), strict=True):
        for episode in find_episodes(context, size, settings.maps, near=near):
            of_scene.append(drive(episode, context.networks, settings.repeats))
            progress(sum(map(len, drives)) / (2 * settings.maps))
    scenes = Scenes(*drives)
    plans = " and ".join(", ".join(str(len(each.rounds)) for each in of_scene) for of_scene in drives)
    notes.append(TIMES_NOTE)
    notes.append(
        f"Maps of {size}². -s is an episode's first plan; -d all its plans, one every {stride_on(size)} cells, in "
        f"the paper's scene, where rectangles appear anywhere on the way; -n all plans, one every {NEAR_STRIDE} "
        f"cells, where smaller rectangles appear near the robot alone. Plans: {plans}. *Mended* counts the plans "
        "after an episode's first for which a search from before was mended rather than made afresh."
    )
    notes.append(
        "CC of an episode is the sum over its plans, each of the path from the robot to the goal, as Table 3 adds "
        "it up; the paper does not say what its Table 4 adds up (its CC grows less from -s to -d than in its Table"
        " 3), so only shares are compared."
    )
    about = About(
        context.networks.named,
        f"{settings.maps} maps, an episode of each scene on each; ours the median of {settings.repeats} lives",
        CONTROLS_NOTE,
    )
    answered = (
        ((scene, at, n), query, of)
        for scene, of_scene in zip((DYNAMIC, NEAR), drives, strict=True)
        for at, each in enumerate(of_scene, 1)
        for n, query, of in each.answered()
    )
    data = answers_table("scene | map | plan", answered)
    summed = summary(scenes, context.networks)
    return Result(about, summed, data, findings(scenes), _picture(scenes), notes)


def summary(scenes: Scenes, networks: Networks) -> Sections:
    """The paper's methods map by map, ours map by map, and all of them summed over the maps."""
    parts = []
    for heading, names, theirs in (
        ("The paper's methods, plain Python", (PLAIN, PLAIN_NN, PLAIN_DSTAR, PLAIN_DSTAR_NN), True),
        ("Ours", ("astar", "nnpp", "dstar", "nnpp-dstar"), False),
    ):
        rows = []
        for letter, drives in (("s", scenes.anywhere), ("d", scenes.anywhere), ("n", scenes.near)):
            for at, each in enumerate(drives, 1):
                rows.append(
                    _line(f"map{at}-{letter}", each.rounds[:1] if letter == "s" else each.rounds, names, networks)
                )
        if theirs:
            rows += [_paper_row(f"paper's {name}-s", row) for name, row in paper.TABLE_4_STATIC.items()]
            rows += [_paper_row(f"paper's {name}-d", row) for name, row in paper.TABLE_4_DYNAMIC.items()]
        parts.append((heading, Table(columns(_HEADER), rows)))
    return Sections([*parts, ("All methods, summed over the maps", _sums(scenes, networks))])


_HEADER = (
    "scenario | network | A*: AT | A*NN: AT | D*: AT | D*NN: AT | A*NN over A* | D*NN over D* | CC of A* | CC of "
    "A*NN | CC of D*NN | MM of A*NN | D*NN mended"
)


def _line(label: str, rounds: Sequence[Round], names: Sequence[str], networks: Networks) -> Row:
    """An episode by four methods: A*, A*NN, D*, D*NN."""
    astar, nn, dstar, dstar_nn = of = [means(rounds, name) for name in names]
    gains = times(astar.total_s, nn.total_s), times(dstar.total_s, dstar_nn.total_s)
    ccs = (f"{each.total_cc:.2f}" for each in (astar, nn, dstar_nn))
    done = mended(rounds[1:], names[3]) if len(rounds) > 1 else None
    ats = (seconds(each.total_s) for each in of)
    return (label, network_of(names[1], networks), *ats, *gains, *ccs, optional(nn.mm, ".3f"), done)


def _sums(scenes: Scenes, networks: Networks) -> Table:
    header = columns(
        "scene | method | network | plans | AT, summed | over A* of its kind | found | CC increase | mended"
    )
    rows: list[Row] = []
    for scene in (STATIC, DYNAMIC, NEAR):
        rounds = scenes.rounds(scene)
        for name in PLANNERS:
            m, slow = means(rounds, name), PLAIN if name.startswith("plain") else "astar"
            gain = times(means(rounds, slow).total_s, m.total_s)
            done = None if scene == STATIC else mended(scenes.later(scene), name)
            quality = (percent(m.success), percent(m.cc_increase, 2), done)
            rows.append(
                (scene, label(name), network_of(name, networks), len(rounds), seconds(m.total_s), gain, *quality)
            )
    return Table(header, rows)


def _paper_row(label: str, row: paper.Static) -> Row:
    moving = row if isinstance(row, paper.Dynamic) else None
    return (
        *(label, "the paper's", seconds(row.astar_s), seconds(row.nn_s)),
        *((seconds(moving.dstar_s), seconds(moving.dstar_nn_s)) if moving else (None, None)),
        *(times(row.astar_s, row.nn_s), times(moving.dstar_s, moving.dstar_nn_s) if moving else None),
        *(f"{row.astar_cc:.2f}", f"{row.nn_cc:.2f}", f"{moving.dstar_nn_cc:.2f}" if moving else None),
        *(f"{row.nn_mm:.2f}", None),
    )


def findings(scenes: Scenes) -> Sequence[Finding]:
    found = []
    for each in _COMPARISONS:
        rounds = scenes.rounds(each.scene)
        for (slow, fast), kind in ((each.plain, "plain"), (each.compiled, "ours")):
            control, controls = CONTROL_OF.get(fast), None
            if control is not None:
                controls = {CORRIDOR: speedup(rounds, CONTROL_OF.get(slow, slow), control)}
            claim, gain = f"speed-up of {each.label}, both {kind}", speedup(rounds, slow, fast)
            found.append(judge_ratio(claim, each.paper, gain, controls=controls))
    for (slow, fast), kind in (((PLAIN_DSTAR, PLAIN_NN), "plain"), (("dstar", "nnpp"), "ours")):
        rounds = scenes.rounds(DYNAMIC)
        theirs, ours = _ratio(_D, "dstar_s", "nn_s"), speedup(rounds, slow, fast)
        claim = f"the network gains A* more than D* does: A*NN is sooner done than D*, dynamic, both {kind}"
        as_well = {CORRIDOR: speedup(rounds, slow, CONTROL_OF[fast]) > 1.0}
        rule, texts = f"{label(fast)} takes less time than {label(slow)}", (f"{theirs:.2f}×", f"{ours:.2f}×")
        found.append(judge(claim, *texts, agrees=ours > 1.0, rule=rule, controls=as_well))
    for what, name, scene, gain in (
        ("A*NN, static, plain", PLAIN_NN, STATIC, _ratio(_S, "nn_cc", "astar_cc")),
        ("A*NN, dynamic, plain", PLAIN_NN, DYNAMIC, _ratio(_D, "nn_cc", "astar_cc")),
        ("D*NN, dynamic, plain", PLAIN_DSTAR_NN, DYNAMIC, _ratio(_D, "dstar_nn_cc", "astar_cc")),
        ("D*NN, dynamic, ours", "nnpp-dstar", DYNAMIC, _ratio(_D, "dstar_nn_cc", "astar_cc")),
    ):
        own, corridor = (means(scenes.rounds(scene), each).cc_increase for each in (name, CONTROL_OF[name]))
        found.append(judge_increase(f"CC increase of {what}", gain - 1.0, own, controls={CORRIDOR: corridor}))
    for scene in (DYNAMIC, NEAR):
        if later := scenes.later(scene):
            found += [_mends(later, scene, name) for name in (PLAIN_DSTAR_NN, "nnpp-dstar")]
    return found


def _mends(later: Sequence[Round], scene: str, name: str) -> Finding:
    """Whether D*NN mends, and gains by it over A*NN, which searches afresh."""
    afresh = PLAIN_NN if name == PLAIN_DSTAR_NN else "nnpp"
    gain, control = speedup(later, afresh, name), speedup(later, CONTROL_OF[afresh], CONTROL_OF[name])
    often = sum(each.answers[name].mended for each in later) >= 0.5 * len(later)
    ours = f"{mended(later, name)} plans after the first, {gain:.2f}× as fast as afresh"
    claim = f"D*NN mends, and gains by it, {scene} ({label(name)})"
    rule, as_well = "on half of the plans or more, and faster than afresh", {CORRIDOR: control > 1.0}
    return judge(claim, "yes", ours, agrees=often and gain > 1.0, rule=rule, controls=as_well)


def _picture(scenes: Scenes) -> bytes:
    figure = new_figure(12.0, 4.6)
    axes = figure.subplots()
    width, gap = 0.26, 0.28
    for at, each in enumerate(_COMPARISONS):
        rounds, drives = scenes.rounds(each.scene), scenes.near if each.scene == NEAR else scenes.anywhere
        bars: list[tuple[int, float, str, list[float]]] = [(0, each.paper, PAPER, [])]
        for place, pair, colour in ((1, each.plain, COLOURS[PLAIN]), (2, each.compiled, OURS)):
            of_maps = [speedup(one.rounds[:1] if each.scene == STATIC else one.rounds, *pair) for one in drives]
            bars.append((place, speedup(rounds, *pair), colour, of_maps))
        for place, height, colour, of_maps in bars:
            x = at + (place - 1) * gap
            axes.bar(x, height, width, color=colour)
            axes.plot([x] * len(of_maps), of_maps, ".", color="black", markersize=4)
            above = (x, max([height, *of_maps]))
            axes.annotate(f"{height:.2f}", above, (0, 3), textcoords="offset points", ha="center", fontsize="small")
    for kind, colour in (("paper", PAPER), ("ours, plain Python", COLOURS[PLAIN]), ("ours, compiled", OURS)):
        axes.fill_between([], [], color=colour, label=kind)
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
