"""`nnpp-edge reach`: what can be reached from a place within a cost, a time or an energy."""

import json
import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import GroundOptions
from nnpp_edge.cli.requests import Start
from nnpp_edge.cli.text import aligned, tell
from nnpp_edge.runtime.compiled.notice import told_if_slow
from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.runtime.options import StepOptions

if TYPE_CHECKING:
    from nnpp_edge.runtime.map.ground import Ground

_FILES = ("reach.tif", "reach.geojson", "reach.png", "reach.json")
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}
_JOULES = {"J": 1.0, "kJ": 1e3, "MJ": 1e6, "Wh": 3600.0, "kWh": 3.6e6}
_IN_SECONDS = ("time", "tobler")
"""Step costs that are times."""
_TOO_LONG = (
    "in eight directions: one straight between them counts up to 8.2 % too long",
    "in sixteen directions: one straight between them counts up to 2.8 % too long",
)
"""Of a point, and of a body: 1 over the cosine of half the widest angle between two directions."""


def _amount(units: dict[str, float], word: str) -> float:
    found = re.fullmatch(rf"(\d+(?:\.\d*)?(?:e\d+)?)\s*({'|'.join(units)})?", word)
    amount = float(found[1]) * units.get(found[2], 1.0) if found else 0.0
    if not 0.0 < amount <= options.LARGEST:
        raise ValueError
    return amount


_DURATION = options.Parsed(
    "TIME", "a time such as 90, 90s, 30min or 2h", partial(_amount, _SECONDS)
)
_WORK = options.Parsed(
    "ENERGY", "an energy such as 3e4, 500kJ, 20MJ or 2kWh", partial(_amount, _JOULES)
)


@options.command("reach")
def command(
    dem: Annotated[Path, options.MAP],
    /,
    *,
    start: Start,
    within_cost: Annotated[
        float | None, "The most that a path may cost, in the unit of --step-cost."
    ] = None,
    within_time: Annotated[
        float | None,
        _DURATION,
        (
            "The longest time of a path: by --step-cost, else at the vehicle's speeds, else by "
            "Tobler's function."
        ),
    ] = None,
    within_energy: Annotated[
        float | None,
        _WORK,
        (
            "The most energy that a --vehicle may draw, in joules unless a unit is given: 500kJ, "
            "20MJ, 2kWh."
        ),
    ] = None,
    robot: GroundOptions,
    levels: Annotated[int, click.IntRange(1, 24), "Number of areas."] = 4,
    steps: StepOptions,
    output: Annotated[
        Path | None,
        "-o",
        options.PATH,
        "Folder for reach.tif, reach.geojson, reach.png, reach.json.",
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Show what can be reached on the elevation map DEM from a place, within a cost, a time or an
    energy.

    The areas are nested: each holds the cells that can be reached within its share of the limit.
    reach.tif has the cost of reaching each cell, reach.geojson the areas in the map's own
    coordinates, along the cells' sides.

    \b
    nnpp-edge reach dem.tif --start 20,30 --within-cost 500 --workload limit20 -o reach
    """
    measure, most = _limit(robot, cost=within_cost, time=within_time, energy=within_energy)
    if output is not None:
        optional_module("rasterio", "--output", "geo")
    names = [*_FILES]
    if output is not None and not options.can_draw("reach.png"):
        names.remove("reach.png")
    paths = options.files_in(output, names)

    from dataclasses import replace

    import numpy as np

    from nnpp_edge.cli.maps import chart_of, refuse, size_in_words, size_of
    from nnpp_edge.files import write_all
    from nnpp_edge.runtime import Planner
    from nnpp_edge.runtime.planners.query import problem_with
    from nnpp_edge.runtime.robots.slope.cost import unit_of
    from nnpp_edge.terrain.rasters import raster_bytes
    from nnpp_edge.terrain.route import Reach
    from nnpp_edge.viz.picture import encoded, reach_picture

    with told_if_slow(f"reading {dem}"):
        terrain = robot.read(dem)
    cell = start(terrain)
    with told_if_slow("costs of the map"):
        ground = robot.of(terrain)
        cost = ground.costs(warn=True)
    step_cost = _step_cost(measure, robot.step_cost, ground)
    ground = replace(ground, step_cost=step_cost)
    planner = Planner(ground.priced(cost), **steps)
    if problem := problem_with(planner.state.grid, cell, cell):
        refuse(problem, cell, cell, terrain, planner, ground)
    shares = tuple((most * np.arange(1, levels + 1) / levels).tolist())
    with told_if_slow("searching"):
        found = Reach(planner.reach(cell, most), shares, measure, unit_of(step_cost), terrain)

    files = [str(path) for path in paths]
    figures: dict[str, object] = {"start": cell, "measure": measure, "unit": found.unit}
    figures |= {"areas": found.areas, **size_of(terrain)}
    within = [_within(measure, level, found.unit) for level in shares]
    if paths:
        figures["files"] = files
        bands = list(zip(shares, within, strict=True))
        contents = {
            "reach.tif": raster_bytes(paths[0], found.raster(), terrain),
            "reach.geojson": found.geojson(),
            "reach.json": json.dumps(figures, indent=1).encode(),
        }
        if "reach.png" in names:
            picture = reach_picture(chart_of(terrain, cost), found.field, bands, cell)
            contents["reach.png"] = encoded(picture)
        write_all({path: contents[path.name] for path in paths})
    lines: dict[str, object] = {"map": size_in_words(terrain), "start": cell}
    if measure == "time":
        of_vehicle = step_cost == "time"
        walker = "" if of_vehicle else ground.slope_cost and ground.slope_cost.function
        lines["speeds"] = "of the vehicle" if of_vehicle else f"of a walker, by {walker}"
    lines["ways"] = _TOO_LONG[ground.body is not None]
    for words, (_, cells, area) in zip(within, map(dict.values, found.areas), strict=True):
        size = f"{area / 1e6:.4g} km²" if area >= 1e5 else f"{area:.0f} m²"
        lines[words] = f"{cells} cells, {size}, {100.0 * cells / cost.size:.1f} % of the map"
    tell(as_json, figures, lambda: aligned(lines | {"written": ", ".join(files)}))


def _limit(robot: GroundOptions, **given: float | None) -> tuple[str, float]:
    """What is limited, and to how much; UsageError unless it is one thing that steps can count."""
    asked = [(name, most) for name, most in given.items() if most is not None]
    if len(asked) != 1:
        raise click.UsageError("give one of --within-cost, --within-time and --within-energy")
    ((measure, most),) = asked
    in_seconds = robot.step_cost in _IN_SECONDS
    if measure != "cost" and robot.step_cost != "paper" and not (measure == "time" and in_seconds):
        raise click.UsageError(
            f"--within-{measure} counts {measure} already: leave out --step-cost, or give "
            "--within-cost with it; one in seconds goes with --within-time"
        )
    return measure, most


def _step_cost(measure: str, given: str, ground: "Ground") -> str:
    """The step cost by which a measure is counted."""
    mobility = ground.mobility
    assert mobility is not None
    if measure == "energy":
        return "energy"
    if measure == "cost" or given in _IN_SECONDS:
        return given
    if mobility.time is None:
        raise click.UsageError(
            "--within-time wants speeds: give a vehicle's, by --vehicle or --mobility, or a "
            "walker's, by --step-cost tobler"
        )
    return "time"


def _within(measure: str, level: float, unit: str) -> str:
    """A limit in words."""
    from nnpp_edge.terrain.facts import duration, work

    if measure == "cost":
        return f"within a cost of {level:.6g} {unit}".rstrip()
    return f"within {duration(level) if measure == 'time' else work(level)}"
