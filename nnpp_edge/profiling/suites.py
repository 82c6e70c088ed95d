"""Maps and queries to judge planners by, from terrain files or from a data set."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from nnpp_edge.profiling.ground import whole_cost
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.dataset import read_recipe, read_shards
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.labels import random_query
from nnpp_edge.terrain.rocks import with_rocks
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.terrain.workloads import body_rocks, workload

QUERIES_PER_MAP = 10
SYNTHETIC = "synthetic"
SYNTHETIC_CELL_M = 20.0
LEAST_DISTANCE = 0.35
"""Between start and goal by default, as a share of the map's longer side."""
_SAMPLE_FILE, _SAMPLE_CELL_M = "moon_highlands.npz", 20.0
_CELLS_TO_A_BODY = 4.0
"""Cells of synthetic ground along a vehicle."""
_TRIES = 50

Size = int | tuple[int, int]
"""Side of a square map, or rows and columns."""


def shape_of(size: Size) -> tuple[int, int]:
    """Rows and columns of a map of this size."""
    return (size, size) if isinstance(size, int) else size


def name_of(size: Size) -> int | str:
    """A size as tables show it: 256, or 300x700."""
    return size if isinstance(size, int) else f"{size[0]}x{size[1]}"


@dataclass(frozen=True)
class Case:
    """A cost map with queries on it."""

    workload: str
    size: Size
    cost: Float2D
    """(H, W) traversability cost."""
    queries: tuple[Endpoints, ...]
    """Start and goal both passable, a vehicle's in some heading; whether they are connected is not known yet."""
    ground: Ground | None = None
    """Source of the costs; None where that is not known."""
    least_distance: float = 0.0
    """Cells between start and goal at least."""

    def more_queries(self) -> Iterator[Endpoints]:
        """Other random queries, always the same ones; they end where no fitting one is found."""
        rng = np.random.default_rng(np.ravel(self.queries))
        while (query := random_query(rng, self.cost, self.least_distance)) is not None:
            yield query


@dataclass(frozen=True)
class TerrainFiles:
    """Elevation files, and how they are read."""

    paths: tuple[Path, ...]
    rescale: float | None = None
    """Side of a cell in metres that the terrain is rescaled to, its slopes kept."""
    cell_size: float | None = None
    """Side of a cell in metres, where the files do not say."""
    allow_vrt: bool = False

    @classmethod
    def or_sample(
        cls,
        paths: Sequence[Path],
        rescale: float | None = None,
        cell_size: float | None = None,
        allow_vrt: bool = False,
    ) -> "TerrainFiles":
        """These files; without any, the sample that travels with the package, at cells of 20 m by default."""
        if paths:
            return cls(tuple(paths), rescale, cell_size, allow_vrt)
        sample = Path(str(files("nnpp_edge.terrain") / "samples" / _SAMPLE_FILE))
        return cls((sample,), rescale or _SAMPLE_CELL_M, None)

    def read(self) -> list[Dem]:
        """Every file's terrain; TerrainError if one cannot be read."""
        dems = [read_dem(path, self.cell_size, allow_vrt=self.allow_vrt) for path in self.paths]
        return dems if self.rescale is None else [dem.rescaled(self.rescale) for dem in dems]


def check_sizes(dems: Sequence[Dem], sizes: Sequence[Size]) -> None:
    """InvalidQueryError where a terrain is smaller than one of the sizes."""
    rows, cols = (max(side) for side in zip(*map(shape_of, sizes), strict=True))
    for dem in dems:
        if dem.elevation.shape[0] < rows or dem.elevation.shape[1] < cols:
            raise InvalidQueryError(
                f"{dem.source}: wanted terrain of at least {rows} × {cols} cells, got {dem.elevation.shape}"
            )


@dataclass(frozen=True)
class Scene:
    """A workload's scene on elevations: limits, and for a vehicle's workloads the vehicle and rocks."""

    limits: Traversability
    vehicle: Vehicle | None = None
    rocks: float = 0.0
    """Share of the ground under rocks."""

    @classmethod
    def of(cls, name: str, vehicle: Vehicle | None = None, rocks: float = 0.0) -> "Scene":
        """The scene of a workload, with `rocks` where its name says nothing of them.

        InvalidQueryError where there is none of that name, or it takes a vehicle.
        """
        own = body_rocks(name)
        if own is None:
            return cls(workload(name), None, rocks)
        if vehicle is None:
            raise InvalidQueryError(f"the workload {name} is a vehicle's: wanted a vehicle, got none")
        return cls(Traversability(), vehicle, own or rocks)

    def ground(self, heights: Float2D, sides_m: tuple[float, float], rng: np.random.Generator) -> Ground:
        """Of heights in metres; rocks are drawn by a child of `rng`, which itself goes on as it would without."""
        if self.rocks:
            heights = with_rocks(heights, sides_m[0], self.rocks, rng.spawn(1)[0], cell_width_m=sides_m[1])
        size, width = sides_m
        heights = np.ascontiguousarray(heights)
        return Ground.of_elevation(heights, size, self.limits, cell_width_m=width, vehicle=self.vehicle)


