"""`nnpp-edge run`: the onboard loop as a program."""

import json
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import GroundOptions, Known
from nnpp_edge.cli.options import MANY
from nnpp_edge.cli.text import aligned, counted, loop_lines
from nnpp_edge.robot.transports.wiring import STDOUT, Wiring
from nnpp_edge.runtime.options import StepOptions

if TYPE_CHECKING:
    from nnpp_edge.runtime.loop.messages import Counters
    from nnpp_edge.runtime.map.ground import Ground

_SETTING = options.SettingType(
    "nnpp_edge.runtime.loop.settings:OnboardLoop", "tolerance=0.05", bare=True
)


@options.command("run")
def command(
    map_file: Annotated[Path, "--map", options.MAP, "Elevation map, or an .npz of `costmap`."],
    wiring: Wiring,
    robot: GroundOptions,
    steps: StepOptions,
    known: Known = None,
    profile: Annotated[
        str | None,
        {"metavar": "NAME|FILE"},
        "A shipped profile or a TOML file; its table [loop] counts where no option is given.",
    ] = None,
    rate: Annotated[float | None, options.RATE, "Ticks a second; 17 by default."] = None,
    method: Annotated[str | None, "Planner; auto by default."] = None,
    model: options.Model | None = None,
    loop: Annotated[
        tuple[options.Setting, ...],
        _SETTING,
        MANY,
        (
            "Set a value of the profile's table [loop], such as cores=[2,3], priority=50, "
            "tolerance=0.05, approach=true or refine=any-angle. May be repeated."
        ),
    ] = (),
    ticks: Annotated[int | None, "End after so many."] = None,
    fail_on_misses: Annotated[
        float | None,
        options.SHARE,
        {"metavar": "SHARE"},
        (
            "Exit code 1 where more than this share of the deadlines was missed, such as 0.01; a "
            "tick that takes several periods misses several."
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Plan at a fixed rate: patches, poses and goals in, paths out.

    Inputs and answers are JSON; see docs/run.md. SIGTERM ends the run after its tick with exit code
    0. Closing stdin ends it once the last inputs were answered. At the end the counters are printed
    on stderr, or with --json on stdout. With --fail-on-misses the exit code is 1 where too many
    deadlines were missed.

    \b
    nnpp-edge run --map dem.tif --workload limit20
    nnpp-edge run --map dem.tif --profile edge-2core --input zenoh --log drive.mcap
    nnpp-edge run --map dem.tif --input replay:drive.jsonl --fast --output none --json
    """
    from nnpp_edge.robot.operations.onboard import run
    from nnpp_edge.runtime.loop.settings import OnboardLoop
    from nnpp_edge.runtime.network.loading import begin_loading
    from nnpp_edge.runtime.network.model_file import model_path
    from nnpp_edge.runtime.planners.plan import DynamicMethod
    from nnpp_edge.runtime.reading import changed

    if as_json and any(entry.name == STDOUT for entry, _ in wiring.sinks):
        raise click.UsageError(
            "--json prints on stdout, which answers go to: add --output none, or zenoh"
        )
    if wiring.fast and fail_on_misses is not None:
        raise click.UsageError(
            "--fail-on-misses needs deadlines, and a replay that is --fast has none"
        )
    settings = OnboardLoop()
    if profile:
        from nnpp_edge.profiling.profile_file import read_profile

        settings = read_profile(profile).loop
    for setting in loop:
        settings = changed(settings, **setting.values)
    settings = changed(settings, rate_hz=rate, method=method, model=model, **steps)
    model_path(settings.model)  # refused where there is none, needed or not
    if "network" in DynamicMethod(settings.method).entry.needs:
        begin_loading(settings.model)
    ground = robot.of(robot.read(map_file), known) if known else _ground(map_file, robot)
    counters = run(ground, wiring, settings, ticks=ticks, report=partial(click.echo, err=True))
    if as_json:
        click.echo(json.dumps(asdict(counters)))
    else:
        click.echo(summary(counters), err=True)
    if fail_on_misses is not None:
        missed = counters.overruns + counters.skipped
        deadlines = counters.ticks + counters.skipped
        share = missed / max(deadlines, 1)
        click.echo(
            f"{missed} of {deadlines} deadlines missed, {100 * share:.3g} %; "
            f"allowed are {100 * fail_on_misses:g} %",
            err=True,
        )
        sys.exit(int(share > fail_on_misses))


def summary(counters: "Counters") -> str:
    """The counters for people; what never happened is left out."""
    c = counters
    odd = {"clipped": c.patches_clipped, "rejected": c.patches_rejected, "merged": c.patches_merged}
    patches = (f"{c.patches} ({c.cells_changed} cells changed)", counted(odd))
    tick_ms = (c.tick_ms or {}).items()
    lines = {
        **loop_lines(c),
        "tick": ", ".join(f"{name} {ms:.2f} ms" for name, ms in tick_ms),
        "patches": ", ".join(filter(None, patches)) if c.patches else "",
        "memory": f"{c.rss_bytes / 1e6:.0f} MB",
    }
    return aligned(lines)


def _ground(path: Path, robot: GroundOptions) -> "Ground":
    """The robot, and its first map."""
    from nnpp_edge.runtime.map.ground import Ground
    from nnpp_edge.terrain.array_files import read_cost_map

    if (found := read_cost_map(path)) is None:
        return robot.of(robot.read(path))
    if robot != GroundOptions():
        raise click.UsageError(
            f"{path.name} holds costs: limits, a vehicle and other options of the ground need "
            "elevations"
        )
    return Ground(found[0], cell_size_m=found[1])
