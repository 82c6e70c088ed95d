"""Running experiments into a folder: each is written whole or not at all, and not run again without need."""

import hashlib
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from nnpp_edge import __version__
from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.profiling.machine import environment
from nnpp_edge.profiling.suites import TerrainFiles
from nnpp_edge.progress import bar
from nnpp_edge.reproduction.drawing import png
from nnpp_edge.reproduction.dynamic import table3, table4
from nnpp_edge.reproduction.exact import fig6, fig7, table1
from nnpp_edge.reproduction.experiment import Context, Result
from nnpp_edge.reproduction.looks import fig8, fig14
from nnpp_edge.reproduction.pages import Stored, experiment_page, index_page
from nnpp_edge.reproduction.regions import CONTROLS_NOTE, Networks
from nnpp_edge.reproduction.rows import Row
from nnpp_edge.reproduction.static import fig9, fig11, fig12, table2
from nnpp_edge.runtime.errors import InvalidQueryError, OutputError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import read_model_file

FORMAT = "nnpp-edge-reproduction-2"
EXPERIMENTS = {
    each.run.__name__: each for each in (table1, fig6, fig7, fig8, table2, fig9, fig11, fig12, fig14, table3, table4)
}
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
    terrain is too small for one; TerrainError, ModelError, DataSetError or OutputError where a file is at fault.
    """
    if unknown := set(request.names) - set(EXPERIMENTS):
        raise InvalidQueryError(f"experiment must be one of {', '.join(EXPERIMENTS)}, got {', '.join(unknown)}")
    dems = request.terrain.read()
    networks = Networks(*map(NetworkModel, request.models))
    common = _made_with(request, [dem.cell_size_m for dem in dems])
    make_folder(request.output)
    for name in request.names:
        experiment = EXPERIMENTS[name]
        settings = experiment.settings(quick=request.quick, queries=request.queries)
        made_with = common | {"settings": settings} | ({} if experiment.asks_networks else {"networks": {}})
        made_as_json = msgspec.json.encode(made_with)
        stored = read_experiment(request.output / name)
        if stored is not None and msgspec.json.encode(stored.made_with) == made_as_json and not request.again:
            yield stored, False
            continue
        cores = sorted(os.sched_getaffinity(0))
        machine = environment(cores)
        exercise()  # no kernel is compiled or loaded while the clock runs
        with bar(name, 1000, quiet=True) as advance:
            context = Context(dems, request.seed, networks, advance)
            result = experiment.run(context, **settings)
        about = {"networks": result.networks or networks.named, "controls": result.controls or CONTROLS_NOTE}
        about["samples"] = ", ".join(f"{name} {value}" for name, value in settings.items())
        if not experiment.asks_networks:
            about |= {"networks": result.networks or "none", "controls": "none, as no network takes part"}
        facts = Stored(
            *(FORMAT, name, experiment.where, experiment.title),
            *(f"{machine['cpu']}, {len(cores)} core(s)", machine["load_average"][0], made_with, about),
            *(list(result.findings), context.notes, result.summary),
        )
        _store(request.output / name, facts, result)
        write_index(request.output)
        yield facts, True
    write_index(request.output)


def _made_with(request: Request, cell_sizes_m: list[float]) -> Row:
    """All that decides the figures, except the settings: names and contents of files, never their places."""
    models = [read_model_file(model) for model in request.models]
    terrain = [
        {"name": path.name, "sha256": _digest(path.read_bytes()), "cell_size_m": side}
        for path, side in zip(request.terrain.paths, cell_sizes_m, strict=True)
    ]
    networks = {
        whose: {"name": model.name, "sha256": model.sha256}
        for whose, model in zip(("the paper's method", "ours"), models, strict=True)
    }
    facts = {"version": __version__, "quick": request.quick, "seed": request.seed}
    return facts | {"terrain": terrain, "networks": networks}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _store(folder: Path, facts: Stored, result: Result) -> None:
    """Write an experiment's folder beside its place, then put it there."""
    fresh, old = folder.with_name(f".{folder.name}.new"), folder.with_name(f".{folder.name}.old")
    files = {
        "csv": result.rows.csv().encode(),
        "md": experiment_page(facts).encode(),
        "png": png(result.picture),
        "json": msgspec.json.format(msgspec.json.encode(facts), indent=1),
    }
    try:
        for path in (fresh, old):
            shutil.rmtree(path, ignore_errors=True)
        fresh.mkdir()
        for ending, content in files.items():
            write_whole(fresh / f"{folder.name}.{ending}", content)
        if folder.exists():
            folder.replace(old)
        fresh.replace(folder)
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{folder}: could not be written ({error.strerror or error})") from error


def read_experiment(folder: Path) -> Stored | None:
    """Content of NAME.json in a finished experiment's folder; None where it is missing or not whole."""
    try:
        stored = msgspec.json.decode((folder / f"{folder.name}.json").read_bytes(), type=Stored)
    except (OSError, msgspec.DecodeError):
        return None
    whole = all((folder / f"{folder.name}.{ending}").is_file() for ending in ("csv", "md", "png"))
    return stored if whole and stored.format == FORMAT else None


def write_index(output: Path) -> None:
    """Write README.md of a folder from the experiments that it holds."""
    stored = [found for name in EXPERIMENTS if (found := read_experiment(output / name)) is not None]
    write_whole(output / "README.md", index_page(stored).encode())
