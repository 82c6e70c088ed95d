"""`nnpp-edge dataset`: labelled samples from terrain."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.ground_options import TerrainOptions
from nnpp_edge.cli.text import tell
from nnpp_edge.runtime.options import Omega

_PAPERS = {
    "workloads": (("soft", 1.0),),
    "cell_sizes_m": (20.0,),
    "poolings": ((1, 1.0),),
    "margin_share": 0.0,
}


@options.command("dataset")
def command(
    terrain_files: Annotated[
        tuple[Path, ...], options.MAP, {"nargs": -1, "metavar": "[TERRAIN]..."}
    ] = (),
    /,
    *,
    output: Annotated[Path, "-o", options.FOLDER, "Folder; resumed if it holds a part."],
    maps: Annotated[int, "Number of maps."] = 4096,
    size: Annotated[
        int | None,
        (
            "Side of the network's input, or a multiple of it: 64 for edge, 256 for nnpp; with "
            "--known 32 blocks. [256]"
        ),
    ] = None,
    points: Annotated[
        int, click.IntRange(2, 1000), "On a map; pairs far enough apart are queries."
    ] = 4,
    synthetic_share: Annotated[float, options.SHARE] = 0.25,
    validation_share: Annotated[
        float,
        options.Real(0.0, 1.0, max_open=True),
        "Leave out this share of each file, a stripe at the end of its longer side, for "
        "--held-out.",
    ] = 0.0,
    held_out: Annotated[bool, "Use only that stripe, for validation."] = False,
    own_cell_size: Annotated[
        bool,
        "Leave the terrain's cells and heights as they are; else it is rescaled to cells of 1 to "
        "20 m.",
    ] = False,
    papers_maps: Annotated[
        bool,
        (
            "Maps as the paper's: its cost without hard limits, cells of 20 m, none averaged "
            "or with a margin."
        ),
    ] = False,
    known: Annotated[
        tuple[int, ...],
        options.COUNTS,
        "Maps are known by means of so many cells to a side, for --architecture unseen.",
    ] = (),
    terrain: TerrainOptions,
    omega: Omega = 0.011,
    workers: Annotated[int | None, "Processes; by default one a core."] = None,
    seed: options.Seed = 1,
    as_json: options.AsJson = False,
) -> None:
    """Make a training set from TERRAIN files (without any: from synthetic terrain alone).

    Maps are random crops at several rescalings, under soft and hard limits, some with obstacles;
    labels are computed by the exact search. With --limit or --workload all maps are made by those.
    The format is described in docs/dataset.md.

    \b
    nnpp-edge dataset train/*.tif -o data/train --maps 9216
    nnpp-edge dataset train/*.tif -o data/unseen --maps 6000 --known 4,8,16
    nnpp-edge dataset dem.tif -o data/train --validation-share 0.2 --own-cell-size
    nnpp-edge dataset dem.tif -o data/val --validation-share 0.2 --own-cell-size --held-out
    """
    own_limits = bool(terrain.limit or terrain.workload)
    if papers_maps and (own_cell_size or terrain.rescale or own_limits):
        raise click.UsageError(
            "--papers-maps decides cells and limits: leave out --own-cell-size, --rescale and "
            "limits"
        )
    if own_cell_size and (terrain.rescale or not terrain_files):
        raise click.UsageError("--own-cell-size goes with TERRAIN files, and without --rescale")
    if held_out and not validation_share:
        raise click.UsageError("--held-out uses what --validation-share leaves out: give that, too")
    from nnpp_edge.progress import bar
    from nnpp_edge.runtime.reading import converted
    from nnpp_edge.terrain.dataset import make_dataset
    from nnpp_edge.terrain.shards import Recipe

    kind: dict[str, object] = dict(_PAPERS) if papers_maps else {}
    if own_cell_size or terrain.rescale:
        kind["cell_sizes_m"] = () if terrain.rescale is None else (terrain.rescale,)
    if own_limits:
        workload = terrain.workload or "soft"
        limits = replace(terrain, workload=workload).limits()
        kind |= {"limits": limits.changed, "workloads": ((workload, 1.0),)}
    if known:
        kind |= {"known": True, "poolings": tuple((factor, 1.0) for factor in known)}
    size = size or (32 if known else 256)
    asked = {
        "terrain": tuple(map(str, terrain_files)),
        "maps": maps,
        "seed": seed,
        "size": size,
        "blocks": size // 4,
        "points_per_map": points,
        "synthetic_share": synthetic_share,
        "omega": omega,
        "stripe": (1.0 - validation_share, 1.0) if held_out else (0.0, 1.0 - validation_share),
        "cell_size_m": terrain.cell_size,
    }
    recipe = converted(asked | kind, Recipe)
    with bar("shards", recipe.shards) as advance:
        counts = make_dataset(recipe, output, workers=workers, progress=advance)
    words = "{folder}: {shards} of {of} shards, {maps} maps, {queries} queries"
    told = counts | {"folder": str(output)}
    tell(as_json, told, lambda: words.format(**told))
