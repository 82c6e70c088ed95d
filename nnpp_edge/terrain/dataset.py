"""Making, storing and reading a training set. The format is described in docs/dataset.md."""

import multiprocessing
import os
import signal
import warnings
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.progress import Progress, ignore
from nnpp_edge.runtime.arrays import Array, Float32s, Int32, UInt8, in_blocks
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.unseen import ANSWERS
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.terrain.shards import Recipe, Tiles, poolings, read_terrain, shard_content

FORMAT = "nnpp-edge-dataset-1"
RECIPE_FILE = "dataset.json"

Shards = Generator[tuple[int, bytes], None, None]
"""Numbers and contents of shards, in the order done."""
Query = tuple[Float32s, tuple[float, float], tuple[float, float]]
"""Planes (2, S, S) in [0, 1]; start and goal, (row, col) in network cells."""
Arrays = dict[str, Array]
"""The arrays of a shard, by name."""
T = TypeVar("T")
_OF_QUERIES = ("map_index", "start", "goal", "excess", "on_path")


@dataclass(frozen=True)
class Samples:
    """Labelled queries in memory: Q queries on M maps of S × S cells, with labels on B ×
    B blocks.
    """

    planes: UInt8
    """(M, 2, S, S) mean cost (impassable as 1) and share of impassable cells, in 255ths."""
    map_index: Int32
    """(Q,) the map of each query."""
    start: Float32s
    """(Q, 2) row and column in input cells."""
    goal: Float32s
    excess: UInt8
    """(Q, B, B) excess of each block over the optimum, in steps of 0.1 %."""
    on_path: UInt8
    """(Q, B, B / 8) bits: whether the optimal path crosses a block."""

    def __len__(self) -> int:
        return len(self.map_index)

    def query(self, at: int) -> Query:
        """One query as a network is fed with it."""
        start = self.start[at].tolist()
        goal = self.goal[at].tolist()
        planes = self.planes[self.map_index[at]].astype(np.float32) / 255.0
        return planes, tuple(start), tuple(goal)

    def averaged(self, size: int) -> "Samples":
        """Average the maps to `size` cells a side, a whole part of theirs; else DataSetError."""
        count, planes, side, _ = self.planes.shape
        if side % size:
            raise DataSetError(
                f"wanted maps of {size} cells a side or a multiple of that, got {side}"
            )
        factor = side // size
        if factor == 1:
            return self
        small = np.empty((count, planes, size, size), np.uint8)
        for at, cells in enumerate(self.planes):  # one by one: all as float32 would fill the memory
            blocks = in_blocks(cells.astype(np.float32), factor)
            small[at] = np.rint(blocks.mean(axis=(2, 4)))
        half = np.float32(0.5)
        start = (self.start + half) / factor - half
        goal = (self.goal + half) / factor - half
        return replace(self, planes=small, start=start, goal=goal)

    def pick(self, queries: Array | range) -> "Samples":
        """Some of the queries, by a mask or by their numbers; the maps stay."""
        return replace(self, **{name: getattr(self, name)[queries] for name in _OF_QUERIES})


Queries = Samples | KnownMaps
"""Labelled queries, or maps known by their blocks for a network that prices unseen ground."""


