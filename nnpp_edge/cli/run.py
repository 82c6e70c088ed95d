"""`nnpp-edge run`: the onboard loop as a program."""

from pathlib import Path
from typing import Any

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.costmap import make_rules, workload_option

_LIMITS = ("slope_limit", "roughness_limit", "step_limit", "hard_slope", "hard_roughness", "hard_step", "workload")


@click.command(name="run")
@click.option("--map", "map_file", type=options.PATH, required=True,
              help="Elevation map, or an .npz that `nnpp-edge costmap` has written.")  # fmt: skip
@click.option("--profile", metavar="NAME|FILE", help="A shipped profile or a TOML file; its table [loop] counts.")
@click.option("--input", "input_", default="stdin", show_default=True, metavar="stdin|replay:FILE|zenoh[:ENDPOINT]",
              help="Where patches, poses and goals come from.")  # fmt: skip
@click.option("--output", "outputs", multiple=True, metavar="stdout|zenoh[:ENDPOINT]|none",
              help="Where paths go; may be given several times. By default back to where inputs come from, and of a "
                   "replay to stdout.")  # fmt: skip
@click.option("--rate", "rate_hz", type=float, help="Ticks a second, in place of the profile's (else 17).")
@click.option("--method", help="Planner, in place of the profile's (else auto).")
@click.option("--model", help="Shipped network's name, or an ONNX file, in place of the profile's (else edge).")
@click.option("--cores", type=options.Numbers(), help="Pin the loop to these cores.")
@click.option("--priority", type=int, help="1 to 99: run the loop under SCHED_FIFO.")
@click.option("--tolerance", type=float,
              help="Keep a path while it can cost at most this share more than a new one (else 0.02).")  # fmt: skip
@click.option("--ticks", type=click.IntRange(1), help="End after so many.")
@click.option("--framing", type=click.Choice(["lines", "length"]), default="lines", show_default=True,
              help="On stdin and stdout: a message a line, or after its length in 4 bytes.")  # fmt: skip
@click.option("--fast", is_flag=True, help="Replay one recorded tick a tick, and ticks without a pause.")
@click.option("--stay", is_flag=True, help="Go on when stdin is closed or the replay is over.")
@click.option("--zenoh-connect", metavar="ENDPOINT", help="Go to this router or peer instead of listening.")
@click.option("--zenoh-prefix", default="nnpp_edge", show_default=True, help="First part of all topics.")
@click.option("--record", type=options.NEW_FILE, help="Write the inputs to this file, for replay.")
@click.option("--log", type=options.NEW_FILE, help="Write inputs and answers to this .mcap file.")
@click.option("--metrics-port", type=click.IntRange(0, 65535), help="Serve the counters to Prometheus at this port.")
@click.option("--metrics-file", type=options.NEW_FILE, help="Keep the counters in this file, in Prometheus' format.")
@options.view
@options.dem_input
@options.traversability
@workload_option
@options.as_json
def command(
    map_file: Path, profile: str | None, input_: str, outputs: tuple[str, ...], ticks: int | None, framing: str,
    fast: bool, stay: bool, zenoh_connect: str | None, zenoh_prefix: str, record: Path | None, log: Path | None,
    metrics_port: int | None, metrics_file: Path | None, view: str | None, as_json: bool, **given: Any,
) -> None:  # fmt: skip
    """Plan at a fixed rate: patches, poses and goals in, paths out.

    Inputs and answers are JSON; see docs/run.md. SIGTERM ends the run after its tick with exit code 0, SIGHUP reads
    the model again. Closing stdin ends it once the last inputs were answered. At the end the counters are
    printed on stderr, or with --json on stdout.

    \b
    nnpp-edge run --map dem.tif --workload limit20
    nnpp-edge run --map dem.tif --profile edge-2core --input zenoh --log drive.mcap
    nnpp-edge run --map dem.tif --input replay:drive.jsonl --fast --output none --json
    """
    from nnpp_edge.profiling.profile_file import OnboardLoop, overridden_loop, read_profile
    from nnpp_edge.robot.operations.onboard import STDOUT, Wiring, run, summary, summary_json

    wiring = Wiring(
        input=input_, outputs=outputs, framing=framing, zenoh_connect=zenoh_connect, zenoh_prefix=zenoh_prefix,
        fast=fast, stay=stay, record=record, log=log, metrics_port=metrics_port, metrics_file=metrics_file, view=view,
    )  # fmt: skip
    if as_json and STDOUT in wiring.output_kinds:
        raise click.UsageError("--json prints on stdout, which answers go to: add --output none, or zenoh")
    changes = {key: given.pop(key) for key in ("rate_hz", "method", "model", "cores", "priority", "tolerance")}
    loop = overridden_loop(read_profile(profile).loop if profile else OnboardLoop(), **changes)
    world, cell_size_m = _world(map_file, given)
    counters = run(
        world, loop, wiring, ticks=ticks, cell_size_m=cell_size_m, tell=lambda line: click.echo(line, err=True)
    )
    if as_json:
        click.echo(summary_json(counters))
    else:
        click.echo(summary(counters), err=True)


def _world(path: Path, given: dict[str, Any]) -> tuple[Any, float]:
    """The map at the begin, and the side of its cells in metres."""
    from nnpp_edge.runtime.loop.world import World

    if (found := _cost_map(path)) is not None:
        context = click.get_current_context()
        for name in (*_LIMITS, "cell_size", "vertical_scale", "rescale"):
            if context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
                raise click.UsageError(f"{path.name} holds costs: --{name.replace('_', '-')} does not go with it")
        return World(found[0]), found[1]
    cell_size, vertical_scale, rescale, workload = (
        given.pop(name) for name in ("cell_size", "vertical_scale", "rescale", "workload")
    )
    dem = options.load_dem(path, cell_size, vertical_scale, rescale)
    rules = make_rules(workload, given)
    world = World.of_elevation(dem.elevation, dem.cell_size_m, rules, cell_width_m=dem.cell_width_m)
    return world, dem.cell_size_m


def _cost_map(path: Path) -> tuple[Any, float] | None:
    """Costs and cell size of a file that `nnpp-edge costmap` has written; None for any other file."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return None
    import numpy as np

    try:
        with np.load(path, allow_pickle=False) as content:
            if "cost" not in content.files:
                return None
            return content["cost"], float(content["cell_size_m"]) if "cell_size_m" in content.files else 1.0
    except (OSError, ValueError, EOFError):  # a broken file: told by who reads elevation maps
        return None
