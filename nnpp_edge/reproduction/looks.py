"""Fig. 14 and 15: the network's region for several goals, and around moving obstacles."""

import math

import numpy as np

from nnpp_edge.profiling.suites import LEAST_DISTANCE, Case
from nnpp_edge.reproduction import drawing
from nnpp_edge.reproduction.experiment import PAPERS, Context, Result, experiment
from nnpp_edge.reproduction.findings import Finding, Own, judge
from nnpp_edge.reproduction.planners import OneMap
from nnpp_edge.reproduction.regions import CONTROLS, NETWORK
from nnpp_edge.reproduction.rows import Rows, percent
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.obstacles import covered
from nnpp_edge.viz.figures import new_figure

_KINDS = {kind: kind for kind in (NETWORK, *CONTROLS)}
_FRAMES = 5
"""From T to T + 4Δt (the paper's)."""
_LENGTH = 1 / 4
_DEPTH = 1 / 12
_STEP = 1 / 10
"""Of an obstacle, as shares of the map's side: along the rows, across them, and its way between two
frames.
"""
_WHERE = (0.35, 0.65)
"""Of the way, as shares of the optimal path, where the obstacles cross it half-way through the
frames.
"""
_MAPS = 40
"""Tried for one on which the goals can be reached and the obstacles leave a way."""


@experiment(
    "Fig. 14 and 15",
    "Other goals, and obstacles that move",
    {"size": 128, "goals": 3},
    networks=PAPERS,
)
def fig14(context: Context, *, size: int = 256, goals: int = 5) -> Result:
    """One map: several goals from one start, then obstacles that move on the way to the first of
    them.
    """
    size = context.one_size(size)
    for tried, (case, (start, goal)) in enumerate(context.maps(size, _MAPS)):
        context.progress(0.8 * tried / _MAPS)
        ends = _goals(case, start, goal, goals)
        moving = _moving(case.cost, start, goal)
        if len(ends) == goals and moving:
            break
    else:
        raise InvalidQueryError(
            f"none of {_MAPS} maps of {size} × {size} cells has ways around moving obstacles"
        )
    parts = {
        "goals": {f"goal {n}": (case.cost, each) for n, each in enumerate(ends, 1)},
        "obstacles": {drawing.frame(at): (cost, goal) for at, cost in enumerate(moving)},
    }
    columns = max(map(len, parts.values()))
    figure = new_figure(2.5 * columns, 5.8)
    rows = Rows()
    grid = figure.subplots(2, columns, squeeze=False)
    for panels, (part, scenes) in zip(grid, parts.items(), strict=True):
        first = None
        for axes, (scene, (cost, end)) in zip(panels, scenes.items(), strict=False):
            here = OneMap(cost, (start, end), context.networks)
            blocks = {kind: region.blocks() for kind, region in here.regions.items()}
            first = first or blocks
            for row in here.searched(_KINDS):
                mine = blocks[row["planner"]]
                theirs = first[row["planner"]]
                common = float((mine & theirs).sum() / max((mine | theirs).sum(), 1))
                rows.append({"part": part, "scene": scene, **row, "common": common})
            view = drawing.view_plan(cost, (start, end), context.networks.paper)
            above = percent(rows.of(NETWORK, part=part, scene=scene).mean("excess"), 2)
            drawing.draw_view(axes, view, f"{scene}: {above} above the optimum")
        for axes in panels[len(scenes) :]:
            axes.set_visible(False)
    drawing.map_legend(figure, grid[0, 0])
    return Result(rows, ("scene", "planner"), fig14_findings(rows), figure)


def _goals(case: Case, start: Cell, goal: Cell, most: int) -> list[Cell]:
    """The first goal, and ends of the map's other queries that are far from the start and can be
    reached.
    """
    planner = Planner(case.cost)
    least = LEAST_DISTANCE * len(case.cost)
    others = dict.fromkeys(
        end for query in case.queries for end in query if math.dist(start, end) >= least
    )
    found = [
        goal,
        *(end for end in others if end != goal and planner.plan(start, end, method="astar").ok),
    ]
    return found[:most]


def _moving(cost: Float2D, start: Cell, goal: Cell) -> list[Float2D]:
    """The map at each frame; none if an obstacle would cover start or goal, or leave no way."""
    size = len(cost)
    way = Planner(cost).plan(start, goal, method="astar").path
    places = sorted(way[int(share * len(way))].tolist() for share in _WHERE)
    length = int(_LENGTH * size)
    depth = max(int(_DEPTH * size), 2)
    costs = list[Float2D]()
    for at in range(_FRAMES):
        moved = int((at - _FRAMES // 2) * _STEP * size)
        blocks = [
            (max(row - depth // 2, 0), col + towards * moved - length // 2, depth, length)
            for (row, col), towards in zip(places, (-1, 1), strict=True)
        ]
        costs.append(covered(cost, (0, 0, size, size), blocks))
    free = all(Planner(changed).plan(start, goal, method="astar").ok for changed in costs)
    return costs if free else []


def fig14_findings(rows: Rows) -> list[Finding]:
    """Of the rows of both parts: goals, and frames with obstacles."""
    found = []
    for part, what in (("goals", "goal"), ("obstacles", "frame")):
        of = rows.of(part=part)
        mine = of.of(NETWORK)

        def good(own: Own, of: Rows = of) -> bool:
            return all(row.get("excess", 1.0) <= 0.03 for row in of.of(own(NETWORK)))

        farthest = (
            f"at most {percent(max(mine.all('excess'), default=np.nan), 2)} above the optimum"
        )
        ours = f"{sum(mine.all('found')):.0f} of {len(mine)} in the region, {farthest}"
        claim = f"a good path in the region for every {what}"
        rule = "all in the region, within 3 % of the optimum"
        found.append(judge(claim, "yes (pictures)", ours, rule, good, of, NETWORK))
    last = rows.of(part="obstacles", scene=rows[-1]["scene"])
    claim = "the regions at T and T + 4Δt are the same, as the obstacles there are not in the way"
    ours = f"{percent(last.of(NETWORK).mean('common'))} in common"
    rule = "nine blocks in ten in common"
    found.append(
        judge(
            claim,
            "identical",
            ours,
            rule,
            lambda own: last.of(own(NETWORK)).mean("common") >= 0.9,
            last,
            NETWORK,
        )
    )
    return found
