"""Maps that a passage network learns from: rough ground of many kinds, a vehicle, and which of its poses pass.

Cells have a side of 1: a vehicle's lengths and all heights are in cells.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import DataSetError, InvalidMapError
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.crossing import costs_of_crossing
from nnpp_edge.runtime.map.poses import pose_costs
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.network.passage import unsuited
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.rocks import MOST_COVER, with_rocks
from nnpp_edge.terrain.synthetic import add_craters, fractal


class PassageRecipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All that decides what a data set for passage networks holds, as `Recipe` does of those for others.

    Raises DataSetError where a number is out of range.
    """

    terrain: tuple[str, ...]
    """Elevation files; without any, all terrain is synthetic."""
    maps: int = 4096
    seed: int = 1
    size: int = 128
    """Side of a map, in cells."""
    maps_per_vehicle: int = 4
    maps_per_shard: int = 256
    stripe: tuple[float, float] = (0.0, 1.0)
    """The part of each file that is used: from where to where on its longer side, as shares of it."""
    vehicle: dict[str, float] = {}
    """Fields of the only vehicle; without, each is drawn from the range that networks are made for."""
    vehicle_cell_m: float = 0.0
    """Side of the cells that the only vehicle stands on."""
    cell_size_m: float | None = None
    """As for `read_dem`; so are the next two."""
    vertical_scale: float | None = None
    allow_vrt: bool = False

    def __post_init__(self) -> None:
        counts = self.maps, self.maps_per_vehicle, self.maps_per_shard
        start, end = self.stripe
        conditions = {
            f"size must be a multiple of 32, got {self.size}": self.size > 0 == self.size % 32,
            "numbers of maps must be above 0": min(counts) > 0 <= self.seed,
            "maps of a shard must be a multiple of a vehicle's": self.maps_per_shard % self.maps_per_vehicle == 0,
            f"a stripe must lie in [0, 1], got {self.stripe}": 0.0 <= start < end <= 1.0,
            "a vehicle needs the cells' size": not self.vehicle or 0.0 < self.vehicle_cell_m < math.inf,
        }
        for wanted, met in conditions.items():
            if not met:
                raise DataSetError(wanted)
        if self.vehicle and (problem := unsuited(self.only_vehicle(), (1.0, 1.0))):
            raise DataSetError(f"a passage network {problem}")

    @property
    def shards(self) -> int:
        """Number of files."""
        return math.ceil(self.maps / self.maps_per_shard)

    def only_vehicle(self) -> Vehicle:
        """The vehicle, in cells; DataSetError where the fields make none."""
        lengths = {k: v / self.vehicle_cell_m if k.endswith("_m") else v for k, v in self.vehicle.items()}
        try:
            return msgspec.convert(lengths, Vehicle, strict=False)
        except (InvalidMapError, msgspec.ValidationError) as error:
            raise DataSetError(f"wanted a vehicle, got {self.vehicle}: {error}") from error


CELL_SIZES_M = 0.1, 1.0
"""Of the cells whose rocks are drawn: their sizes follow a law in metres."""


def random_vehicle(rng: np.random.Generator) -> Vehicle:
    """A vehicle within the range that networks are trained for, in cells."""
    length = rng.uniform(2.8, 8.4)
    width = length * rng.uniform(0.5, 1.05)
    long, wide = (side * _between(rng, 0.04, 0.3) for side in (length, width))
    base, track = (
        (most - wheel) * (1.0 if rng.random() < 0.25 else rng.uniform(0.5, 1.0))
        for most, wheel in ((length, long), (width, wide))
    )
    clearance = length * _between(rng, 0.08, 0.35)
    step = clearance * (1.0 if rng.random() < 0.3 else _between(rng, 0.5, 1.5))
    tilt = math.degrees(math.atan(_between(rng, 0.21, 0.73)))
    pitch, roll = (_below(tilt, 1.0 if rng.random() < 0.7 else rng.uniform(0.5, 1.0)) for _ in range(2))
    axles = int(rng.integers(2, 5))
    return Vehicle(length, width, clearance, tilt, pitch, roll, step, axles, base, track, long, wide)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is as likely anywhere between these two's."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _below(tilt_deg: float, share: float) -> float:
    """The angle whose gradient is this share of another's."""
    return math.degrees(math.atan(share * math.tan(math.radians(tilt_deg))))


