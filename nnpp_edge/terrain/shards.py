"""A data set's recipe, and the making of one shard by it: random maps of some terrain, and their
labels.
"""

import io
import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Annotated, TypeVar

import msgspec
import numpy as np
from numpy.random import Generator

from nnpp_edge.runtime.arrays import Array, Float2D, in_blocks
from nnpp_edge.runtime.errors import DataSetError
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.network.encoding import Frame, map_planes
from nnpp_edge.runtime.terrain.step_cost import PAPER_OMEGA, StepModel
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.georeference import LEAST_SIDE_M, MOST_SIDE_M
from nnpp_edge.terrain.known import KnownMaps, known_map
from nnpp_edge.terrain.labels import label_queries, random_points
from nnpp_edge.terrain.synthetic import synthetic_terrain
from nnpp_edge.terrain.workloads import SOFT, workload

WORKLOADS = (
    ("soft", 0.45),
    ("limit25", 0.05),
    ("limit20", 0.2),
    ("limit15", 0.2),
    ("limit12", 0.1),
)
_WHOLE = (0.0, 1.0)
BARREN_MAPS = 100
"""Maps of the terrain without a query, one after another, after which a shard is given up."""
_SIZE_STEP = 32
"""Of the network's side, so that the labels' blocks fill whole bytes."""
_ARRAYS = ("planes", "workload", "pooling", "map_index", "start", "goal", "excess", "on_path")
"""Of a shard: of each map, then of each query."""
Tiles = Sequence[Dem]
T = TypeVar("T")


Count = Annotated[int, msgspec.Meta(ge=1)]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Weight = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
Side = Annotated[float, msgspec.Meta(ge=LEAST_SIDE_M, le=MOST_SIDE_M)]


class Recipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All that decides what a data set holds. The same recipe makes the same shards on any machine.

    msgspec checks its numbers where it is read or converted; DataSetError where they do not go
    together.
    """

    terrain: tuple[str, ...]
    """Elevation files; without any, all terrain is synthetic."""
    maps: Count = 4096
    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    size: Annotated[int, msgspec.Meta(ge=_SIZE_STEP, multiple_of=_SIZE_STEP)] = 256
    """Side of the network's input, in cells."""
    blocks: Annotated[int, msgspec.Meta(ge=8, multiple_of=8)] = 64
    """The labels' excess is given on blocks × blocks."""
    points_per_map: Annotated[int, msgspec.Meta(ge=2)] = 4
    """Queries are all pairs of these."""
    maps_per_shard: Count = 64
    synthetic_share: Share = 0.25
    obstacle_share: Share = 0.3
    """Share of maps with rectangles of cost 1."""
    margin_share: Share = 0.15
    """Share of maps of which part is left outside, as maps that are not square are seen."""
    workloads: tuple[tuple[str, Weight], ...] = WORKLOADS
    """Name and share of each; ``soft`` are the limits as they are."""
    cell_sizes_m: tuple[Side, ...] = (20.0, 10.0, 5.0, 2.0, 1.0)
    """The terrain is taken as self-similar and rescaled to one of these; without any, it stays as
    it is.
    """
    poolings: tuple[tuple[Count, Weight], ...] = ((1, 0.6), (2, 0.32), (4, 0.08))
    """How many map cells to an input cell's side, and the share of maps: large maps are seen
    averaged.
    """
    least_distance: Share = 0.125
    """Between start and goal, as a share of the map's side."""
    omega: Annotated[float, msgspec.Meta(gt=0.0, le=1e9)] = PAPER_OMEGA
    limits: dict[str, float] = {}
    """Fields of `Traversability` that are not its defaults: the user's own limits."""
    stripe: tuple[Share, Share] = _WHOLE
    """The part of each file that is used: from where to where on its longer side, as
    shares of it.
    """
    cell_size_m: float | None = None
    """See `read_dem`."""
    known: bool = False
    """Whether maps are known by the means of their blocks, and what lies unseen is learned:
    `size` blocks of `poolings` cells to a side (`terrain.known`)."""

    def __post_init__(self) -> None:
        drawn = [sum(share for _, share in each) for each in (self.poolings, self.workloads)]
        start, end = self.stripe
        checks = {
            f"blocks must divide {self.size}, got {self.blocks}": self.size % self.blocks == 0,
            "shares must be above 0": min(drawn) > 0.0,
            f"a stripe must have a width, got {self.stripe}": start < end,
            "synthetic terrain needs a cell size": self.cell_sizes_m or self.terrain,
        }
        for wanted, fits in checks.items():
            if not fits:
                raise DataSetError(wanted)
        for name, _ in self.workloads:
            self.limits_of(name)

    def limits_of(self, name: str) -> Traversability:
        """The limits of a workload on top of the user's own."""
        try:
            return workload(name, Traversability(**self.limits))
        except (TypeError, ValueError) as error:
            raise DataSetError(
                f"wanted limits of slope, roughness and step, got {self.limits} {name!r}"
            ) from error

    @property
    def common_limits(self) -> Traversability:
        """The limits that all maps have: those of the only workload, or the user's own, which
        several add to.
        """
        return self.limits_of(self.workloads[0][0] if len(self.workloads) == 1 else SOFT)

    @property
    def shards(self) -> int:
        """Number of files."""
        return math.ceil(self.maps / self.maps_per_shard)


