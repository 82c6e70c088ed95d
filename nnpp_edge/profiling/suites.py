"""Maps and queries to judge planners by, from terrain files or from a data set."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.planners.planner import Planner
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
    ground: Ground
    """Source of the costs: elevations, or of a data set the costs themselves."""

    @property
    def standing(self) -> Ground:
        """For planners on a standing map: the costs, but elevations where a vehicle's poses or the slope decide."""
        return self.ground if self.ground.vehicle is not None or self.ground.by_slope else Ground(self.cost)

    def connections(self) -> Callable[[Endpoints], bool]:
        """Whether there is a path, as a function of the query."""
        planner = Planner(self.standing)
        return lambda query: planner.plan(*query, method=Method.CORRIDOR).ok


@dataclass(frozen=True)
class TerrainFiles:
    """Elevation files, and how they are read."""

    paths: tuple[Path, ...]
    rescale: float | None = None
    """Side of a cell in metres that the terrain is rescaled to, its slopes kept."""
    cell_size: float | None = None
    """Side of a cell in metres, where the files do not say."""

    @classmethod
    def or_sample(
        cls, paths: Sequence[Path], rescale: float | None = None, cell_size: float | None = None
    ) -> "TerrainFiles":
        """These files; without any, the sample that travels with the package, at cells of 20 m by default."""
        if paths:
            return cls(tuple(paths), rescale, cell_size)
        sample = Path(str(files("nnpp_edge.terrain") / "samples" / _SAMPLE_FILE))
        return cls((sample,), rescale or _SAMPLE_CELL_M, None)

    def read(self) -> list[Dem]:
        """Every file's terrain; TerrainError if one cannot be read."""
        dems = [read_dem(path, self.cell_size) for path in self.paths]
        return dems if self.rescale is None else [dem.rescaled(self.rescale) for dem in dems]


def check_sizes(dems: Sequence[Dem], sizes: Sequence[Size]) -> None:
    """InvalidQueryError where a terrain is smaller than one of the sizes."""
    rows, cols = (max(side) for side in zip(*map(shape_of, sizes), strict=True))
    for dem in dems:
        if dem.elevation.shape[0] < rows or dem.elevation.shape[1] < cols:
            raise InvalidQueryError(
                f"{dem.source}: wanted terrain of at least {rows} × {cols} cells, got {dem.elevation.shape}"
            )


def heights_of(ground: Ground) -> Float2D:
    """(H, W) float32, metres, of a ground of elevations."""
    assert ground.elevation is not None
    return as_map(ground.elevation, "elevation")


def whole_cost(ground: Ground) -> Float2D:
    """The whole cost map, (H, W) float32; with a vehicle that of each cell's best pose, inf where all fail."""
    if ground.vehicle is None:
        return ground.costs()
    (size, width), limits = ground.sides_m, ground.traversability
    poses = pose_costs(heights_of(ground), size, ground.vehicle, cell_width_m=width, traversability=limits)
    best: Float2D = poses.min(0)
    return best


def large_enough(dems: Sequence[Dem], size: Size) -> list[Dem]:
    """Those that a map of this size can be cropped from."""
    rows, cols = shape_of(size)
    return [dem for dem in dems if dem.elevation.shape[0] >= rows and dem.elevation.shape[1] >= cols]


def source_of(dems: Sequence[Dem], size: Size) -> str:
    """Name of the terrain that `terrain_cases` takes maps of this size from."""
    return ", ".join(dict.fromkeys(dem.source.stem for dem in large_enough(dems, size))) or SYNTHETIC


def terrain_cases(
    dems: Sequence[Dem],
    name: str,
    size: Size,
    seed: int = 1,
    least_distance: float = LEAST_DISTANCE,
    vehicle: Vehicle | None = None,
    rocks: float = 0.0,
) -> Iterator[Case]:
    """Cases of one workload and size, without end, the same for the same seed on any machine.

    Maps are random crops of the terrain that is large enough. Where none is, they are fractal and cratered ground
    (`synthetic_terrain`), with cells of 20 m, for a vehicle's workloads of a quarter of its length. `least_distance`
    is that between start and goal, as a share of the map's longer side; `vehicle` is for its workloads, `rocks` the
    share of ground that they cover where the workload does not say.

    InvalidQueryError if many maps in a row have no fitting query, there is no such workload, or it takes a vehicle.
    """
    fitting, (rows, cols), own = large_enough(dems, size), shape_of(size), body_rocks(name)
    limits = Traversability() if own is not None else workload(name)
    if own is not None and vehicle is None:
        raise InvalidQueryError(f"the workload {name} is a vehicle's: wanted a vehicle, got none")
    body = None if own is None else vehicle
    cell_m = SYNTHETIC_CELL_M if body is None else body.length_m / _CELLS_TO_A_BODY
    rng = np.random.default_rng([seed, *dict.fromkeys((rows, cols))])
    least, cover, in_vain = least_distance * max(rows, cols), own or rocks, 0
    while in_vain < _TRIES:
        if fitting:
            dem = fitting[int(rng.integers(len(fitting)))]
            row, col = (int(rng.integers(0, n - m + 1)) for n, m in zip(dem.shape, (rows, cols), strict=True))
            heights, sides_m = dem.elevation[row : row + rows, col : col + cols], (dem.cell_size_m, dem.cell_width_m)
        else:
            heights, sides_m = synthetic_terrain(rng, max(rows, cols), cell_m)[:rows, :cols], (cell_m, cell_m)
        if cover:  # by a generator of their own: the maps are those without rocks
            heights = with_rocks(heights, sides_m[0], cover, rng.spawn(1)[0], cell_width_m=sides_m[1])
        heights = np.ascontiguousarray(heights)
        ground = Ground.of_elevation(heights, sides_m[0], limits, cell_width_m=sides_m[1], vehicle=body)
        cost = whole_cost(ground)
        queries = [query for _ in range(QUERIES_PER_MAP) if (query := random_query(rng, cost, least)) is not None]
        in_vain = 0 if queries else in_vain + 1
        if queries:
            yield Case(name, size, cost, tuple(queries), ground)
    raise InvalidQueryError(
        f"no two passable cells {least:.0f} apart were found in {_TRIES} maps of {rows} × {cols} for the workload "
        f"{name}"
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
            yield Case(name, recipe.size, cost, queries, Ground(cost))
    if not found:
        raise DataSetError(f"{folder}: holds no map of the workload {name} at full resolution")
