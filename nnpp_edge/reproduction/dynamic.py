"""Tables 3 and 4, Fig. 16: episodes on a map that changes, for plain A* and A*NN, and our dynamic
planners.
"""

from collections.abc import Iterator
from functools import partial
from operator import methodcaller

import numpy as np

from nnpp_edge.profiling.contest import Harness
from nnpp_edge.profiling.rows import Rows
from nnpp_edge.reproduction import drawing, paper
from nnpp_edge.reproduction.episode import STRIDE, Episode, Step, make_episode
from nnpp_edge.reproduction.experiment import Context, Experiment
from nnpp_edge.reproduction.findings import (
    Figure,
    Finding,
    judge,
    judge_increase,
    judge_speedups,
    stated,
)
from nnpp_edge.reproduction.paper import ASTAR, ASTAR_NN, DSTAR, DSTAR_NN, DYNAMIC, STATIC
from nnpp_edge.reproduction.planners import PLAIN_KINDS, PLAIN_NN, WHOLE_MAP, OneMap
from nnpp_edge.reproduction.regions import CORRIDOR, NETWORK, NetworkPair
from nnpp_edge.reproduction.table import seconds
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import Plan

COMPILED = ("astar", "nnpp", "dstar", "nnpp-dstar", "corridor", "corridor-dstar")
KINDS = (WHOLE_MAP, NETWORK, CORRIDOR)
"""Of the regions that the plain planners search."""
PLANNERS = (*(PLAIN_KINDS[kind] for kind in KINDS), *COMPILED)
LEAST_DISTANCE = 0.7
"""Between start and goal, as a share of the map's side: four plans or more at 256²."""


def find_episodes(context: Context, size: int, count: int) -> Iterator[tuple[int, Episode]]:
    """So many numbered episodes on crops of the terrain."""
    (size,) = context.fitting([size])
    for number, case in context.maps([size], count, LEAST_DISTANCE):
        seed = context.seed + number - 1
        yield number, make_episode(case.cost, *case.queries[0], seed, stride_on(size))


