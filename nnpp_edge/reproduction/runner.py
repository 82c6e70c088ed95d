"""Running experiments into a folder: each is written whole or not at all, and not run again without need."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from nnpp_edge import __version__
from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.profiling.machine import environment
from nnpp_edge.profiling.suites import TerrainFiles
from nnpp_edge.reproduction.experiment import NAMES, Context, Experiment, OnProgress, find_experiment
from nnpp_edge.reproduction.index import FileFacts, MadeWith, Stored, experiment_page, findings_of, index_page
from nnpp_edge.reproduction.regions import Networks
from nnpp_edge.reproduction.report import Finding, Result
from nnpp_edge.runtime.errors import DataSetError, OutputError
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.model_file import read_model_file

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FORMAT = "nnpp-edge-reproduction-2"
_WORK = ".work"


@dataclass(frozen=True)
class Request:
    """Which experiments to run, on what, and where to."""

    names: Sequence[str]
    """Of `NAMES`."""
    terrain: TerrainFiles
    output: Path
    seed: int = 1
    models: tuple[str, str] = ("paper", "edge")
    """Networks of the paper's method, and of ours."""
    quick: bool = False
    steps: int | None = None
    """Training steps for each encoding of Fig. 13, where not the settings' own."""
    queries: int | None = None
    """Queries, where not the settings' own."""
    dataset: Path | None = None
    again: bool = False
    """Run what is complete, too."""


@dataclass(frozen=True)
class ExperimentOutcome:
    """How an experiment ended."""

    name: str
    how: str
    """``done``, ``skipped`` (complete already) or ``missing`` (not in this version)."""
    findings: Sequence[Finding] = ()


def reproduce(
    request: Request, *, bar: Callable[[str, int], AbstractContextManager[Callable[[int], None]]]
) -> Iterator[ExperimentOutcome]:
    """Run the experiments asked for, one at a time; the folder's index is brought up to date after each.

    `bar` opens a progress bar from a name and a total; its value is called with how much is done.

    Raises
    ------
    InvalidQueryError
        There is no such experiment, or the terrain is too small for one.
    TerrainError, ModelError, DataSetError
        A file cannot be read.
    OutputError
        The folder cannot be written to.
    """
    wanted = [(name, find_experiment(name)) for name in request.names]
    dems = request.terrain.read()
    networks = Networks(*map(NetworkModel, request.models))
    common = _made_with(request, [dem.cell_size_m for dem in dems])
    make_folder(request.output)
    for name, experiment in wanted:
        if experiment is None:
            yield ExperimentOutcome(name, "missing")
            continue
        settings = _settings(experiment, request)
        facts_of_it = {"settings": asdict(settings)} | ({} if experiment.asks_networks else {"networks": {}})
        made_with: MadeWith = json.loads(json.dumps(common | facts_of_it))
        stored = read_experiment(request.output / name)
        if stored is not None and stored["made_with"] == made_with and not request.again:
            yield ExperimentOutcome(name, "skipped", findings_of(stored))
            continue
        work = request.output / _WORK / f"{name}-{_digest(json.dumps(made_with, sort_keys=True).encode())[:12]}"
        context = Context(dems, request.seed, networks, work, request.dataset)
        machine, load = _machine()
        exercise()  # no kernel is compiled or loaded while the clock runs
        with bar(name, 1000) as advance:
            result = experiment.run(context, settings, _in_thousandths(advance))
        facts = Stored(
            format=FORMAT,
            name=name,
            where=experiment.where,
            title=experiment.title,
            machine=machine,
            load=load,
            made_with=made_with,
            about=asdict(result.about),
            findings=[asdict(finding) for finding in result.findings],
            notes=list(result.notes),
            animated=result.animation is not None,
            summary=result.summary.markdown(),
        )
        _store(request.output / name, facts, result)
        shutil.rmtree(work, ignore_errors=True)
        _remove_if_empty(request.output / _WORK)
        write_index(request.output)
        yield ExperimentOutcome(name, "done", result.findings)
    write_index(request.output)


def _in_thousandths(advance: Callable[[int], None]) -> OnProgress:
    return lambda share: advance(int(1000 * share))


def _settings(experiment: "Experiment[DataclassInstance]", request: Request) -> "DataclassInstance":
    settings = experiment.quick if request.quick else experiment.full
    for name in ("steps", "queries"):
        if getattr(request, name) is not None and hasattr(settings, name):
            settings = replace(settings, **{name: getattr(request, name)})
    return settings


def _made_with(request: Request, cell_sizes_m: list[float]) -> MadeWith:
    """All that decides the figures, but the settings: names and contents of files, never their places."""
    models, dataset = [read_model_file(model) for model in request.models], None
    if request.dataset is not None:
        try:
            recipe = (request.dataset / "dataset.json").read_bytes()
        except OSError as error:
            raise DataSetError(f"{request.dataset}: wanted a data set's folder with dataset.json") from error
        dataset = FileFacts(name=request.dataset.name, sha256=_digest(recipe))
    terrain = [
        FileFacts(name=path.name, sha256=_digest(path.read_bytes()), cell_size_m=side)
        for path, side in zip(request.terrain.paths, cell_sizes_m, strict=True)
    ]
    return MadeWith(
        version=__version__,
        quick=request.quick,
        seed=request.seed,
        terrain=terrain,
        networks={
            whose: FileFacts(name=model.name, sha256=model.sha256)
            for whose, model in zip(("the paper's method", "ours"), models, strict=True)
        },
        dataset=dataset,
        settings={},
    )


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _store(folder: Path, facts: Stored, result: Result) -> None:
    """Write an experiment's folder beside its place, then put it there."""
    name = folder.name
    fresh, old = folder.with_name(f".{name}.new"), folder.with_name(f".{name}.old")
    files = {
        f"{name}.csv": result.data.csv().encode(),
        f"{name}.md": experiment_page(facts).encode(),
        f"{name}.png": result.picture,
        f"{name}.json": json.dumps(facts, indent=1, ensure_ascii=False).encode(),
    }
    if result.animation is not None:
        files[f"{name}.gif"] = result.animation
    try:
        for path in (fresh, old):
            shutil.rmtree(path, ignore_errors=True)
        fresh.mkdir()
        for file, content in files.items():
            write_whole(fresh / file, content)
        if folder.exists():
            folder.replace(old)
        fresh.replace(folder)
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{folder}: could not be written ({error.strerror or error})") from error


def read_experiment(folder: Path) -> Stored | None:
    """What NAME.json in a finished experiment's folder holds; None where it is missing or not whole."""
    name = folder.name
    try:
        stored = json.loads((folder / f"{name}.json").read_text())
    except (OSError, ValueError):
        return None
    if not isinstance(stored, dict) or stored.get("format") != FORMAT:
        return None
    endings = ("csv", "md", "png", "gif") if stored.get("animated") else ("csv", "md", "png")
    whole = all((folder / f"{name}.{ending}").is_file() for ending in endings)
    return cast(Stored, stored) if whole else None


def write_index(output: Path) -> None:
    """Write README.md of a folder from the experiments that it holds."""
    stored = [found for name in NAMES if (found := read_experiment(output / name)) is not None]
    missing = [name for name in NAMES if find_experiment(name) is None]
    write_whole(output / "README.md", index_page(stored, missing).encode())


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _machine() -> tuple[str, float]:
    """The processor's name with the number of cores this process may use, and how busy the machine is."""
    cores = sorted(os.sched_getaffinity(0))
    found = environment(cores)
    return f"{found['cpu']}, {len(cores)} core(s)", found["load_average"][0]
