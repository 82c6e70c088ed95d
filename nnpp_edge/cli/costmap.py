"""`nnpp-edge costmap`: what crossing each cell of an elevation map costs."""

import json
from pathlib import Path
from typing import Any

import click

from nnpp_edge.cli import options

_RASTERS = (".tif", ".tiff")
_ARRAYS = (".npy", ".npz")
_SHARES = (0.1, 0.5, 0.9, 0.99)

workload_option = click.option(
    "--workload", help="soft (the paper's cost), or limitN: φ_s = N degrees, steeper cells are impassable."
)


@click.command(name="costmap")
@click.argument("dem", type=options.PATH)
@click.option("-o", "--output", type=options.NEW_FILE, required=True, help=".tif, .npy or .npz.")
@click.option("--picture", type=options.NEW_FILE, help="PNG; by default beside the output, under its name.")
@options.dem_input
@options.traversability
@workload_option
@options.as_json
def command(
    dem: Path, output: Path, picture: Path | None, cell_size: float | None, vertical_scale: float | None,
    rescale: float | None, workload: str | None, as_json: bool, **limits: Any,
) -> None:  # fmt: skip
    """Write the traversability cost of an elevation map, and a picture of it.

    Costs lie in [0, 1). A GeoTIFF keeps the DEM's georeference; its impassable cells are NaN, declared as
    nodata. In .npy and .npz (arrays cost, cell_size_m, cell_width_m) they are inf. In the picture, whiter is
    costlier and impassable cells are brown.

    \b
    nnpp-edge costmap dem.tif -o cost.tif --workload limit20
    """
    picture = picture or output.with_suffix(".png")
    _check_names(dem, output, picture)

    from nnpp_edge.viz.picture import cost_map_picture, save_picture

    terrain = options.load_dem(dem, cell_size, vertical_scale, rescale)
    rules = make_rules(workload, limits)
    cost = cost_of(terrain, rules)
    _write(output, cost, terrain)
    save_picture(picture, cost_map_picture(cost, cell_size_m=terrain.cell_width_m))
    told = {**summary(cost, terrain, rules), "files": [str(output), str(picture)]}
    click.echo(json.dumps(told) if as_json else text(dem, told))


def make_rules(workload: str | None, limits: dict[str, Any]) -> Any:
    """The `Traversability` of the options; UsageError where a workload sets a limit that was given too."""
    from nnpp_edge.terrain.workloads import SOFT
    from nnpp_edge.terrain.workloads import workload as named

    rules = options.make_traversability(**limits)
    if workload is None:
        return rules
    context = click.get_current_context()
    for name in ("slope_limit", "hard_slope"):
        source = context.get_parameter_source(name)
        if workload != SOFT and source is not click.core.ParameterSource.DEFAULT:
            raise click.UsageError(
                f"--workload {workload} sets the slope limits: leave out --{name.replace('_', '-')}"
            )
    return named(workload, rules)


def cost_of(terrain: Any, rules: Any) -> Any:
    """The cost map of a `Dem`."""
    from nnpp_edge.runtime.terrain.traversability import traversability_cost

    return traversability_cost(terrain.elevation, terrain.cell_size_m, rules, cell_width_m=terrain.cell_width_m)


def summary(cost: Any, terrain: Any, rules: Any) -> dict[str, Any]:
    """Size, share passable, quantiles of the passable cells' cost, share of known cells at each limit."""
    import numpy as np

    from nnpp_edge.runtime.terrain.traversability import TERMS, terrain_terms

    passable = cost[np.isfinite(cost)]
    quantiles = np.quantile(passable, _SHARES).round(6).tolist() if passable.size else [None] * len(_SHARES)
    terms = terrain_terms(terrain.elevation, terrain.cell_size_m, cell_width_m=terrain.cell_width_m)
    known = max(np.isfinite(terms[0]).sum(), 1)
    full = (np.radians(rules.slope_limit_deg), rules.roughness_limit_m, rules.step_limit_m)
    return {
        "rows": cost.shape[0], "cols": cost.shape[1],
        "cell_size_m": terrain.cell_size_m, "cell_width_m": terrain.cell_width_m,
        "passable_share": passable.size / cost.size,
        "cost_quantiles": {f"{share:g}": q for share, q in zip(_SHARES, quantiles, strict=True)},
        "saturated_share": {
            name: round(float((term >= limit).sum() / known), 6)
            for name, term, limit in zip(TERMS, terms, full, strict=True)
        },
    }  # fmt: skip


def text(dem: Path, told: dict[str, Any]) -> str:
    """The summary for people."""
    quantiles = [
        f"{100 * float(share):.0f} % of cells up to {q:.3f}"
        for share, q in told["cost_quantiles"].items()
        if q is not None
    ]
    limits = [f"{name} {100 * share:.1f} %" for name, share in told["saturated_share"].items()]
    return "\n".join(
        (
            f"map       {dem.name}: {size_text(told)}",
            f"passable  {100 * told['passable_share']:.2f} % of cells",
            f"cost      {', '.join(quantiles) or 'no cell is passable'}",
            f"at limit  {', '.join(limits)}",
            f"written   {', '.join(told['files'])}",
        )
    )


def size_text(told: dict[str, Any]) -> str:
    """Rows, columns and cell size for people."""
    size, width = told["cell_size_m"], told["cell_width_m"]
    cell = f"{size:.4g} m" if abs(size - width) <= 5e-4 * size else f"{size:.4g} m (north) × {width:.4g} m (east)"
    return f"{told['rows']} × {told['cols']} cells of {cell}"


def _check_names(dem: Path, output: Path, picture: Path) -> None:
    """Refuse names that say no format, or that would overwrite something."""
    ending = output.suffix.lower()
    if ending not in _RASTERS + _ARRAYS:
        raise click.UsageError(f"--output must end in {', '.join(_RASTERS + _ARRAYS)}, got {output.name!r}")
    if picture.suffix.lower() != ".png":
        raise click.UsageError(f"--picture must end in .png, got {picture.name!r}")
    for name, path in (("--output", output), ("--picture", picture)):
        if path.resolve() == dem.resolve():
            raise click.UsageError(f"{name} would replace the elevation map {dem}: give another name")


def _write(output: Path, cost: Any, terrain: Any) -> None:
    """The cost in the format that the name's ending asks for."""
    import io

    import numpy as np

    from nnpp_edge.files import write_whole
    from nnpp_edge.terrain.dem import write_raster

    if output.suffix.lower() in _RASTERS:
        write_raster(output, np.where(np.isfinite(cost), cost, np.nan), terrain)
        return
    content = io.BytesIO()
    if output.suffix.lower() == ".npy":
        np.save(content, cost)
    else:
        sides = {"cell_size_m": terrain.cell_size_m, "cell_width_m": terrain.cell_width_m}
        np.savez_compressed(content, cost=cost, **sides)
    write_whole(output, content.getvalue())
