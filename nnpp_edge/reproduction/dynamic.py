"""Tables 3 and 4, Fig. 16: episodes on a map that changes, for the paper's plain methods and our dynamic planners."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.drawing import frame
from nnpp_edge.reproduction.episode import LEAST_DISTANCE, STRIDE, Episode, Step, episodes_of
from nnpp_edge.reproduction.experiment import MAPS_TRIED, Context, Result, experiment
from nnpp_edge.reproduction.findings import Finding, judge, judge_increase, judge_speedup
from nnpp_edge.reproduction.paper import ASTAR, ASTAR_NN, DSTAR, DSTAR_NN, DYNAMIC, NEAR, STATIC
from nnpp_edge.reproduction.plain_dstar import PlainDStar
from nnpp_edge.reproduction.planners import (
    CONTROLS_OF,
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_DSTAR,
    PLAIN_DSTAR_CORRIDOR,
    PLAIN_DSTAR_NN,
    PLAIN_NN,
    OneMap,
    planner_table,
    shown,
)
from nnpp_edge.reproduction.regions import CORRIDOR, NETWORK, Networks, corridor_region
from nnpp_edge.reproduction.rows import Columns, Groups, Row, Rows, number, seconds, table
from nnpp_edge.runtime.cells import Cell, Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import Plan, Source

COMPILED = ("astar", "nnpp", "dstar", "nnpp-dstar", "corridor", "corridor-dstar")
PLAIN_ASTARS = (PLAIN, PLAIN_NN, PLAIN_CONTROLS[CORRIDOR])
PLAIN_DSTARS = (PLAIN_DSTAR, PLAIN_DSTAR_NN, PLAIN_DSTAR_CORRIDOR)
PLAIN_PLANNERS = (*PLAIN_ASTARS, *PLAIN_DSTARS)
PLANNERS = (*PLAIN_PLANNERS, *COMPILED)
NEAR_STRIDE = 5
"""Cells that the robot walks between two plans where the map changes near it."""
OURS_OF = {ASTAR: (PLAIN, "astar"), ASTAR_NN: (PLAIN_NN, "nnpp"), DSTAR: (PLAIN_DSTAR, "dstar")}
OURS_OF |= {DSTAR_NN: (PLAIN_DSTAR_NN, "nnpp-dstar")}
"""For each of the paper's methods ours: plain and compiled."""
_CONTROLS_NOTE = (
    "a *corridor* in place of the network's region: for the plain methods the blocks nearest to the path over the "
    "map averaged to blocks, as many as the network's region; for ours `corridor` and `corridor-dstar`"
)


