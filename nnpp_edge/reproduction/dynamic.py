"""Tables 3 and 4, Fig. 16: episodes on a map that changes, for plain A* and A*NN, and our dynamic
planners.
"""

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import islice

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.episode import STRIDE, Episode, Step, make_episode
from nnpp_edge.reproduction.experiment import MAPS_TRIED, Context, Result, experiment
from nnpp_edge.reproduction.findings import Finding, judge, judge_increase, judge_speedup
from nnpp_edge.reproduction.paper import ASTAR, ASTAR_NN, DSTAR, DSTAR_NN, DYNAMIC, STATIC
from nnpp_edge.reproduction.planners import PLAIN, PLAIN_CONTROLS, PLAIN_NN, OneMap, shown
from nnpp_edge.reproduction.regions import CORRIDOR, Networks
from nnpp_edge.reproduction.rows import Row, Rows, seconds
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import Plan, Source
from nnpp_edge.viz.figures import new_figure

COMPILED = ("astar", "nnpp", "dstar", "nnpp-dstar", "corridor", "corridor-dstar")
PLAIN_ASTARS = (PLAIN, PLAIN_NN, PLAIN_CONTROLS[CORRIDOR])
PLANNERS = (*PLAIN_ASTARS, *COMPILED)
LEAST_DISTANCE = 0.7
"""Between start and goal, as a share of the map's side: four plans or more at 256²."""
PLAIN_OF = {ASTAR: PLAIN, ASTAR_NN: PLAIN_NN}
OURS_OF = {ASTAR: "astar", ASTAR_NN: "nnpp", DSTAR: "dstar", DSTAR_NN: "nnpp-dstar"}
"""For each of the paper's methods ours."""
_COMPARED = [(ASTAR, ASTAR_NN, STATIC), (ASTAR, ASTAR_NN, DYNAMIC), (ASTAR, DSTAR, DYNAMIC)]
_COMPARED += [(DSTAR, DSTAR_NN, DYNAMIC), (ASTAR_NN, DSTAR_NN, DYNAMIC)]
"""The paper's methods whose times are compared in Table 4, and in which scene."""


