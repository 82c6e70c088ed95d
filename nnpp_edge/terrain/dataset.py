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

from nnpp_edge.files import make_folder, write_all
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
        side = self.planes.shape[-1]
        if side % size:
            raise DataSetError(
                f"wanted maps of {size} cells a side or a multiple of that, got {side}"
            )
        factor = side // size
        if factor == 1:
            return self
        means = in_blocks(self.planes, factor).mean(axis=(3, 5), dtype=np.float32)
        half = np.float32(0.5)
        start = (self.start + half) / factor - half
        goal = (self.goal + half) / factor - half
        return replace(self, planes=np.rint(means).astype(np.uint8), start=start, goal=goal)

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
    large = [f"{recipe.size * each[0]}²" for each in recipe.poolings if each not in fitting]
    if large:
        warnings.warn(
            f"the terrain has no room for maps of {' and '.join(large)} cells: they are left out",
            stacklevel=2,
        )
    make_folder(folder)
    path = folder / RECIPE_FILE
    begun = path.exists() and any(folder.glob("shard-*.npz"))
    if begun and read_recipe(folder) != recipe:
        raise DataSetError(
            f"{folder}: holds a data set made by another recipe; give another folder"
        )
    stored = {"format": FORMAT, **msgspec.structs.asdict(recipe)}
    recipe_json = msgspec.json.format(msgspec.json.encode(stored), indent=1)

    done = recipe.shards - len(missing)
    progress(done)
    with closing(_shards_here(recipe, tiles, missing, workers)) as made:
        for index, content in made:
            write_all({path: recipe_json, _shard_path(folder, index): content})
            done += 1
            progress(done)

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
    size = recipe.size
    blocks = recipe.blocks
    layout: dict[str, tuple[str, tuple[int, ...]]] = {
        "planes": ("u1", (2, size, size)),
        "map_index": ("<i4", ()),
        "start": ("<f4", (2,)),
        "goal": ("<f4", (2,)),
        "excess": ("u1", (blocks, blocks)),
        "on_path": ("u1", (blocks, blocks // 8)),
    }
    if recipe.known:
        layout = {
            "heights": ("<f4", (size, size)),
            "answers": ("u1", (ANSWERS, size, size)),
            "factor": ("<i4", ()),
            "cell_size_m": ("<f4", ()),
            "slope_limit_deg": ("<f4", ()),
            "hard_slope_deg": ("<f4", ()),
        }
    for path in sorted(folder.glob("shard-*.npz")):
        wanted = f"{path}: wanted a shard of this data set, got a file that is none"
        with (
            refused_as(DataSetError, wanted),
            path.open("rb") as file,
            np.load(file, allow_pickle=False) as content,
        ):
            shard = {name: content[name] for name in layout}
            for name, (kind, shape) in layout.items():
                found = shard[name]
                if (found.dtype, found.shape[1:]) != (np.dtype(kind), shape):
                    raise ValueError(f"{name} is {found.shape} {found.dtype}")
            # of queries, or of maps that are known by their blocks
            if len({len(each) for name, each in shard.items() if name != "planes"}) > 1:
                raise ValueError("its arrays have other lengths")
        yield shard


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
    parts: list[Arrays] = []
    maps = 0
    for shard in read_shards(folder, recipe):
        part = Samples(**shard)  # type: ignore[arg-type]  # as checked there
        part.map_index[:] += maps
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
