"""Making, storing and reading a training set. The format is described in docs/dataset.md."""

import multiprocessing
import os
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, fields, replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.files import make_folder, write_whole
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.network.unseen import ANSWERS
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.known import KnownMaps
from nnpp_edge.terrain.shards import Recipe, left_out, read_terrain, shard_content

FORMAT = "nnpp-edge-dataset-1"
RECIPE_FILE = "dataset.json"

Shards = Generator[tuple[int, bytes], None, None]
"""Numbers and contents of shards, in the order done."""
Query = tuple[NDArray[np.float32], tuple[float, float], tuple[float, float]]
"""Planes (2, S, S) in [0, 1]; start and goal, (row, col) in network cells."""
Arrays = dict[str, NDArray[np.generic]]
"""The arrays of a shard, by name."""
_OF_QUERIES = ("map_index", "start", "goal", "excess", "on_path")


@dataclass(frozen=True)
class Samples:
    """Labelled queries in memory: Q queries on M maps of S × S cells, with labels on B ×
    B blocks.
    """

    planes: NDArray[np.uint8]
    """(M, 2, S, S) mean cost (impassable as 1) and share of impassable cells, in 255ths."""
    map_index: NDArray[np.int32]
    """(Q,) the map of each query."""
    start: NDArray[np.float32]
    """(Q, 2) row and column in input cells."""
    goal: NDArray[np.float32]
    excess: NDArray[np.uint8]
    """(Q, B, B) excess of each block over the optimum, in steps of 0.1 %."""
    on_path: NDArray[np.uint8]
    """(Q, B, B / 8) bits: whether the optimal path crosses a block."""

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[np.generic]]) -> "Samples":
        """The arrays of these names; others are left out."""
        return cls(*(np.asarray(arrays[field.name]) for field in fields(cls)))

    def __len__(self) -> int:
        return len(self.map_index)

    def query(self, at: int) -> Query:
        """One query as a network is fed with it."""
        start = self.start[at].tolist()
        goal = self.goal[at].tolist()
        return self.planes[self.map_index[at]].astype(np.float32) / 255.0, tuple(start), tuple(goal)

    def averaged(self, size: int) -> "Samples":
        """These samples on maps averaged to `size` cells a side, a whole part of theirs, or
        DataSetError.
        """
        count, planes, side, _ = self.planes.shape
        if side % size:
            raise DataSetError(
                f"wanted maps of {size} cells a side or a multiple of that, got {side}"
            )
        factor = side // size
        half = np.float32(0.5)
        if factor == 1:
            return self
        small = np.empty((count, planes, size, size), np.uint8)
        for at, cells in enumerate(
            self.planes
        ):  # one by one: as numbers of four bytes they would fill the memory
            parts = cells.astype(np.float32).reshape(planes, size, factor, size, factor)
            small[at] = np.rint(parts.mean(axis=(2, 4)))
        start, goal = ((place + half) / factor - half for place in (self.start, self.goal))
        return replace(self, planes=small, start=start, goal=goal)

    def pick(self, queries: NDArray[np.generic] | range) -> "Samples":
        """Some of the queries, by a mask or by their numbers; the maps stay."""
        return replace(self, **{name: getattr(self, name)[queries] for name in _OF_QUERIES})


def make_dataset(
    recipe: Recipe,
    folder: Path,
    *,
    workers: int | None = None,
    make: Callable[[Recipe, Sequence[Dem], Sequence[int]], Shards] | None = None,
    progress: Callable[[int], object] = lambda done: None,
) -> dict[str, int]:
    """Write what is missing of a data set; numbers of ``shards``, ``maps``, ``queries``, and of all
    shards (``of``).

    The folder is made if need be; shards that are there are kept. To `make` shards elsewhere
    (`terrain.cluster`) is to yield number and content of each missing one as it is done, from the
    recipe, the terrain and the numbers; else `workers` processes do, one a core. `progress` is
    called with how many are done.

    Raises DataSetError, TerrainError or OutputError where the folder holds another set, damaged
    shards, or cannot be written to; terrain cannot be read, is too small or has no two cells to
    plan between; a process died.
    """
    missing = [i for i in range(recipe.shards) if not _shard_path(folder, i).exists()]
    tiles = read_terrain(recipe) if missing else []
    if sides := left_out(recipe, tiles):
        names = " and ".join(f"{side}²" for side in sides)
        warnings.warn(
            f"the terrain has no room for maps of {names} cells: they are left out", stacklevel=2
        )
    make_folder(folder)
    _claim(recipe, folder)
    done = recipe.shards - len(missing)
    progress(done)
    made = make(recipe, tiles, missing) if make else _shards_here(recipe, tiles, missing, workers)
    try:
        with closing(made):
            for index, content in made:
                write_whole(_shard_path(folder, index), content)
                done += 1
                progress(done)
    finally:
        if not any(folder.glob("shard-*.npz")):  # a recipe alone is no part of a data set
            (folder / RECIPE_FILE).unlink(missing_ok=True)
    maps_in, queries_in = ("heights", "factor") if recipe.known else ("planes", "map_index")
    counts = [
        (len(shard[maps_in]), len(shard[queries_in])) for shard in read_shards(folder, recipe)
    ]
    maps, queries = (sum(each) for each in zip(*counts, strict=True)) if counts else (0, 0)
    return {"shards": len(counts), "of": recipe.shards, "maps": maps, "queries": queries}