def stride_on(size: int) -> int:
    """Cells that the robot walks between two plans: the paper's 45 at 256² and more, fewer on
    smaller maps.
    """
    return min(STRIDE, max(STRIDE * size // 256, 1))


def find_episodes(context: Context, size: int, count: int) -> list[Episode]:
    """So many episodes on crops of the terrain; InvalidQueryError if too few have a way."""
    found = list[Episode]()
    for at, case in enumerate(islice(context.cases(size, LEAST_DISTANCE), MAPS_TRIED * count)):
        with suppress(InvalidQueryError):
            found.append(
                make_episode(case.cost, *case.queries[0], context.seed + at, stride_on(size))
            )
        if len(found) == count:
            return found
    raise InvalidQueryError(
        f"wanted {count} maps of {size} × {size} cells with a path, got {len(found)}"
    )


def drive(episode: Episode, networks: Networks, repeats: int) -> Rows:
    """Have all of `PLANNERS` make every plan of an episode; of ours the median of `repeats` lives
    counts.
    """
    harness = Harness()
    rows = Rows()
    for at, (step, compiled) in enumerate(
        zip(episode.steps, _ours(episode, networks.ours, repeats), strict=True)
    ):
        here = OneMap(episode.map_at(at), (step.start, episode.goal), networks)
        rows += [{"plan": at, **row} for row in (*here.timed(PLAIN_ASTARS, 1, harness), *compiled)]
    return rows


def _ours(episode: Episode, model: NetworkModel, repeats: int) -> Iterator[list[Row]]:
    """Rows of `COMPILED` for each plan. New planners go through the episode `repeats` times, after
    once untimed.

    A plan's time is the map's update, the network's view of it, and the plan with every widening
    and fallback. What depends on the first map alone is made before the clock starts.
    """
    lives = []
    for turn in range(repeats + 1):
        planners = {
            name: DynamicPlanner(episode.cost, episode.goal, name, model=model) for name in COMPILED
        }
        for planner in planners.values():
            planner.prepare()
        calls = {name: partial(_replan, planner) for name, planner in planners.items()}
        lives.append(list(Harness(turn).measure(calls, episode.steps)))
    for at, answers in enumerate(zip(*lives, strict=True)):
        exact_cc = answers[-1]["astar"].results[0].traverse_cost
        rows = list[Row]()
        for name in COMPILED:
            plan = answers[-1][name].results[0]
            time_s = np.median([life[name].median_s for life in answers[1:]])
            mended = name.endswith("dstar") and at > 0
            row = {
                "planner": name,
                "found": float(plan.source in (Source.MAP, Source.REGION)),
                "time_s": time_s,
            }
            of_path = {"cc": plan.traverse_cost, "exact_cc": exact_cc} if plan.ok else {}
            rows.append(row | of_path | {"mended": float(mended)})
        yield rows


def _replan(planner: DynamicPlanner, step: Step) -> Plan:
    for patch in step.patches:
        planner.update(*patch)
    planner.move(step.start)
    return planner.replan()


_QUICK = {"size": 128, "repeats": 1}


@experiment(
    "Table 3 and Fig. 16",
    "Planning anew as the map changes, plan by plan",
    {**_QUICK, "episodes": 3},
)
def table3(context: Context, *, size: int = 256, episodes: int = 12, repeats: int = 5) -> Result:
    """One episode, every plan of it by all planners: of so many the one with as many plans as the
    paper's.
    """
    size = context.one_size(size)
    frames = len(paper.TABLE_3.of(ASTAR))
    episode = min(
        find_episodes(context, size, episodes), key=lambda each: abs(len(each.steps) - frames)
    )
    context.progress(0.2)
    rows = drive(episode, context.networks, repeats)
    context.progress(0.6)
    views = [
        drawing.view_plan(
            episode.map_at(at), (step.start, episode.goal), context.networks.paper, step.patches
        )
        for at, step in enumerate(episode.steps)
    ]
    figure = new_figure(2.7 * len(views), 3.4)
    panels = figure.subplots(1, len(views), squeeze=False)[0]
    for at, (axes, view) in enumerate(zip(panels, views, strict=True)):
        drawing.draw_view(axes, view, drawing.frame(at), before=views[at - 1] if at else None)
    drawing.map_legend(figure, panels[min(1, len(views) - 1)])
    return Result(rows, ("plan", "planner"), table3_findings(rows), figure, [*paper.TABLE_3, *rows])


def table3_findings(rows: Rows) -> list[Finding]:
    """Of the rows of one episode, beside the paper's table."""
    found = list[Finding]()
    for slow, fast in ((ASTAR, ASTAR_NN), (ASTAR, DSTAR), (DSTAR, DSTAR_NN)):
        found += _speedups(slow, fast, paper.TABLE_3.speedup(slow, fast), rows)
    for theirs, name in ((ASTAR_NN, PLAIN_NN), (DSTAR_NN, "nnpp-dstar")):
        claim = f"CC increase of {_short(theirs)} ({shown('planner', name)})"
        found.append(judge_increase(claim, paper.TABLE_3.increase(theirs), rows, name))
    last = rows.of(plan=max(rows.all("plan")))
    nn_s, dstar_s = (last.of(name).mean("time_s") for name in ("nnpp-dstar", "dstar"))
    theirs_s = (
        seconds(paper.TABLE_3.of(name, plan=3).mean("time_s")) for name in (DSTAR_NN, DSTAR)
    )
    ours = f"{seconds(nn_s)} against {seconds(dstar_s)}"
    rule = "`nnpp-dstar` takes longer"
    claim = "near the goal, in the last frame, D*NN takes longer than D*"
    return [
        *found,
        judge(claim, " against ".join(theirs_s), ours, rule, True, better=nn_s <= dstar_s),
    ]


def _short(theirs: str) -> str:
    return theirs.removeprefix("paper's ")


def _speedups(
    slow: str, fast: str, theirs: float, rows: Rows, where: str = ""
) -> Iterator[Finding]:
    """One of the paper's methods over another, plain where we have both so, and compiled."""
    for label, of in {"plain": PLAIN_OF, "ours": OURS_OF}.items():
        if slow in of and fast in of:
            claim = f"speed-up of {_short(fast)} over {_short(slow)}{where}, both {label}"
            yield judge_speedup(claim, theirs, rows, (of[slow], of[fast]))


@experiment("Table 4", "Five maps, standing still and changing", {**_QUICK, "maps": 2})
def table4(context: Context, *, size: int = 256, maps: int = 5, repeats: int = 5) -> Result:
    """An episode on each of some maps, by all planners; its first plan is that of the map standing
    still.
    """
    rows = Rows()
    for at, episode in enumerate(find_episodes(context, context.one_size(size), maps), 1):
        rows += [
            {"scene": DYNAMIC, "map": at, **row}
            for row in drive(episode, context.networks, repeats)
        ]
        context.progress(at / maps)
    rows = Rows([{**row, "scene": STATIC} for row in rows.of(plan=0)] + rows)
    everything = Rows([*paper.TABLE_4, *rows])
    context.notes.append(
        "Times and CC are summed over the plans for which every method found a path."
    )
    picture = drawing.bars({str(scene): of for (scene,), of in everything.by("scene").items()})
    return Result(
        rows, ("scene", "planner"), table4_findings(rows), picture, everything, totals=True
    )


def table4_findings(rows: Rows) -> list[Finding]:
    """Of the rows of all scenes, beside the paper's table."""
    found = list[Finding]()
    for slow, fast, scene in _COMPARED:
        theirs = paper.TABLE_4.of(scene=scene).speedup(slow, fast)
        found += _speedups(slow, fast, theirs, rows.of(scene=scene), f", {scene}")
    of = rows.of(scene=DYNAMIC)
    slow = OURS_OF[DSTAR]
    fast = OURS_OF[ASTAR_NN]
    claim = "the network gains A* more than D* does: A*NN is faster than D*, dynamic, both ours"
    theirs = paper.TABLE_4.of(scene=DYNAMIC).speedup(DSTAR, ASTAR_NN)
    texts = f"{theirs:.2f}×", f"{of.speedup(slow, fast):.2f}×"
    rule = f"{shown('planner', fast)} takes less time than {shown('planner', slow)}"
    found.append(
        judge(claim, *texts, rule, lambda own: of.speedup(own(slow), own(fast)) > 1.0, of, fast)
    )
    for what, method, name, scene in (
        ("A*NN, static, plain", ASTAR_NN, PLAIN_NN, STATIC),
        ("A*NN, dynamic, plain", ASTAR_NN, PLAIN_NN, DYNAMIC),
        ("D*NN, dynamic, ours", DSTAR_NN, "nnpp-dstar", DYNAMIC),
    ):
        more = paper.TABLE_4.of(scene=scene).increase(method)
        found.append(judge_increase(f"CC increase of {what}", more, rows.of(scene=scene), name))
    later = Rows(row for row in of if row["plan"])
    return [*found, _mends(later, OURS_OF[ASTAR_NN], OURS_OF[DSTAR_NN])] if later else found


def _mends(later: Rows, afresh: str, name: str) -> Finding:
    """Whether D*NN repairs, and gains by it over A*NN, which searches afresh."""
    mended = later.of(name).all("mended")
    gain = later.speedup(afresh, name)
    claim = f"D*NN repairs, and gains by it, dynamic ({shown('planner', name)})"
    ours = (
        f"{sum(mended):.0f} of {len(mended)} plans after the first, {gain:.2f}× as fast as afresh"
    )
    rule = "on half of the plans or more, and faster than afresh"
    often = sum(mended) >= 0.5 * len(mended)
    return judge(
        claim,
        "yes",
        ours,
        rule,
        lambda own: often and later.speedup(own(afresh), own(name)) > 1.0,
        later,
        name,
    )
