"""The paper's dynamic scene (NNPP, section 5.5, Table 4) as a benchmark.

All methods answer the same queries on the same maps, those of an `Episode`.
``python -m nnpp_edge.benchmarks.dynamic_scene --terrain FILE`` prints the table; `nnpp-edge reproduce table3 table4`
sets it beside the paper's figures.
"""

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import click
import numpy as np

from nnpp_edge.benchmarks.dynamic_episode import LEAST_DISTANCE, STRIDE, Episode, Step, episodes_of
from nnpp_edge.profiling.contest import Columns, Figures, Row, Summary, gap, mean, summarised
from nnpp_edge.profiling.harness import Harness
from nnpp_edge.profiling.suites import TerrainFiles, check_sizes, terrain_cases
from nnpp_edge.runtime.errors import NnppEdgeError
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.planners.dynamic import DynamicPlanner
from nnpp_edge.runtime.planners.plan import DynamicMethod, Method, Plan, Source

EXACT, DSTAR = str(DynamicMethod.ASTAR), str(DynamicMethod.DSTAR)


def run_scene(
    episodes: Iterable[Episode],
    methods: Sequence[str],
    *,
    model: str | Path = "edge",
    repeats: int = 3,
    stride: int = STRIDE,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Row]:
    """Have every method go through the same episodes, one after another at each step, in an order drawn anew.

    The episodes are made with the same `stride`; exact A* always takes part. New planners go through every episode
    `repeats` times, after once without the clock; a step's median time counts. `progress` is called with the number
    of episodes that are done. Rows come by episode, step and method.

    Notes
    -----
    A step's time is the map's update, the network's view of it, and the plan with every widening and fallback.
    What depends on the first map alone is made before the clock starts, for all methods alike.
    """
    names = [str(name) for name in dict.fromkeys((DynamicMethod.ASTAR, *map(DynamicMethod, methods)))]
    network = NetworkModel(model) if any(DynamicMethod(name).base is Method.NNPP for name in names) else "edge"
    rows: list[Row] = []
    for at, episode in enumerate(episodes):
        lives = [_one_life(episode, names, network, turn) for turn in range(repeats + 1)]
        for step, (before, first) in enumerate(zip(episode.steps, lives[0], strict=True)):
            answers = {name: plan for name, (_, plan) in lives[-1][step].items()}
            cost, walked = episode.map_at(step), stride if step + 1 < len(episode.steps) else None
            for name, plan in answers.items():
                times_ms = [1e3 * life[step][name][0] for life in lives[1:] or lives]
                region = first[name][1].region
                figures = {
                    "episode": at,
                    "step": step,
                    "time_ms": float(np.median(times_ms)),
                    "solved": plan.ok,
                    "first": plan.source in (Source.MAP, Source.REGION),
                    "mended": plan.choice.startswith("mended"),
                    "expansions": plan.expansions,
                    "region_share": 1.0 if region is None else region.area() / cost.size,
                }
                if plan.ok:
                    figures |= {"cost": plan.cost, "optimal_cost": answers[EXACT].cost, "cc": plan.traverse_cost}
                    driven = cost[tuple(plan.path[:walked].T)].sum(dtype=np.float64)
                    figures |= {"optimal_cc": answers[EXACT].traverse_cost, "driven_cc": float(driven)}
                rows.append(Row(name, (before.start, episode.goal), figures))
        progress(at + 1)
    return rows


def _one_life(
    episode: Episode, names: Sequence[str], network: NetworkModel | str, turn: int
) -> list[dict[str, tuple[float, Plan]]]:
    """Seconds and plans of new planners, step by step; in the first turn, not timed, they keep their regions."""
    calls: dict[str, Callable[[Step], Plan]] = {}
    for name in names:
        planner = DynamicPlanner(episode.cost, episode.goal, name, model=network)
        planner.prepare()
        calls[name] = partial(_replan, planner, keep_regions=not turn)
    life = Harness(turn).measure(calls, episode.steps)
    return [{name: (record.median_s, record.results[0]) for name, record in each.items()} for each in life]


def _replan(planner: DynamicPlanner, step: Step, *, keep_regions: bool) -> Plan:
    for patch in step.patches:
        planner.update(*patch)
    planner.move(step.start)
    return planner.replan(keep_regions=keep_regions)


