"""`nnpp-edge run`: the onboard loop as a program."""

import json
import re
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nnpp_edge.cli import options, vehicle_options
from nnpp_edge.cli.options import COUNT, TerrainOptions
from nnpp_edge.cli.vehicle_options import VehicleOptions

if TYPE_CHECKING:
    from nnpp_edge.runtime.loop.messages import Counters
    from nnpp_edge.runtime.map.ground import Ground

_FRAMINGS = click.Choice(["lines", "length"])
_INPUTS, _OUTPUTS = "stdin|replay:FILE|zenoh[:ENDPOINT]", "stdout|zenoh[:ENDPOINT]|none"
_OUTPUT_HELP = "Where paths go; may be repeated. By default to the sender of the inputs, and of a replay to stdout."


def _loop_keys() -> list[str]:
    from nnpp_edge.profiling.profile_file import OnboardLoop

    return list(OnboardLoop.__struct_fields__)


@click.command(name="run")
@click.option("--map", "map_file", type=options.MAP, required=True, help="Elevation map, or an .npz of `costmap`.")
@click.option("--profile", metavar="NAME|FILE", help="A shipped profile or a TOML file; its table [loop] counts.")
@click.option("--input", default="stdin", metavar=_INPUTS, help="Where patches, poses and goals come from.")
@click.option("--output", "outputs", multiple=True, metavar=_OUTPUTS, help=_OUTPUT_HELP)
@click.option("--rate", "rate_hz", type=options.RATE, help="Ticks a second, in place of the profile's (else 17).")
@click.option("--method", help="Planner, in place of the profile's (else auto).")
@click.option(
    "--model",
    type=options.ModelName(),
    help="Shipped network's name, or an ONNX file, in place of the profile's (else edge).",
)
@click.option(
    "--loop",
    "loop_settings",
    type=options.SettingType(_loop_keys, "tolerance=0.05", bare=True),
    multiple=True,
    help="Set a value of the profile's table [loop], such as cores=[2,3], priority=50, tolerance=0.05, approach=true "
    "or refine=any-angle. May be repeated.",
)
@click.option("--ticks", type=COUNT, help="End after so many.")
@click.option("--framing", type=_FRAMINGS, default="lines", help="A message a line, or after its length in 4 bytes.")
@click.option("--fast", is_flag=True, help="Replay one recorded tick a tick, and ticks without a pause.")
@click.option("--stay", is_flag=True, help="Go on when stdin is closed or the replay is over.")
@click.option("--zenoh-connect", metavar="ENDPOINT", help="Connect to this router or peer instead of listening.")
@click.option("--zenoh-prefix", default="nnpp_edge", help="First part of all topics.")
@click.option("--record", type=options.NEW_FILE, help="Write the inputs to this file, for replay.")
@click.option("--log", type=options.NEW_FILE, help="Write inputs and answers to this .mcap file.")
@click.option(
    "--metrics",
    multiple=True,
    type=options.NEW_FILE,
    metavar="PORT|FILE",
    help="Serve the counters to Prometheus at this port, or keep them in this file. May be repeated.",
)
@options.view
@options.trace
@options.terrain
@options.step_cost
@vehicle_options.vehicle
@options.as_json
def command(
    map_file: Path,
    profile: str | None,
    ticks: int | None,
    as_json: bool,
    terrain: TerrainOptions,
    vehicle: VehicleOptions,
    step_cost: str,
    loop_settings: tuple[options.Setting, ...],
    metrics: tuple[Path, ...],
    **given: Any,
) -> None:
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
    from nnpp_edge.robot.operations.onboard import Pace, run
    from nnpp_edge.robot.operations.wiring import STDOUT, Wiring
    from nnpp_edge.runtime.loop.ladder import NavigatorSettings
    from nnpp_edge.runtime.network.loading import begin_loading
    from nnpp_edge.runtime.network.model_file import model_path

    given |= _metrics(metrics)
    wiring = Wiring(**{field.name: given.pop(field.name) for field in fields(Wiring)})
    if as_json and STDOUT in wiring.output_kinds:
        raise click.UsageError("--json prints on stdout, which answers go to: add --output none, or zenoh")
    changes = {name: value for each in loop_settings for name, value in each.values.items()}
    changes |= {name: value for name, value in given.items() if value is not None}
    loop = overridden_loop(read_profile(profile).loop if profile else OnboardLoop(), **changes)
    vehicle.check_turns(loop.refine)
    navigator = NavigatorSettings(
        method=loop.method,
        model=loop.model,
        tolerance=loop.tolerance,
        corner_cutting=loop.corner_cutting,
        refine=loop.refine or None,
        approach=loop.approach,
    )
    options.check_outputs(  # --record never replaces a file
        *(("--log", wiring.log), ("--metrics", wiring.metrics_file), ("--view", options.view_file(wiring.view))),
        ("--trace", wiring.trace),
        more_inputs=[model_path(loop.model)],
    )
    pace = Pace(loop.rate_hz, loop.cores, loop.priority)
    if navigator.asks_network:
        begin_loading(navigator.model)
    ground = _ground(map_file, terrain, vehicle, step_cost)
    report = partial(click.echo, err=True)
    counters = run(ground, navigator, wiring, pace, ticks=ticks, report=report)
    if as_json:
        click.echo(json.dumps(asdict(counters)))
    else:
        click.echo(summary(counters), err=True)


