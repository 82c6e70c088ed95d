"""`nnpp-edge warmup`: compile ahead of the first plan."""

import warnings
from typing import Annotated

import click

from nnpp_edge.cli import options
from nnpp_edge.cli.text import tell
from nnpp_edge.progress import bar


@options.command("warmup")
def command(
    keep_old: Annotated[bool, "Keep the kernels of other versions of this package."] = False,
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
    $XDG_CACHE_HOME or ~/.cache. Run it after installing, as the user who will plan. Kernels of
    other versions of this package are deleted, unless they were written within the last hour.

    \b
    nnpp-edge warmup
    """
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", "no folder that only this user"
        )  # here it is the error below
        from nnpp_edge.runtime.warmup import VERSIONS, warm_up
    with bar("warmup", VERSIONS) as progress:
        warmth = warm_up(keep_old=keep_old, jobs=jobs, progress=progress)
    counts = (
        f"{warmth.kernels} kernels ({warmth.signatures} versions, {warmth.compiled} of them new)"
    )
    kept = f"{counts}, {warmth.seconds:.1f} s; what is compiled is kept in {warmth.folder}"
    lines = [kept, *(f"deleted {each}" for each in warmth.removed)]
    tell(as_json, warmth.summary(), lambda: "\n".join(lines), indent=1)
