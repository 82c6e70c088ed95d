"""The paper's dynamic scene (NNPP, section 5.5, Tables 3 and 4) as a benchmark.

All methods answer the same queries on the same maps, those of an `Episode`.
``python -m nnpp_edge.benchmarks.dynamic_scene --terrain FILE`` prints both tables.
"""

import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.benchmarks.dynamic_episode import LEAST_DISTANCE, STRIDE, Episode, terrain_episodes
from nnpp_edge.profiling.suites import TerrainSuite
from nnpp_edge.runtime.errors import NnppEdgeError, Status
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod, Plan


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
    """Have every method live through the same episodes, one after another at each step, in an order drawn anew.

    Parameters
    ----------
    episodes : iterable of Episode
        Made with the same `stride`.
    methods : sequence of str
        Of `DynamicMethod`; exact A* always takes part.
    model : str or Path
        For the methods that ask a network: a shipped model's name, or a file.
    repeats : int
        So often every episode is lived through by new planners, after once without the clock; a step's median
        time counts.
    progress : callable
        Told how many episodes are done.

    Returns
    -------
    list of SceneRow
        By episode, step and method.

    Notes
    -----
    A step's time is the map's update, the network's view of it, and the plan with every widening and fallback.
    What depends on the first map alone is made before the clock starts, for all methods alike.
    """
    names = list(dict.fromkeys((DynamicMethod.ASTAR, *map(DynamicMethod, methods))))
    # a model each: a planner whose model has just seen another's map would show it its own again
    models = {DynamicMethod(name): NetworkModel(model) for name in names if str(name).startswith("nnpp")}
    rows: list[SceneRow] = []
    for at, episode in enumerate(episodes):
        times = np.empty((repeats + 1, len(episode.steps), len(names)))
        for turn in range(repeats + 1):
            answers = _live_through(episode, names, models, turn, times[turn])
        medians = np.median(times[1:], axis=0) if repeats else times[0]
        for step, plans in enumerate(answers):
            walked = stride if step + 1 < len(answers) else None
            for number, name in enumerate(names):
                plan, share, walk = plans[name], *_figures(plans[name], episode, step, walked)
                exact = plans[DynamicMethod.ASTAR]
                rows.append(
                    SceneRow(
                        at, step, str(name), str(plan.by), str(plan.status), str(plan.source or ""),
                        float(medians[step, number]), plan.cost, plan.traverse_cost, exact.cost, exact.traverse_cost,
                        walk, plan.expansions, share,
                    )
                )  # fmt: skip
        progress(at + 1)
    return rows


def totals(rows: Sequence[SceneRow], *, static: bool = False) -> list[SceneTotal]:
    """A line for each method: over whole episodes, or with `static` over the first plans alone (Table 4, ``-s``)."""
    chosen = [row for row in rows if row.step == 0 or not static]
    out = []
    spent = {m: sum(r.time_ms for r in chosen if r.method == m) for m in dict.fromkeys(r.method for r in chosen)}
    for method, ms in spent.items():
        own = [row for row in chosen if row.method == method]
        solved = [row for row in own if row.status == Status.OK]
        cc, best_cc = sum(row.cc for row in solved), sum(row.optimal_cc for row in solved)
        cost, best = sum(row.cost for row in solved), sum(row.optimal_cost for row in solved)
        dstar = spent.get(str(DynamicMethod.DSTAR))
        out.append(
            SceneTotal(
                method, len(own), len(solved) / len(own), ms, spent[str(DynamicMethod.ASTAR)] / ms,
                None if dstar is None else dstar / ms, cc, cc / best_cc - 1.0 if best_cc else 0.0,
                cost / best - 1.0 if best else 0.0, sum(row.driven_cc for row in solved),
                sum(row.expansions for row in own),
            )
        )  # fmt: skip
    return out


def _live_through(
    episode: Episode,
    names: Sequence[DynamicMethod],
    models: Mapping[DynamicMethod, NetworkModel],
    turn: int,
    times: NDArray[np.float64],
) -> list[dict[DynamicMethod, Plan]]:
    """One life of new planners: milliseconds into `times` (steps, methods), and the answers of each step."""
    planners = {
        name: DynamicPlanner(episode.cost, episode.goal, name, model=models.get(name, "edge")) for name in names
    }
    for planner in planners.values():
        planner.prepare()
    answers, order = [], np.random.default_rng(turn)
    for at, step in enumerate(episode.steps):
        plans: dict[DynamicMethod, Plan] = {}
        for number in order.permutation(len(names)):  # so that none always finds its code warmed by the same other
            planner = planners[names[number]]
            began = time.perf_counter()
            for row, col, patch in step.patches:
                planner.update(row, col, patch)
            planner.move(step.start)
            plans[names[number]] = planner.replan()
            times[at, number] = 1e3 * (time.perf_counter() - began)
            if (region := plans[names[number]].region) is not None:  # read now: it lives in the planner's memory
                plans[names[number]].timings_ms["region_cells"] = float(region.area())
        answers.append(plans)
    return answers


