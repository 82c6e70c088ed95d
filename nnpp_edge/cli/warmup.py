"""`nnpp-edge warmup`: compile ahead of the first plan."""

import json
import sys
import warnings

import click

from nnpp_edge.cli import options


@click.command(name="warmup")
@click.option("--keep-old", is_flag=True, help="Keep the kernels of other versions of this package.")
@click.option(
    "--jobs",
    type=click.IntRange(1, 64),
    help="Processes that compile at once, 0.6 to 0.9 GB each; by default one a processor, four at most, as "
    "far as memory is left.",
)
@options.as_json
def command(keep_old: bool, jobs: int | None, as_json: bool) -> None:
    """Compile every kernel ahead of the first plan.

    The kernels stay in the cache folder: NUMBA_CACHE_DIR if it is set, else nnpp-edge under
    $XDG_CACHE_HOME or ~/.cache. Run it after installing, as the user who will plan. What other versions
    of this package left there is deleted, unless it was written within the last hour.

    \b
    nnpp-edge warmup
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # that there is no folder: here it is the error below
        from nnpp_edge.runtime.warmup import warm_up
    from nnpp_edge.runtime.errors import OutputError

    try:
        warmth = warm_up(keep_old=keep_old, jobs=jobs)
    except OutputError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(1)
    if as_json:
        click.echo(json.dumps(warmth.summary(), indent=1))
        return
    counts = f"{warmth.kernels} kernels ({warmth.signatures} versions, {warmth.compiled} of them new)"
    click.echo(f"{counts} in {warmth.folder}, {warmth.seconds:.1f} s")
    for folder in warmth.removed:
        click.echo(f"deleted {folder}")
