"""The paper's dynamic scene (NNPP, section 5.5, Tables 3 and 4) as a benchmark.

All methods answer the same queries on the same maps, those of an `Episode`.
``python -m nnpp_edge.benchmarks.dynamic_scene --terrain FILE`` prints both tables.
"""

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import click
import numpy as np

from nnpp_edge.benchmarks.dynamic_episode import LEAST_DISTANCE, STRIDE, Episode, Step, episodes_of
from nnpp_edge.profiling.harness import Harness
from nnpp_edge.profiling.suites import TerrainFiles, check_sizes, terrain_cases
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import NnppEdgeError, Status
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan


@dataclass(frozen=True)
class SceneRow:
    """One method's answer at one step of an episode."""

    episode: int
    step: int
    method: str
    used: str
    """The method that answered; for ``auto`` the one it picked."""
    status: str
    source: str
    time_ms: float
    """Map update and plan: the median over the repeats."""
    cost: float
    cc: float
    optimal_cost: float
    """Exact A*'s on the same query."""
    optimal_cc: float
    driven_cc: float
    """CC of the cells that the robot walks before the next plan, of this method's own path."""
    expansions: int
    region_share: float
    """Of the map's cells, of the region searched at full resolution; 1 for the whole map."""
    mended: bool
    """Whether a search from before was mended in a region, rather than made afresh."""


@dataclass(frozen=True)
class SceneTotal:
    """One method over whole episodes, or over their first plans."""

    method: str
    plans: int
    solved: float
    """Share of plans that found a path."""
    time_ms: float
    """Summed."""
    speedup_astar: float
    """Summed time of exact A* over this."""
    speedup_dstar: float | None
    """The same for whole-map D* Lite; None where it did not take part."""
    cc: float
    """Summed over all plans."""
    cc_excess: float
    """By how much, relatively, exact A*'s sum is exceeded."""
    cost_excess: float
    """The same for the path's cost, which is what the searches minimise."""
    driven_cc: float
    expansions: int


def run_scene(
    episodes: Iterable[Episode],
    methods: Sequence[str],
    *,
    model: str | Path = "edge",
    repeats: int = 3,
    stride: int = STRIDE,
    progress: Callable[[int], None] = lambda done: None,
) -> list[SceneRow]:
    """Have every method go through the same episodes, one after another at each step, in an order drawn anew.

    The episodes are made with the same `stride`; exact A* always takes part. New planners go through every episode
    `repeats` times, after once without the clock; a step's median time counts. `progress` is called with the number
    of episodes that are done. Rows come by episode, step and method.

    Notes
    -----
    A step's time is the map's update, the network's view of it, and the plan with every widening and fallback.
    What depends on the first map alone is made before the clock starts, for all methods alike.
    """
    names = list(dict.fromkeys((DynamicMethod.ASTAR, *map(DynamicMethod, methods))))
    network = NetworkModel(model) if any(name.base is Method.NNPP for name in names) else "edge"
    rows: list[SceneRow] = []
    for at, episode in enumerate(episodes):
        lives = [_one_life(episode, names, network, turn) for turn in range(repeats + 1)]
        timed = lives[1:] or lives
        for step, answers in enumerate(lives[-1]):
            walked = stride if step + 1 < len(episode.steps) else None
            cost = episode.map_at(step)
            for name in names:
                answer = replace(lives[0][step][name], plan=answers[name].plan)
                seconds = float(np.median([life[step][name].seconds for life in timed]))
                rows.append(_row((at, step, name), seconds, answer, answers[DynamicMethod.ASTAR], cost, walked))
        progress(at + 1)
    return rows


@dataclass(frozen=True)
class _Answer:
    """One planner's answer at one step."""

    plan: Plan
    seconds: float
    searched_cells: int | None
    """Of the region searched at full resolution, in the first life; None for the whole map."""