def random_ground(rng: np.random.Generator, tiles: Sequence[Dem], side: int, vehicle: Vehicle) -> Float2D:
    """(side, side) float32 heights in cells, NaN where unknown."""
    steepest = math.degrees(math.atan(math.tan(math.radians(vehicle.tilts_deg[2]))))
    if tiles and rng.random() < 0.75:
        ground = _crop(rng, tiles, side) * np.float32(_between(rng, 0.3, 1.4))
    else:
        ground = fractal(rng, side, 1.0, steepest * rng.uniform(0.05, 0.5))
    if rng.random() < 0.55:
        ground = ground + _patchy(rng, fractal(rng, side, 1.0, steepest * math.exp(rng.uniform(-4.0, -1.2))))
    if rng.random() < 0.15:
        ground = add_craters(rng, ground, 1.0, int(rng.integers(1, 12)))
    if rng.random() < 0.12:
        ground = ground + _ledges(rng, side, vehicle.step_m)
    if rng.random() < 0.65:
        cell_m = _between(rng, *CELL_SIZES_M)
        ground = with_rocks(ground * np.float32(cell_m), cell_m, MOST_COVER * rng.random(), rng) / np.float32(cell_m)
    if rng.random() < 0.08:
        ground = _with_holes(rng, ground)
    return np.ascontiguousarray(ground, np.float32)


def _crop(rng: np.random.Generator, tiles: Sequence[Dem], side: int) -> Float2D:
    """Part of a random tile in cells, averaged by 1, 2 or 4."""
    fits = [dem for dem in tiles if min(dem.elevation.shape) >= side]
    dem = fits[int(rng.integers(len(fits)))]
    factor = int(rng.choice([f for f in (1, 2, 4) if side * f <= min(dem.elevation.shape)]))
    row, col = (int(rng.integers(0, n - side * factor + 1)) for n in dem.elevation.shape)
    crop = dem.elevation[row : row + side * factor, col : col + side * factor]
    averaged: Float2D = crop.reshape(side, factor, side, factor).mean(axis=(1, 3), dtype=np.float32)
    averaged /= np.float32(dem.cell_size_m * factor)
    return averaged


def _patchy(rng: np.random.Generator, heights: Float2D) -> Float2D:
    """Roughness that comes and goes over the map, on half of the maps."""
    if rng.random() < 0.5:
        return heights
    where = fractal(rng, heights.shape[0], 1.0, 1.0)
    share = (where - where.min()) / max(float(np.ptp(where)), 1e-6)
    strength: Float2D = np.clip(2.0 * share - 0.5, 0.0, 1.0).astype(np.float32)
    return heights * strength


def _ledges(rng: np.random.Generator, side: int, step: float) -> Float2D:
    """Ground that rises by a step wherever a smooth field passes a height."""
    field = fractal(rng, side, 1.0, 5.0)
    levels = np.quantile(field, rng.random(int(rng.integers(1, 5))))
    heights = rng.uniform(0.3, 2.0, len(levels)) * step
    return sum((np.float32(h) * (field > level) for h, level in zip(heights, levels, strict=True)), 0.0 * field)


def _with_holes(rng: np.random.Generator, ground: Float2D) -> Float2D:
    """The same, unknown in a few places or beyond a line."""
    side, out = ground.shape[0], ground.copy()
    if rng.random() < 0.3:
        out[int(side * rng.uniform(0.5, 0.95)) :] = np.nan
    for _ in range(int(rng.integers(1, 30))):
        row, col = rng.integers(0, side, 2).tolist()
        rows, cols = rng.integers(1, 12, 2).tolist()
        out[row : row + rows, col : col + cols] = np.nan
    return out


class BlockLabels(NamedTuple):
    """What the dense check says of the blocks of a map of (H, W) cells, H and W multiples of 4."""

    passing: NDArray[np.uint8]
    """(4, H / 4, W / 4) how many of a block's 16 poses of each heading pass."""
    cost: NDArray[np.uint8]
    """(4, H / 4, W / 4) the mean T of those, in 255ths; 0 where none passes."""
    link: NDArray[np.uint8]
    """(4, H / 4, W / 4) the mean T of the way to the next block along each heading, in 127ths, up to 2; 255 where
    there is no way. Detours count as dearer ground."""


CLOSED = 255
"""Of a link: that there is none."""
LINK_STEPS = 127.0
"""To a T of 1, of links."""


