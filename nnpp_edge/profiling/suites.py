"""Maps and queries to judge planners by, from terrain files or from a data set."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.costmap import traversability_cost
from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.terrain.dataset import read_recipe
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.labels import Query, random_query
from nnpp_edge.terrain.workloads import workload

QUERIES_PER_MAP = 10
_TRIES = 50


@dataclass(frozen=True)
class Case:
    """A cost map and what is asked on it."""

    workload: str
    size: int
    cost: NDArray[np.float32]
    """(H, W) traversability cost."""
    queries: tuple[Query, ...]
    """Start and goal both passable; whether they are connected is not known yet."""


@dataclass(frozen=True)
class TerrainSuite:
    """Random square crops of terrain files, with random queries.

    The same settings give the same cases on any machine. A workload's crops and queries do not depend on
    which other workloads and sizes are asked for.
    """

    terrain: tuple[Path, ...]
    workloads: tuple[str, ...] = ("soft",)
    sizes: tuple[int, ...] = (256,)
    seed: int = 1
    rescale: float | None = None
    """Side of a cell in metres that the terrain is rescaled to, its slopes kept."""
    cell_size: float | None = None
    least_distance: float = 0.35
    """Between start and goal, as a share of the map's side."""

    def load(self) -> list[Dem]:
        """Read the terrain files; InvalidQueryError where a file is smaller than a size asked for."""
        dems = []
        for path in self.terrain:
            dem = read_dem(path, cell_size_m=self.cell_size)
            if min(dem.elevation.shape) < max(self.sizes):
                raise InvalidQueryError(
                    f"{path}: wanted terrain of at least {max(self.sizes)} cells a side, got {dem.elevation.shape}"
                )
            dems.append(dem if self.rescale is None else dem.rescaled(self.rescale))
        return dems

    def cases(self, dems: Sequence[Dem], name: str, size: int) -> Iterator[Case]:
        """Cases of one workload and size, without end; InvalidQueryError if the terrain has no fitting query."""
        limits = workload(name)
        rng = np.random.default_rng([self.seed, size])
        while True:
            for _ in range(_TRIES):
                dem = dems[int(rng.integers(len(dems)))]
                row, col = (int(rng.integers(0, n - size + 1)) for n in dem.elevation.shape)
                crop = dem.elevation[row : row + size, col : col + size]
                cost = traversability_cost(crop, dem.cell_size_m, limits, cell_width_m=dem.cell_width_m, warn=False)
                wanted = (random_query(rng, cost, self.least_distance * size) for _ in range(QUERIES_PER_MAP))
                queries = tuple(query for query in wanted if query is not None)
                if queries:
                    yield Case(name, size, cost, queries)
                    break
            else:
                raise InvalidQueryError(
                    f"no two passable cells {self.least_distance * size:.0f} apart were found in "
                    f"{_TRIES} crops of {size} × {size} for the workload {name}"
                )


def dataset_cases(folder: Path, name: str) -> Iterator[Case]:
    """Maps of a data set that belong to a workload and were not averaged, with their queries."""
    size = read_recipe(folder).size
    found = False
    for path in sorted(folder.glob("shard-*.npz")):
        with np.load(path) as shard:
            chosen = np.flatnonzero((shard["workload"] == name) & (shard["pooling"] == 1))
            for at in chosen:
                planes = shard["planes"][at]
                cost = np.minimum(planes[0].astype(np.float32), 254.0) / np.float32(255.0)
                cost[planes[1] > 127] = math.inf
                of_map = np.flatnonzero(shard["map_index"] == at)
                ends = np.rint(np.stack([shard["start"][of_map], shard["goal"][of_map]], axis=1)).astype(int)
                queries = tuple(((int(a[0]), int(a[1])), (int(b[0]), int(b[1]))) for a, b in ends)
                found = True
                yield Case(name, size, cost, queries)
    if not found:
        raise DataSetError(f"{folder}: holds no map of the workload {name} at full resolution")
