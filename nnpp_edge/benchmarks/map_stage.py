"""From elevations to costs, coarse levels and a first path: what each stage takes, beside a copy of the elevations.

``python -m nnpp_edge.benchmarks.map_stage --beside FOLDER`` sets another checkout of the project beside this one.
Each runs in a process of its own, on the same cores, and they take turns, stage by stage: medians, and the median of
the ratios of each repetition.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import click
import numpy as np

import nnpp_edge
from nnpp_edge.benchmarks.dynamic_scene import run_alone
from nnpp_edge.benchmarks.map_stage_worker import METHODS, PATCH
from nnpp_edge.files import temporary_folder
from nnpp_edge.profiling.ground import Ground
from nnpp_edge.profiling.suites import TerrainFiles, cases_from, source_of
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError, NnppEdgeError
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.workloads import SOFT

HERE = Path(nnpp_edge.__file__).resolve().parents[1]
_WORKER = Path(__file__).with_name("map_stage_worker.py")
_KEEP_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(1 << 25), "MALLOC_TRIM_THRESHOLD_": str(1 << 31)}
"""What is freed stays with the process, but for arrays above 32 MiB. Left to itself glibc gives it back or not by
what else has been freed before, and to get each page again takes microseconds: one checkout would be lucky, another
not."""
_QUERIES = 10
"""Of a map, for first paths; repetitions take turns with them."""
_BY_CELL = ("copy", "cost map", "grid", "pyramid", "grid and pyramid", "all less cost map", "all")
_FIRST_PATHS = tuple(f"{method}, {how}" for method in METHODS for how in ("lazy", "eager"))
_BEST = "best method"
_TITLES = {
    "copy": "copy of the elevations",
    "cost map": "cost map",
    "grid": "grid, from costs",
    "pyramid": "pyramid, from the grid",
    "grid and pyramid": "grid and pyramid, from costs",
    "all less cost map": "grid and pyramid, in the passes of the whole",
    "all": "elevations → all costs and coarse levels",
    "patch": f"patch of {PATCH[0]} × {PATCH[1]} into all of it",
    **{each: f"elevations → first path: {each}" for each in (*_FIRST_PATHS, _BEST)},
}


@dataclass(frozen=True)
class StageRow:
    """One stage at one size."""

    size: int
    terrain: str
    stage: str
    unit: str
    """``ns/cell``, ``µs`` or ``ms``."""
    here: float
    """Median over the repetitions."""
    beside: float | None
    """The other checkout's; None without one, or where it does not have this stage by itself."""
    times_as_fast: float | None
    """Median over the repetitions of the other's time over ours."""
    page_faults: float
    """Median number of pages that the system had to hand out meanwhile, which is dear: a kernel call for each."""
    page_faults_beside: float | None
    repetitions: int


class Measured(NamedTuple):
    """One call of a stage."""

    seconds: float
    page_faults: float


class Worker:
    """A process that times stages with one checkout of the project.

    Parameters
    ----------
    checkout : Path
        Its folder, for messages.
    packages : Path
        The folder that its package `nnpp_edge` is imported from.
    cores : sequence of int
        To pin the process to; empty for all.

    Raises
    ------
    NnppEdgeError
        From every method: the process has failed; the message ends with the last line that it wrote.
    """

    def __init__(self, checkout: Path, packages: Path, cores: Sequence[int] = ()) -> None:
        self.checkout = checkout
        environment = os.environ | {"PYTHONPATH": str(packages)} | _KEEP_MEMORY
        command = [sys.executable, "-P", str(_WORKER), json.dumps(list(cores))]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()

    def prepare(self, path: Path, ground: Ground, queries: Sequence[Endpoints], model: str) -> list[str]:
        """Take a map, (H, W) elevations in a file, and its queries; the names of the stages."""
        sides = ground.cell_size_m, ground.cell_width_m
        answer = self._ask({"map": str(path), "sides": sides, "queries": queries, "model": model})
        assert isinstance(answer, list)
        return answer

    def measure(self, stage: str, number: int) -> "Measured":
        """A stage, once; `number` is that of the repetition, and chooses the query."""
        answer = self._ask({"task": stage, "number": number})
        assert isinstance(answer, list)
        return Measured(*answer)

    def _ask(self, words: Mapping[str, object]) -> object:
        stdin, stdout, stderr = self._process.stdin, self._process.stdout, self._process.stderr
        assert stdin is not None and stdout is not None and stderr is not None
        try:
            stdin.write(json.dumps(words) + "\n")
            stdin.flush()
            answer = stdout.readline()
        except OSError:
            answer = ""
        if not answer:
            self._process.kill()
            said = stderr.read().strip().splitlines() or ["no word of why"]
            raise NnppEdgeError(f"{self.checkout}: the process that times its stages failed: {said[-1]}")
        found: object = json.loads(answer)
        return found


