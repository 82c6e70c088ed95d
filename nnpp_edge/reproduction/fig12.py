"""Fig. 12 and the static rows of Table 4: the network's region and the path on five maps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.profiling.suites import Case
from nnpp_edge.reproduction import paper
from nnpp_edge.reproduction.contest import (
    PLAIN,
    PLAIN_CONTROLS,
    PLAIN_NN,
    PLAIN_PLANNERS,
    Round,
    answers_table,
    contest,
    increase,
    network_of,
)
from nnpp_edge.reproduction.experiment import Context, Experiment, OnProgress
from nnpp_edge.reproduction.pictures import (
    OPTIMUM,
    PATH,
    Cells,
    bare,
    draw_ends,
    draw_path,
    map_legend,
    new_figure,
    png,
    tinted,
)
from nnpp_edge.reproduction.regions import CONTROLS_NOTE, Networks, PaperRegions, optimal_path
from nnpp_edge.reproduction.report import (
    About,
    Finding,
    Result,
    Row,
    Table,
    columns,
    judge,
    judge_increase,
    judge_ratio,
    optional,
    percent,
    seconds,
)
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.planners.planner import Planner


@dataclass(frozen=True)
class Settings:
    """How much is measured."""

    size: int = 256
    maps: int = 5
    repeats: int = 5


@dataclass(frozen=True)
class _Scene:
    """A map with a query, all planners' answers, and what is drawn."""

    case: Case
    query: Endpoints
    round: Round
    drawn: tuple[tuple[str, NDArray[np.bool_], Cells], ...]
    """Planner, the region that it searched, and its path."""
    optimum: Cells


def run(context: Context, settings: Settings, progress: OnProgress) -> Result:
    """One query on each of five maps: drawn, and answered by all planners."""
    size, notes = context.one_size(settings.size)
    scenes = []
    for case, query in context.maps(size, settings.maps):
        scenes.append(_scene(context, case, query, settings.repeats))
        progress(len(scenes) / settings.maps)
    notes.append(
        "Cyan: above, the network's region at the adaptive threshold td, in which the paper searches; below, the "
        "cells that this toolkit's search at full resolution is given; cost is above the optimum. The whiter, the "
        "higher the traversability cost. The paper's maps are other ones: only orders of magnitude can be compared."
    )
    data = answers_table("map", (((at,), scene.query, scene.round) for at, scene in enumerate(scenes, 1)))
    samples = f"{settings.maps} maps, one query each; ours the median of {settings.repeats}"
    about = About(context.networks.named, samples, CONTROLS_NOTE)
    return Result(about, _summary(scenes, context.networks), data, _findings(scenes), _picture(scenes), notes)


def _scene(context: Context, case: Case, query: Endpoints, repeats: int) -> _Scene:
    one = Case(case.workload, case.size, case.cost, (query,))
    (answered,) = contest([one], context.networks, 1, repeats=repeats)
    planner = Planner(case.cost, model=context.networks.ours, ask_from=0)
    optimum = planner.plan(*query, method="astar").path
    plan = planner.plan(*query, method="nnpp", keep_regions=True)
    regions = PaperRegions(case.cost, context.networks.paper)
    at_td, _ = regions.find(query)
    in_region = optimal_path(regions.grid, query, at_td)
    searched = np.ones(case.cost.shape, bool) if plan.region is None else plan.region.mask()
    shown_path = np.empty((0, 2), np.int32) if in_region is None else in_region
    drawn = (PLAIN_NN, at_td.mask(), shown_path), ("nnpp", searched, plan.path)
    return _Scene(case, query, answered, drawn, optimum)