def _one_life(
    episode: Episode, names: Sequence[DynamicMethod], network: NetworkModel | str, turn: int
) -> list[dict[str, _Answer]]:
    """The answers of new planners, step by step. In the first turn, which is not timed, they keep their regions."""
    calls: dict[str, Callable[[Step], Plan]] = {}
    for name in names:
        planner = DynamicPlanner(episode.cost, episode.goal, name, model=network)
        planner.prepare()
        calls[str(name)] = partial(_replan, planner, keep_regions=not turn)
    life = []
    for records in Harness(turn).measure(calls, episode.steps):
        answers = {}
        for method, record in records.items():
            (plan,) = record.results
            cells = None if plan.region is None else plan.region.area()
            answers[method] = _Answer(plan, record.median_s, cells)
        life.append(answers)
    return life


def _replan(planner: DynamicPlanner, step: Step, *, keep_regions: bool) -> Plan:
    for patch in step.patches:
        planner.update(*patch)
    planner.move(step.start)
    return planner.replan(keep_regions=keep_regions)


def _row(
    place: tuple[int, int, str], seconds: float, answer: _Answer, exact: _Answer, cost: Float2D, walked: int | None
) -> SceneRow:
    """The row of one answer, by the map's cost at that step and the number of cells that the robot walks."""
    plan, best = answer.plan, exact.plan
    part = plan.path[:walked]
    return SceneRow(
        episode=place[0],
        step=place[1],
        method=str(place[2]),
        used=str(plan.planner),
        status=str(plan.status),
        source=str(plan.source or ""),
        time_ms=1e3 * seconds,
        cost=plan.cost,
        cc=plan.traverse_cost,
        optimal_cost=best.cost,
        optimal_cc=best.traverse_cost,
        driven_cc=float(cost[part[:, 0], part[:, 1]].sum(dtype=np.float64)) if plan.ok else 0.0,
        expansions=plan.expansions,
        region_share=1.0 if answer.searched_cells is None else answer.searched_cells / cost.size,
        mended=plan.choice.startswith("mended"),
    )


def totals(rows: Sequence[SceneRow], *, static: bool = False) -> list[SceneTotal]:
    """A line for each method: over whole episodes, or with `static` over the first plans alone (Table 4, ``-s``)."""
    chosen = [row for row in rows if row.step == 0 or not static]
    by_method = {m: [r for r in chosen if r.method == m] for m in dict.fromkeys(r.method for r in chosen)}
    spent_ms = {method: sum(row.time_ms for row in own) for method, own in by_method.items()}
    return [_total(method, own, spent_ms) for method, own in by_method.items()]


def _total(method: str, own: Sequence[SceneRow], spent_ms: Mapping[str, float]) -> SceneTotal:
    solved = [row for row in own if row.status == Status.OK]
    cc, best_cc = sum(row.cc for row in solved), sum(row.optimal_cc for row in solved)
    cost, best = sum(row.cost for row in solved), sum(row.optimal_cost for row in solved)
    ms, dstar_ms = spent_ms[method], spent_ms.get(DynamicMethod.DSTAR)
    return SceneTotal(
        method=method,
        plans=len(own),
        solved=len(solved) / len(own),
        time_ms=ms,
        speedup_astar=spent_ms[DynamicMethod.ASTAR] / ms,
        speedup_dstar=None if dstar_ms is None else dstar_ms / ms,
        cc=cc,
        cc_excess=cc / best_cc - 1.0 if best_cc else 0.0,
        cost_excess=cost / best - 1.0 if best else 0.0,
        driven_cc=sum(row.driven_cc for row in solved),
        expansions=sum(row.expansions for row in own),
    )


def render(rows: Sequence[SceneRow]) -> str:
    """Table 3 (by step, means over the episodes) and Table 4 (static and dynamic totals) for people."""
    from nnpp_edge.progress import render_table

    methods = list(dict.fromkeys(row.method for row in rows))
    by_step = []
    for step in range(max(row.step for row in rows) + 1):
        of_step = [row for row in rows if row.step == step]
        line = [f"T + {step}Δt" if step else "T", str(sum(row.method == methods[0] for row in of_step))]
        for method in methods:
            own = [row for row in of_step if row.method == method and row.status == Status.OK]
            means = (np.mean([row.time_ms for row in own]), np.mean([row.cc for row in own])) if own else ()
            line += [f"{mean:.2f}" for mean in means] or ["–", "–"]
        by_step.append(line)
    header = ["frame", "n", *(f"{name}\n{what}" for name in methods for what in ("ms", "CC"))]
    lines = [_line("static", total) for total in totals(rows, static=True)]
    lines += [_line("dynamic", total) for total in totals(rows)]
    sections = [line[1] == DynamicMethod.ASTAR for line in lines]
    return "\n".join([render_table(header, by_step), render_table(_TOTALS, lines, sections=sections)])


