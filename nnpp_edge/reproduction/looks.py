"""Fig. 8, 14 and 15: the network's region at several thresholds, for several goals, and around moving obstacles."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction import drawing
from nnpp_edge.reproduction.drawing import frame
from nnpp_edge.reproduction.experiment import Context, Result, experiment
from nnpp_edge.reproduction.findings import Finding, judge
from nnpp_edge.reproduction.planners import OneMap
from nnpp_edge.reproduction.regions import CONTROLS, NETWORK, PaperRegions
from nnpp_edge.reproduction.rows import Columns, Rows, percent, table
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.region.learned import probability_of
from nnpp_edge.terrain.obstacles import OBSTACLE, covered

_FRAMES = 5
"""From T to T + 4Δt (the paper's)."""
_LENGTH, _DEPTH, _STEP = 1 / 4, 1 / 12, 1 / 10
"""Of an obstacle, as shares of the map's side: along the rows, across them, and its way between two frames."""
_WHERE = (0.35, 0.65)
"""Of the way, as shares of the optimal path, where the obstacles cross it half-way through the frames."""
_MAPS = 40
"""Tried for one on which the goals can be reached and the obstacles leave a way."""


@experiment("Fig. 8", "Regions at several thresholds", {"size": 128})
def fig8(
    context: Context, *, size: int = 256, above: Sequence[float] = (0.6, 0.3), below: Sequence[float] = (1.0, 0.5)
) -> Result:
    """The answer of the paper's network at td, and at thresholds around it.

    `above` are shares of the way from td to 1, `below` shares of td.
    """
    size, name = context.one_size(size), f"`{context.networks.paper.metadata.name}`"
    ((case, query),) = context.maps(size, 1)
    maker = PaperRegions(case.cost, context.networks.paper)
    maker.find(query)
    td, levels = probability_of(maker.td), maker.finder.levels
    answer = np.vectorize(probability_of)(levels.astype(int))
    thresholds = [*(td + share * (1.0 - td) for share in above), *(share * td for share in below)]
    figure, rows = drawing.new_figure(2.7 * (len(thresholds) + 1), 3.3), Rows()
    first, *others = figure.subplots(1, len(thresholds) + 1)
    first.imshow(answer[np.ix_(*maker.lookup)])
    first.set(title="the network's answer", xticks=[], yticks=[])
    drawing.draw_ends(first, *query)
    for axes, threshold in zip(others, thresholds, strict=True):
        region = maker.at(int(levels[answer >= threshold].min(initial=255))).mask()
        joined = "connected" if threshold <= td else "apart"
        rows.append({"td": threshold, "share": float(region.mean()), "ends": joined})
        drawing.draw_map(axes, case.cost, f"td = {threshold:.3g}: {joined}", region)
        drawing.draw_ends(axes, *query)
    columns: Columns = {
        "network": lambda of: name,
        "region, of the map": lambda of: percent(of.mean("share")),
        "start and goal": lambda of: str(of[0]["ends"]),
    }
    here = OneMap(case.cost, query, context.networks)
    found = Rows(here.searched({kind: kind for kind in here.regions}, here.regions))
    small = {kind: found.of(kind, found=1.0).mean("share") < 0.2 for kind in (NETWORK, *CONTROLS)}
    own, claim = found.of(NETWORK).mean("share"), "the greatest td that joins start and goal leaves a small part"
    findings = [judge(f"{claim} of the map", "yes (picture)", percent(own), small.pop(NETWORK), "below 20 %", small)]
    summary = table("td", {(f"{row['td']:.4g}",): Rows([row]) for row in rows}, columns)
    named = f"{name} in the paper's method; ours does not take part"
    return Result(summary, rows, findings, figure, named)


@experiment("Fig. 14 and 15", "Other goals, and obstacles that move", {"size": 128, "goals": 3})
def fig14(context: Context, *, size: int = 256, goals: int = 5) -> Result:
    """One map: several goals from one start, then obstacles that move on the way to the first of them."""
    size, name = context.one_size(size), f"`{context.networks.paper.metadata.name}`"
    for tried, (case, (start, goal)) in enumerate(context.maps(size, _MAPS)):
        context.progress(0.8 * tried / _MAPS)
        if (ends := _goals(case, start, goal, goals)) and (moving := _moving(case, start, goal)):
            break
    else:
        raise InvalidQueryError(f"none of {_MAPS} maps of {size} × {size} cells has ways around moving obstacles")
    parts = {
        "goals": {f"goal {n}": (case.cost, each) for n, each in enumerate(ends, 1)},
        "obstacles": {frame(at): (cost, goal) for at, cost in enumerate(moving)},
    }
    columns = max(map(len, parts.values()))
    figure, rows = drawing.new_figure(2.5 * columns, 5.8), Rows()
    grid = figure.subplots(2, columns, squeeze=False)
    for panels, (part, scenes) in zip(grid, parts.items(), strict=True):
        first = None
        for axes, (scene, (cost, end)) in zip(panels, scenes.items(), strict=False):
            here = OneMap(cost, (start, end), context.networks)
            blocks = {kind: region.blocks() for kind, region in here.regions.items()}
            first = first or blocks
            found = Rows(here.searched({kind: kind for kind in blocks}, here.regions))
            for row, (kind, own) in zip(found, blocks.items(), strict=True):
                common = float((own & first[kind]).sum() / max((own | first[kind]).sum(), 1))
                rows.append({"part": part, "name": scene, **row, "common": common})
            view = drawing.view_plan(cost, (start, end), context.networks.paper)
            drawing.draw_view(axes, view, f"{scene}: {_cost_in(NETWORK, found)} above the optimum")
        for axes in panels[len(scenes) :]:
            axes.set_visible(False)
    drawing.map_legend(figure, grid[0, 0])
    shown: Columns = {
        "network": lambda of: name,
        "region at td, of the map": lambda of: percent(of.of(NETWORK).mean("share")),
        "in common with the first": lambda of: percent(of.of(NETWORK).mean("common")),
        **{f"cost above the optimum, {kind}": partial(_cost_in, kind) for kind in (NETWORK, *CONTROLS)},
    }
    named = f"{name} in the paper's method; ours does not take part"
    summary = table("scene | goal", rows.by("name", "goal"), shown)
    return Result(summary, rows, fig14_findings(rows), figure, named)


def _cost_in(region: str, rows: Rows) -> str:
    """Cost of the path in a region above the optimum."""
    return percent(rows.of(region).mean("excess"), 2) if all(rows.of(region).all("found")) else "no path"


def _goals(case: Case, start: Cell, goal: Cell, count: int) -> list[Cell]:
    """Goals far from the start, the first given, each in another direction; none if they cannot be found."""
    size, planner = case.cost.shape[0], Planner(case.cost)
    found = [goal]
    first = np.arctan2(goal[0] - start[0], goal[1] - start[1])
    for turn in range(1, 48):
        angle = first + 2.4 * turn  # in turns that do not come round
        reach = (0.35 + 0.3 * (turn % 3) / 2) * size
        row, col = (int(x) for x in (start[0] + reach * np.sin(angle), start[1] + reach * np.cos(angle)))
        if 0 <= row < size and 0 <= col < size and planner.plan(start, (row, col), method="astar").ok:
            found.append((row, col))
        if len(found) == count:
            return found
    return []


def _moving(case: Case, start: Cell, goal: Cell) -> list[Float2D]:
    """The map at each frame; none if an obstacle would cover start or goal, or leave no way."""
    size = case.cost.shape[0]
    way = Planner(case.cost).plan(start, goal, method="astar").path
    places = sorted((way[int(share * len(way))].tolist() for share in _WHERE), key=lambda cell: cell[0])
    length, depth = int(_LENGTH * size), max(int(_DEPTH * size), 2)
    costs = list[Float2D]()
    for at in range(_FRAMES):
        obstacles: list[Rectangle] = []
        for (row, col), towards in zip(places, (-1, 1), strict=True):
            left = col + towards * int((at - _FRAMES // 2) * _STEP * size) - length // 2
            obstacles.append((max(row - depth // 2, 0), left, depth, length))
        cost = covered(case.cost, (0, 0, size, size), obstacles)
        if max(cost[start], cost[goal]) >= OBSTACLE or not Planner(cost).plan(start, goal, method="astar").ok:
            return []
        costs.append(cost)
    return costs


def fig14_findings(rows: Rows) -> list[Finding]:
    """Of the rows of both parts: goals, and frames with obstacles."""
    found = []
    for part, what in (("goals", "goal"), ("obstacles", "frame")):
        of, own = rows.of(part=part), rows.of(NETWORK, part=part)
        good = {kind: all(row.get("excess", 1.0) <= 0.03 for row in of.of(kind)) for kind in (NETWORK, *CONTROLS)}
        farthest = f"at most {percent(max(own.all('excess')), 2)} above the optimum"
        ours = f"{sum(own.all('found')):.0f} of {len(own)} in the region, {farthest}"
        claim, rule = f"a good path in the region for every {what}", "all in the region, within 3 % of the optimum"
        found.append(judge(claim, "yes (pictures)", ours, good.pop(NETWORK), rule, good))
    common = {kind: rows.of(kind, part="obstacles").all("common")[-1] for kind in (NETWORK, *CONTROLS)}
    claim = "the regions at T and T + 4Δt are the same, as the obstacles there are not in the way"
    same, ours = {kind: share >= 0.9 for kind, share in common.items()}, f"{percent(common[NETWORK])} in common"
    return [*found, judge(claim, "identical", ours, same.pop(NETWORK), "nine blocks in ten in common", same)]