def _summary(scenes: Sequence[_Scene], networks: Networks) -> Table:
    header = columns("map | planner | network | AT | CC | CC increase | MM")
    rows: list[Row] = []
    for at, scene in enumerate(scenes, 1):
        answers = scene.round.answers
        for name in (*PLAIN_PLANNERS, "nnpp"):
            a, label = answers[name], name if name != "nnpp" else "`nnpp`"
            more = increase(a.traverse_cost, answers[PLAIN].traverse_cost)
            quality = (
                (f"{a.traverse_cost:.2f}", percent(more, 2), optional(a.mm, ".3f")) if a.found else (None, None, None)
            )
            rows.append((f"map {at}", label, network_of(name, networks), seconds(a.time_s), *quality))
    for name, row in paper.TABLE_4_STATIC.items():
        rows.append((f"paper's {name}", "A*", None, seconds(row.astar_s), f"{row.astar_cc:.2f}", None, None))
        theirs = percent(increase(row.nn_cc, row.astar_cc), 2)
        rows.append(
            (
                f"paper's {name}",
                "A*NN",
                "the paper's",
                seconds(row.nn_s),
                f"{row.nn_cc:.2f}",
                theirs,
                f"{row.nn_mm:.2f}",
            )
        )
    return Table(header, rows)


def _findings(scenes: Sequence[_Scene]) -> Sequence[Finding]:
    def mean(name: str, figure: str) -> float:
        return float(np.mean([getattr(scene.round.answers[name], figure) for scene in scenes]))

    mms = [scene.round.answers[PLAIN_NN].mm or 0.0 for scene in scenes]
    mm, rows = float(np.mean(mms)), paper.TABLE_4_STATIC.values()
    least, greatest = min(row.nn_mm for row in rows), max(row.nn_mm for row in rows)
    theirs_faster = sum(row.astar_s for row in rows) / sum(row.nn_s for row in rows)
    theirs_cc = sum(row.nn_cc for row in rows) / sum(row.astar_cc for row in rows) - 1.0
    increases = {name: increase(mean(name, "traverse_cost"), mean(PLAIN, "traverse_cost")) for name in PLAIN_PLANNERS}
    gains = {name: mean(PLAIN, "time_s") / mean(name, "time_s") for name in PLAIN_PLANNERS}
    good = {
        kind: name
        for kind, name in PLAIN_CONTROLS.items()
        if increases[name] <= max(increases[PLAIN_NN], theirs_cc + 0.01)
    }
    both = "of A*NN over A*, both plain"
    in_range = judge(
        "MM of the network's region at td",
        f"{least:.2f} to {greatest:.2f}",
        f"{min(mms):.3f} to {max(mms):.3f}",
        agrees=least <= mm <= greatest,
        rule="our mean lies within the paper's range",
        better=mm > greatest,
        controls={kind: mean(name, "mm") >= least for kind, name in good.items()},
    )
    of_controls = {kind: gains[name] for kind, name in good.items()}
    faster = judge_ratio(f"speed-up {both}", theirs_faster, gains[PLAIN_NN], controls=of_controls)
    of_controls = {kind: increases[name] for kind, name in PLAIN_CONTROLS.items()}
    return [
        faster,
        in_range,
        judge_increase(f"CC increase {both}", theirs_cc, increases[PLAIN_NN], controls=of_controls),
    ]


def _picture(scenes: Sequence[_Scene]) -> bytes:
    figure = new_figure(2.6 * len(scenes), 5.9)
    grid = figure.subplots(2, len(scenes), squeeze=False)
    for at, scene in enumerate(scenes):
        for row, (name, region, path) in enumerate(scene.drawn):
            axes, answer = grid[row, at], scene.round.answers[name]
            axes.imshow(tinted(scene.case.cost, region), interpolation="nearest")
            draw_path(axes, scene.optimum, OPTIMUM, 3.2, "optimal path")
            draw_path(axes, path, PATH, 1.3, "path in the region")
            draw_ends(axes, *scene.query)
            above = f"map {at + 1}\n" if row == 0 else ""
            mm = "whole map" if answer.mm is None else f"MM {answer.mm:.3f}"
            cost = f"cost +{abs(100 * answer.excess):.2f} %" if np.isfinite(answer.excess) else "no path"
            bare(axes, f"{above}{mm}, {cost}")
    grid[0, 0].set_ylabel("plain A*NN: region at td")
    grid[1, 0].set_ylabel("nnpp: region searched")
    map_legend(figure, grid[1, 0], "region", columns=5)
    return png(figure)


EXPERIMENT = Experiment(
    "Fig. 12 and Table 4, static", "Regions and paths on five maps", run, Settings(), Settings(repeats=2)
)