def summary(counters: "Counters") -> str:
    """The counters for people; what never happened is left out."""
    c = counters
    lines = {"ticks": f"{c.ticks}: {c.planned} planned, {c.kept} kept, {c.failed} without a path"}
    if c.tick_ms:
        lines["tick"] = ", ".join(f"{name} {ms:.2f} ms" for name, ms in c.tick_ms.items())
    if c.overruns or c.skipped:
        lines["late"] = f"{c.overruns} overruns, {c.skipped} deadlines skipped"
    for name, counts in (("degraded", c.degraded), ("errors", c.errors), ("dropped", c.drops), ("lost", c.lost)):
        if shown := [f"{where} {count}" for where, count in counts.items() if count]:
            lines[name] = ", ".join(shown)
    if c.patches:
        odd = {"clipped": c.patches_clipped, "rejected": c.patches_rejected, "merged": c.patches_merged}
        shown = [f"{count} {what}" for what, count in odd.items() if count]
        lines["patches"] = ", ".join([f"{c.patches} ({c.cells_changed} cells changed)", *shown])
    if c.reloads:
        lines["reloads"] = str(c.reloads)
    lines["memory"] = f"{c.rss_bytes / 1e6:.0f} MB"
    return "\n".join(f"{name:<10}{value}" for name, value in lines.items())


def _metrics(places: tuple[Path, ...]) -> dict[str, object]:
    """Where the counters go: a port, a file, or both."""
    ports = [int(str(place)) for place in places if re.fullmatch(r"\d{1,5}", str(place))]
    kept = [place for place in places if not re.fullmatch(r"\d{1,5}", str(place))]
    if len(ports) > 1 or len(kept) > 1 or max(ports, default=0) > 65535:
        raise click.UsageError("--metrics takes one port up to 65535 and one file")
    return {"metrics_port": ports[0] if ports else None, "metrics_file": kept[0] if kept else None}


def _ground(path: Path, terrain: TerrainOptions, vehicle: VehicleOptions, step_cost: str) -> "Ground":
    """The robot, and its first map."""
    from nnpp_edge.runtime.map.ground import Ground
    from nnpp_edge.terrain.array_files import read_cost_map

    if (found := read_cost_map(path)) is not None:
        for name in options.given_options():
            if hasattr(terrain, name):
                raise click.UsageError(f"{path.name} holds costs: --{name.replace('_', '-')} does not go with it")
        if vehicle.make() is not None:
            raise click.UsageError(f"{path.name} holds costs: a vehicle stands on elevations")
        if step_cost != "paper":
            raise click.UsageError(
                f"{path.name} holds costs: --step-cost {step_cost} goes by the slopes of elevations"
            )
        return Ground(found[0], cell_size_m=found[1])
    limits, dem = terrain.limits(), terrain.read(path)
    return Ground.of_elevation(
        dem.elevation,
        dem.cell_size_m,
        limits,
        cell_width_m=dem.cell_width_m,
        vehicle=vehicle.make(),
        step_cost=step_cost,
        mobility=vehicle.mobility(dem),
    )