def stride_on(size: int) -> int:
    """Cells that the robot walks between two plans: the paper's 45 at 256² and more, fewer on smaller maps."""
    return min(STRIDE, max(STRIDE * size // 256, 1))


def find_episodes(context: Context, size: int, count: int, *, near: bool = False) -> list[Episode]:
    """So many episodes on crops of the terrain: the paper's scene, or the one whose changes stay near the robot.

    InvalidQueryError if too few have a way.
    """
    cases = islice(context.cases(size, LEAST_DISTANCE), MAPS_TRIED * count)
    stride = NEAR_STRIDE if near else stride_on(size)
    found = list(islice(episodes_of(cases, context.seed, stride, near=near), count))
    if len(found) < count:
        raise InvalidQueryError(f"wanted {count} maps of {size} × {size} cells with a path, got {len(found)}")
    return found


def drive(episode: Episode, networks: Networks, repeats: int) -> Rows:
    """Have all of `PLANNERS` make every plan of an episode; of ours the median of `repeats` lives counts."""
    harness, rows, dstars = Harness(), Rows(), dict[str, PlainDStar]()
    for at, (step, compiled) in enumerate(zip(episode.steps, _ours(episode, networks.ours, repeats), strict=True)):
        here = OneMap(episode.map_at(at), (step.start, episode.goal), networks)
        found = [*here.timed(PLAIN_ASTARS, 1, harness), *_repaired(here, dstars, harness), *compiled]
        rows += [{"plan": at, **row} for row in found]
    return rows


def _ours(episode: Episode, model: NetworkModel, repeats: int) -> Iterator[list[Row]]:
    """Rows of `COMPILED` for each plan. New planners go through the episode `repeats` times, after once untimed.

    A plan's time is the map's update, the network's view of it, and the plan with every widening and fallback. What
    depends on the first map alone is made before the clock starts.
    """
    lives = []
    for turn in range(repeats + 1):
        planners = {name: DynamicPlanner(episode.cost, episode.goal, name, model=model) for name in COMPILED}
        for planner in planners.values():
            planner.prepare()
        calls = {name: partial(_replan, planner) for name, planner in planners.items()}
        lives.append(list(Harness(turn).measure(calls, episode.steps)))
    for at, answers in enumerate(zip(*lives, strict=True)):
        exact_cc, rows = answers[-1]["astar"].results[0].traverse_cost, list[Row]()
        for name in COMPILED:
            plan, time_s = answers[-1][name].results[0], np.median([life[name].median_s for life in answers[1:]])
            mended = plan.choice.startswith("mended") or (name == "dstar" and at > 0)
            row = {"planner": name, "found": float(plan.source in (Source.MAP, Source.REGION)), "time_s": time_s}
            of_path = {"cc": plan.traverse_cost, "exact_cc": exact_cc} if plan.ok else {}
            rows.append(row | of_path | {"mended": float(mended)})
        yield rows


def _replan(planner: DynamicPlanner, step: Step) -> Plan:
    for patch in step.patches:
        planner.update(*patch)
    planner.move(step.start)
    return planner.replan()


def _repaired(here: OneMap, dstars: dict[str, PlainDStar], harness: Harness) -> list[Row]:
    """The next answers of the plain D* Lite searches, which are kept in `dstars`."""
    rows, (start, goal) = [], here.query
    for name, make in {
        PLAIN_DSTAR: None,
        PLAIN_DSTAR_NN: here.maker.find,
        PLAIN_DSTAR_CORRIDOR: partial(corridor_region, here.grid, like=here.regions[NETWORK]),
    }.items():
        begins = name not in dstars

        def plan(name: str = name, make: Callable[[Endpoints], Region] | None = make) -> list[Cell] | None:
            inside = None if make is None else make(here.query).mask()
            if name not in dstars:
                dstars[name] = PlainDStar(here.cost, start, goal, inside)
            else:
                dstars[name].change(here.cost, inside)
                dstars[name].move(start)
            return dstars[name].plan()

        time_s, path = harness.timed(plan)
        row = here.row(name, np.array(path or [], np.int32).reshape(-1, 2))
        rows.append(row | {"time_s": time_s, "mended": float(not begins)})
    return rows


@experiment(
    "Table 3 and Fig. 16",
    "Planning anew as the map changes, plan by plan",
    {"size": 128, "repeats": 1, "episodes": 3},
)
def table3(context: Context, *, size: int = 256, episodes: int = 12, repeats: int = 5) -> Result:
    """One episode, every plan of it by all planners: of so many the one with as many plans as the paper's."""
    size = context.one_size(size)
    stride, frames = stride_on(size), len(paper.TABLE_3.of(ASTAR))
    episode = min(find_episodes(context, size, episodes), key=lambda each: abs(len(each.steps) - frames))
    context.progress(0.2)
    rows = drive(episode, context.networks, repeats)
    context.progress(0.6)
    views = drawing.view_episode(episode, context.networks.paper)
    groups = {(frame(int(at)),): of for (at,), of in rows.by("plan").items()} | {("all",): rows}
    theirs = {(f"paper's {frame(int(at))}",): of for (at,), of in paper.TABLE_3.by("plan").items()}
    summary = f"""{_side_by_side("frame", groups, theirs | {("paper's, all",): paper.TABLE_3})}
### Mended

{table("planner", {(shown(str(name)),): of for (name,), of in rows.by("planner").items()}, {"plans": _mended})}"""
    figure = drawing.new_figure(2.7 * (len(views) + 1), 3.4)
    *panels, last = figure.subplots(1, len(views) + 1)
    for at, (axes, view) in enumerate(zip(panels, views, strict=True)):
        drawing.draw_view(axes, view, frame(at), before=views[at - 1] if at else None)
    drawing.draw_map(last, views[-1].cost, "the way driven")
    drawing.draw_path(last, drawing.driven(views, stride), "driven")
    drawing.map_legend(figure, panels[min(1, len(views) - 1)])
    return Result(summary, rows, table3_findings(rows), figure, controls=_CONTROLS_NOTE)


def _side_by_side(keys: str, ours: Groups, theirs: Groups) -> str:
    """Two tables, AT and CC of each planner: the plain ones with the paper's figures below, and ours."""
    names = {mine: (theirs, mine) for theirs, pair in OURS_OF.items() for mine in pair}
    plain, compiled = (
        {shown(each): partial(_time_and_cc, names.get(each, (each,))) for each in planners}
        for planners in (PLAIN_PLANNERS, COMPILED)
    )
    return f"""### The paper's methods, plain Python: AT, CC

{table(keys, {**ours, **theirs}, plain)}
### Ours: AT, CC

{table(keys, ours, compiled)}"""


def _time_and_cc(names: Sequence[str], rows: Rows) -> str:
    """Summed time and CC of these planners' answers."""
    of = rows.of(*names)
    return f"{seconds(sum(of.all('time_s')))}, {number(sum(of.all('cc')) or math.nan, '.2f')}" if of else "–"


def _later(rows: Rows) -> Rows:
    """The plans after an episode's first."""
    return Rows(row for row in rows if row["plan"])


def _mended(of: Rows) -> str:
    """On how many of the plans after an episode's first one planner mended what it knew."""
    return f"{sum(_later(of).all('mended')):.0f} of {len(_later(of))}"


def _short(theirs: str) -> str:
    return theirs.removeprefix("paper's ")


def table3_findings(rows: Rows) -> list[Finding]:
    """Of the rows of one episode, beside the paper's table."""
    found = list[Finding]()
    for slow, fast in ((ASTAR, ASTAR_NN), (ASTAR, DSTAR), (DSTAR, DSTAR_NN)):
        found += _speedups(slow, fast, paper.TABLE_3.speedup(slow, fast), rows)
    for theirs, name in ((ASTAR_NN, PLAIN_NN), (DSTAR_NN, PLAIN_DSTAR_NN), (DSTAR_NN, "nnpp-dstar")):
        claim = f"CC increase of {_short(theirs)} ({shown(name)})"
        found.append(judge_increase(claim, paper.TABLE_3.increase(theirs), rows, name))
    last = rows.of(plan=max(rows.all("plan")))
    nn_s, dstar_s = (last.of(name).mean("time_s") for name in (PLAIN_DSTAR_NN, PLAIN_DSTAR))
    theirs_s = (seconds(paper.TABLE_3.of(name, plan=3).mean("time_s")) for name in (DSTAR_NN, DSTAR))
    texts = " against ".join(theirs_s), f"{seconds(nn_s)} against {seconds(dstar_s)}"
    claim, longer = "near the goal, in the last frame, D*NN takes longer than D*", f"{PLAIN_DSTAR_NN} takes longer"
    return [*found, judge(claim, *texts, nn_s > dstar_s, longer, better=nn_s <= dstar_s)]


def _speedups(slow: str, fast: str, theirs: float, rows: Rows, where: str = "") -> Iterator[Finding]:
    """One of the paper's methods over another, plain and compiled."""
    for pair, label in zip(zip(OURS_OF[slow], OURS_OF[fast], strict=True), ("plain", "ours"), strict=True):
        claim = f"speed-up of {_short(fast)} over {_short(slow)}{where}, both {label}"
        yield judge_speedup(claim, theirs, rows, pair)


_COMPARED = [(ASTAR, ASTAR_NN, STATIC), (ASTAR, ASTAR_NN, DYNAMIC), (ASTAR, DSTAR, DYNAMIC)]
_COMPARED += [(slow, DSTAR_NN, scene) for scene in (DYNAMIC, NEAR) for slow in (DSTAR, ASTAR_NN)]
"""The paper's methods whose times are compared, and in which scene."""


@experiment("Table 4", "Five maps, standing still and changing", {"size": 128, "maps": 2, "repeats": 1})
def table4(context: Context, *, size: int = 256, maps: int = 5, repeats: int = 5) -> Result:
    """Two episodes on each of some maps, by all planners: changes anywhere, and near the robot."""
    size, rows = context.one_size(size), Rows()
    for near, scene in enumerate((DYNAMIC, NEAR)):
        for at, episode in enumerate(find_episodes(context, size, maps, near=bool(near)), 1):
            rows += [{"scene": scene, "map": at, **row} for row in drive(episode, context.networks, repeats)]
            context.progress((near * maps + at) / (2 * maps))
    rows = Rows([{**row, "scene": STATIC} for row in rows.of(scene=DYNAMIC, plan=0)] + rows)
    ours = {(f"map {at}", scene): of for (scene, at), of in rows.by("scene", "map").items()}
    theirs = {(f"paper's map {at}", scene): of for (scene, at), of in paper.TABLE_4.by("scene", "map").items()}
    more: Columns = {"plans": lambda of: str(len(of)), "mended": _mended}
    summary = f"""{_side_by_side("map | scene", ours, theirs)}
### All methods, summed over the maps

{planner_table(rows, "scene", "network | AT | over A* | success | CC increase | MM", context.networks, more)}"""
    figure = drawing.new_figure(12.0, 4.6)
    axes = figure.subplots()
    kinds = {"paper": drawing.PAPER, "ours, plain": drawing.PLAIN, "ours, compiled": drawing.OURS}
    for at, (label, colour) in enumerate(kinds.items(), -1):
        heights = [_gain(rows, slow, fast, scene, at) for slow, fast, scene in _COMPARED]
        drawn = axes.bar(np.arange(len(_COMPARED)) + 0.28 * at, heights, 0.26, color=colour, label=label)
        axes.bar_label(drawn, fmt="%.2f", fontsize="small")
    axes.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
    drawing.tidy(axes, "Speed-ups, of times summed over all maps and plans", "", "times as fast")
    names = [f"{_short(fast)} over {_short(slow)},\n{scene}" for slow, fast, scene in _COMPARED]
    axes.set_xticks(range(len(_COMPARED)), names)
    axes.set_yscale("log")
    axes.legend(frameon=False, fontsize="small")
    return Result(summary, rows, table4_findings(rows), figure, controls=_CONTROLS_NOTE)


def _gain(rows: Rows, slow: str, fast: str, scene: str, kind: int = -1) -> float:
    """Speed-up of one of the paper's methods over another in a scene: theirs (-1), our plain (0) or compiled ones."""
    if kind >= 0:
        return rows.of(scene=scene).speedup(OURS_OF[slow][kind], OURS_OF[fast][kind])
    return paper.TABLE_4.of(scene=DYNAMIC if scene == NEAR else scene).speedup(slow, fast)


def table4_findings(rows: Rows) -> list[Finding]:
    """Of the rows of all scenes, beside the paper's table."""
    found = list[Finding]()
    for slow, fast, scene in _COMPARED:
        found += _speedups(slow, fast, _gain(rows, slow, fast, scene), rows.of(scene=scene), f", {scene}")
    for kind, label in enumerate(("plain", "ours")):
        (slow, fast), of = (OURS_OF[DSTAR][kind], OURS_OF[ASTAR_NN][kind]), rows.of(scene=DYNAMIC)
        claim = f"the network gains A* more than D* does: A*NN is faster than D*, dynamic, both {label}"
        texts = f"{_gain(rows, DSTAR, ASTAR_NN, DYNAMIC):.2f}×", f"{of.speedup(slow, fast):.2f}×"
        as_well = {CORRIDOR: of.speedup(slow, CONTROLS_OF[fast][CORRIDOR]) > 1.0}
        rule = f"{shown(fast)} takes less time than {shown(slow)}"
        found.append(judge(claim, *texts, of.speedup(slow, fast) > 1.0, rule, as_well))
    for what, theirs, name, scene in (
        ("A*NN, static, plain", ASTAR_NN, PLAIN_NN, STATIC),
        ("A*NN, dynamic, plain", ASTAR_NN, PLAIN_NN, DYNAMIC),
        ("D*NN, dynamic, plain", DSTAR_NN, PLAIN_DSTAR_NN, DYNAMIC),
        ("D*NN, dynamic, ours", DSTAR_NN, "nnpp-dstar", DYNAMIC),
    ):
        more = paper.TABLE_4.of(scene=scene).increase(theirs)
        found.append(judge_increase(f"CC increase of {what}", more, rows.of(scene=scene), name))
    for scene in (DYNAMIC, NEAR):
        if later := _later(rows.of(scene=scene)):
            found += [_mends(later, scene, OURS_OF[ASTAR_NN][kind], OURS_OF[DSTAR_NN][kind]) for kind in (0, 1)]
    return found


def _mends(later: Rows, scene: str, afresh: str, name: str) -> Finding:
    """Whether D*NN mends, and gains by it over A*NN, which searches afresh."""
    gain, often = later.speedup(afresh, name), later.of(name).mean("mended") >= 0.5
    claim = f"D*NN mends, and gains by it, {scene} ({shown(name)})"
    ours = f"{_mended(later.of(name))} plans after the first, {gain:.2f}× as fast as afresh"
    as_well = {CORRIDOR: later.speedup(CONTROLS_OF[afresh][CORRIDOR], CONTROLS_OF[name][CORRIDOR]) > 1.0}
    rule = "on half of the plans or more, and faster than afresh"
    return judge(claim, "yes", ours, often and gain > 1.0, rule, as_well)
