"""Maps and queries to judge planners by, from terrain files or from a data set."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import DataSetError, InvalidQueryError
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.terrain.dataset import read_recipe
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.labels import Query, random_query
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.terrain.workloads import workload

QUERIES_PER_MAP = 10
SYNTHETIC = "synthetic"
SYNTHETIC_CELL_M = 20.0
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
    """A cost map and what is asked on it."""

    workload: str
    size: Size
    cost: NDArray[np.float32]
    """(H, W) traversability cost."""
    queries: tuple[Query, ...]
    """Start and goal both passable; whether they are connected is not known yet."""


@dataclass(frozen=True)
class TerrainSuite:
    """Random crops of terrain files, with random queries.

    The same settings give the same cases on any machine. A workload's crops and queries do not depend on
    which other workloads and sizes are asked for.
    """

    terrain: tuple[Path, ...]
    workloads: tuple[str, ...] = ("soft",)
    sizes: tuple[Size, ...] = (256,)
    seed: int = 1
    rescale: float | None = None
    """Side of a cell in metres that the terrain is rescaled to, its slopes kept."""
    cell_size: float | None = None
    least_distance: float = 0.35
    """Between start and goal, as a share of the map's longer side."""

    def load(self) -> list[Dem]:
        """Read the terrain files; InvalidQueryError where a file is smaller than a size asked for."""
        dems = []
        rows, cols = (max(side) for side in zip(*map(shape_of, self.sizes), strict=True))
        for path in self.terrain:
            dem = read_dem(path, cell_size_m=self.cell_size)
            if dem.elevation.shape[0] < rows or dem.elevation.shape[1] < cols:
                raise InvalidQueryError(
                    f"{path}: wanted terrain of at least {rows} × {cols} cells, got {dem.elevation.shape}"
                )
            dems.append(dem if self.rescale is None else dem.rescaled(self.rescale))
        return dems

    def cases(self, dems: Sequence[Dem], name: str, size: Size) -> Iterator[Case]:
        """Cases of one workload and size, without end; InvalidQueryError if the terrain has no fitting query."""
        limits, (rows, cols) = workload(name), shape_of(size)
        rng = np.random.default_rng([self.seed, *dict.fromkeys((rows, cols))])

        def cost() -> NDArray[np.float32]:
            dem = dems[int(rng.integers(len(dems)))]
            row = int(rng.integers(0, dem.elevation.shape[0] - rows + 1))
            col = int(rng.integers(0, dem.elevation.shape[1] - cols + 1))
            crop = dem.elevation[row : row + rows, col : col + cols]
            return traversability_cost(crop, dem.cell_size_m, limits, cell_width_m=dem.cell_width_m, warn=False)

        yield from _with_queries(name, size, cost, rng, self.least_distance)


def synthetic_cases(name: str, size: Size, seed: int, least_distance: float = 0.35) -> Iterator[Case]:
    """Cases on fractal and cratered ground (`synthetic_terrain`), as of `TerrainSuite`, for what no file holds."""
    limits, (rows, cols) = workload(name), shape_of(size)
    rng = np.random.default_rng([seed, *dict.fromkeys((rows, cols))])

    def cost() -> NDArray[np.float32]:
        heights = synthetic_terrain(rng, max(rows, cols), SYNTHETIC_CELL_M)[:rows, :cols]
        return traversability_cost(heights, SYNTHETIC_CELL_M, limits, warn=False)

    yield from _with_queries(name, size, cost, rng, least_distance)


def _with_queries(
    name: str, size: Size, cost: Callable[[], NDArray[np.float32]], rng: np.random.Generator, least_distance: float
) -> Iterator[Case]:
    """Map after map with random queries; InvalidQueryError where many maps in a row have no fitting one."""
    rows, cols = shape_of(size)
    least = least_distance * max(rows, cols)
    while True:
        for _ in range(_TRIES):
            of_map = cost()
            wanted = (random_query(rng, of_map, least) for _ in range(QUERIES_PER_MAP))
            queries = tuple(query for query in wanted if query is not None)
            if queries:
                yield Case(name, size, of_map, queries)
                break
        else:
            raise InvalidQueryError(
                f"no two passable cells {least:.0f} apart were found in {_TRIES} maps of {rows} × {cols} "
                f"for the workload {name}"
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
