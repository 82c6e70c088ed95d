"""The maps and queries of a profile: crops of terrain, synthetic terrain where no file is large enough."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nnpp_edge.profiling.profile_file import SAMPLE, Load
from nnpp_edge.profiling.suites import (
    QUERIES_PER_MAP,
    SYNTHETIC,
    TerrainFiles,
    large_enough,
    source_of,
    terrain_cases,
)
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Endpoints
from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.planners.plan import Method
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.labels import random_points
from nnpp_edge.terrain.vehicle_files import load_vehicle

_LEAST_NEAR = 6.0
"""Cells between start and goal of the nearest queries."""
_TRIES = 50


@dataclass(frozen=True)
class ProfileQuery:
    """A query, and whether budgets are judged by it."""

    ends: Endpoints
    judged: bool = True

    @property
    def distance(self) -> int:
        """Cells between start and goal, as the king moves: what `auto` decides by."""
        return max(abs(a - b) for a, b in zip(*self.ends, strict=True))


@dataclass(frozen=True)
class ProfileMap:
    """A map with its queries."""

    cost: Float2D
    """With a vehicle the cost of the best pose of each cell; each planner checks the poses itself."""
    ground: Ground
    queries: tuple[ProfileQuery, ...]

    @property
    def has_body(self) -> bool:
        """Whether a vehicle's poses cost."""
        return self.ground.vehicle is not None

    def connections(self) -> Callable[[ProfileQuery], bool]:
        """Whether there is a path, as a function of the query."""
        planner = Planner(self.ground if self.has_body else self.cost)
        return lambda query: planner.plan(*query.ends, method=Method.CORRIDOR).ok


class ProfileMaps:
    """Where a profile's maps come from. The same load gives the same maps on any machine.

    TerrainError or InvalidQueryError if a terrain file or the vehicle's cannot be read, or no file is large enough
    for any of the sizes.
    """

    def __init__(self, load: Load) -> None:
        self.load = load
        self._vehicle = None if load.vehicle is None else load_vehicle(load.vehicle)
        self._dems: list[Dem] = []
        for name in () if load.terrain == (SYNTHETIC,) else load.terrain:
            paths = () if name == SAMPLE else (Path(name),)
            self._dems += TerrainFiles.or_sample(paths, load.rescale, load.cell_size).read()
        largest = max(self._dems, key=lambda dem: min(dem.shape), default=None)
        if largest is not None and not any(large_enough(self._dems, size) for size in load.sizes):
            (rows, cols), least = largest.shape, min(load.sizes)
            raise TerrainError(
                f"{largest.source}: wanted at least {least} × {least} cells, the size to be measured, got {rows} × "
                f"{cols}; --sizes {min(rows, cols)} measures on it"
            )

    def source(self, size: int) -> str:
        """Name of the terrain that maps of this size come from."""
        return source_of(self._dems, size)

    def maps(self, name: str, size: int) -> Iterator[ProfileMap]:
        """Maps of one workload and size, without end; on each a share of the far and of the near queries."""
        load = self.load
        near_per_map = math.ceil(load.near * QUERIES_PER_MAP / load.queries)
        for at, case in enumerate(terrain_cases(self._dems, name, size, load.seed, load.min_distance, self._vehicle)):
            rng = np.random.default_rng([load.seed, size, at])
            near = _near(rng, case.cost, near_per_map, load.min_distance * size)
            assert case.ground is not None
            yield ProfileMap(case.cost, case.ground, (*map(ProfileQuery, case.queries), *near))


def _near(rng: np.random.Generator, cost: Float2D, wanted: int, farthest: float) -> list[ProfileQuery]:
    """Queries whose distances are spread evenly on a logarithmic scale, up to `farthest` cells."""
    found: list[ProfileQuery] = []
    for _ in range(_TRIES * wanted if farthest > _LEAST_NEAR else 0):
        points = random_points(rng, cost, 1)
        distance = math.exp(rng.uniform(math.log(_LEAST_NEAR), math.log(farthest)))
        angle = rng.uniform(0.0, 2.0 * math.pi)
        if len(points) == 0 or len(found) == wanted:
            break
        start = int(points[0][0]), int(points[0][1])
        row, col = round(start[0] + distance * math.sin(angle)), round(start[1] + distance * math.cos(angle))
        if 0 <= row < cost.shape[0] and 0 <= col < cost.shape[1] and cost[row, col] < 1.0:
            found.append(ProfileQuery((start, (row, col)), judged=False))
    return found
