"""`nnpp-edge dataset`: labelled samples from terrain."""

import json
from pathlib import Path

import click

from nnpp_edge.cli import options


class Part(click.ParamType):
    """`K/N`."""

    name = "K/N"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Parse, or fail with what came."""
        if isinstance(value, tuple):
            return value
        try:
            k, n = (int(part) for part in str(value).split("/"))
        except ValueError:
            self.fail(f"wanted K/N, such as 2/8, got {value!r}", param, ctx)
        return k, n


@click.command(name="dataset")
@click.argument("terrain", nargs=-1, type=options.PATH)
@click.option("-o", "--output", type=options.FOLDER, required=True, help="Folder; resumed if it holds a part.")
@click.option("--maps", type=click.IntRange(1), default=4096, show_default=True, help="Number of maps.")
@click.option("--size", type=click.IntRange(16), default=256, show_default=True, help="Side of the network's input.")
@click.option("--points", type=click.IntRange(2), default=4, show_default=True,
              help="Points on a map; each pair that is far enough apart makes a query.")  # fmt: skip
@click.option("--synthetic-share", type=click.FloatRange(0, 1), default=0.25, show_default=True)
@click.option("--obstacle-share", type=click.FloatRange(0, 1), default=0.3, show_default=True,
              help="Share of maps with rectangles of cost 1.")  # fmt: skip
@click.option("--shard", "part", type=Part(), default="1/1", show_default=True,
              help="Make every N-th shard from the K-th on; the union is the whole set.")  # fmt: skip
@click.option("--workers", type=click.IntRange(1), help="Processes; by default one a core.")
@click.option("--scheduler", metavar="ADDRESS",
              help="Of a Dask scheduler, such as tcp://10.0.0.5:8786: its workers make the shards.")  # fmt: skip
@click.option("--picture", type=options.NEW_FILE, help="Sheet of random samples; by default DIR/samples.png.")
@options.seed
@options.as_json
def command(
    terrain: tuple[Path, ...], output: Path, maps: int, size: int, points: int, synthetic_share: float,
    obstacle_share: float, part: tuple[int, int], workers: int | None, scheduler: str | None,
    picture: Path | None, seed: int, as_json: bool,
) -> None:  # fmt: skip
    """Make a training set from TERRAIN files (without any: from synthetic terrain alone).

    Maps are random crops at several rescalings, under soft and hard limits, some with obstacles; labels are
    computed by the exact search. The format is described in docs/dataset.md.

    \b
    nnpp-edge dataset train/*.tif -o data/train --maps 9216
    """
    if workers and scheduler:
        raise click.UsageError("--workers counts processes on this machine; leave it out with --scheduler")
    from functools import partial

    from nnpp_edge.progress import bar
    from nnpp_edge.terrain.cluster import shards_on_cluster
    from nnpp_edge.terrain.dataset import make_dataset, read_samples
    from nnpp_edge.terrain.shards import Recipe
    from nnpp_edge.viz.figures import sample_sheet

    recipe = Recipe(
        tuple(str(path) for path in terrain), maps=maps, seed=seed, size=size, blocks=size // 4,
        points_per_map=points, synthetic_share=synthetic_share, obstacle_share=obstacle_share,
    )  # fmt: skip
    with bar("shards", recipe.shards) as advance:
        counts = make_dataset(
            recipe, output, workers=workers, part=part,
            make=partial(shards_on_cluster, scheduler) if scheduler else None,
            progress=lambda done, total: advance(done),
        )  # fmt: skip
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
