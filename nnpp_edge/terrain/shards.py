"""A data set's recipe, and the making of one shard by it: random maps of some terrain, and their labels."""

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.map.step_cost import PAPER_OMEGA, StepModel
from nnpp_edge.runtime.network.encoding import Frame, map_planes
from nnpp_edge.runtime.terrain.traversability import traversability_cost
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.labels import label_queries, random_points
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.terrain.workloads import workload

WORKLOADS = (("soft", 0.45), ("limit25", 0.05), ("limit20", 0.2), ("limit15", 0.2), ("limit12", 0.1))
T = TypeVar("T")


class Recipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All that decides what a data set holds. The same recipe makes the same shards on any machine."""

    terrain: tuple[str, ...]
    """Elevation files; without any, all terrain is synthetic."""
    maps: int = 4096
    seed: int = 1
    size: int = 256
    """Side of the network's input, in cells."""
    blocks: int = 64
    """The labels' excess is given on blocks × blocks."""
    points_per_map: int = 4
    """Queries are all pairs of these."""
    maps_per_shard: int = 64
    synthetic_share: float = 0.25
    obstacle_share: float = 0.3
    """Share of maps with rectangles of cost 1."""
    margin_share: float = 0.15
    """Share of maps of which part is left outside, as maps that are not square are seen."""
    workloads: tuple[tuple[str, float], ...] = WORKLOADS
    """Name and share of each."""
    cell_sizes_m: tuple[float, ...] = (20.0, 10.0, 5.0, 2.0, 1.0)
    """The terrain is taken as self-similar and rescaled to one of these."""
    poolings: tuple[tuple[int, float], ...] = ((1, 0.6), (2, 0.32), (4, 0.08))
    """How many map cells to an input cell's side, and the share of maps: large maps are seen averaged."""
    least_distance: float = 0.125
    """Between start and goal, as a share of the map's side."""
    omega: float = PAPER_OMEGA

    @property
    def shards(self) -> int:
        """Number of files."""
        return math.ceil(self.maps / self.maps_per_shard)


def read_terrain(recipe: Recipe) -> list[Dem]:
    """The recipe's elevation files; TerrainError for one that cannot be read."""
    return [read_dem(Path(name)) for name in recipe.terrain]


def shard_content(recipe: Recipe, tiles: Sequence[Dem], index: int) -> bytes:
    """The file of shard number `index` (.npz), which recipe, terrain and number alone determine."""
    maps = min(recipe.maps_per_shard, recipe.maps - index * recipe.maps_per_shard)
    content = io.BytesIO()
    arrays = make_shard(recipe, tiles, np.random.default_rng([recipe.seed, index]), maps)
    np.savez(content, **arrays)  # type: ignore[arg-type]  # numpy's stub takes `allow_pickle` for one of them
    return content.getvalue()


def make_shard(
    recipe: Recipe, tiles: Sequence[Dem], rng: np.random.Generator, maps: int
) -> dict[str, NDArray[np.generic]]:
    """The arrays of one shard: those of `Samples`, and for each map its workload and its pooling."""
    planes: list[NDArray[np.uint8]] = []
    names, poolings = [], []
    index, start, goal, excess, on_path = [], [], [], [], []
    while len(planes) < maps:
        name = _pick(rng, recipe.workloads)
        pooling = _pick(rng, recipe.poolings)
        cost = _random_cost(recipe, tiles, rng, name, recipe.size * pooling)
        points = random_points(rng, cost, recipe.points_per_map)
        least = recipe.least_distance * cost.shape[0]
        labelled = label_queries(cost, points, least, recipe.blocks, recipe.omega)
        if not labelled:
            continue
        frame = Frame(cost.shape[0], cost.shape[1], recipe.size)
        for label in labelled:
            crossed = np.zeros((recipe.blocks, recipe.blocks), bool)
            crossed[tuple((label.path * recipe.blocks // cost.shape[0]).T)] = True
            index.append(len(planes))
            start.append(frame.place(label.start))
            goal.append(frame.place(label.goal))
            excess.append(label.excess)
            on_path.append(np.packbits(crossed, axis=-1))
        planes.append(_seen_by_network(cost, frame, recipe.omega))
        names.append(name)
        poolings.append(pooling)
    return {
        "planes": np.stack(planes),
        "workload": np.array(names),
        "pooling": np.array(poolings, np.int32),
        "map_index": np.array(index, np.int32),
        "start": np.array(start, np.float32),
        "goal": np.array(goal, np.float32),
        "excess": np.stack(excess),
        "on_path": np.stack(on_path),
    }


def _seen_by_network(cost: NDArray[np.float32], frame: Frame, omega: float) -> NDArray[np.uint8]:
    """The map's two planes (2, S, S), in 255ths."""
    grid = Grid.of(cost, StepModel.of("paper", omega))
    planes = np.empty((2, frame.size, frame.size), np.float32)
    map_planes(grid.weights, grid.stride, frame, *grid.as_traversability(), planes)
    return np.asarray(np.rint(planes * 255.0), np.uint8)


def _pick(rng: np.random.Generator, shares: Sequence[tuple[T, float]]) -> T:
    """One of the values, each as often as its share says."""
    weights = np.array([share for _, share in shares])
    return shares[rng.choice(len(shares), p=weights / weights.sum())][0]


def _random_cost(
    recipe: Recipe, tiles: Sequence[Dem], rng: np.random.Generator, name: str, side: int
) -> NDArray[np.float32]:
    """A square cost map of some terrain, with obstacles and a margin on a share of the maps."""
    cell_size_m = float(rng.choice(recipe.cell_sizes_m))
    if not tiles or rng.random() < recipe.synthetic_share:
        dem = synthetic_terrain(rng, side, cell_size_m)
    else:
        dem = _random_crop(tiles, rng, side, cell_size_m)
    cost = traversability_cost(dem, cell_size_m, workload(name), warn=False)
    if rng.random() < recipe.obstacle_share:
        for _ in range(rng.integers(1, 9)):
            rows, cols = np.exp(rng.uniform(np.log(max(side / 64, 1.0)), np.log(side / 3), 2)).astype(int)
            row, col = rng.integers(-rows // 2, side - rows // 2), rng.integers(-cols // 2, side - cols // 2)
            cost[max(row, 0) : row + rows, max(col, 0) : col + cols] = np.inf
    if rng.random() < recipe.margin_share:
        kept = int(side * rng.uniform(0.25, 0.95))
        cost[kept:] = np.inf
    return cost


def _random_crop(
    tiles: Sequence[Dem], rng: np.random.Generator, side: int, cell_size_m: float
) -> NDArray[np.float32]:
    """Part of a random tile, averaged where the tile allows it, rescaled with its slopes kept."""
    areas = np.array([dem.elevation.size for dem in tiles], np.float64)
    dem = tiles[int(rng.choice(len(tiles), p=areas / areas.sum()))]
    fits = [f for f in (1, 2, 4) if side * f <= min(dem.elevation.shape)]
    if not fits:
        raise DataSetError(
            f"{dem.source}: wanted at least {side} cells on the shorter side, got {dem.elevation.shape}"
        )
    factor = int(rng.choice(fits))
    row, col = (int(rng.integers(0, n - side * factor + 1)) for n in dem.elevation.shape)
    crop = dem.elevation[row : row + side * factor, col : col + side * factor]
    averaged: NDArray[np.float32] = crop.reshape(side, factor, side, factor).mean(axis=(1, 3))
    return averaged * np.float32(cell_size_m / (dem.cell_size_m * factor))
