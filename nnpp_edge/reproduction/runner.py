"""Running experiments into a folder: each is written whole or not at all, and not run again without need."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import msgspec

from nnpp_edge import __version__
from nnpp_edge.files import make_folder, write_all, write_whole
from nnpp_edge.profiling.machine import environment
from nnpp_edge.profiling.suites import TerrainFiles
from nnpp_edge.progress import bar
from nnpp_edge.reproduction.drawing import png
from nnpp_edge.reproduction.dynamic import table3, table4
from nnpp_edge.reproduction.exact import fig6, fig7, table1
from nnpp_edge.reproduction.experiment import BOTH, Context
from nnpp_edge.reproduction.looks import fig8, fig14
from nnpp_edge.reproduction.pages import Stored, index_page
from nnpp_edge.reproduction.planners import summary
from nnpp_edge.reproduction.regions import Networks
from nnpp_edge.reproduction.static import fig9, fig11, fig12, table2
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import read_model_file

FORMAT = "nnpp-edge-reproduction-3"
_RUN = (table1, fig6, fig7, fig8, table2, fig9, fig11, fig12, fig14, table3, table4)
EXPERIMENTS = {each.run.__name__: each for each in _RUN}
"""The experiments of the paper by name, in the order in which they run."""


@dataclass(frozen=True)
class Request:
    """Which experiments to run, on what, and where to."""

    names: Sequence[str]
    """Of `EXPERIMENTS`."""
    terrain: TerrainFiles
    output: Path
    seed: int = 1
    models: tuple[str, str] = ("paper", "edge")
    """Networks of the paper's method, and of ours."""
    quick: bool = False
    queries: int | None = None
    """Timed queries, where not the settings' own."""
    again: bool = False
    """Run what is complete, too."""


def reproduce(request: Request) -> Iterator[tuple[Stored, bool]]:
    """Run the experiments asked for, one at a time: what is kept of each, and whether it was run or complete already.

    The folder's index is brought up to date after each. InvalidQueryError if there is no such experiment, or the
    terrain is too small for one; TerrainError, ModelError or OutputError where a file is at fault.
    """
    if unknown := set(request.names) - set(EXPERIMENTS):
        raise InvalidQueryError(f"experiment must be one of {', '.join(EXPERIMENTS)}, got {', '.join(unknown)}")
    dems, networks = request.terrain.read(), Networks(*map(NetworkModel, request.models))
    files = [(path.name, sha256(path.read_bytes()).hexdigest()) for path in request.terrain.paths]
    terrain = [
        {"name": name, "sha256": digest, "cell_size_m": dem.cell_size_m}
        for (name, digest), dem in zip(files, dems, strict=True)
    ]
    of_networks = {
        whose: {"name": model.name, "sha256": model.sha256}
        for whose, model in zip(BOTH, map(read_model_file, request.models), strict=True)
    }
    make_folder(request.output)
    for name in request.names:
        experiment = EXPERIMENTS[name]
        settings = experiment.settings(quick=request.quick, queries=request.queries)
        made_with = {
            "version": __version__,
            "quick": request.quick,
            "seed": request.seed,
            "terrain": terrain,
            "networks": {whose: of_networks[whose] for whose in experiment.networks},
            "settings": settings,
        }
        stored = read_experiment(request.output / name)
        same = stored is not None and msgspec.json.encode(stored.made_with) == msgspec.json.encode(made_with)
        if stored is not None and same and not request.again:
            yield stored, False
            continue
        cores = sorted(os.sched_getaffinity(0))
        machine = environment(cores)
        exercise()  # no kernel is compiled or loaded while the clock runs
        with bar(name, 1000, quiet=True) as advance:
            context = Context(dems, request.seed, networks, advance)
            result = experiment.run(context, **settings)
        table = summary(result.table or result.rows, result.by, networks, totals=result.totals)
        models = zip(experiment.networks, networks, strict=False)
        about = {
            "networks": ", ".join(f"{whose}: `{model.metadata.name}`" for whose, model in models) or "none",
            "controls": experiment.controls if experiment.networks else "none, as no network takes part",
            "samples": ", ".join(f"{name} {value}" for name, value in settings.items()),
            "load before": f"{machine['load_average'][0]:.1f}, the average over a minute",
        }
        facts = Stored(
            *(FORMAT, name, experiment.where, experiment.title),
            *(f"{machine['cpu']}, {len(cores)} core(s)", made_with, about),
            *(list(result.findings), context.notes, table),
        )
        place = request.output / name / name
        make_folder(place.parent)
        write_all(
            {
                place.with_suffix(".csv"): result.rows.csv().encode(),
                place.with_suffix(".png"): png(result.picture),
                place.with_suffix(".json"): msgspec.json.format(msgspec.json.encode(facts), indent=1),
            }
        )
        _write_index(request.output)
        yield facts, True
    _write_index(request.output)


def read_experiment(folder: Path) -> Stored | None:
    """Content of NAME.json in a finished experiment's folder; None where it is missing or not whole."""
    try:
        stored = msgspec.json.decode((folder / f"{folder.name}.json").read_bytes(), type=Stored)
    except (OSError, msgspec.DecodeError):
        return None
    whole = all((folder / f"{folder.name}.{ending}").is_file() for ending in ("csv", "png"))
    return stored if whole and stored.format == FORMAT else None


def _write_index(output: Path) -> None:
    stored = [found for name in EXPERIMENTS if (found := read_experiment(output / name)) is not None]
    write_whole(output / "README.md", index_page(stored).encode())