def map_stage(
    sizes: Sequence[int],
    dems: Sequence[Dem] = (),
    *,
    beside: Path | None = None,
    repetitions: int = 15,
    cores: Sequence[int] = (),
    model: str = "edge",
    seed: int = 1,
    progress: Callable[[int], None] = lambda done: None,
) -> list[StageRow]:
    """Every stage at every size, on terrain that is large enough, else on synthetic ground.

    `beside` is the folder of another checkout. `progress` is called with the number of repetitions that are done.
    InvalidQueryError if that folder holds none; NnppEdgeError if one of the processes fails.
    """
    rows: list[StageRow] = []
    rng = np.random.default_rng(seed)
    with ExitStack() as stack:
        folder = stack.enter_context(temporary_folder())
        workers = [stack.enter_context(Worker(HERE, HERE, cores))]
        if beside is not None:
            workers.append(stack.enter_context(Worker(beside, _importable(beside, folder), cores)))
        for at, size in enumerate(sizes):
            ground, queries = _map(dems, size, seed)
            np.save(folder / "dem.npy", ground.elevation)
            known = [worker.prepare(folder / "dem.npy", ground, queries, model) for worker in workers]
            measured: list[dict[str, list[Measured]]] = [{stage: [] for stage in stages} for stages in known]
            for number in range(repetitions):
                for stage in rng.permutation(known[0]):
                    for who in rng.permutation(len(workers)):
                        if stage in measured[who]:
                            measured[who][stage].append(workers[who].measure(str(stage), number))
                progress(at * repetitions + number + 1)
            rows += _rows(size, source_of(dems, size), measured)
    return rows


def _importable(checkout: Path, folder: Path) -> Path:
    """A folder that the checkout's packages can be imported from: older ones put them together when installed."""
    package, runtime = checkout / "nnpp_edge", checkout / "runtime"
    if (package / "runtime").is_dir():
        return checkout
    if not (package.is_dir() and runtime.is_dir()):
        raise InvalidQueryError(f"{checkout}: wanted a checkout of this project, got a folder without its runtime")
    linked = folder / "checkout" / "nnpp_edge"
    linked.mkdir(parents=True)
    for each in (*package.iterdir(), runtime):
        (linked / each.name).symlink_to(each)
    return linked.parent


def _map(dems: Sequence[Dem], size: int, seed: int) -> tuple[Ground, list[Endpoints]]:
    """The first map with a query that has a path, and its queries that have one."""
    for case in cases_from(dems, SOFT, size, seed):
        planner = Planner(case.cost)
        queries = [query for query in case.queries if planner.plan(*query, method="corridor").ok][:_QUERIES]
        if queries and case.ground is not None:
            return case.ground, queries
    raise AssertionError("cases are without end")


def _rows(size: int, terrain: str, measured: Sequence[Mapping[str, list[Measured]]]) -> Iterator[StageRow]:
    whole = [dict(each) | _derived(each) for each in measured]
    for stage in (*_BY_CELL, "patch", *_FIRST_PATHS, _BEST):
        if stage not in whole[0]:
            continue
        unit = "ns/cell" if stage in _BY_CELL else "µs" if stage == "patch" else "ms"
        scale = {"ns/cell": 1e9 / size**2, "µs": 1e6, "ms": 1e3}[unit]
        here, *others = (np.array(each[stage]).T for each in whole if stage in each)
        other = others[0] if others else None
        yield StageRow(
            size=size,
            terrain=terrain,
            stage=stage,
            unit=unit,
            here=scale * float(np.median(here[0])),
            beside=None if other is None else scale * float(np.median(other[0])),
            times_as_fast=None if other is None else float(np.median(other[0] / here[0])),
            page_faults=float(np.median(here[1])),
            page_faults_beside=None if other is None else float(np.median(other[1])),
            repetitions=here.shape[1],
        )


