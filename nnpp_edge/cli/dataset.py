"""`nnpp-edge dataset`: labelled samples from terrain."""

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import replace

from nnpp_edge.cli import options
from nnpp_edge.cli.options import TerrainOptions

if TYPE_CHECKING:
    from nnpp_edge.terrain.shards import Recipe

_POINTS = "On a map; pairs far enough apart are queries."
_SHARDS = "Make every N-th shard from the K-th on; the union is the whole set."
_SIZE = "Side of the network's input, or a multiple of it: 64 for edge, 256 for nnpp."
_PAPERS_MAPS = "Maps as the paper's: its cost without hard limits, cells of 20 m, none averaged or with a margin."
_OWN_CELLS = "Leave the terrain's cells and heights as they are; else it is rescaled to cells of 1 to 20 m."
_LEAVE = "Leave out this share of each file, a stripe at the end of its longer side, for --held-out."
_HELD_OUT = "Use nothing but that stripe, to validate on."


def _part(word: str) -> tuple[int, int]:
    k, n = map(int, word.split("/"))
    return k, n


_PART = options.Parsed("K/N", "K/N, such as 2/8", _part)


@click.command(name="dataset")
@click.argument("terrain_files", nargs=-1, type=options.MAP, metavar="[TERRAIN]...")
@click.option("-o", "--output", type=options.FOLDER, required=True, help="Folder; resumed if it holds a part.")
@click.option("--maps", type=options.COUNT, default=4096, help="Number of maps.")
@click.option("--size", type=options.COUNT, default=256, help=_SIZE)
@click.option("--points", "points_per_map", type=click.IntRange(2, 1000), default=4, help=_POINTS)
@click.option("--synthetic-share", type=options.SHARE, default=0.25)
@click.option("--obstacle-share", type=options.SHARE, default=0.3, help="Share of maps with rectangles of cost 1.")
@click.option("--validation-share", type=options.Real(0.0, 1.0, max_open=True), default=0.0, help=_LEAVE)
@click.option("--held-out", is_flag=True, help=_HELD_OUT)
@click.option("--own-cell-size", is_flag=True, help=_OWN_CELLS)
@click.option("--papers-maps", is_flag=True, help=_PAPERS_MAPS)
@options.terrain
@options.omega
@click.option("--shard", "part", type=_PART, default="1/1", help=_SHARDS)
@click.option("--workers", type=options.COUNT, help="Processes; by default one a core.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask scheduler (tcp://10.0.0.5:8786) to make the shards.")
@options.seed
@options.as_json
def command(
    terrain_files: tuple[Path, ...],
    terrain: TerrainOptions,
    output: Path,
    size: int,
    validation_share: float,
    held_out: bool,
    own_cell_size: bool,
    papers_maps: bool,
    part: tuple[int, int],
    workers: int | None,
    scheduler: str | None,
    seed: int,
    as_json: bool,
    **recipe_fields: Any,
) -> None:
    """Make a training set from TERRAIN files (without any: from synthetic terrain alone).

    Maps are random crops at several rescalings, under soft and hard limits, some with obstacles; labels are
    computed by the exact search. With limits or a workload of one's own all maps are made by those. The format
    is described in docs/dataset.md.

    \b
    nnpp-edge dataset train/*.tif -o data/train --maps 9216
    nnpp-edge dataset dem.tif -o data/train --validation-share 0.2 --own-cell-size --limit hard_slope_deg=20
    nnpp-edge dataset dem.tif -o data/val --validation-share 0.2 --held-out --own-cell-size --limit hard_slope_deg=20
    """
    if workers and scheduler:
        raise click.UsageError("--workers counts processes on this machine; leave it out with --scheduler")
    if papers_maps and (own_cell_size or terrain.rescale or terrain.limits_given):
        raise click.UsageError(
            "--papers-maps decides cells and limits: leave out --own-cell-size, --rescale and limits"
        )
    if own_cell_size and (terrain.rescale or not terrain_files):
        raise click.UsageError("--own-cell-size goes with TERRAIN files, and without --rescale")
    if held_out and not validation_share:
        raise click.UsageError("--held-out uses what --validation-share leaves out: give that, too")
    from nnpp_edge.progress import bar
    from nnpp_edge.terrain.cluster import shards_on_cluster
    from nnpp_edge.terrain.dataset import make_dataset, read_samples
    from nnpp_edge.terrain.shards import Recipe
    from nnpp_edge.viz.figures import sample_sheet

    stripe = (1.0 - validation_share, 1.0) if held_out else (0.0, 1.0 - validation_share)
    recipe = Recipe(
        tuple(map(str, terrain_files)),
        size=size,
        blocks=size // 4,
        seed=seed,
        stripe=stripe,
        cell_size_m=terrain.cell_size,
        vertical_scale=terrain.vertical_scale,
        allow_vrt=terrain.allow_vrt,
        **recipe_fields,
    )
    recipe = _of_terrain(recipe, terrain, own_cell_size, papers_maps)
    make = partial(shards_on_cluster, scheduler) if scheduler else None
    with bar("shards", recipe.shards) as advance:

        def report(done: int, total: int) -> None:
            advance(done)

        counts = make_dataset(recipe, output, workers=workers, part=part, make=make, progress=report)
    picture = output / "samples.png"
    if counts["shards"]:
        sample_sheet(read_samples(output, most_maps=256), picture, seed=seed)
    if as_json:
        click.echo(json.dumps(counts | {"folder": str(output), "picture": str(picture)}))
    else:
        click.echo(
            f"{output}: {counts['shards']} of {counts['of']} shards, {counts['maps']} maps, "
            f"{counts['queries']} queries; a sheet of samples is in {picture}"
        )


def _of_terrain(recipe: "Recipe", terrain: TerrainOptions, own_cell_size: bool, papers_maps: bool) -> "Recipe":
    """With the cells that are asked for and the limits by which they are judged."""
    if papers_maps:
        soft = (("soft", 1.0),)
        return replace(recipe, workloads=soft, cell_sizes_m=(20.0,), poolings=((1, 1.0),), margin_share=0.0)
    if own_cell_size or terrain.rescale:
        recipe = replace(recipe, cell_sizes_m=() if terrain.rescale is None else (terrain.rescale,))
    if not terrain.limits_given:
        return recipe
    from nnpp_edge.runtime.terrain.traversability import Traversability

    limits, papers = asdict(terrain.limits()), asdict(Traversability())
    own = {name: value for name, value in limits.items() if value != papers[name]}
    return replace(recipe, limits=own, workloads=((terrain.workload or "soft", 1.0),))
