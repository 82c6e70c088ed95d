"""`nnpp-edge learn`: a network for one's own ground, and whether it is worth keeping."""

import io
import math
import shlex
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click
import msgspec

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import TerrainOptions
from nnpp_edge.cli.text import columns, table
from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.profiling.contest import Figures
from nnpp_edge.profiling.worth import BETTER, KEEP, OPEN, Beside, Interval, beside, verdict
from nnpp_edge.runtime.errors import InvalidQueryError, OutputError
from nnpp_edge.runtime.options import Omega
from nnpp_edge.runtime.reading import refused_as

if TYPE_CHECKING:
    from nnpp_edge.runtime.terrain.traversability import Traversability
    from nnpp_edge.terrain.dem import Dem

_OWN = "own"
"""Name of the network, in its file and in the table."""
_NAMES = {"astar": "exact A*", "corridor": "corridor", "nnpp:edge": "edge", "nnpp": _OWN}
"""The planners, as the table calls them."""
_REGION_FACTOR = 0.2
"""On the adaptive threshold: that of the shipped `edge`, so that only the weights differ."""
_INPUT = 64
"""Side of the network's input."""
_LARGEST = 256
"""Side of the training's maps at most: such a map is shown averaged over 4 × 4 cells."""
VALIDATED_ON = 128
"""Maps of the stripe that is held out, for validation."""
_MOST_COMPARED = 512
"""Cells to a side of the maps that planners are compared on, at most."""
_MINUTES = "Minutes of training, about."
_SHARE = (
    "Share of the map, a stripe at the end of its longer side, that is not trained on, to judge by."
)
_COLUMNS = columns(
    "planner: method | first/region: success_raw .1% | gap/mean: gap_mean z.2% | "
    "gap/p99: gap_p99 z.2% | ms/median: time_ms_median | times as/fast: speedup_total"
)


class Step(msgspec.Struct):
    """A step that was made, as `learn.json` keeps it."""

    line: str
    """The command, or what it does."""
    answer: str
    """What it printed, or its figures as JSON."""


class Comparison(msgspec.Struct):
    """The network beside other planners, on ground that it was not trained on."""

    network: str
    shape: tuple[int, int]
    """Of the maps, in cells."""
    figures: list[Figures]
    beside: list[Beside]
    verdict: str


class Steps:
    """Steps that are made one after another. Those that were made before are not repeated, unless
    their lines or that of a step before have changed.
    """

    def __init__(self, folder: Path, count: int, show: Callable[[str], None]) -> None:
        self._file = folder / "learn.json"
        self._count = count
        self._show = show
        self._made: list[Step] = []
        self._before: list[Step] = []
        if self._file.exists():
            with refused_as(OutputError, f"{self._file}: wanted the steps of nnpp-edge learn"):
                self._before = msgspec.json.decode(self._file.read_bytes(), type=list[Step])

    def answer(self, line: str, make: Callable[[], str]) -> str:
        """The answer of the next step, which is made if need be."""
        self._show(f"[{len(self._made) + 1}/{self._count}] {line}")
        if self._before and self._before[0].line == line:
            step = self._before.pop(0)
        else:
            self._before.clear()
            step = Step(line, make())
        self._made.append(step)
        content = msgspec.json.encode([*self._made, *self._before])
        write_whole(self._file, msgspec.json.format(content, indent=1))
        return step.answer

    def command(self, *words: object) -> str:
        """What a command prints, which is shown."""
        line = list(map(str, words))
        printed = self.answer(shlex.join(["nnpp-edge", *line]), partial(_printed, line))
        self._show(printed)
        return printed