def terrain_cases(
    dems: Sequence[Dem],
    name: str,
    size: Size,
    seed: int = 1,
    least_distance: float = LEAST_DISTANCE,
    vehicle: Vehicle | None = None,
    rocks: float = 0.0,
) -> Iterator[Case]:
    """Cases of one workload and size on random crops of terrain, without end; the same for the same seed on any
    machine.

    Each terrain must be at least of the size. `least_distance` is that between start and goal, as a share of the
    map's longer side; `vehicle` is for its workloads, `rocks` the share of ground that
    they cover. InvalidQueryError if the terrain has no fitting query.
    """
    scene, (rows, cols) = Scene.of(name, vehicle, rocks), shape_of(size)

    def ground(rng: np.random.Generator) -> Ground:
        dem = dems[int(rng.integers(len(dems)))]
        row = int(rng.integers(0, dem.elevation.shape[0] - rows + 1))
        col = int(rng.integers(0, dem.elevation.shape[1] - cols + 1))
        crop = dem.elevation[row : row + rows, col : col + cols]
        return scene.ground(crop, (dem.cell_size_m, dem.cell_width_m), rng)

    return _with_queries(name, size, ground, seed, least_distance)


def synthetic_cases(
    name: str,
    size: Size,
    seed: int,
    least_distance: float = LEAST_DISTANCE,
    vehicle: Vehicle | None = None,
    rocks: float = 0.0,
) -> Iterator[Case]:
    """Cases on fractal and cratered ground (`synthetic_terrain`), as of `terrain_cases`, for what no file holds.

    Cells are 20 m wide, and for a vehicle's workloads a quarter of its length.
    """
    scene, (rows, cols) = Scene.of(name, vehicle, rocks), shape_of(size)
    cell_m = SYNTHETIC_CELL_M if scene.vehicle is None else scene.vehicle.length_m / _CELLS_TO_A_BODY

    def ground(rng: np.random.Generator) -> Ground:
        heights = synthetic_terrain(rng, max(rows, cols), cell_m)[:rows, :cols]
        return scene.ground(heights, (cell_m, cell_m), rng)

    return _with_queries(name, size, ground, seed, least_distance)


def large_enough(dems: Sequence[Dem], size: int) -> list[Dem]:
    """Those that a square map of this side can be cropped from."""
    return [dem for dem in dems if min(dem.elevation.shape) >= size]


def source_of(dems: Sequence[Dem], size: int) -> str:
    """Name of the terrain that `cases_from` takes maps of this size from."""
    return ", ".join(dict.fromkeys(dem.source.stem for dem in large_enough(dems, size))) or SYNTHETIC


def cases_from(
    dems: Sequence[Dem],
    name: str,
    size: int,
    seed: int,
    least_distance: float = LEAST_DISTANCE,
    vehicle: Vehicle | None = None,
) -> Iterator[Case]:
    """`terrain_cases` of the terrain that is large enough; `synthetic_cases` where none is."""
    fitting = large_enough(dems, size)
    if fitting:
        return terrain_cases(fitting, name, size, seed, least_distance, vehicle)
    return synthetic_cases(name, size, seed, least_distance, vehicle)


def _with_queries(
    name: str, size: Size, ground: Callable[[np.random.Generator], Ground], seed: int, least_distance: float
) -> Iterator[Case]:
    """Map after map with random queries; InvalidQueryError where many maps in a row have no fitting one."""
    rows, cols = shape_of(size)
    rng = np.random.default_rng([seed, *dict.fromkeys((rows, cols))])
    least = least_distance * max(rows, cols)
    while True:
        for _ in range(_TRIES):
            below = ground(rng)
            cost = whole_cost(below)
            wanted = (random_query(rng, cost, least) for _ in range(QUERIES_PER_MAP))
            queries = tuple(query for query in wanted if query is not None)
            if queries:
                yield Case(name, size, cost, queries, below, least)
                break
        else:
            raise InvalidQueryError(
                f"no two passable cells {least:.0f} apart were found in {_TRIES} maps of {rows} × {cols} "
                f"for the workload {name}"
            )


def dataset_cases(folder: Path, name: str) -> Iterator[Case]:
    """Maps of a data set that belong to a workload and were not averaged, with their queries."""
    recipe = read_recipe(folder)
    found = False
    for shard in read_shards(folder, recipe):
        for at in np.flatnonzero((shard["workload"] == name) & (shard["pooling"] == 1)):
            planes = shard["planes"][at]
            cost = np.minimum(planes[0].astype(np.float32), 254.0) / np.float32(255.0)
            cost[planes[1] > 127] = math.inf
            of_map = np.flatnonzero(shard["map_index"] == at)
            ends = np.rint(np.stack([shard["start"][of_map], shard["goal"][of_map]], axis=1)).astype(int)
            queries = tuple(((int(a[0]), int(a[1])), (int(b[0]), int(b[1]))) for a, b in ends)
            found = True
            yield Case(name, recipe.size, cost, queries)
    if not found:
        raise DataSetError(f"{folder}: holds no map of the workload {name} at full resolution")