_TOTALS = (
    *("scene", "method", "plans", "solved", "ms", "over A*", "over D*"),
    *("CC", "CC\nexcess", "cost\nexcess", "CC\ndriven", "expansions"),
)


def _line(scene: str, t: SceneTotal) -> list[str]:
    over_dstar = "–" if t.speedup_dstar is None else f"{t.speedup_dstar:.2f}"
    return [
        *(scene, t.method, str(t.plans), f"{100 * t.solved:.0f} %", f"{t.time_ms:.2f}"),
        *(f"{t.speedup_astar:.2f}", over_dstar, f"{t.cc:.2f}", f"{100 * t.cc_excess:+.2f} %"),
        *(f"{100 * t.cost_excess:+.2f} %", f"{t.driven_cc:.2f}", str(t.expansions)),
    ]


def as_json(rows: Sequence[SceneRow]) -> dict[str, list[dict[str, object]]]:
    """Every row, and the totals, for programs."""
    return {
        "static": [asdict(total) for total in totals(rows, static=True)],
        "dynamic": [asdict(total) for total in totals(rows)],
        "rows": [asdict(row) for row in rows],
    }


@click.command()
@click.option("--terrain", multiple=True, required=True, type=click.Path(path_type=Path), help="Elevation file.")
@click.option("--rescale", type=float, help="Rescale the terrain to cells of so many metres, slopes kept.")
@click.option("--cell-size", type=float, help="Side of a cell in metres, where the files do not say.")
@click.option("--workload", default="soft", show_default=True, help="soft, limit20, limit15 or any limitN.")
@click.option("--size", type=click.IntRange(64), default=256, show_default=True, help="Side of the maps.")
@click.option("--episodes", "count", type=click.IntRange(1), default=5, show_default=True)
@click.option("--methods", default=",".join(DynamicMethod), show_default=True)
@click.option("--model", default="edge", show_default=True, help="Shipped model or file.")
@click.option("--repeats", type=click.IntRange(1), default=3, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--json", "json_wanted", is_flag=True, help="Print JSON for programs.")
def main(
    terrain: tuple[Path, ...],
    rescale: float | None,
    cell_size: float | None,
    workload: str,
    size: int,
    count: int,
    methods: str,
    model: str,
    repeats: int,
    seed: int,
    json_wanted: bool,
) -> None:
    """The paper's dynamic scene on terrain: every method through the same episodes."""
    from nnpp_edge.progress import bar

    names = dynamic_methods(methods)
    dems = TerrainFiles(terrain, rescale, cell_size).read()
    check_sizes(dems, (size,))
    episodes = islice(episodes_of(terrain_cases(dems, workload, size, seed, LEAST_DISTANCE), seed), count)
    with bar("dynamic scene", count) as advance:
        rows = run_scene(episodes, names, model=model, repeats=repeats, progress=advance)
    click.echo(json.dumps(as_json(rows), indent=1) if json_wanted else render(rows))


def dynamic_methods(joined: str) -> list[str]:
    """The methods named in `--methods`, joined by commas; click.UsageError if there is no such method."""
    names = [name.strip() for name in joined.split(",")]
    if unknown := set(names) - set(DynamicMethod):
        raise click.UsageError(f"--methods must be of {', '.join(DynamicMethod)}, got {', '.join(sorted(unknown))}")
    return names


def run_alone(command: Callable[[], None]) -> None:
    """Run a benchmark's command: an error of ours is one line and exit code 2."""
    try:
        command()
    except NnppEdgeError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    run_alone(main)