def read_terrain(recipe: Recipe) -> list[Dem]:
    """Read the parts of the recipe's elevation files that it uses.

    Raises TerrainError for one that cannot be read, DataSetError for one that is too small for the
    recipe's smallest maps.
    """
    tiles = []
    factor = min(pooling for pooling, share in recipe.poolings if share)
    least = recipe.size * factor
    for name in recipe.terrain:
        dem = stripe_of(read_dem(name, recipe.cell_size_m), recipe.stripe)
        rows, cols = dem.shape
        side = min(rows, cols)
        if side < least:
            option = "--known" if recipe.known else "--size"
            fits = side // recipe.size if recipe.known else side // _SIZE_STEP * _SIZE_STEP
            hint = f": {option} {fits} is the largest that fits" if fits else ""
            stripe = (
                "" if recipe.stripe == _WHOLE else " in the stripe that --validation-share leaves"
            )
            raise DataSetError(
                f"{dem.source}: wanted at least {least} cells on the shorter side{stripe}, got "
                f"{rows} × {cols}{hint}"
            )
        tiles.append(dem)
    return tiles


def poolings(recipe: Recipe, tiles: Tiles) -> list[tuple[int, float]]:
    """The poolings, and their shares, of which some tile has room for a map."""
    room = max((min(dem.shape) for dem in tiles), default=math.inf)
    return [each for each in recipe.poolings if recipe.size * each[0] <= room]


def stripe_of(dem: Dem, stripe: tuple[float, float]) -> Dem:
    """The part of an elevation map between two shares of its longer side."""
    rows, cols = dem.shape
    first, last = (round(share * max(rows, cols)) for share in stripe)
    part = dem.elevation[first:last] if rows >= cols else dem.elevation[:, first:last]
    return replace(dem, elevation=np.ascontiguousarray(part), georeference=None)


def shard_content(recipe: Recipe, tiles: Tiles, index: int) -> bytes:
    """Make the file of shard number `index` (.npz), which recipe, terrain and number determine."""
    maps = min(recipe.maps_per_shard, recipe.maps - index * recipe.maps_per_shard)
    key = [recipe.seed, index]
    if recipe.stripe[0] != 0.0:  # else synthetic maps repeat
        key.append(1)
    make = make_known_shard if recipe.known else make_shard
    content = io.BytesIO()
    arrays = make(recipe, tiles, np.random.default_rng(key), maps)
    # numpy's stub takes `allow_pickle` for one of them
    np.savez(content, **arrays)  # type: ignore[arg-type]
    return content.getvalue()


