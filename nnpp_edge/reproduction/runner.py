"""Running experiments into a folder: each is written whole or not at all, and not run again without
need.

The folder's page says what agrees with the paper.
"""

import os
from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path

import msgspec

from nnpp_edge import __version__
from nnpp_edge.files import make_folder, write_all, write_whole
from nnpp_edge.profiling.machine import environment
from nnpp_edge.profiling.suites import TerrainFiles
from nnpp_edge.progress import bar, markdown_table
from nnpp_edge.reproduction.dynamic import table3, table4
from nnpp_edge.reproduction.exact import fig7, table1
from nnpp_edge.reproduction.experiment import BOTH, CONTROLS_NOTE, Context
from nnpp_edge.reproduction.findings import Finding, Verdict
from nnpp_edge.reproduction.looks import fig14
from nnpp_edge.reproduction.planners import summary
from nnpp_edge.reproduction.regions import Networks
from nnpp_edge.reproduction.static import fig9, fig11, fig12, table2
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import read_model_file
from nnpp_edge.viz.figures import encoded

FORMAT = "nnpp-edge-reproduction-3"
EXPERIMENTS = {
    each.run.__name__: each
    for each in (table1, fig7, table2, fig9, fig11, fig12, fig14, table3, table4)
}
"""The experiments of the paper by name, in the order in which they run."""
_COLUMNS = ("", "claim", "paper", "ours", "rule", "verdict")
_HEADS = {
    Verdict.DIFFERS: "What does not agree",
    Verdict.BETTER: "What is better than in the paper",
}
_HEADS |= {Verdict.AGREES: "What agrees"}


class Stored(msgspec.Struct):
    """Content of an experiment's NAME.json."""

    format: str
    name: str
    where: str
    title: str
    quick: bool
    machine: str
    made_with: dict[str, str]
    """All that decides the figures, except the machine."""
    findings: list[Finding]
    notes: list[str]
    summary: str


def reproduce(
    names: Sequence[str],
    terrain: TerrainFiles,
    output: Path,
    *,
    models: tuple[str, str] = ("paper", "edge"),
    seed: int = 1,
    quick: bool = False,
    queries: int | None = None,
    again: bool = False,
) -> Iterator[tuple[Stored, bool]]:
    """Run experiments, one at a time: what is kept of each, and whether it was run or complete
    already.

    The `names` are of `EXPERIMENTS`, the `models` networks of the paper's method and of ours,
    `queries` the number of timed ones in place of the settings' own; what is complete is run
    `again` only if that is asked for. The folder's page is brought up to date after each.

    InvalidQueryError if the terrain is too small for one; TerrainError, ModelError or OutputError
    where a file is at fault.
    """
    dems = terrain.read()
    networks = Networks(*map(NetworkModel, models))
    files = dict(zip(BOTH, map(read_model_file, models), strict=True))
    grounds = [
        f"`{path.name}` (cells of {dem.cell_size_m:g} m, SHA-256 "
        f"{sha256(path.read_bytes()).hexdigest()[:12]}…)"
        for path, dem in zip(terrain.paths, dems, strict=True)
    ]
    make_folder(output)
    for name in names:
        experiment = EXPERIMENTS[name]
        settings = experiment.settings(quick=quick, queries=queries)
        of_networks = [
            f"{of}: `{file.name}` (SHA-256 {file.sha256[:12]}…, region {{p ≥ "
            f"{file.metadata.region_factor:g} · td}})"
            for of, file in files.items()
            if of in experiment.networks
        ]
        made_with = {
            "made by": f"nnpp-edge {__version__}, seed {seed}" + ", `--quick`" * quick,
            "terrain": ", ".join(grounds),
            "networks": ", ".join(of_networks) or "none",
            "controls": CONTROLS_NOTE if of_networks else "none, as no network takes part",
            "samples": ", ".join(f"{setting} {value}" for setting, value in settings.items()),
        }
        stored = read_experiment(output / name)
        if stored is not None and stored.made_with == made_with and not again:
            yield stored, False
            continue
        cores = sorted(os.sched_getaffinity(0))
        machine = environment(cores)
        exercise()  # no kernel is compiled or loaded while the clock runs
        with bar(name, 1000, quiet=True) as advance:
            context = Context(dems, seed, networks, advance)
            result = experiment.run(context, **settings)
        on = (
            f"{machine['cpu']}, {len(cores)} core(s), load before of "
            f"{machine['load_average'][0]:.1f}"
        )
        table = summary(result.table or result.rows, result.by, networks, totals=result.totals)
        facts = Stored(
            *(FORMAT, name, experiment.where, experiment.title, quick, on, made_with),
            *(list(result.findings), context.notes, table),
        )
        place = output / name / name
        make_folder(place.parent)
        write_all(
            {
                place.with_suffix(".csv"): result.rows.csv().encode(),
                place.with_suffix(".png"): encoded(result.picture, dpi=130),
                place.with_suffix(".json"): msgspec.json.format(
                    msgspec.json.encode(facts), indent=1
                ),
            }
        )
        _write_index(output)
        yield facts, True
    _write_index(output)