def stride_on(size: int) -> int:
    """Cells that the robot walks between two plans: the paper's 45 at 256² and more, fewer on
    smaller maps.
    """
    return min(STRIDE, max(STRIDE * size // 256, 1))


def maps_of(episode: Episode, networks: NetworkPair) -> Iterator[OneMap]:
    """The map and the query of each plan."""
    for at, step in enumerate(episode.steps):
        yield OneMap(episode.map_at(at), (step.start, episode.goal), networks)


def drive(episode: Episode, networks: NetworkPair, repeats: int) -> Rows:
    """Have all of `PLANNERS` make every plan of an episode; the median of `repeats` drives counts
    for ours, after one that does not.

    A plan's time is the map's update, the network's view of it, and the plan with every widening
    and fallback. What depends on the first map alone is made before the clock starts.
    """
    drives = []
    for turn in range(repeats + 1):
        calls = {}
        for name in COMPILED:
            planner = DynamicPlanner(episode.cost, episode.goal, name, model=networks.ours)
            planner.prepare()
            calls[name] = partial(_replan, planner)
        drives.append(list(Harness(turn).measure(calls, episode.steps)))
    harness = Harness()
    rows = Rows()
    plans = zip(maps_of(episode, networks), *drives, strict=True)
    for at, (here, _, *answers) in enumerate(plans):
        of_plan = here.plain(KINDS, harness)
        for name in COMPILED:
            plan = answers[-1][name].results[0]
            time_s = np.median([records[name].median_s for records in answers])
            of_plan.append({**here.row(name, plan), "time_s": float(time_s)})
        rows += [{"plan": at, **row} for row in of_plan]
    return rows


def _replan(planner: DynamicPlanner, step: Step) -> Plan:
    for patch in step.patches:
        planner.update(*patch)
    planner.move(step.start)
    return planner.replan()


def table3(context: Context, *, size: int, episodes: int, repeats: int) -> Rows:
    """Every plan of one episode by all planners: of `episodes` the one whose number of plans is
    nearest to the paper's.
    """
    frames = len(paper.TABLE_3.of(ASTAR))
    found = [episode for _, episode in find_episodes(context, size, episodes)]
    episode = min(found, key=lambda each: abs(len(each.steps) - frames))
    before = None
    for at, here in enumerate(maps_of(episode, context.networks)):
        context.scenes.append(drawing.scene(drawing.frame(at), here, before))
        before = here
    return drive(episode, context.networks, repeats)


def table3_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of one episode, beside the paper's table."""
    theirs = paper.TABLE_3
    for slow, fast in ((ASTAR, ASTAR_NN), (ASTAR, DSTAR), (DSTAR, DSTAR_NN)):
        yield from judge_speedups(slow, fast, theirs, rows)
    yield judge_increase("A*NN (plain A*NN)", theirs.increase(ASTAR_NN), rows, PLAIN_NN)
    yield judge_increase("D*NN (`nnpp-dstar`)", theirs.increase(DSTAR_NN), rows, "nnpp-dstar")
    *their_s, nn_s, dstar_s = (
        of.of(planner).all("time_s")[-1]
        for of, planner in (
            (theirs, DSTAR_NN),
            (theirs, DSTAR),
            (rows, "nnpp-dstar"),
            (rows, "dstar"),
        )
    )
    yield stated(
        "near the goal, in the last frame, D*NN takes longer than D*",
        " against ".join(map(seconds, their_s)),
        f"{seconds(nn_s)} against {seconds(dstar_s)}",
        "`nnpp-dstar` takes longer",
        holds=True,
        better=nn_s <= dstar_s,
    )


def table4(context: Context, *, size: int, maps: int, repeats: int) -> Rows:
    """An episode on each of some maps, by all planners; its first plan is that of the map standing
    still.
    """
    rows = Rows()
    for number, episode in find_episodes(context, size, maps):
        for row in drive(episode, context.networks, repeats):
            rows.append({"scene": DYNAMIC, "map": number, **row})
    return Rows([*({**row, "scene": STATIC} for row in rows.of(plan=0)), *rows])


def table4_findings(rows: Rows) -> Iterator[Finding]:
    """Findings on the rows of both scenes, beside the paper's table."""
    for slow, fast, scene in (
        (ASTAR, ASTAR_NN, STATIC),
        (ASTAR, ASTAR_NN, DYNAMIC),
        (ASTAR, DSTAR, DYNAMIC),
        (DSTAR, DSTAR_NN, DYNAMIC),
        (ASTAR_NN, DSTAR_NN, DYNAMIC),
    ):
        theirs = paper.TABLE_4.of(scene=scene)
        yield from judge_speedups(slow, fast, theirs, rows.of(scene=scene), f", {scene}")
    dynamic = rows.of(scene=DYNAMIC)
    gain = paper.TABLE_4.of(scene=DYNAMIC).speedup(DSTAR, ASTAR_NN)
    yield judge(
        "the network gains A* more than D* does: A*NN is faster than D*, dynamic, both ours",
        f"{gain:.2f}×",
        "`nnpp` takes less time than `dstar`",
        Figure(methodcaller("speedup", "dstar", "nnpp"), "{:.3g}×".format),
        dynamic,
        "nnpp",
        least=1.0,
    )
    for what, method, ours, scene in (
        ("A*NN, static, plain", ASTAR_NN, PLAIN_NN, STATIC),
        ("A*NN, dynamic, plain", ASTAR_NN, PLAIN_NN, DYNAMIC),
        ("D*NN, dynamic, ours", DSTAR_NN, "nnpp-dstar", DYNAMIC),
    ):
        increase = paper.TABLE_4.of(scene=scene).increase(method)
        yield judge_increase(what, increase, rows.of(scene=scene), ours)
    later = Rows(row for row in dynamic if row["plan"])
    if not later:
        return
    yield judge(
        "D*NN repairs, and gains by it, dynamic (`nnpp-dstar`)",
        "yes",
        "faster than afresh, by the plans after the first",
        Figure(methodcaller("speedup", "nnpp", "nnpp-dstar"), "{:.3g}×".format),
        later,
        "nnpp-dstar",
        least=1.0,
    )


EXPERIMENTS = {
    "table3": Experiment(
        "Table 3 and Fig. 16",
        "Planning anew as the map changes, plan by plan",
        table3,
        ("plan", "planner"),
        table3_findings,
        None,
        {"size": 256, "episodes": 12, "repeats": 5},
        paper.TABLE_3,
    ),
    "table4": Experiment(
        "Table 4",
        "Five maps, standing still and changing",
        table4,
        ("scene", "planner"),
        table4_findings,
        partial(drawing.by_planner, "scene"),
        {"size": 256, "maps": 5, "repeats": 5},
        paper.TABLE_4,
        totals=True,
    ),
}