def _sum(name: str) -> Callable[[Columns], float]:
    return lambda columns: sum(columns[name])


def _excess(name: str, optimum: str) -> Callable[[Columns], float]:
    return lambda columns: gap(sum(columns[name]), sum(columns[optimum]))


_TOTALS: Summary = {
    "plans": lambda columns: len(columns["step"]),
    "solved": mean("solved"),
    "time_ms": _sum("time_ms"),
    "cc": _sum("cc"),
    "cc_excess": _excess("cc", "optimal_cc"),
    "cost_excess": _excess("cost", "optimal_cost"),
    "driven_cc": _sum("driven_cc"),
    "expansions": _sum("expansions"),
}


def totals(rows: Sequence[Row], *, static: bool = False) -> list[Figures]:
    """A line for each method: over whole episodes, or with `static` over the first plans alone (Table 4, ``-s``).

    ``speedup_astar`` and ``speedup_dstar`` are the summed times of these over the method's; None where whole-map D*
    Lite did not take part.
    """
    chosen = [row for row in rows if row.figures["step"] == 0 or not static]
    names = dict.fromkeys(row.rival for row in chosen)
    spent_ms = {name: sum(row.figures["time_ms"] for row in chosen if row.rival == name) for name in names}
    return [
        {
            "method": name,
            **summarised((row for row in chosen if row.rival == name), _TOTALS),
            "speedup_astar": spent_ms[EXACT] / spent_ms[name],
            "speedup_dstar": spent_ms[DSTAR] / spent_ms[name] if DSTAR in spent_ms else None,
        }
        for name in names
    ]


_COLUMNS = {"method": "{}", "plans": "{}", "solved": "{:.0%}", "expansions": "{:.0f}"}
_COLUMNS |= dict.fromkeys(("time_ms", "speedup_astar", "speedup_dstar", "cc", "driven_cc"), "{:.2f}")
_COLUMNS |= dict.fromkeys(("cc_excess", "cost_excess"), "{:+.2%}")


def render(rows: Sequence[Row]) -> str:
    """Table 4 for people: summed over the first plans alone, static, and over all plans."""
    from nnpp_edge.progress import render_table

    lines = [
        [scene, *("–" if total[key] is None else form.format(total[key]) for key, form in _COLUMNS.items())]
        for scene in ("static", "dynamic")
        for total in totals(rows, static=scene == "static")
    ]
    sections = [line[1] == EXACT for line in lines]
    return render_table(["scene", *(key.replace("_", "\n") for key in _COLUMNS)], lines, sections=sections)


@click.command()
@click.option("--terrain", multiple=True, required=True, type=click.Path(path_type=Path), help="Elevation file.")
@click.option("--rescale", type=float, help="Rescale the terrain to cells of so many metres, slopes kept.")
@click.option("--workload", default="soft", show_default=True, help="soft, limit20, limit15 or any limitN.")
@click.option("--size", type=click.IntRange(64), default=256, show_default=True, help="Side of the maps.")
@click.option("--episodes", "count", type=click.IntRange(1), default=5, show_default=True)
@click.option("--methods", default=",".join(DynamicMethod), show_default=True)
@click.option("--model", default="edge", show_default=True, help="Shipped model or file.")
@click.option("--repeats", type=click.IntRange(1), default=3, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--json", "json_wanted", is_flag=True, help="Print JSON for programs.")
def main(
    methods: str, count: int, model: str, repeats: int, json_wanted: bool, size: int, seed: int, **of_ground: Any
) -> None:
    """The paper's dynamic scene on terrain: every method through the same episodes."""
    from nnpp_edge.progress import bar

    names = dynamic_methods(methods)
    dems = TerrainFiles(of_ground["terrain"], of_ground["rescale"]).read()
    check_sizes(dems, (size,))
    episodes = islice(
        episodes_of(terrain_cases(dems, of_ground["workload"], size, seed, LEAST_DISTANCE), seed), count
    )
    with bar("dynamic scene", count) as advance:
        rows = run_scene(episodes, names, model=model, repeats=repeats, progress=advance)
    facts = {"static": totals(rows, static=True), "dynamic": totals(rows), "rows": [asdict(row) for row in rows]}
    click.echo(json.dumps(facts, indent=1) if json_wanted else render(rows))


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