def make_dataset(
    recipe: Recipe,
    folder: Path,
    *,
    workers: int | None = None,
    progress: Progress = ignore,
) -> dict[str, int]:
    """Write what is missing of a data set; numbers of ``shards``, ``maps``, ``queries``, and of all
    shards (``of``).

    The folder is made if need be; shards that are there are kept, the others are made by `workers`
    processes, by default one a core. `progress` is called with how many are done.

    Raises DataSetError, TerrainError or OutputError where the folder holds another set, damaged
    shards, or cannot be written to; terrain cannot be read, is too small or has no two cells to
    plan between; a process died.
    """
    missing = [i for i in range(recipe.shards) if not _shard_path(folder, i).exists()]
    tiles = read_terrain(recipe) if missing else []
    fitting = poolings(recipe, tiles)
    names = [f"{recipe.size * each[0]}²" for each in recipe.poolings if each not in fitting]
    if names:
        warnings.warn(
            f"the terrain has no room for maps of {' and '.join(names)} cells: they are left out",
            stacklevel=2,
        )
    make_folder(folder)
    _claim(recipe, folder)

    done = recipe.shards - len(missing)
    progress(done)
    made = _shards_here(recipe, tiles, missing, workers)
    try:
        with closing(made):
            for index, content in made:
                write_whole(_shard_path(folder, index), content)
                done += 1
                progress(done)
    finally:
        if not any(folder.glob("shard-*.npz")):  # a recipe alone is no part of a data set
            (folder / RECIPE_FILE).unlink(missing_ok=True)

    of_map, of_query = ("heights", "factor") if recipe.known else ("planes", "map_index")
    counts = {"shards": 0, "of": recipe.shards, "maps": 0, "queries": 0}
    for shard in read_shards(folder, recipe):
        counts["shards"] += 1
        counts["maps"] += len(shard[of_map])
        counts["queries"] += len(shard[of_query])
    return counts


def read_shards(folder: Path, recipe: Recipe) -> Iterator[Arrays]:
    """The arrays of each shard in the folder, by name; DataSetError for one that is damaged or of
    another recipe.
    """
    for path in sorted(folder.glob("shard-*.npz")):
        wanted = f"{path}: wanted a shard of this data set, got a file that is none"
        with (
            refused_as(DataSetError, wanted),
            path.open("rb") as file,
            np.load(file, allow_pickle=False) as content,
        ):
            shard = dict(content)
            _check_shard(shard, recipe)
        yield shard


_LAYOUT = {
    "planes": ("u1", "M2SS"),
    "workload": ("<U", "M"),
    "pooling": ("<i4", "M"),
    "map_index": ("<i4", "Q"),
    "start": ("<f4", "Q2"),
    "goal": ("<f4", "Q2"),
    "excess": ("u1", "QBB"),
    "on_path": ("u1", "QBP"),
}
_KNOWN_LAYOUT = {
    "heights": ("<f4", "MSS"),
    "answers": ("u1", "M3SS"),
    "factor": ("<i4", "M"),
    **dict.fromkeys(("cell_size_m", "slope_limit_deg", "hard_slope_deg"), ("<f4", "M")),
}
"""Type and shape of each array of a shard: M maps, Q queries, S cells and B blocks to a side, P
bytes of B bits.
"""


