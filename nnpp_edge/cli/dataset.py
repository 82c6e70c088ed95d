"""`nnpp-edge dataset`: labelled samples from terrain."""

import json
from functools import partial
from pathlib import Path

import click

from nnpp_edge.cli import options

_SHARE = click.FloatRange(0, 1)
_POINTS = "On a map; pairs far enough apart are queries."
_SHARDS = "Make every N-th shard from the K-th on; the union is the whole set."


def _part(word: str) -> tuple[int, int]:
    k, n = map(int, word.split("/"))
    return k, n


_PART = options.Parsed("K/N", "K/N, such as 2/8", _part)


@click.command(name="dataset")
@click.argument("terrain", nargs=-1, type=options.PATH)
@click.option("-o", "--output", type=options.FOLDER, required=True, help="Folder; resumed if it holds a part.")
@click.option("--maps", type=options.COUNT, default=4096, help="Number of maps.")
@click.option("--size", type=click.IntRange(16), default=256, help="Side of the network's input.")
@click.option("--points", "points_per_map", type=click.IntRange(2), default=4, help=_POINTS)
@click.option("--synthetic-share", type=_SHARE, default=0.25)
@click.option("--obstacle-share", type=_SHARE, default=0.3, help="Share of maps with rectangles of cost 1.")
@click.option("--shard", "part", type=_PART, default="1/1", help=_SHARDS)
@click.option("--workers", type=options.COUNT, help="Processes; by default one a core.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask scheduler (tcp://10.0.0.5:8786) to make the shards.")
@click.option("--picture", type=options.NEW_FILE, help="Sheet of random samples; by default DIR/samples.png.")
@options.seed
@options.as_json
def command(
    terrain: tuple[Path, ...],
    output: Path,
    size: int,
    part: tuple[int, int],
    workers: int | None,
    scheduler: str | None,
    picture: Path | None,
    seed: int,
    as_json: bool,
    **recipe_fields: object,
) -> None:
    """Make a training set from TERRAIN files (without any: from synthetic terrain alone).

    Maps are random crops at several rescalings, under soft and hard limits, some with obstacles; labels are
    computed by the exact search. The format is described in docs/dataset.md.

    \b
    nnpp-edge dataset train/*.tif -o data/train --maps 9216
    """
    if workers and scheduler:
        raise click.UsageError("--workers counts processes on this machine; leave it out with --scheduler")
    import msgspec

    from nnpp_edge.progress import bar
    from nnpp_edge.terrain.cluster import shards_on_cluster
    from nnpp_edge.terrain.dataset import make_dataset, read_samples
    from nnpp_edge.terrain.shards import Recipe
    from nnpp_edge.viz.figures import sample_sheet

    names = [str(path) for path in terrain]
    recipe_fields |= {"terrain": names, "size": size, "blocks": size // 4, "seed": seed}
    recipe = msgspec.convert(recipe_fields, Recipe)
    make = partial(shards_on_cluster, scheduler) if scheduler else None
    with bar("shards", recipe.shards) as advance:

        def report(done: int, total: int) -> None:
            advance(done)

        counts = make_dataset(recipe, output, workers=workers, part=part, make=make, progress=report)
    picture = picture or output / "samples.png"
    if counts["shards"]:
        sample_sheet(read_samples(output, most_maps=256), picture, seed=seed)
    if as_json:
        click.echo(json.dumps(counts | {"folder": str(output), "picture": str(picture)}))
    else:
        click.echo(
            f"{output}: {counts['shards']} of {counts['of']} shards, {counts['maps']} maps, "
            f"{counts['queries']} queries; a sheet of samples is in {picture}"
        )