def _figures(plan: Plan, episode: Episode, step: int, walked: int | None) -> tuple[float, float]:
    """Share of the map that was searched, and CC of the cells that the robot walks on this path."""
    share = plan.timings_ms.get("region_cells", float(episode.cost.size)) / episode.cost.size
    if not plan.ok:
        return share, 0.0
    cost = episode.map_at(step)
    part = plan.path[:walked]
    return share, float(cost[part[:, 0], part[:, 1]].astype(np.float64).sum())


def render(rows: Sequence[SceneRow]) -> str:
    """Table 3 (by step, means over the episodes) and Table 4 (static and dynamic totals) for people."""
    from nnpp_edge.progress import render_table

    methods = list(dict.fromkeys(row.method for row in rows))
    body = []
    for step in range(max(row.step for row in rows) + 1):
        line = [f"T + {step}Δt" if step else "T", str(sum(r.step == step and r.method == methods[0] for r in rows))]
        for method in methods:
            own = [row for row in rows if row.step == step and row.method == method and row.status == Status.OK]
            empty = ["–", "–"]
            line += (
                [f"{np.mean([r.time_ms for r in own]):.2f}", f"{np.mean([r.cc for r in own]):.2f}"] if own else empty
            )
        body.append(line)
    header = ["frame", "n", *(f"{name}\n{what}" for name in methods for what in ("ms", "CC"))]
    tables = [render_table(header, body)]
    lines = [
        [kind, t.method, str(t.plans), f"{100 * t.solved:.0f} %", f"{t.time_ms:.2f}", f"{t.speedup_astar:.2f}",
         "–" if t.speedup_dstar is None else f"{t.speedup_dstar:.2f}", f"{t.cc:.2f}", f"{100 * t.cc_excess:+.2f} %",
         f"{100 * t.cost_excess:+.2f} %", f"{t.driven_cc:.2f}", str(t.expansions)]
        for kind, static in (("static", True), ("dynamic", False)) for t in totals(rows, static=static)
    ]  # fmt: skip
    header = ["scene", "method", "plans", "solved", "ms", "over A*", "over D*", "CC", "CC\nexcess", "cost\nexcess",
              "CC\ndriven", "expansions"]  # fmt: skip
    return "\n".join([*tables, render_table(header, lines, sections=[line[1] == "astar" for line in lines])])


def as_json(rows: Sequence[SceneRow]) -> dict[str, Any]:
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
@click.option("--episodes", type=click.IntRange(1), default=5, show_default=True)
@click.option("--methods", default=",".join(DynamicMethod), show_default=True)
@click.option("--model", default="edge", show_default=True, help="Shipped model or file.")
@click.option("--repeats", type=click.IntRange(1), default=3, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--json", "json_wanted", is_flag=True, help="Print JSON for programs.")
def main(
    terrain: tuple[Path, ...], rescale: float | None, cell_size: float | None, workload: str, size: int,
    episodes: int, methods: str, model: str, repeats: int, seed: int, json_wanted: bool,
) -> None:  # fmt: skip
    """The paper's dynamic scene on terrain: every method through the same episodes."""
    from nnpp_edge.progress import bar

    suite = TerrainSuite(terrain, (workload,), (size,), seed, rescale, cell_size, LEAST_DISTANCE)
    names = [name.strip() for name in methods.split(",")]
    if unknown := set(names) - set(DynamicMethod):
        raise click.UsageError(f"--methods must be of {', '.join(DynamicMethod)}, got {', '.join(sorted(unknown))}")
    with bar("dynamic scene", episodes) as advance:
        scenes = terrain_episodes(suite, workload, size, episodes)
        rows = run_scene(scenes, names, model=model, repeats=repeats, progress=advance)
    click.echo(json.dumps(as_json(rows), indent=1) if json_wanted else render(rows))


if __name__ == "__main__":
    try:
        main()
    except NnppEdgeError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(2)