def block_labels(heights: Float2D, vehicle: Vehicle) -> BlockLabels:
    """Of a map of heights in cells: every pose is checked."""
    costs = pose_costs(heights, 1.0, vehicle)
    rows, cols = (n // FACTOR for n in heights.shape)
    blocks = costs.reshape(4, rows, FACTOR, cols, FACTOR).transpose(0, 1, 3, 2, 4).reshape(4, rows, cols, -1)
    passes = np.isfinite(blocks)
    passing = passes.sum(-1)
    total = np.where(passes, blocks, np.float32(0.0)).sum(-1)
    mean = total / np.maximum(passing, 1)
    return BlockLabels(passing.astype(np.uint8), np.rint(255.0 * mean).astype(np.uint8), _links(costs))


def _links(costs: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The label of that name."""
    weight = np.float32(StepModel.of("paper").scale)
    crossing = costs_of_crossing(costs, float(weight))
    codes = np.rint(LINK_STEPS * (np.where(np.isfinite(crossing), crossing, 1.0) - 1.0) / (2.0 * weight))
    return np.where(np.isfinite(crossing), np.clip(codes, 0, CLOSED - 1), CLOSED).astype(np.uint8)


LENGTHS = 12
"""Numbers in which a stored vehicle is kept."""


def as_stored(vehicle: Vehicle) -> NDArray[np.float64]:
    """(12,) a vehicle in cells, for a shard."""
    pitch, roll, tilt = vehicle.tilts_deg
    return np.array(
        (
            vehicle.length_m,
            vehicle.width_m,
            vehicle.clearance_m,
            tilt,
            pitch,
            roll,
            vehicle.step_m,
            vehicle.axles,
            *vehicle.stance_m,
            *vehicle.contact_m,
        )
    )


def of_stored(numbers: NDArray[np.float64]) -> Vehicle:
    """The vehicle of such numbers."""
    *sizes, axles, base, track, long, wide = numbers.tolist()
    length, width, clearance, tilt, pitch, roll, step = sizes
    return Vehicle(length, width, clearance, tilt, pitch, roll, step, int(axles), base, track, long, wide)


def make_passage_shard(
    recipe: PassageRecipe, tiles: Sequence[Dem], rng: np.random.Generator, maps: int
) -> dict[str, NDArray[np.generic]]:
    """The arrays of a shard, by name: maps in the order of their vehicles."""
    heights, scales, numbers, labels = [], [], [], []
    for n in range(maps):
        if n % recipe.maps_per_vehicle == 0:
            vehicle = recipe.only_vehicle() if recipe.vehicle else random_vehicle(rng)
        stored, scale, found = _labelled(random_ground(rng, tiles, recipe.size, vehicle), vehicle)
        heights.append(stored)
        scales.append(scale)
        labels.append(found)
        numbers.append(as_stored(vehicle))
    return {
        "heights": np.stack(heights),
        "scale": np.array(scales, np.float32),
        "vehicle": np.stack(numbers),
        **{name: np.stack([getattr(each, name) for each in labels]) for name in BlockLabels._fields},
    }


def check_passage_shard(shard: Mapping[str, NDArray[np.generic]], recipe: PassageRecipe) -> None:
    """KeyError or ValueError where a shard's arrays are not those that the recipe makes."""
    maps, side, blocks = len(shard["heights"]), recipe.size, recipe.size // FACTOR
    labels = dict.fromkeys(BlockLabels._fields, ((maps, 4, blocks, blocks), "u1"))
    wanted = {
        "heights": ((maps, side, side), "i2"),
        "scale": ((maps,), "f4"),
        "vehicle": ((maps, LENGTHS), "f8"),
        **labels,
    }
    for name, (shape, dtype) in wanted.items():
        if shard[name].shape != shape or shard[name].dtype != np.dtype(dtype):
            raise ValueError(f"{name} is {shard[name].shape} {shard[name].dtype}, not {shape} {np.dtype(dtype)}")
    for vehicle in np.unique(shard["vehicle"], axis=0):
        of_stored(vehicle.astype(np.float64))


_NOWHERE = -32768
_BARREN, _TRIES = 0.05, 3
"""Share of passing poses below which heights are halved, and how often."""


def _labelled(ground: Float2D, vehicle: Vehicle) -> tuple[NDArray[np.int16], float, BlockLabels]:
    """Packed heights and their labels; ground on which hardly a pose passes is flattened first."""
    for _ in range(_TRIES):
        stored, scale = packed_heights(ground)
        labels = block_labels(unpacked_heights(stored, scale), vehicle)
        if labels.passing.mean() >= 16 * _BARREN:
            break
        ground = ground * np.float32(0.5)
    return stored, scale, labels


def packed_heights(heights: Float2D) -> tuple[NDArray[np.int16], float]:
    """Heights around their middle in int16, and how many cells a step of these is; -32768 is unknown."""
    known = heights[np.isfinite(heights)]
    if known.size == 0:
        return np.full(heights.shape, _NOWHERE, np.int16), 1.0
    middle = 0.5 * (float(known.min()) + float(known.max()))
    scale = max(float(known.max()) - middle, 1e-3) / 32767.0
    steps = np.rint((heights.astype(np.float64) - middle) / scale)
    return np.where(np.isfinite(steps), steps, _NOWHERE).astype(np.int16), scale


def unpacked_heights(stored: NDArray[np.int16], scale: float) -> Float2D:
    """Heights in cells, NaN where unknown."""
    return np.where(stored == _NOWHERE, np.float32(np.nan), stored * np.float32(scale)).astype(np.float32)
