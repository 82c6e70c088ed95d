"""`nnpp-edge learn`: a network for one's own ground, and whether it is worth keeping."""

import io
import shlex
from contextlib import redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import click
import msgspec

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import TerrainOptions
from nnpp_edge.cli.text import columns, table
from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.options import Omega

SIZES = (64, 128, 256)
"""Sides of the training's maps, of which the largest that fits is taken; `edge` is shown 64²."""
VALIDATED_ON = 128
"""Maps of the stripe that is held out, for validation."""
MOST_COMPARED = 2048
"""Cells to a side of the map that planners are compared on, at most."""
OWN = "own"
"""Name of the network that is made."""
_COLUMNS = columns(
    "planner: method | first/region: success_raw .1% | gap/mean: gap_mean z.2% | "
    "gap/p99: gap_p99 z.2% | ms/median: time_ms_median | times as fast/as astar: speedup_median"
)


def output_of(words: list[str]) -> str:
    """What a command prints on stdout; it ends this one, too, where its exit code is not 0."""
    from nnpp_edge.cli.main import cli

    with redirect_stdout(io.StringIO()) as out:
        code = cli.main(words, prog_name="nnpp-edge", standalone_mode=False)
    if code:
        click.echo(out.getvalue(), nl=False)
        click.get_current_context().exit(code)
    return out.getvalue().rstrip()


@options.command("learn")
def command(
    elevations: Annotated[Path, options.MAP, {"metavar": "MAP"}],
    /,
    *,
    output: Annotated[Path, "-o", options.FOLDER, "Folder of all files; resumed if begun."],
    time_limit: Annotated[float, options.POSITIVE, "Minutes of training, about."] = 15.0,
    validation_share: Annotated[
        float,
        options.Real(0.01, 0.5),
        "Share of the map, a stripe at the end of its longer side, that is kept to judge by.",
    ] = 0.25,
    maps: Annotated[int, "Number of maps to train on."] = 2048,
    queries: Annotated[int, "To compare the planners on."] = 600,
    terrain: TerrainOptions,
    omega: Omega = 0.011,
    seed: options.Seed = 1,
    as_json: options.AsJson = False,
) -> None:
    """Train a network on your own MAP, and tell whether it is worth keeping.

    A stripe of MAP is held out. From the rest a data set is made and a network of the architecture
    edge trained, exported and quantised. On the stripe it is compared with exact A*, with corridor,
    which needs no network, and with the shipped edge. Limits are those of nnpp-edge plan.

    Each step is a command whose line is printed. The same command continues where it was stopped:
    data sets and a training that are complete are not made again.

    \b
    nnpp-edge learn dem.tif -o own --time-limit 15
    """
    from nnpp_edge.terrain.dem import read_dem

    terrain = replace(terrain, workload=terrain.workload or "safe")
    terrain.limits()  # refused now
    shape = read_dem(elevations, terrain.cell_size).shape
    room = min(*shape, round(validation_share * max(shape)))
    fitting = [size for size in SIZES if size <= room]
    if not fitting:
        wanted = f"at least {SIZES[0]} cells across the stripe that --validation-share holds out"
        raise InvalidQueryError(f"{elevations}: wanted {wanted}, got {room}: {shape}")
    make_folder(output)

    ground = ["--size", fitting[-1], "--validation-share", validation_share, "--omega", omega]
    ground += ["--own-cell-size"] if terrain.rescale is None else ["--rescale", terrain.rescale]
    ground += ["--workload", terrain.workload]
    ground += [word for limit in terrain.limit for word in ("--limit", limit.word)]
    if terrain.cell_size is not None:
        ground += ["--cell-size", terrain.cell_size]
    data, held_out, run = (output / name for name in ("data", "data-held-out", "run"))
    fp32, int8 = (output / f"{name}.onnx" for name in ("fp32", "int8"))
    drawn = ["--maps", VALIDATED_ON, "--seed", seed + 1, "--synthetic-share", 0, "--held-out"]
    judged = ["--validation", held_out]
    steps = [
        ["dataset", elevations, "-o", data, *ground, "--maps", maps, "--seed", seed],
        ["dataset", elevations, "-o", held_out, *ground, *drawn],
        ["train", data, "-o", run, *judged, "--time-limit", time_limit, "--seed", seed],
        ["export", run / "best.pt", "-o", fp32, "--name", OWN, "--dataset", data],
        ["quantize", fp32, "-o", int8, "--dataset", data, *judged, "--seed", seed],
    ]
    tell = partial(click.echo, err=as_json)
    for number, words in enumerate(steps, 1):
        line = list(map(str, words))
        tell(f"[{number}/6] {shlex.join(['nnpp-edge', *line])}")
        tell(output_of(line))

    beside = "exact A*, corridor, edge and controls"
    tell(f"[6/6] {int8}, {beside} on {queries} queries of the stripe")
    tell(_compared(int8, held_out, terrain, omega, queries, seed))
    if as_json:
        click.echo((output / "comparison.json").read_text())


def _compared(
    network: Path,
    held_out: Path,
    terrain: TerrainOptions,
    omega: float,
    queries: int,
    seed: int,
) -> str:
    """The network beside other planners on the stripe, in words; figures in a file beside it."""
    from nnpp_edge.profiling.evaluate import evaluate, evaluated
    from nnpp_edge.profiling.quantities import EXACT
    from nnpp_edge.profiling.rivals import RivalPlanner, controls, exact_and
    from nnpp_edge.profiling.suites import terrain_cases
    from nnpp_edge.profiling.worth import beside, verdict
    from nnpp_edge.progress import bar
    from nnpp_edge.runtime.network.inference import NetworkModel
    from nnpp_edge.runtime.planners.plan import Method
    from nnpp_edge.terrain.dataset import read_recipe
    from nnpp_edge.terrain.shards import read_terrain

    (stripe,) = read_terrain(read_recipe(held_out))
    if terrain.rescale is not None:
        stripe = stripe.rescaled(terrain.rescale)
    size = min(MOST_COMPARED, *stripe.shape)
    name = str(terrain.workload)
    cases = terrain_cases([stripe], name, size, seed, limits=terrain.limits())
    networks = (OWN, network), ("edge", "edge")
    learned = [RivalPlanner(name, Method.NNPP, NetworkModel(file)) for name, file in networks]
    rivals = exact_and(["corridor"], {}) + learned + controls()
    rivals = [replace(each, omega=omega) for each in rivals]
    with bar("compare", queries) as advance:
        rows = evaluate(cases, rivals, queries, progress=advance)
    figures = evaluated(rows)
    of = rows.by("planner")
    pairs = [beside(name, of[OWN], of[name]) for name in of if name not in (EXACT, OWN)]
    by_method = {each["method"]: each for each in figures}
    told = {"network": str(network), "verdict": verdict(pairs), "beside": pairs, "rows": by_method}
    content = msgspec.json.format(msgspec.json.encode(told), indent=1)
    write_whole(network.with_name("comparison.json"), content)
    lines = [table(figures, _COLUMNS)]
    for each in pairs:
        gap = f"mean gaps differ by {each.gap_points} points"
        speed = f"{each.times_as_fast} times as fast in the median"
        lines.append(f"{OWN} beside {each.other}: {gap}, {speed}: {each.judgement}")
    lines.append(
        f"{len(of[OWN])} queries on maps of {size} × {size} cells that it was not trained on; "
        "brackets: 95 %, had other queries been drawn there"
    )
    lines.append(f"verdict: {told['verdict']}")
    return "\n".join(lines)
