"""Maps and queries to judge planners by, from terrain files."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.robots.body.poses import pose_costs
from nnpp_edge.runtime.terrain.traversability import Traversability
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.dem import Dem, read_dem, sample_path
from nnpp_edge.terrain.labels import random_query
from nnpp_edge.terrain.rocks import with_rocks
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.terrain.workloads import body_rocks, workload

QUERIES_PER_MAP = 10
SYNTHETIC = "synthetic"
SYNTHETIC_CELL_M = 20.0
"""Of synthetic ground, and of the sample."""
LEAST_DISTANCE = 0.35
"""Between start and goal by default, as a share of the map's side."""
_CELLS_TO_A_BODY = 4.0
"""Cells of synthetic ground along a vehicle."""
_TRIES = 50
_MAPS_TRIED = 20
"""Times as many maps as queries are wanted are searched for those that have a path."""


@dataclass(frozen=True)
class Case:
    """A cost map with queries on it."""

    workload: str
    size: int
    cost: Float2D
    """(H, W) traversability cost."""
    queries: tuple[Endpoints, ...]
    """Start and goal both passable, a vehicle's in some heading; whether they are connected is not
    known yet.
    """
    ground: Ground
    """Source of the costs: elevations, as a rule."""
    terrain: str = SYNTHETIC
    """Name of the terrain that maps of this size are taken from."""
    unsolvable: int = 0
    """Queries without a path, on this map and those before: see `solvable`."""

    @property
    def standing(self) -> Ground:
        """For planners on a standing map: the costs, but elevations where a vehicle's poses or the
        slope decide.
        """
        return self.ground.priced(self.cost)

    def connections(self) -> Callable[[Endpoints], bool]:
        """Whether there is a path, as a function of the query."""
        planner = Planner(self.standing)
        return lambda query: planner.plan(*query, method=Method.CORRIDOR).ok


def dems_of(
    paths: Sequence[Path], rescale: float | None = None, cell_size: float | None = None
) -> list[Dem]:
    """Terrain of elevation files; without any, of the sample that travels with the package.

    With `rescale` cells get this side in metres, the slopes kept; those of the sample are else of
    20 m. `cell_size` is the side where the files do not say. TerrainError if one cannot be read.
    """
    if not paths:
        sample = read_dem(sample_path("moon_highlands"))
        return [sample.rescaled(rescale or SYNTHETIC_CELL_M)]
    dems = [read_dem(path, cell_size) for path in paths]
    return dems if rescale is None else [dem.rescaled(rescale) for dem in dems]


def check_sizes(dems: Sequence[Dem], sizes: Sequence[int]) -> None:
    """InvalidQueryError where a terrain is smaller than one of the sizes."""
    most = max(sizes)
    for dem in dems:
        rows, cols = dem.shape
        if min(rows, cols) < most:
            raise InvalidQueryError(
                f"{dem.source}: wanted terrain of at least {most} × {most} cells, got {rows} × "
                f"{cols}: --sizes {min(rows, cols)} is the largest that fits"
            )


def heights_of(ground: Ground) -> Float2D:
    """(H, W) float32, metres, of a ground of elevations."""
    assert ground.elevation is not None
    return as_map(ground.elevation, "elevation")


def whole_cost(ground: Ground) -> Float2D:
    """The whole cost map, (H, W) float32; with a vehicle that of each cell's best pose, inf where
    all fail.
    """
    if ground.vehicle is None:
        return ground.costs()
    size, width = ground.sides_m
    best: Float2D = pose_costs(
        heights_of(ground),
        size,
        ground.vehicle,
        cell_width_m=width,
        traversability=ground.limits,
    ).min(0)
    return best


def terrain_cases(
    dems: Sequence[Dem],
    name: str,
    size: int,
    seed: int = 1,
    least_distance: float = LEAST_DISTANCE,
    vehicle: Vehicle | None = None,
    limits: Traversability | None = None,
) -> Iterator[Case]:
    """Cases of one workload and size, without end, the same for the same seed on any machine.

    Maps are random crops of the terrain that is large enough. Where none is, they are fractal and
    cratered ground (`synthetic_terrain`), with cells of 20 m, for a vehicle's workloads of a
    quarter of its length. `least_distance` is that between start and goal, as a share of the map's
    side; `vehicle` is for its workloads; `limits` are those of the cost in place of the workload's
    own.

    InvalidQueryError if many maps in a row have no fitting query, there is no such workload, or it
    takes a vehicle.
    """
    fitting = [dem for dem in dems if min(dem.shape) >= size]
    terrain = ", ".join(dict.fromkeys(dem.source.stem for dem in fitting)) or SYNTHETIC
    rocks = body_rocks(name)
    if rocks is None:
        vehicle = None
    elif vehicle is None:
        raise InvalidQueryError(f"the workload {name} is a vehicle's: wanted a vehicle, got none")
    if limits is None:
        limits = workload(name) if rocks is None else Traversability()
    cell_m = SYNTHETIC_CELL_M if vehicle is None else vehicle.length_m / _CELLS_TO_A_BODY
    rng = np.random.default_rng([seed, size])
    least = least_distance * size
    in_vain = 0
    while in_vain < _TRIES:
        # the ground: a crop of the terrain, or synthetic
        if fitting:
            dem = fitting[int(rng.integers(len(fitting)))]
            heights = dem.random_square(rng, size)
            size_m = dem.cell_size_m
            width_m = dem.cell_width_m
        else:
            heights = synthetic_terrain(rng, size, cell_m)
            size_m = width_m = cell_m
        if rocks:  # by a generator of their own: the maps are those without rocks
            heights = with_rocks(heights, size_m, rocks, rng.spawn(1)[0], cell_width_m=width_m)
        heights = np.ascontiguousarray(heights)
        ground = Ground.of_elevation(heights, size_m, limits, cell_width_m=width_m, vehicle=vehicle)

        cost = whole_cost(ground)
        drawn = [random_query(rng, cost, least) for _ in range(QUERIES_PER_MAP)]
        queries = tuple(query for query in drawn if query is not None)
        in_vain = 0 if queries else in_vain + 1
        if queries:
            yield Case(name, size, cost, queries, ground, terrain)
    raise InvalidQueryError(
        f"no two passable cells {least:.0f} apart were found in {_TRIES} maps of {size} × {size} "
        f"for the workload {name}"
    )


def solvable(cases: Iterable[Case], count: int, most: int = QUERIES_PER_MAP) -> Iterator[Case]:
    """Cases with those of their queries that have a path, `most` of each, until there are `count`.

    InvalidQueryError if too many maps have too few.
    """
    missing = count
    unsolvable = 0
    tried = 0
    for case in islice(cases, _MAPS_TRIED * count):
        tried += 1
        connected = case.connections()
        queries: list[Endpoints] = []
        for query in case.queries:
            if len(queries) == min(missing, most):
                break
            if connected(query):
                queries.append(query)
            else:
                unsolvable += 1
        missing -= len(queries)
        if queries:
            yield replace(case, queries=tuple(queries), unsolvable=unsolvable)
        if not missing:
            return
    raise InvalidQueryError(
        f"wanted {count} queries with a path on maps of {case.size} × {case.size} "
        f"({case.workload}), found {count - missing} on {tried} maps"
    )