def _check_shard(shard: Arrays, recipe: Recipe) -> None:
    """KeyError or ValueError where a shard's arrays are not those that the recipe makes."""
    layout = _KNOWN_LAYOUT if recipe.known else _LAYOUT
    sides = {"S": recipe.size, "B": recipe.blocks, "P": recipe.blocks // 8, "2": 2, "3": ANSWERS}
    for name, (kind, letters) in layout.items():
        found = shard[name]
        # the first array to name a number of maps or queries sets it
        shape = [sides.setdefault(*pair) for pair in zip(letters, found.shape, strict=True)]
        if [*found.shape] != shape or not found.dtype.str.removeprefix("|").startswith(kind):
            raise ValueError(f"{name} is {found.shape} {found.dtype}, not {shape} {kind}")
    if not recipe.known:
        ends = np.stack([shard["start"], shard["goal"]]).astype(np.float32)
        inside = (ends > -1) & (ends < recipe.size)
        numbers = set(shard["map_index"].tolist())
        if not (numbers and numbers <= set(range(sides["M"])) and inside.all()):
            raise ValueError("its queries do not lie on its maps")


def read_known(folder: Path) -> KnownMaps:
    """Read all maps of a data set that are known by their blocks; DataSetError where it cannot be
    read, or has none."""
    recipe = _recipe_of_kind(folder, known=True)
    return _joined(KnownMaps, folder, read_shards(folder, recipe))


def _recipe_of_kind(folder: Path, known: bool) -> Recipe:
    """As `read_recipe`; DataSetError for a set of the other kind, too."""
    recipe = read_recipe(folder)
    if recipe.known != known:
        kinds = ["with queries", "that are known by their blocks (--known, for unseen)"]
        raise DataSetError(f"{folder}: wanted maps {kinds[known]}, got maps {kinds[recipe.known]}")
    return recipe


def read_recipe(folder: Path) -> Recipe:
    """The recipe in a data set's folder; DataSetError if there is none."""
    wanted = f"{folder}: wanted a data set's folder with {RECIPE_FILE}"
    with refused_as(DataSetError, wanted):
        stored = msgspec.json.decode((folder / RECIPE_FILE).read_bytes(), type=dict[str, object])
        of = stored.pop("format", None)
        if of != FORMAT:
            raise DataSetError(f"{folder}: wanted a data set of format {FORMAT}, got {of!r}")
        return msgspec.convert(stored, Recipe)


def read_samples(folder: Path, most_maps: int | None = None, *, size: int | None = None) -> Samples:
    """Read all samples of a data set (or of its first shards, up to `most_maps`), averaged down to
    maps of `size`.

    DataSetError where the set cannot be read, or has no maps of that size."""
    recipe = _recipe_of_kind(folder, known=False)
    names = [field.name for field in fields(Samples)]
    parts: list[Arrays] = []
    maps = 0
    for shard in read_shards(folder, recipe):
        shard["map_index"] = shard["map_index"].astype(np.int32) + maps
        arrays = [shard[name] for name in names]  # as checked by _check_shard
        part = Samples(*arrays)  # type: ignore[arg-type]
        maps += len(part.planes)
        parts.append(vars(part.averaged(size or recipe.size)))
        if most_maps is not None and maps >= most_maps:
            break
    return _joined(Samples, folder, parts)


def _joined(kind: type[T], folder: Path, shards: Iterable[Arrays]) -> T:
    """One record with the arrays of all shards; DataSetError where there is none."""
    parts = list(shards)
    if not parts:
        raise DataSetError(f"{folder}: wanted at least one shard, got none")
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]  # a dataclass
    return kind(*(np.concatenate([part[name] for part in parts]) for name in names))


def _claim(recipe: Recipe, folder: Path) -> None:
    """Write the recipe into the folder, or check that the one there is the same: one without shards
    is replaced.
    """
    path = folder / RECIPE_FILE
    if not path.exists() or not any(folder.glob("shard-*.npz")):
        stored = {"format": FORMAT, **msgspec.structs.asdict(recipe)}
        write_whole(path, msgspec.json.format(msgspec.json.encode(stored), indent=1))
    elif read_recipe(folder) != recipe:
        raise DataSetError(
            f"{folder}: holds a data set made by another recipe; give another folder"
        )


def _shard_path(folder: Path, index: int) -> Path:
    return folder / f"shard-{index:05d}.npz"


_recipe: Recipe
_tiles: Tiles


def _shards_here(
    recipe: Recipe,
    tiles: Tiles,
    indices: Sequence[int],
    workers: int | None,
) -> Shards:
    """Make shards in processes of this machine."""
    workers = workers or len(os.sched_getaffinity(0))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, start_worker, (recipe, tiles)) as pool:
        try:
            jobs = [pool.submit(_make_here, i) for i in indices]
            for job in as_completed(jobs):
                yield job.result()
        except (BrokenProcessPool, MemoryError) as error:
            raise DataSetError(
                f"wanted {workers} processes that make shards, got one that died; fewer --workers "
                "take less memory"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)


def start_worker(recipe: Recipe, tiles: Tiles) -> None:
    # Ctrl-C ends it at once, not after the shards that wait for it
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    global _recipe, _tiles
    _recipe = recipe
    _tiles = tiles


def _make_here(index: int) -> tuple[int, bytes]:
    return index, shard_content(_recipe, _tiles, index)
