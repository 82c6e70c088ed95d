"""Fig. 14 and 15: several goals from one start, and obstacles that move between a start and a goal that stay."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction.animation import View, draw_view, frame, legend, view_plan
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import bare, new_figure, png
from nnpp_edge.reproduction.regions import (
    CONTROLS,
    CONTROLS_NOTE,
    NETWORK,
    Found,
    Networks,
    PaperRegions,
    all_regions,
    compare_regions,
)
from nnpp_edge.reproduction.report import About, Finding, Result, Row, Table, columns, judge, percent
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Endpoints, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.obstacles import OBSTACLE, covered

_FRAMES = 5
"""From T to T + 4Δt (the paper's)."""
_LENGTH, _DEPTH, _STEP = 1 / 4, 1 / 12, 1 / 10
"""Of an obstacle, as shares of the map's side: along the rows, across them, and its way between two frames."""
_WHERE = (0.35, 0.65)
"""Of the way, as shares of the optimal path, where the obstacles cross it half-way through the frames."""
_FARTHEST_GAP = 0.03
"""The cost gap that the paper allows itself (Table 2)."""
_MAPS = 40
"""Tried for one on which the goals can be reached and the obstacles leave a way."""


@dataclass(frozen=True)
class Settings:
    """How much is looked at."""

    size: int = 256
    goals: int = 5


@dataclass(frozen=True)
class _Scene:
    """A map and a query: what the paper's method made of it, beside the optimum, and what controls did."""

    name: str
    goal: Cell
    view: View
    found: dict[str, Found]
    """In the network's region and in those of the controls."""
    blocks: dict[str, NDArray[np.bool_]]
    """Of these regions."""

    @property
    def gap(self) -> float:
        """By how much the path in the region costs more than the optimum, as a share; inf without a path."""
        return self.found[NETWORK].excess


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """One map: several goals from one start, then obstacles that move on the way to the first of them."""
    size, notes = context.one_size(settings.size)
    networks = context.networks
    for tried, (case, (start, goal)) in enumerate(context.maps(size, _MAPS)):
        progress(0.8 * tried / _MAPS)
        if (goals := _goals(case, start, goal, settings.goals)) and (moving := _moving(networks, case, start, goal)):
            break
    else:
        raise InvalidQueryError(f"none of {_MAPS} maps of {size} × {size} cells has ways around moving obstacles")
    several = [_scene(networks, case.cost, (start, each), f"goal {n}") for n, each in enumerate(goals, 1)]
    notes.append(
        f"One map of {size}², by the paper's method alone. Above, the network's region at td for several goals from"
        " one start (Fig. 14); below, for a start and a goal that stay while two obstacles of cost 1 move, the "
        "upper one to the left and the lower one to the right (Fig. 15). The paper shows a Martian map, without "
        "figures."
    )
    about = About(
        f"`{networks.paper.metadata.name}` in the paper's method; ours does not take part",
        f"1 map, {len(several)} goals, {len(moving)} frames",
        CONTROLS_NOTE,
    )
    summary, data, picture = _summary(several, moving, networks), _data(several, moving), _picture(several, moving)
    return Result(about, summary, data, _findings(several, moving), picture, notes)


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


def _moving(networks: Networks, case: Case, start: Cell, goal: Cell) -> list[_Scene]:
    """The frames; none if an obstacle would cover start or goal, or leave no way."""
    size = case.cost.shape[0]
    way = Planner(case.cost).plan(start, goal, method="astar").path
    places = sorted((way[int(share * len(way))].tolist() for share in _WHERE), key=lambda cell: cell[0])
    length, depth = int(_LENGTH * size), max(int(_DEPTH * size), 2)
    scenes = list[_Scene]()
    for at in range(_FRAMES):
        obstacles: list[Rectangle] = []
        for (row, col), towards in zip(places, (-1, 1), strict=True):
            left = col + towards * int((at - _FRAMES // 2) * _STEP * size) - length // 2
            obstacles.append((max(row - depth // 2, 0), left, depth, length))
        cost = covered(case.cost, (0, 0, size, size), obstacles)
        if max(cost[start], cost[goal]) >= OBSTACLE or not Planner(cost).plan(start, goal, method="astar").ok:
            return []
        scenes.append(_scene(networks, cost, (start, goal), frame(at)))
    return scenes


def _scene(networks: Networks, cost: Float2D, query: Endpoints, name: str) -> _Scene:
    found = compare_regions(cost, query, networks.paper, networks.shuffled)
    regions = all_regions(PaperRegions(cost, networks.paper), query, networks.shuffled)
    blocks = {kind: region.blocks() for kind, region in regions.items()}
    return _Scene(name, query[1], view_plan(cost, query, networks.paper), found, blocks)


def _in_common(one: _Scene, other: _Scene, kind: str = NETWORK) -> float:
    """Blocks that both regions hold, as a share of those that either does."""
    a, b = one.blocks[kind], other.blocks[kind]
    return float(np.logical_and(a, b).sum()) / max(float(np.logical_or(a, b).sum()), 1.0)


def _summary(several: Sequence[_Scene], moving: Sequence[_Scene], networks: Networks) -> Table:
    header = columns(
        " | network | goal | path in the region | cost above the optimum | region at td, of the map | in common "
        "with T | cost above the optimum in the corridor | in the straight band | with shuffled weights"
    )
    rows: list[Row] = []
    for scenes in (several, moving):
        for scene in scenes:
            own = scene.found[NETWORK]
            common = percent(_in_common(scene, moving[0])) if scenes is moving else None
            place = (scene.name, f"`{networks.paper.metadata.name}`", str(scene.goal))
            gaps = (_gap(scene.found[kind]) for kind in CONTROLS)
            rows.append((*place, "yes" if own.found else "no", _gap(own), percent(own.share), common, *gaps))
    return Table(header, rows)


def _gap(found: Found) -> str | None:
    return percent(found.excess, 2) if found.found else None


def _data(several: Sequence[_Scene], moving: Sequence[_Scene]) -> Table:
    header = columns(
        "part | name | start_row | start_col | goal_row | goal_col | region | found | cost_excess | region_share | "
        "in_common_with_first"
    )
    rows: list[Row] = []
    for part, scenes in (("goals", several), ("obstacles", moving)):
        for s in scenes:
            ends = (*s.view.optimum[0].tolist(), *s.goal)
            for kind, found in s.found.items():
                figures = (float(found.found), found.excess, found.share, _in_common(s, scenes[0], kind))
                rows.append((part, s.name, *ends, kind, *figures))
    return Table(header, rows)


def _findings(several: Sequence[_Scene], moving: Sequence[_Scene]) -> Sequence[Finding]:
    found = []
    for scenes, what in ((several, "goal"), (moving, "frame")):
        good = {kind: _all_good(scenes, kind) for kind in (NETWORK, *CONTROLS)}
        first, gap = sum(scene.found[NETWORK].found for scene in scenes), max(scene.gap for scene in scenes)
        farthest = f"at most {percent(gap, 2)} above the optimum" if np.isfinite(gap) else "no path in the others"
        claim, rule = f"a good path in the region for every {what}", "all in the region, within 3 % of the optimum"
        texts, agrees = ("yes (pictures)", f"{first} of {len(scenes)} in the region, {farthest}"), good.pop(NETWORK)
        found.append(judge(claim, *texts, agrees=agrees, rule=rule, controls=good))
    claim = "the regions at T and T + 4Δt are the same, as the obstacles there are not in the way"
    common, rule = _in_common(moving[0], moving[-1]), "nine blocks in ten in common"
    as_well = {kind: _in_common(moving[0], moving[-1], kind) >= 0.9 for kind in CONTROLS}
    ours = f"{percent(common)} in common"
    found.append(judge(claim, "identical", ours, agrees=common >= 0.9, rule=rule, controls=as_well))
    return found


def _all_good(scenes: Sequence[_Scene], kind: str) -> bool:
    return all(scene.found[kind].found and scene.found[kind].excess <= _FARTHEST_GAP for scene in scenes)


def _picture(several: Sequence[_Scene], moving: Sequence[_Scene]) -> bytes:
    columns = max(len(several), len(moving))
    figure = new_figure(2.5 * columns, 5.8)
    grid = figure.subplots(2, columns, squeeze=False)
    for row, scenes in enumerate((several, moving)):
        for at in range(columns):
            axes = grid[row, at]
            if at >= len(scenes):
                axes.set_visible(False)
                continue
            draw_view(axes, scenes[at].view)
            gap = scenes[at].gap
            bare(axes, f"{scenes[at].name}: {f'cost +{percent(abs(gap), 2)}' if np.isfinite(gap) else 'no path'}")
    grid[0, 0].set_ylabel("Fig. 14: other goals")
    grid[1, 0].set_ylabel("Fig. 15: moving obstacles")
    legend(figure, grid[0, 0], changes=False)
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 14 and 15", "Other goals, and obstacles that move", run, Settings(), Settings(size=128, goals=3)
)
