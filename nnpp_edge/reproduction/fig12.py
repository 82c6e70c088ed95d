"""Fig. 12 and the static rows of Table 4: the network's region and the path on five maps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import PLAIN, PLAIN_NN, Round, contest, increase
from nnpp_edge.reproduction.experiment import Context, Experiment, Report
from nnpp_edge.reproduction.pictures import OPTIMUM, PATH, REGION, new_figure, png, tinted
from nnpp_edge.reproduction.plain_astar import build_graph, search
from nnpp_edge.reproduction.report import Finding, Result, Table, judge, judge_ratio, percent, seconds
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.labels import Query


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    size: int = 256
    maps: int = 5
    repeats: int = 5


@dataclass(frozen=True)
class _Scene:
    """A map with a query, what all planners made of it, and what is drawn."""

    case: Case
    query: Query
    round: Round
    drawn: tuple[tuple[str, NDArray[np.bool_], NDArray[np.int32]], ...]
    """Planner, the region that it searched, and its path."""
    optimum: NDArray[np.int32]


def run(context: Context, settings: Settings, report: Report) -> Result:
    """One query on each of five maps: drawn, and put to all planners."""
    sizes, notes = context.fitting((settings.size, 128, 64))
    size = max(sizes)
    scenes = []
    for case, query in context.maps(size, settings.maps):
        scenes.append(_scene(context, case, query, settings.repeats))
        report(len(scenes) / settings.maps)
    notes = [note for note in notes if size < settings.size]
    notes.append(
        "Cyan: above, the network's region at the adaptive threshold td, in which the paper searches; below, the "
        "cells that this toolkit's search at full resolution is given; cost is above the optimum. The whiter, the "
        "higher the traversability cost. The paper's maps are other ones: only orders of magnitude can be compared."
    )
    return Result(_summary(scenes), _data(scenes), _findings(scenes), _picture(scenes), notes)


def _scene(context: Context, case: Case, query: Query, repeats: int) -> _Scene:
    one = Case(case.workload, case.size, case.cost, (query,))
    (answered,) = contest(iter([one]), context.model, 1, repeats=repeats)
    planner = Planner(case.cost, model=context.model, ask_from=0)
    optimum = planner.plan(*query, method="astar").path
    plan = planner.plan(*query, method="nnpp")
    assert plan.network_region is not None
    at_threshold = plan.network_region.mask()
    searched = np.ones(case.cost.shape, bool) if plan.region is None else plan.region.mask()
    in_region = search(build_graph(case.cost, at_threshold), *query) or []
    drawn = (PLAIN_NN, at_threshold, np.array(in_region, np.int32).reshape(-1, 2)), ("nnpp", searched, plan.path)
    return _Scene(case, query, answered, drawn, optimum)


def _summary(scenes: Sequence[_Scene]) -> Table:
    header = ("map", "plain A*: AT", "plain A*NN: AT", "`nnpp`: AT", "CC of A*", "CC of plain A*NN", "CC of `nnpp`",
              "MM, plain A*NN", "MM, `nnpp`")  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for at, scene in enumerate(scenes, 1):
        plain, plain_nn, ours = (scene.round.answers[name] for name in (PLAIN, PLAIN_NN, "nnpp"))
        rows.append((
            f"map {at}", seconds(plain.time_s), seconds(plain_nn.time_s), seconds(ours.time_s),
            *(f"{a.traverse_cost:.2f}" for a in (plain, plain_nn, ours)), *(_mm(a.mm) for a in (plain_nn, ours)),
        ))  # fmt: skip
    for name, row in paper.TABLE_4_STATIC.items():
        rows.append((f"paper's {name}", seconds(row.astar_s), seconds(row.nn_s), None, f"{row.astar_cc:.2f}",
                     f"{row.nn_cc:.2f}", None, f"{row.nn_mm:.2f}", None))  # fmt: skip
    return Table(header, rows)


def _mm(mm: float | None) -> str | None:
    return None if mm is None else f"{mm:.3f}"


def _data(scenes: Sequence[_Scene]) -> Table:
    header = ("map", "planner", "path_cells", "start_row", "start_col", "goal_row", "goal_col", "time_s", "cc",
              "cost_excess", "mm")  # fmt: skip
    rows = [
        (
            at,
            name,
            scene.round.path_cells,
            *scene.query[0],
            *scene.query[1],
            a.time_s,
            a.traverse_cost,
            a.excess,
            a.mm,
        )
        for at, scene in enumerate(scenes, 1)
        for name, a in scene.round.answers.items()
    ]
    return Table(header, rows)


def _findings(scenes: Sequence[_Scene]) -> Sequence[Finding]:
    def mean(name: str, figure: str) -> float:
        return float(np.mean([getattr(scene.round.answers[name], figure) for scene in scenes]))

    mms = [scene.round.answers[PLAIN_NN].mm or 0.0 for scene in scenes]
    rows = paper.TABLE_4_STATIC.values()
    least, greatest = min(row.nn_mm for row in rows), max(row.nn_mm for row in rows)
    theirs = sum(row.nn_cc for row in rows) / sum(row.astar_cc for row in rows) - 1.0
    ours = increase(mean(PLAIN_NN, "traverse_cost"), mean(PLAIN, "traverse_cost"))
    return [
        judge_ratio("speed-up of A*NN over A*, both plain",
                    sum(row.astar_s for row in rows) / sum(row.nn_s for row in rows),
                    mean(PLAIN, "time_s") / mean(PLAIN_NN, "time_s")),
        judge("MM of the network's region at td", f"{least:.2f} to {greatest:.2f}",
              f"{min(mms):.3f} to {max(mms):.3f}", agrees=least <= float(np.mean(mms)) <= greatest,
              rule="our mean lies within the paper's range", better=float(np.mean(mms)) > greatest),
        judge("CC increase of A*NN over A*, both plain", percent(theirs), percent(ours, 2),
              agrees=abs(ours - theirs) <= 0.01, rule="within one point", better=ours < theirs),
    ]  # fmt: skip


def _picture(scenes: Sequence[_Scene]) -> bytes:
    from matplotlib.patches import Patch

    figure = new_figure(2.6 * len(scenes), 5.9)
    grid = figure.subplots(2, len(scenes), squeeze=False)
    for at, scene in enumerate(scenes):
        for row, (name, region, path) in enumerate(scene.drawn):
            axes = grid[row, at]
            axes.imshow(tinted(scene.case.cost, region), interpolation="nearest")
            axes.plot(scene.optimum[:, 1], scene.optimum[:, 0], color=OPTIMUM, linewidth=3.2, label="optimal path")
            axes.plot(path[:, 1], path[:, 0], color=PATH, linewidth=1.3, label="path in the region")
            (r, c), (i, j) = scene.query
            ends: dict[str, Any] = {"markeredgecolor": "black", "linestyle": "none", "clip_on": False, "zorder": 5}
            axes.plot(c, r, "s", color="gold", markersize=7, label="start", **ends)
            axes.plot(j, i, "*", color="red", markersize=12, label="goal", **ends)
            axes.set_xticks([])
            axes.set_yticks([])
            answer = scene.round.answers[name]
            above = f"map {at + 1}\n" if row == 0 else ""
            mm = "whole map" if answer.mm is None else f"MM {answer.mm:.3f}"
            axes.set_title(f"{above}{mm}, cost +{abs(100 * answer.excess):.2f} %", fontsize="small")
    grid[0, 0].set_ylabel("plain A*NN: region at td")
    grid[1, 0].set_ylabel("nnpp: region searched")
    handles, labels = grid[1, 0].get_legend_handles_labels()
    handles.append(Patch(facecolor=REGION))
    labels.append("region")
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize="small", frameon=False)
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 12 and Table 4, static", "Regions and paths on five maps", run, Settings(), Settings(repeats=2)
)
