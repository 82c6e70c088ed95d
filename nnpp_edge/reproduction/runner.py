"""Running experiments into a folder: each is written whole or not at all.

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
from nnpp_edge.profiling.rows import Rows
from nnpp_edge.progress import THOUSANDTHS, bar
from nnpp_edge.reproduction import dynamic, exact, looks, static
from nnpp_edge.reproduction.drawing import maps
from nnpp_edge.reproduction.experiment import BOTH, Context, Experiment
from nnpp_edge.reproduction.findings import Finding, Verdict
from nnpp_edge.reproduction.regions import NetworkPair
from nnpp_edge.reproduction.table import summary
from nnpp_edge.runtime.errors import optional_module
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import read_model_file
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.viz.picture import encoded

FORMAT = "nnpp-edge-reproduction-4"
EXPERIMENTS: dict[str, Experiment] = {}
for room in (exact, static, looks, dynamic):
    EXPERIMENTS |= room.EXPERIMENTS
"""The experiments of the paper by name, in the order in which they run."""
QUICK = {
    "sizes": (64, 128, 256),
    "size": 128,
    "maps": 3,
    "queries": 4,
    "repeats": 1,
    "fine": 25,
    "goals": 3,
    "episodes": 3,
}
"""Settings of a smoke run."""
_HEADS = {
    Verdict.DIFFERS: "What does not agree",
    Verdict.TOO_FEW: "What too few queries were made for",
    Verdict.BETTER: "What is better than in the paper",
    Verdict.AGREES: "What agrees",
}
_OF_TOTALS = "Times and CC are summed over the plans for which every method found a path."


class Stored(msgspec.Struct):
    """Content of an experiment's NAME.json."""

    format: str
    name: str
    where: str
    title: str
    quick: bool
    made_with: dict[str, str]
    """All that decides the figures."""
    findings: list[Finding]
    notes: list[str]
    summary: str


def reproduce(
    names: Sequence[str],
    dems: Sequence[Dem],
    output: Path,
    *,
    models: tuple[str, str] = ("paper", "edge"),
    seed: int = 1,
    quick: bool = False,
) -> Iterator[Stored]:
    """Run experiments, one at a time: what is stored of each.

    The `names` are of `EXPERIMENTS`, the `models` networks of the paper's method and of ours. The
    folder's page is brought up to date after each, with what earlier runs have left there.

    InvalidQueryError if the terrain is too small for one; TerrainError, ModelError or OutputError
    where a file is at fault.
    """
    networks = NetworkPair(*map(NetworkModel, models))
    grounds = []
    for dem in dems:
        digest = sha256(dem.source.read_bytes()).hexdigest()[:12]
        grounds.append(f"`{dem.source.name}` (cells of {dem.cell_size_m:g} m, SHA-256 {digest}…)")
    make_folder(output)
    for name in names:
        experiment = EXPERIMENTS[name]
        settings = dict(experiment.settings)
        if quick:
            settings |= {name: QUICK[name] for name in settings.keys() & QUICK.keys()}
        used = [
            f"{role}: {_network(file)}"
            for role, file in zip(BOTH, models, strict=True)
            if role in experiment.networks
        ]
        facts = {
            "made by": f"nnpp-edge {__version__}, seed {seed}" + ", `--quick`" * quick,
            "terrain": ", ".join(grounds),
            "networks": ", ".join(used) or "none",
            "controls": "corridor, straight band, shuffled weights" if used else "none",
            "samples": ", ".join(f"{setting} {value}" for setting, value in settings.items()),
            "machine": _machine(),
        }
        exercise()  # no kernel is compiled or loaded while the clock runs
        with bar(name, THOUSANDTHS, quiet=True) as advance:
            context = Context(dems, seed, networks, advance)
            rows = Rows(experiment.measure(context, **settings))
        everything = experiment.beside(rows)
        if experiment.totals:
            context.notes.append(_OF_TOTALS)
        made = Stored(
            FORMAT,
            name,
            experiment.where,
            experiment.title,
            quick,
            facts,
            list(experiment.findings(rows)),
            context.notes,
            summary(everything, experiment.by, totals=experiment.totals),
        )
        draw = experiment.picture
        picture = draw(everything) if draw else maps(context.scenes)
        place = output / name / name
        make_folder(place.parent)
        content = msgspec.json.format(msgspec.json.encode(made), indent=1)
        write_all(
            {
                place.with_suffix(".csv"): rows.csv().encode(),
                place.with_suffix(".png"): encoded(picture, dpi=130),
                place.with_suffix(".json"): content,
            }
        )
        _write_page(output)
        yield made


def _network(file: str) -> str:
    """A network's file, for people."""
    read = read_model_file(file)
    region = f"region {{p ≥ {read.metadata.region_factor:g} · td}}"
    return f"`{read.name}` (SHA-256 {read.sha256[:12]}…, {region})"


def _machine() -> str:
    cores = sorted(os.sched_getaffinity(0))
    machine = environment(cores)
    load = machine["load_average"][0]
    return f"{machine['cpu']}, {len(cores)} core(s), load before of {load:.1f}"


def read_experiment(folder: Path) -> Stored | None:
    """Content of NAME.json in an experiment's folder; None where there is none of this format."""
    try:
        content = (folder / folder.name).with_suffix(".json").read_bytes()
        stored = msgspec.json.decode(content, type=Stored)
    except (OSError, msgspec.DecodeError):
        return None
    return stored if stored.format == FORMAT else None


def _write_page(output: Path) -> None:
    """The folder's page: verdicts first, then each experiment with its table and picture."""
    jinja2 = optional_module("jinja2", "the experiments' page", "viz")
    template = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    found = [read_experiment(output / name) for name in EXPERIMENTS]
    stored = [each for each in found if each is not None]
    claims: dict[str, list[tuple[Stored, Finding]]] = {head: [] for head in _HEADS.values()}
    for each in stored:
        for finding in each.findings:
            claims[_HEADS[finding.verdict]].append((each, finding))
    text = Path(__file__).with_name("page.md.j2").read_text()
    page = template.from_string(text).render(stored=stored, claims=claims, verdicts=list(Verdict))
    write_whole(output / "README.md", page.encode())