def make_shard(
    recipe: Recipe,
    tiles: Tiles,
    rng: Generator,
    maps: int,
) -> dict[str, Array]:
    """The arrays of one shard: those of `Samples`, and for each map its workload and its pooling.

    DataSetError where `BARREN_MAPS` in a row have no query.
    """
    fitting = poolings(recipe, tiles)
    model = StepModel.of("paper", recipe.omega)
    blocks = recipe.blocks
    barren = 0
    made: list[tuple[object, ...]] = []
    queries: list[tuple[object, ...]] = []
    while len(made) < maps:
        name = _pick(rng, recipe.workloads)
        pooling = _pick(rng, fitting)
        cost, measured = _random_cost(recipe, tiles, rng, name, recipe.size * pooling)
        side = len(cost)
        least = recipe.least_distance * side
        points = random_points(rng, cost, recipe.points_per_map)
        labelled = label_queries(cost, points, least, blocks, recipe.omega)
        if not labelled:
            barren += 1
            if barren == BARREN_MAPS:
                where = ", ".join(str(dem.source) for dem in tiles) or "synthetic terrain"
                wanted = f"wanted connected passable cells {least:.0f} cells apart"
                raise DataSetError(f"{where}: {wanted}, got none on {barren} maps in a row")
            continue
        if measured or not tiles:
            barren = 0
        frame = Frame(side, side, recipe.size)
        for start, goal, path, excess in labelled:
            crossed = np.zeros((blocks, blocks), bool)
            crossed[tuple((path * blocks // side).T)] = True
            ends = np.array([frame.place(start), frame.place(goal)], np.float32)
            queries.append((np.int32(len(made)), *ends, excess, np.packbits(crossed, axis=-1)))
        planes = np.rint(planes_of(Grid.of(cost, model), frame) * 255.0).astype(np.uint8)
        made.append((planes, name, np.int32(pooling)))
    columns = (*zip(*made, strict=True), *zip(*queries, strict=True))
    return dict(zip(_ARRAYS, map(np.array, columns), strict=True))


def make_known_shard(
    recipe: Recipe,
    tiles: Tiles,
    rng: Generator,
    maps: int,
) -> dict[str, Array]:
    """Make the arrays of one shard of maps that are known by their blocks."""
    fitting = poolings(recipe, tiles)
    made = []
    for _ in range(maps):
        limits = recipe.limits_of(_pick(rng, recipe.workloads))
        factor = _pick(rng, fitting)
        elevation, size_m, width_m, _ = _random_ground(recipe, tiles, rng, recipe.size * factor)
        cost = traversability_cost(elevation, size_m, limits, cell_width_m=width_m, warn=False)
        made.append(known_map(elevation, cost, size_m, limits, factor))
    names = [field.name for field in fields(KnownMaps)]
    return dict(zip(names, map(np.array, zip(*made, strict=True)), strict=True))


def _random_ground(
    recipe: Recipe,
    tiles: Tiles,
    rng: Generator,
    side: int,
) -> tuple[Float2D, float, float, bool]:
    """Square terrain, a cell's size and width; whether it is from a file."""
    given_m = float(rng.choice(recipe.cell_sizes_m)) if recipe.cell_sizes_m else None
    if tiles and rng.random() >= recipe.synthetic_share:
        return *_random_crop(tiles, rng, side, given_m, finely=recipe.known), True
    size_m = given_m or tiles[0].cell_size_m
    return synthetic_terrain(rng, side, size_m), size_m, size_m, False


def planes_of(grid: Grid, frame: Frame) -> Float2D:
    """(2, S, S) mean cost and share of impassable cells of a map."""
    planes = np.empty((2, frame.size, frame.size), np.float32)
    map_planes(grid, frame, planes)
    return planes


def _pick(rng: Generator, shares: Sequence[tuple[T, float]]) -> T:
    """One of the values, each as often as its share says."""
    weights = np.array([share for _, share in shares])
    return shares[rng.choice(len(shares), p=weights / weights.sum())][0]


def _random_cost(
    recipe: Recipe,
    tiles: Tiles,
    rng: Generator,
    name: str,
    side: int,
) -> tuple[Float2D, bool]:
    """A square cost map, with obstacles and a margin on a share of the maps; whether its terrain is
    from a file.
    """
    elevation, size_m, width_m, measured = _random_ground(recipe, tiles, rng, side)
    limits = recipe.limits_of(name)
    cost = traversability_cost(elevation, size_m, limits, cell_width_m=width_m, warn=False)
    if rng.random() < recipe.obstacle_share:
        least = np.log(max(side / 64, 1.0))
        for _ in range(rng.integers(1, 9)):
            sides = np.exp(rng.uniform(least, np.log(side / 3), 2)).astype(int)
            corner = [rng.integers(-length // 2, side - length // 2) for length in sides]
            down, across = (
                slice(max(at, 0), at + length) for at, length in zip(corner, sides, strict=True)
            )
            cost[down, across] = np.inf
    if rng.random() < recipe.margin_share:
        cost[int(side * rng.uniform(0.25, 0.95)) :] = np.inf
    return cost, measured


def _random_crop(
    tiles: Tiles,
    rng: Generator,
    side: int,
    cell_size_m: float | None,
    *,
    finely: bool,
) -> tuple[Float2D, float, float]:
    """Part of a random tile: elevation, and a cell's size and width.

    With a cell size it is averaged where the tile allows it (`finely`: seldom), and rescaled with
    its slopes kept.
    """
    # a tile, the larger the likelier
    tiles = [dem for dem in tiles if min(dem.shape) >= side]
    areas = np.array([dem.elevation.size for dem in tiles], np.float64)
    chosen = rng.choice(len(tiles), p=areas / areas.sum())
    dem = tiles[int(chosen)]

    # how many of its cells are averaged
    factors = (1, 2, 4) if cell_size_m else (1,)
    fits = [factor for factor in factors if side * factor <= min(dem.shape)]
    shares = 1.0 / np.array(fits)
    factor = int(rng.choice(fits, p=shares / shares.sum() if finely else None))

    # where it is cut out
    crop = dem.random_square(rng, side * factor)
    averaged: Float2D = in_blocks(crop, factor).mean(axis=(1, 3))
    if cell_size_m is None:
        return averaged, dem.cell_size_m, dem.cell_width_m
    scale = np.float32(cell_size_m / (dem.cell_size_m * factor))
    return averaged * scale, cell_size_m, cell_size_m * (dem.cell_width_m / dem.cell_size_m)