def read_shards(folder: Path, recipe: Recipe) -> Iterator[Arrays]:
    """The arrays of each shard in the folder, by name; DataSetError for one that is damaged or of
    another recipe.
    """
    for path in sorted(folder.glob("shard-*.npz")):
        with (
            refused_as(
                DataSetError, f"{path}: wanted a shard of this data set, got a file that is none"
            ),
            path.open("rb") as file,
            np.load(file, allow_pickle=False) as content,
        ):
            shard = {name: content[name] for name in content.files}
            _check_shard(shard, recipe)
        yield shard


def _check_shard(shard: Arrays, recipe: Recipe) -> None:
    """KeyError or ValueError where a shard's arrays are not those that the recipe makes."""
    side = recipe.size
    blocks = recipe.blocks
    maps = len(shard["heights" if recipe.known else "planes"])
    queries = 0 if recipe.known else len(shard["map_index"])
    wanted: dict[str, tuple[str, tuple[int, ...]]] = {
        "planes": ("u1", (maps, 2, side, side)),
        "workload": ("U", (maps,)),
        "pooling": ("i4", (maps,)),
        "map_index": ("i4", (queries,)),
        "start": ("f4", (queries, 2)),
        "goal": ("f4", (queries, 2)),
        "excess": ("u1", (queries, blocks, blocks)),
        "on_path": ("u1", (queries, blocks, blocks // 8)),
    }
    if recipe.known:
        wanted = dict.fromkeys(
            ("cell_size_m", "slope_limit_deg", "hard_slope_deg"), ("f4", (maps,))
        )
        wanted |= {
            "heights": ("f4", (maps, side, side)),
            "answers": ("u1", (maps, ANSWERS, side, side)),
        }
        wanted["factor"] = "i4", (maps,)
    for name, (dtype, shape) in wanted.items():
        got = shard[name]
        fits = got.dtype.kind == "U" if dtype == "U" else got.dtype == np.dtype(dtype)
        if got.shape != shape or not fits:
            raise ValueError(f"{name} is {got.shape} {got.dtype}, not {shape} {dtype}")
    if recipe.known:
        return
    ends = np.stack([shard["start"], shard["goal"]]).astype(np.float32)
    numbers = shard["map_index"].astype(np.int32)
    if not (
        queries
        and set(numbers.tolist()) <= set(range(maps))
        and ((ends > -1) & (ends < side)).all()
    ):
        raise ValueError("its queries do not lie on its maps")


def read_known(folder: Path) -> KnownMaps:
    """All maps of a data set that are known by their blocks; DataSetError where it cannot be read,
    or has none.
    """
    recipe = read_recipe(folder)
    if not recipe.known:
        raise DataSetError(
            f"{folder}: wanted maps that are known by their blocks (dataset --known), got others"
        )
    shards = list(read_shards(folder, recipe))
    if not shards:
        raise DataSetError(f"{folder}: wanted at least one shard, got none")
    return KnownMaps(
        *(np.concatenate([shard[field.name] for shard in shards]) for field in fields(KnownMaps))
    )


def read_recipe(folder: Path) -> Recipe:
    """The recipe in a data set's folder; DataSetError if there is none."""
    try:
        stored = msgspec.json.decode((folder / RECIPE_FILE).read_bytes(), type=dict[str, object])
        for former in ("allow_vrt", "vertical_scale"):  # older versions wrote them
            stored.pop(former, None)
        if (of := stored.pop("format", None)) == FORMAT:
            return msgspec.convert(stored, Recipe)
    except (OSError, RecursionError, ValueError, msgspec.MsgspecError) as error:
        raise DataSetError(
            f"{folder}: wanted a data set's folder with {RECIPE_FILE}, got {error}"
        ) from error
    raise DataSetError(f"{folder}: wanted a data set of format {FORMAT}, got {of!r}")


def read_samples(folder: Path, most_maps: int | None = None, *, size: int | None = None) -> Samples:
    """All samples of a data set (or of its first shards, up to `most_maps`), averaged down to maps
    of `size`.

    DataSetError where the set cannot be read, or has no maps of that size.
    """
    recipe = read_recipe(folder)
    if recipe.known:
        raise DataSetError(
            f"{folder}: wanted maps with queries, got maps that are known by their blocks"
        )
    parts: list[Samples] = []
    maps = 0
    for shard in read_shards(folder, recipe):
        part = Samples.of({**shard, "map_index": shard["map_index"] + maps})
        maps += len(part.planes)
        parts.append(part.averaged(size or recipe.size))
        if most_maps is not None and maps >= most_maps:
            break
    if not parts:
        raise DataSetError(f"{folder}: wanted at least one shard, got none")
    return Samples(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(Samples)
        )
    )


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
_tiles: Sequence[Dem]


def _shards_here(
    recipe: Recipe, tiles: Sequence[Dem], indices: Sequence[int], workers: int | None
) -> Shards:
    context = multiprocessing.get_context("spawn")
    workers = workers or len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(workers, context, _start_worker, (recipe, tiles)) as pool:
        try:
            for job in as_completed([pool.submit(_make_here, i) for i in indices]):
                yield job.result()
        except (BrokenProcessPool, MemoryError) as error:
            raise DataSetError(
                f"wanted {workers} processes that make shards, got one that died; fewer --workers "
                "take less memory"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)


def _start_worker(recipe: Recipe, tiles: Sequence[Dem]) -> None:
    global _recipe, _tiles
    _recipe = recipe
    _tiles = tiles


def _make_here(index: int) -> tuple[int, bytes]:
    return index, shard_content(_recipe, _tiles, index)