def _printed(words: list[str]) -> str:
    """What a command prints on stdout; its exit code is this one's, too, if it is not 0."""
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
    time_limit: Annotated[float, options.POSITIVE, _MINUTES] = 15.0,
    validation_share: Annotated[float, options.Real(0.01, 0.5), _SHARE] = 0.25,
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

    Each step is a command whose line is printed. The same command continues where it was stopped; a
    step is repeated if its line has changed.

    \b
    nnpp-edge learn dem.tif -o own --time-limit 15
    """
    from nnpp_edge.terrain.dem import read_dem

    limits = terrain.limits()
    dem = read_dem(elevations, terrain.cell_size)
    side = _side_of_maps(dem, validation_share)
    make_folder(output)
    steps = Steps(output, 6, partial(click.echo, err=as_json))

    ground = ["--size", side, "--validation-share", validation_share, "--omega", omega]
    ground += ["--own-cell-size"] if terrain.rescale is None else ["--rescale", terrain.rescale]
    ground += ["--workload", terrain.workload or "safe"]
    for limit in terrain.limit:
        ground += ["--limit", limit.word]
    if terrain.cell_size is not None:
        ground += ["--cell-size", terrain.cell_size]
    data = output / "data"
    held_out = output / "data-held-out"
    drawn = ["--maps", maps, "--seed", seed]
    steps.command("dataset", elevations, "-o", data, *ground, *drawn)
    drawn = ["--maps", VALIDATED_ON, "--seed", seed + 1, "--synthetic-share", 0, "--held-out"]
    steps.command("dataset", elevations, "-o", held_out, *ground, *drawn)

    run = output / "run"
    chosen = ["--validation", held_out, "--time-limit", time_limit, "--seed", seed]
    steps.command("train", data, "-o", run, *chosen)
    best = run / "best.pt"
    checkpoint = best if best.exists() else run / "checkpoint.pt"
    fp32 = output / "fp32.onnx"
    facts = ["--name", _OWN, "--region-factor", _REGION_FACTOR, "--dataset", data]
    steps.command("export", checkpoint, "-o", fp32, *facts)
    int8 = output / "int8.onnx"
    sets = ["--dataset", data, "--validation", held_out, "--seed", seed]
    recommended = steps.command("quantize", fp32, "-o", int8, *sets).splitlines()[-1]

    network = int8 if recommended.startswith("int8") else fp32
    compare = partial(_compare, network, held_out, terrain, limits, omega, queries, seed)
    line = f"{network} beside exact A*, corridor and edge, on {queries} queries of the stripe"
    answer = steps.answer(line, compare)
    if as_json:
        click.echo(answer)
    else:
        click.echo(_text(msgspec.json.decode(answer, type=Comparison), elevations, queries))


def _side_of_maps(dem: "Dem", validation_share: float) -> int:
    """Side of the training's maps, which fit into the stripe that is held out."""
    longer = max(dem.shape)
    stripe = longer - round((1.0 - validation_share) * longer)
    room = min(*dem.shape, stripe)
    if room >= _INPUT:
        return max(side for side in (_INPUT, 2 * _INPUT, _LARGEST) if side <= room)
    wanted = f"wanted room for maps of {_INPUT} × {_INPUT} cells in the stripe that is held out"
    share = math.ceil(100 * _INPUT / longer) / 100
    way_out = "a larger map"
    if min(dem.shape) >= _INPUT and share <= 0.5:
        way_out = f"--validation-share {share:g}"
    rows, cols = dem.shape
    raise InvalidQueryError(
        f"{dem.source}: {wanted}, got {room} cells of {rows} × {cols}: give {way_out}"
    )


def _compare(
    network: Path,
    held_out: Path,
    terrain: TerrainOptions,
    limits: "Traversability",
    omega: float,
    queries: int,
    seed: int,
) -> str:
    """A `Comparison` as JSON."""
    from nnpp_edge.profiling.evaluate import answers, figures_of
    from nnpp_edge.profiling.rivals import exact_and
    from nnpp_edge.profiling.suites import part_cases
    from nnpp_edge.progress import bar
    from nnpp_edge.runtime.network.inference import NetworkModel
    from nnpp_edge.terrain.dataset import read_recipe
    from nnpp_edge.terrain.shards import read_terrain

    (stripe,) = read_terrain(read_recipe(held_out))
    if terrain.rescale is not None:
        stripe = stripe.rescaled(terrain.rescale)
    rows, cols = (min(_MOST_COMPARED, cells) for cells in stripe.shape)
    networks = {_OWN: NetworkModel(network), "edge": NetworkModel("edge")}
    rivals = [replace(rival, omega=omega) for rival in exact_and(("corridor", "nnpp"), networks)]
    cases = part_cases(stripe, terrain.workload or "safe", _MOST_COMPARED, limits, seed)
    with bar("compare", queries) as advance:
        found = answers(cases, rivals, queries, progress=advance)
    own = found.rows["nnpp"]
    pairs = [beside(name, own, found.rows[name]) for name in ("corridor", "nnpp:edge")]
    figures = list(figures_of(found, rivals).values())
    compared = Comparison(str(network), (rows, cols), figures, pairs, verdict(pairs))
    return msgspec.json.encode(compared).decode()


def _text(found: Comparison, elevations: Path, queries: int) -> str:
    """A comparison for people."""
    rows = [{**row, "method": _NAMES[str(row["method"])]} for row in found.figures]
    lines = [table(rows, _COLUMNS)]
    for each in found.beside:
        gap = each.gap_points
        change = "larger" if gap.value > 0.0 else "smaller"
        lines.append(
            f"{_OWN} beside {_NAMES[each.other]}: mean gap {abs(gap.value):.2f} points {change} "
            f"({_range(gap)}), {each.times_as_fast.value:.2f} times as fast "
            f"({_range(each.times_as_fast)}): {each.judgement}"
        )
    rows_and_cols = "{} × {}".format(*found.shape)
    lines.append(
        f"{queries} queries on ground that it was not trained on, maps of {rows_and_cols} cells; "
        "brackets: 95 %, had other queries been drawn there"
    )
    lines.append(f"verdict: {found.verdict}; {_advice(found, elevations, queries)}")
    return "\n".join(lines)


def _advice(found: Comparison, elevations: Path, queries: int) -> str:
    """What to do after a verdict."""
    if found.verdict == KEEP:
        return f"nnpp-edge plan {elevations} --method nnpp --model {found.network}"
    if found.verdict == OPEN:
        return f"--queries {4 * queries} halves the intervals; until then take corridor"
    better = [each for each in found.beside if each.judgement != BETTER]
    return f"take {_NAMES[better[0].other]}"


def _range(interval: Interval) -> str:
    return f"{interval.low:.2f} to {interval.high:.2f}"
