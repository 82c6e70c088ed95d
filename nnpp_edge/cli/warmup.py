"""`nnpp-edge warmup`: compile ahead of the first plan."""

import warnings
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.text import tell


@options.command("warmup")
def command(
    jobs: Annotated[
        int | None,
        click.IntRange(1, 64),
        (
            "Processes that compile at once, 0.6 to 0.9 GB each; by default one a processor, four "
            "at most, if there is memory."
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Compile every kernel ahead of the first plan.

    The kernels stay in the cache folder: NUMBA_CACHE_DIR if it is set, else nnpp-edge under
    $XDG_CACHE_HOME or ~/.cache. Run it after installing, as the user who will plan.

    \b
    nnpp-edge warmup
    """
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", "no folder that only this user"
        )  # here it is the error below
        from nnpp_edge.runtime.compiled.notice import told_if_slow
        from nnpp_edge.runtime.warmup import warm_up
    with told_if_slow("warming up"):
        warmth = warm_up(jobs)
    counts = (
        f"{warmth.kernels} kernels ({warmth.signatures} versions, {warmth.compiled} of them new)"
    )
    kept = f"{counts}, {warmth.seconds:.1f} s; what is compiled is kept in {warmth.folder}"
    tell(as_json, warmth.summary(), lambda: kept, indent=1)