def read_experiment(folder: Path) -> Stored | None:
    """Content of NAME.json in a finished experiment's folder; None where it is missing or not
    whole.
    """
    try:
        stored = msgspec.json.decode((folder / f"{folder.name}.json").read_bytes(), type=Stored)
    except (OSError, msgspec.DecodeError):
        return None
    whole = all((folder / f"{folder.name}.{ending}").is_file() for ending in ("csv", "png"))
    return stored if whole and stored.format == FORMAT else None


def _write_index(output: Path) -> None:
    """The folder's page: verdicts first, then each experiment with its table and picture."""
    stored = [
        found for name in EXPERIMENTS if (found := read_experiment(output / name)) is not None
    ]
    quick = ", ".join(of.where for of in stored if of.quick)
    link = "[{0.where}](#{0.name})".format
    parts = [
        "# The paper's experiments, repeated",
        "NNPP (Ji et al., arXiv 2308.04792v3), its experiments on our terrain with this toolkit, "
        "each beside the "
        "paper's figures. This page and all that it links to are written by `nnpp-edge "
        "reproduce`; the verdicts "
        "follow from the measured figures by the rules named beside them. How the paper "
        "was read, and what is counted: `docs/reproduce.md`.",
        *[f"**{quick}: smoke runs (`--quick`), far too small to conclude anything from.**"]
        * bool(quick),
    ]
    counts = [
        (
            link(of),
            of.title,
            *(str(sum(f.verdict is verdict for f in of.findings) or "–") for verdict in Verdict),
        )
        for of in stored
    ]
    parts.append(markdown_table(("", "experiment", "agrees", "better", "does not agree"), counts))
    for verdict, head in _HEADS.items():
        lines = [
            (link(of), *finding_cells(f))
            for of in stored
            for f in of.findings
            if f.verdict is verdict
        ]
        if lines:
            parts += [f"## {head}", markdown_table(_COLUMNS, lines)]
    for of in stored:
        place = f"{of.name}/{of.name}"
        facts = of.made_with | {"machine": of.machine}
        parts += [f'<a id="{of.name}"></a>', f"## {of.where}: {of.title}"]
        parts += ["\n".join(f"- {fact}: {text}" for fact, text in facts.items())]
        parts += [f"![{of.title}]({place}.png)", of.summary, *of.notes, f"[Figures]({place}.csv)"]
    write_whole(output / "README.md", "\n\n".join([*parts, ""]).encode())


def finding_cells(finding: Finding) -> tuple[str, ...]:
    """A finding's line in a table."""
    said = "; says nothing about the network, a control does as well: " + ", ".join(
        finding.controls
    )
    verdict = f"**{finding.verdict}**" + said * bool(finding.controls)
    return finding.claim, finding.paper, finding.ours, finding.rule, verdict
