"""Fig. 14 and 15: several goals from one start, and obstacles that move between a start and a goal that stay."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction.animation import View, draw_view, frame, legend
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import bare, new_figure, png
from nnpp_edge.reproduction.report import Finding, Result, Row, Table, columns, judge, percent
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.planners.plan import Plan, Source
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
    """A map and a query: what the network made of it, beside the optimum."""

    name: str
    goal: Cell
    plan: Plan
    view: View
    gap: float
    """By how much the path costs more than the optimum, as a share."""


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """One map: several goals from one start, then obstacles that move on the way to the first of them."""
    size, notes = context.one_size(settings.size)
    for tried, (case, (start, goal)) in enumerate(context.maps(size, _MAPS)):
        progress(0.8 * tried / _MAPS)
        if (goals := _goals(case, start, goal, settings.goals)) and (moving := _moving(context, case, start, goal)):
            break
    else:
        raise InvalidQueryError(f"none of {_MAPS} maps of {size} × {size} cells has ways around moving obstacles")
    planner = Planner(case.cost, model=context.model, ask_from=0)
    several = [_scene(planner, case.cost, start, each, f"goal {n}") for n, each in enumerate(goals, 1)]
    notes.append(
        f"One map of {size}². Above, the network's region at td for several goals from one start (Fig. 14); below, "
        "for a start and a goal that stay while two obstacles of cost 1 move, the upper one to the left and the "
        "lower one to the right (Fig. 15). Paths are `nnpp`'s. The paper shows a Martian map, without figures."
    )
    summary, data, picture = _summary(several, moving), _data(several, moving), _picture(several, moving)
    return Result(summary, data, _findings(several, moving), picture, notes)


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


def _moving(context: Context, case: Case, start: Cell, goal: Cell) -> list[_Scene]:
    """The frames; none if an obstacle would cover start or goal, or leave no way."""
    size = case.cost.shape[0]
    way = Planner(case.cost).plan(start, goal, method="astar").path
    places = sorted((way[int(share * len(way))].tolist() for share in _WHERE), key=lambda cell: cell[0])
    length, depth = int(_LENGTH * size), max(int(_DEPTH * size), 2)
    planner, scenes = Planner(case.cost, model=context.model, ask_from=0), list[_Scene]()
    for at in range(_FRAMES):
        obstacles: list[Rectangle] = []
        for (row, col), towards in zip(places, (-1, 1), strict=True):
            left = col + towards * int((at - _FRAMES // 2) * _STEP * size) - length // 2
            obstacles.append((max(row - depth // 2, 0), left, depth, length))
        cost = covered(case.cost, (0, 0, size, size), obstacles)
        if max(cost[start], cost[goal]) >= OBSTACLE or not Planner(cost).plan(start, goal, method="astar").ok:
            return []
        planner.update(0, 0, cost)
        scenes.append(_scene(planner, cost, start, goal, frame(at)))
    return scenes


def _scene(planner: Planner, cost: Float2D, start: Cell, goal: Cell, name: str) -> _Scene:
    plan = planner.plan(start, goal, method="nnpp", keep_regions=True)
    assert plan.ok and plan.network_region is not None
    region = plan.network_region.mask()
    best = planner.plan(start, goal, method="astar")
    return _Scene(name, goal, plan, View(cost, region, plan.path, best.path, ()), plan.cost / best.cost - 1.0)


def _in_common(one: _Scene, other: _Scene) -> float:
    """Cells that both regions hold, as a share of those that either does."""
    a, b = one.view.region, other.view.region
    return float((a & b).sum() / max((a | b).sum(), 1))


def _summary(several: Sequence[_Scene], moving: Sequence[_Scene]) -> Table:
    header = ("", "goal", "found in", "cost above the optimum", "region at td, of the map", "in common with T")
    rows: list[Row] = []
    for scenes in (several, moving):
        for scene in scenes:
            common = percent(_in_common(scene, moving[0])) if scenes is moving else None
            share = percent(float(scene.view.region.mean()))
            rows.append((scene.name, str(scene.goal), str(scene.plan.source), percent(scene.gap, 2), share, common))
    return Table(header, rows)


def _data(several: Sequence[_Scene], moving: Sequence[_Scene]) -> Table:
    header = columns(
        "part | name | start_row | start_col | goal_row | goal_col | source | cost_excess | region_share | "
        "in_common_with_first"
    )
    rows: list[Row] = []
    for part, scenes in (("goals", several), ("obstacles", moving)):
        for s in scenes:
            figures = (s.gap, float(s.view.region.mean()), _in_common(s, scenes[0]))
            rows.append((part, s.name, *s.view.path[0].tolist(), *s.goal, str(s.plan.source), *figures))
    return Table(header, rows)


def _findings(several: Sequence[_Scene], moving: Sequence[_Scene]) -> Sequence[Finding]:
    found = []
    for scenes, what in ((several, "goal"), (moving, "frame")):
        first = sum(scene.plan.source is Source.REGION for scene in scenes)
        gap = max(scene.gap for scene in scenes)
        ours = f"{first} of {len(scenes)} in the first region, at most {percent(gap, 2)} above the optimum"
        good, rule = (
            first == len(scenes) and gap <= _FARTHEST_GAP,
            "all in the first region, within 3 % of the optimum",
        )
        claim = f"a good path in the region for every {what}"
        found.append(judge(claim, "yes (pictures)", ours, agrees=good, rule=rule))
    claim = "the regions at T and T + 4Δt are the same, as the obstacles there are not in the way"
    common, rule = _in_common(moving[0], moving[-1]), "nine cells in ten in common"
    found.append(judge(claim, "identical", f"{percent(common)} in common", agrees=common >= 0.9, rule=rule))
    return found


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
            bare(axes, f"{scenes[at].name}: cost +{percent(abs(scenes[at].gap), 2)}")
    grid[0, 0].set_ylabel("Fig. 14: other goals")
    grid[1, 0].set_ylabel("Fig. 15: moving obstacles")
    legend(figure, grid[0, 0], changes=False)
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 14 and 15", "Other goals, and obstacles that move", run, Settings(), Settings(size=128, goals=3)
)
