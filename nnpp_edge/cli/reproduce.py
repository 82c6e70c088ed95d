"""`nnpp-edge reproduce`: the paper's experiments, beside the paper's figures."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import click

from nnpp_edge.cli import options

_MODEL = (
    "Network of the paper's method; given twice, the second is ours; by default paper and edge."
)


@options.command("reproduce")
def command(
    experiments: Annotated[tuple[str, ...], {"nargs": -1, "metavar": "[EXPERIMENT]..."}] = (),
    /,
    terrain: options.TerrainFiles = (),
    cell_size: options.CellSize = None,
    rescale: options.Rescale = None,
    models: Annotated[tuple[str, ...], "--model", options.MODEL, options.MANY, _MODEL] = (),
    quick: Annotated[
        bool, "A quick test of less than a minute; its figures are not meaningful."
    ] = False,
    output: Annotated[
        Path, "-o", options.FOLDER, "Folder for the results; other experiments in it are kept."
    ] = Path("reproduction"),
    seed: options.Seed = 1,
) -> None:
    """Repeat the paper's experiments and compare the figures.

    The paper's method runs with the paper's own network, ours with `edge`; --model replaces both.
    Without --terrain the ground is the shipped sample, at cells of 20 m.

    EXPERIMENT is a table or figure of docs/reproduce.md, such as table2 or fig9; by default all.
    Each gets a folder with its figures (CSV) and a picture (PNG); README.md has the
    tables and the verdicts.

    \b
    nnpp-edge reproduce --terrain dem.tif --rescale 20 -o reproduction
    nnpp-edge reproduce table2 fig7 --quick
    """
    from nnpp_edge.profiling.suites import dems_of
    from nnpp_edge.reproduction.runner import EXPERIMENTS, reproduce

    if unknown := [name for name in experiments if name not in EXPERIMENTS]:
        raise click.UsageError(
            f"wanted EXPERIMENT of {', '.join(EXPERIMENTS)}, got {', '.join(unknown)}"
        )
    if len(models) > 2:
        raise click.UsageError(
            f"wanted at most two of --model, the paper's and ours, got {len(models)}"
        )
    both = (models[0], models[-1]) if models else ("paper", "edge")
    names = [name for name in EXPERIMENTS if not experiments or name in experiments]
    dems = dems_of(terrain, rescale, cell_size)
    for made in reproduce(names, dems, output, models=both, seed=seed, quick=quick):
        verdicts = Counter(finding.verdict for finding in made.findings)
        counts = ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items()))
        click.echo(f"{made.name}: {counts}; {output / made.name}")
    click.echo(f"comparison with the paper: {output / 'README.md'}")