def _derived(measured: Mapping[str, list[Measured]]) -> dict[str, list[Measured]]:
    """What the whole takes beyond the cost map, and the first path by the method whose median is the least."""
    both = zip(measured["all"], measured["cost map"], strict=True)
    beyond = [Measured(a.seconds - b.seconds, a.page_faults - b.page_faults) for a, b in both]
    best = min(_FIRST_PATHS, key=lambda stage: float(np.median([each.seconds for each in measured[stage]])))
    return {"all less cost map": beyond, _BEST: measured[best]}


def render(rows: Sequence[StageRow], beside: bool, *, markdown: bool = False) -> str:
    """The rows for people."""
    from nnpp_edge.progress import markdown_table, render_table

    header = ["stage", "size", "unit", "here", *(("beside", "times as fast") if beside else ())]
    body = []
    for row in sorted(rows, key=lambda row: list(_TITLES).index(row.stage)):
        line = [_TITLES[row.stage], f"{row.size}²", row.unit, f"{row.here:.3g}"]
        if beside:
            line += ["–" if row.beside is None else f"{row.beside:.3g}"]
            line += ["–" if row.times_as_fast is None else f"{row.times_as_fast:.2f}"]
        body.append(line)
    if markdown:
        return markdown_table(header, body)
    return render_table(header, body, [at > 0 and line[0] != body[at - 1][0] for at, line in enumerate(body)])


def _numbers(ctx: click.Context, option: click.Parameter, words: str) -> tuple[int, ...]:
    try:
        return tuple(int(word) for word in words.split(",") if word)
    except ValueError:
        raise click.BadParameter(f"wanted numbers joined by commas, got {words!r}") from None


@click.command()
@click.option("--terrain", multiple=True, type=click.Path(path_type=Path), help="Elevation file; else synthetic.")
@click.option("--rescale", type=float, help="Rescale the terrain to cells of so many metres, slopes kept.")
@click.option("--cell-size", type=float, help="Side of a cell in metres, where the files do not say.")
@click.option("--sizes", callback=_numbers, default="256,512,1024,2048", show_default=True, help="Sides of the maps.")
@click.option("--repetitions", type=click.IntRange(1), default=15, show_default=True)
@click.option("--beside", type=click.Path(path_type=Path, file_okay=False), help="Another checkout of the project.")
@click.option(
    "--cores", callback=_numbers, default="", help="To pin the processes to, joined by commas; by default all."
)
@click.option("--model", default="edge", show_default=True, help="Shipped model or file.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option("--json", "json_wanted", is_flag=True, help="Print JSON for programs.")
@click.option("--markdown", is_flag=True, help="Print the table as Markdown.")
def main(
    terrain: tuple[Path, ...],
    rescale: float | None,
    cell_size: float | None,
    sizes: tuple[int, ...],
    repetitions: int,
    beside: Path | None,
    cores: tuple[int, ...],
    model: str,
    seed: int,
    json_wanted: bool,
    markdown: bool,
) -> None:
    """From elevations to costs, coarse levels and a first path, stage by stage."""
    from nnpp_edge.progress import bar

    if not sizes or min(sizes) < 64:
        raise click.UsageError(f"--sizes must be numbers of at least 64, got {','.join(map(str, sizes))}")
    if not set(cores) <= os.sched_getaffinity(0):
        raise click.UsageError(f"--cores must be of {','.join(map(str, sorted(os.sched_getaffinity(0))))}")
    dems = TerrainFiles(terrain, rescale, cell_size).read()
    with bar("map stage", len(sizes) * repetitions, quiet=True) as advance:
        rows = map_stage(
            sizes,
            dems,
            beside=beside and beside.resolve(),
            repetitions=repetitions,
            cores=cores,
            model=model,
            seed=seed,
            progress=advance,
        )
    if json_wanted:
        click.echo(json.dumps([asdict(row) for row in rows], indent=1))
    else:
        click.echo(render(rows, beside is not None, markdown=markdown))


if __name__ == "__main__":
    run_alone(main)
