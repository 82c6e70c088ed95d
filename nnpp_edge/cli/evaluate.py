"""`nnpp-edge evaluate`: the planners beside each other."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import Limit, TerrainOptions, VehicleOptions
from nnpp_edge.cli.text import columns, table, tell
from nnpp_edge.runtime.options import StepOptions

if TYPE_CHECKING:
    from nnpp_edge.profiling.rows import Facts
    from nnpp_edge.profiling.suites import Case

_WORKLOADS = (
    "soft, limit20, limit15 or any limitN; with a vehicle body, body-rocks10 or any body-rocksN."
)
_MODEL = "Shipped model or file for nnpp of a point; several are compared."
_FRESH_MAP = "Also from elevations to the path on a map that has just arrived, lazily and eagerly."
_STRIPE = "The share of each file that `nnpp-edge dataset` left out, for --held-out."
_MIN_DISTANCE = "Between start and goal, as a share of the map's side."
_MODELS = Annotated[tuple[str, ...], "--model", options.MODEL, options.MANY, _MODEL]

_JUDGED = (
    "success: success_raw .1% | after/fallback: success .1% | gap/mean: gap_mean z.2% | "
    "gap/p99: gap_p99 z.2%"
)
_COLUMNS = columns(
    f"workload | size | method | n | {_JUDGED} | ms/median: time_ms_median | ms/p99: time_ms_p99 | "
    "speed-up/median: speedup_median | speed-up/total: speedup_total | "
    "expan-/sions: expansions_median | region: region_share_mean .1% | MM: mm_mean | CC: cc_mean"
)
_FRESH_COLUMNS = columns(
    "workload | size | method | n | elevation →/path, ms: fresh_ms_median | p99: fresh_ms_p99 | "
    "times as fast as/astar-eager: fresh_speedup_median | "
    "costs/computed: costs_computed_mean .1% | gap/mean: fresh_gap_mean z.2% | "
    "gap/p99: fresh_gap_p99 z.2% | standing/map, ms: time_ms_median"
)
_BODY_COLUMNS = columns(
    f"workload | size | method | n | without/a path: unsolvable | {_JUDGED} | "
    "poses/checked: checks_mean | of all: checks_share_mean .1% | "
    "expan-/sions: expansions_median | ms/median: time_ms_median | ms/p95: time_ms_p95 | "
    "ms/p99: time_ms_p99 | "
    "elevation →/path, ms: fresh_ms_median | p99: fresh_ms_p99 | "
    "p99 without/fallback: fresh_ms_p99_first"
)


@options.command("evaluate")
def command(
    *,
    terrain: options.TerrainFiles = (),
    cell_size: options.CellSize = None,
    rescale: options.Rescale = None,
    workloads: Annotated[tuple[str, ...], "--workload", options.NAMES, _WORKLOADS] = ("soft",),
    limit: Limit = (),
    steps: StepOptions,
    synthetic: Annotated[bool, "Use synthetic terrain instead."] = False,
    sizes: Annotated[tuple[int, ...], options.SIZES, "Sides of the maps."] = (256,),
    queries: Annotated[int, "For each row."] = 300,
    validation_share: Annotated[float, options.Real(0.0, 1.0, max_open=True), _STRIPE] = 0.0,
    held_out: Annotated[bool, "Evaluate on that stripe alone."] = False,
    min_distance: Annotated[float, options.SHARE, _MIN_DISTANCE] = 0.35,
    methods: Annotated[tuple[str, ...], options.NAMES] = ("astar", "corridor", "nnpp"),
    models: _MODELS = ("edge",),
    robot: VehicleOptions,
    repeats: Annotated[int, "Times each planner answers each query; its median time counts."] = 3,
    fresh_map: Annotated[bool, _FRESH_MAP] = False,
    seed: options.Seed = 1,
    as_json: options.AsJson = False,
) -> None:
    """Compare planners on many queries, in one interleaved run.

    Every planner gets the same maps and queries, in turns. Speed-ups and gaps are against exact A*
    on the same query. Times count the whole job, widening and fallback included.

    Beside nnpp stand two controls that have learned nothing: a corridor with the learned region's
    narrow bands (corridor-narrow), and edge after three steps of training (nnpp-untrained).

    With --fresh-map each planner is also made from the elevations for every query, all of it timed.

    With --step-cost all planners use costs by the slope; the network was trained for costs without
    a direction.

    The workloads body and body-rocksN, rocks on N percent of the ground, need a vehicle: every
    query gets a new planner, which has checked no poses.

    \b
    nnpp-edge evaluate --terrain dem.tif --rescale 20 --workload soft,limit15 --sizes 256,512
    nnpp-edge evaluate --terrain dem.tif --rescale 20 --sizes 256,1024 --fresh-map
    nnpp-edge evaluate --terrain dem.tif --held-out --validation-share 0.2 --model own.onnx
    nnpp-edge evaluate --terrain dem.tif --vehicle small-rover --workload body,body-rocks10
    """
    from nnpp_edge.profiling import suites
    from nnpp_edge.profiling.evaluate import EAGER, evaluate, evaluated
    from nnpp_edge.profiling.rivals import controls, exact_and
    from nnpp_edge.progress import bar
    from nnpp_edge.runtime.network.inference import NetworkModel
    from nnpp_edge.runtime.planners.plan import Method
    from nnpp_edge.terrain.shards import stripe_of
    from nnpp_edge.terrain.workloads import of_bodies

    if bool(terrain) == synthetic:
        raise click.UsageError("give either --terrain FILE or --synthetic")
    if held_out != bool(validation_share) or (held_out and synthetic):
        raise click.UsageError("--held-out and --validation-share go together, with --terrain")
    if unknown := set(methods) - set(Method):
        raise click.UsageError(
            f"--methods must be of {', '.join(Method)}, got {', '.join(sorted(unknown))}"
        )
    body = robot.body()
    bodies = of_bodies(workloads)
    if bodies and body is None:
        raise click.UsageError(f"--workload {bodies[0]} needs a vehicle: give --vehicle")
    if body and not bodies:
        raise click.UsageError("--vehicle is for the workloads body and body-rocksN")
    if robot.step_cost != "paper":
        robot.mobility().model(robot.step_cost)  # refused now
    own = {
        name: TerrainOptions(limit=limit, workload="soft" if name in bodies else name).limits()
        for name in workloads
    }
    asked = {Method.NNPP, Method.AUTO} & set(methods) and bodies != [*workloads]
    networks = {Path(name).stem: NetworkModel(name) for name in (models if asked else ())}
    without_network = [name for name in methods if name != Method.NNPP]
    of_point = exact_and(methods, networks)
    if networks and Method.NNPP in methods:
        of_point += controls()
    of_body = exact_and(without_network, {})
    dems = [] if synthetic else suites.dems_of(terrain, rescale, cell_size)
    if held_out:
        dems = [stripe_of(dem, (1.0 - validation_share, 1.0)) for dem in dems]
    suites.check_sizes(dems, sizes)
    mobility = robot.mobility(*dems[:1])

    def cases(name: str, size: int) -> "Iterator[Case]":
        for case in suites.terrain_cases(dems, name, size, seed, min_distance, body, own[name]):
            ground = replace(case.ground, step_cost=robot.step_cost, mobility=mobility)
            yield replace(case, ground=ground)

    runs = list(product(workloads, sizes))
    rows: list[Facts] = []
    with bar("evaluate", queries * len(runs)) as advance:
        for at, (name, size) in enumerate(runs):
            answers = evaluate(
                cases(name, size),
                [replace(each, **steps) for each in (of_body if name in bodies else of_point)],
                queries,
                repeats=repeats,
                fresh_map=fresh_map,
                progress=lambda done, before=at * queries: advance(before + done),  # type: ignore[misc]
            )
            words = " ".join([name, *(each.word for each in limit)])
            rows += [{"workload": words, "size": size, **row} for row in evaluated(answers)]
    of_bodies_rows = [row for row in rows if "checks_mean" in row]
    of_points = [row for row in rows if "checks_mean" not in row]
    standing = [row for row in of_points if not str(row["method"]).endswith(EAGER)]

    def text() -> str:
        fresh = of_points if fresh_map else []
        tables = ((standing, _COLUMNS), (fresh, _FRESH_COLUMNS), (of_bodies_rows, _BODY_COLUMNS))
        return "\n\n".join(table(each, as_) for each, as_ in tables if each)

    tell(as_json, rows, text, indent=1)
